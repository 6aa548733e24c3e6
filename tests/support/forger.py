"""Somebody on the link who hears both sides, and speaks in the name of one: runs in virtual time under attack.

He reads the incarnations and the energy messages, and sends a side energy that the other will harvest later, or
never. His frames come to that side at once; but he cannot take away those of the other.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from unittest.mock import patch

from msgspec import structs

from hapnet.assembly.build import Setup, device_session, world_session
from hapnet.params import Params
from hapnet.side.link_port import LinkPort, Packet
from hapnet.simulation.events import heard_by_device, heard_by_world
from hapnet.simulation.simulation import Simulation
from hapnet.wire.messages import Encrypted, Energy, Role, decode, encode
from hapnet.wire.secret import Secret
from hapnet.wire.session import Session

LOOK_NS = 5_000_000
NANO = 1e-9
STYLES = ("bare", "next", "far ahead", "again", "late")
"""What he makes of the further entry ``sums``: none; the next number; one far ahead; that of the other's last message.
Or he keeps frames with the next number, and sends them backwards at the end of his time."""


@dataclass(frozen=True)
class Lie:
    """What he does.

    from_s, until_s : when he speaks, in simulated time. lead_s : he sends what an honest device had sent so much
    later. more_nJ : and so much more. style : one of `STYLES`.
    """

    from_s: float
    until_s: float
    lead_s: float
    more_nJ: int
    style: str


class Keyed(Simulation):
    """A run whose sides tell each other sums.

    secrets : have both a private key? word : that both know besides.
    """

    def __init__(self, params: Params, seed: int, *, secrets: bool, word: str = "") -> None:
        def made(make: Callable[..., Session], private: bytes, setup: Setup, incarnation: int) -> Session:
            session = make(setup, incarnation, secret=Secret(private, word) if secrets else None)
            session.settings = replace(session.settings, sends_sums=True)
            return session

        module = "hapnet.simulation.simulation"
        with (
            patch(f"{module}.device_session", partial(made, device_session, b"d" * 32)),
            patch(f"{module}.world_session", partial(made, world_session, b"w" * 32)),
        ):
            super().__init__(params, seed, kernel=False)

    def port(self, role: Role) -> LinkPort:
        """The port of this side."""
        return self.world_port if role == "world" else self.device_port

    def add(self, port: LinkPort, packets: Iterable[Packet]) -> None:
        """Let the side of this port receive packets that the other side's link has not released."""
        Simulation.receive(self, port, packets)
        (heard_by_world if port is self.world_port else heard_by_device)(self)


class Attacked(Keyed):
    """A run under attack.

    lie : what the forger does; None: nothing.
    foreseen : what an honest other side had sent at a time [ns] in all [nJ].
    towards : the side that he speaks to, in the other's name.
    secrets : do the sides agree on a key? Otherwise they have only `hapnet.wire.sums`. word : that both know.
    """

    def __init__(
        self,
        params: Params,
        seed: int = 0,
        lie: Lie | None = None,
        foreseen: Callable[[int], int] = lambda now_ns: 0,
        *,
        towards: Role = "world",
        secrets: bool = False,
        word: str = "",
    ) -> None:
        self.totals: list[tuple[int, int]] = []
        """All that the other side had sent, by the time [ns, nJ]."""
        self.early_nJ = 0
        """The most that he whom the forger speaks to had credited before the other sent it."""
        self._towards = towards
        self._lie, self._foreseen = lie, foreseen
        self._heard: Energy | None = None
        self._kept: list[Packet] = []
        self._encrypted = 0
        super().__init__(params, seed, secrets=secrets, word=word)

    @property
    def deceived(self) -> Session:
        """Of the side that the forger speaks to."""
        return (self.world_endpoint if self._towards == "world" else self.device_endpoint).session

    @property
    def honest(self) -> Session:
        """Of the side in whose name he speaks."""
        return (self.device_endpoint if self._towards == "world" else self.world_endpoint).session

    def _until(self, end_ns: int) -> None:
        while self.now_ns < end_ns:
            super()._until(min(end_ns, self.now_ns + LOOK_NS))
            self.totals.append((self.now_ns, self.honest.sent_nJ))
            self._speak()
            self.early_nJ = max(self.early_nJ, self.deceived.credited_nJ - self.honest.sent_nJ)

    def receive(self, port: LinkPort, packets: Iterable[Packet]) -> None:
        super().receive(port, self._overheard("world" if port is self.world_port else "device", packets))

    def _overheard(self, towards: Role, packets: Iterable[Packet]) -> list[Packet]:
        for packet in (packets := list(packets)):
            if towards != self._towards or packet.kind != "energy":
                continue
            message = decode(packet.data)
            if isinstance(message, Encrypted):  # he knows only whose it is, and counts himself
                self._encrypted += 1
                addressee = self.deceived.identity.incarnation
                message = Energy(message.incarnation, addressee, 0, 0, {"sums": (self._encrypted, 0, 0)})
            if isinstance(message, Energy):
                self._heard = message
        return packets

    def _deceive(self, packets: Iterable[Packet]) -> None:
        self.add(self.port(self._towards), packets)

    def _speak(self) -> None:
        lie, heard, now_s = self._lie, self._heard, self.now_ns * NANO
        if lie is None or heard is None or now_s < lie.from_s:
            return
        if now_s > lie.until_s:
            self._deceive(reversed(self._kept))
            self._kept.clear()
            return
        total_nJ = max(heard.total_nJ, self._foreseen(self.now_ns + round(lie.lead_s / NANO))) + lie.more_nJ
        number, _, seen = (heard.more or {})["sums"]
        number += {"far ahead": 500, "again": 0}.get(lie.style, 1)
        more = None if lie.style == "bare" else {"sums": (number, total_nJ, seen)}
        packet = Packet("energy", encode(structs.replace(heard, total_nJ=total_nJ, acked_nJ=0, more=more)))
        if lie.style == "late":
            self._kept.append(packet)
        else:
            self._deceive([packet])
