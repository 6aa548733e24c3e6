"""The settings of one side of the protocol."""

from __future__ import annotations

from dataclasses import dataclass

from hapnet.errors import InvalidParameter
from hapnet.params import DeviceParams, WireParams
from hapnet.wire.messages import Position, Stream

_DEFAULT = WireParams()


@dataclass(frozen=True, slots=True)
class SessionSettings:
    """The settings of a session. The defaults are those of the parameters.

    accept_stale : use positions that are older than one already received (the theory of set-positions allows it).
        Otherwise only the newest counts, as always with motions and ports.
    admission_W, admission_burst_J : the energy credited to the peer in the long run [W] and at once [J].
    hello_period_ns : time between two hellos while unpaired.
    spacing_ns : minimum time between two messages with new energy.
    silence_ns : after this time without a new position the peer counts as silent.
    expects : the kind of message in the peer's stream. Waves are used even if they are late, but once each.
    sends_sums : whether energy messages hold sums, by which false senders are detected (`hapnet.wire.sums`).
    """

    accept_stale: bool = _DEFAULT.accept_stale
    admission_W: float = _DEFAULT.admission_W
    admission_burst_J: float = _DEFAULT.admission_burst_J
    hello_period_ns: int = round(_DEFAULT.hello_period_s * 1e9)
    spacing_ns: int = round(_DEFAULT.energy_spacing_s * 1e9)
    silence_ns: int = round(DeviceParams().silence_after_s * 1e9)
    expects: type[Stream] = Position
    sends_sums: bool = False

    def __post_init__(self) -> None:
        for name in ("hello_period_ns", "spacing_ns"):
            value = getattr(self, name)
            if not 1_000_000 <= value <= 10_000_000_000:
                raise InvalidParameter(name, value, "1 ms to 10 s, in ns")
        if self.silence_ns <= 0:
            raise InvalidParameter("silence_ns", self.silence_ns, "a positive number of nanoseconds")
