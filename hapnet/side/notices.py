"""Notices for the people who run a side: a peer was paired or left, a message was refused, and when."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field

from hapnet.recording.samples import Level
from hapnet.side.endpoint import NANO
from hapnet.side.punctuality import seconds
from hapnet.wire.events import (
    Contradiction,
    Event,
    Mismatch,
    Paired,
    PeerHeard,
    PeerLeft,
    PeerRefused,
    PeerSilent,
    SignalReceived,
    Unproven,
)
from hapnet.wire.fields import Signal

OVER = "the run is over"
"""The reason that a side gives when it leaves because its time is up."""


@dataclass(frozen=True)
class Notice:
    """Something that happened at `at_ns` on this machine's monotonic clock.

    kind, values : for programs. text : for people. level : its severity.
    """

    kind: str
    text: str
    at_ns: int
    level: Level = "info"
    values: Mapping[str, str | int | float] = field(default_factory=dict)


def signal_text(name: str, value: Signal) -> str:
    """A signal as text for events and logs: its name, and its value as JSON."""
    return f"{name} = {json.dumps(value)}"


def notice_of(event: Event, now_ns: int, other: str, on_silence: str) -> Notice | None:
    """Return the notice about an event of the session; None: the event needs no notice.

    other : the other side's role. on_silence : the action of this side when nothing arrives.
    """
    match event:
        case Paired(_, number, encrypts, proof, fingerprint):
            again = "" if number == 1 else f" (another process; pair {number})"
            how = ", encrypted" if encrypts else ""
            text = f"paired with the {other}{again}{how}"
            if proof == "nobody":
                text += f", key {fingerprint}; the {other} must show the same" if fingerprint else ", without a key"
                text += ": its identity is not proved"
            values: dict[str, str | int | float] = {"pair": number, **({"key": fingerprint} if fingerprint else {})}
            return Notice("paired", text, now_ns, values=values)
        case SignalReceived(name, value):
            return Notice("signal", signal_text(name, value), now_ns)
        case PeerLeft(reason):
            return Notice("left", f"the {other} left: {reason}", now_ns, values={"reason": reason})
        case Mismatch(reason):
            return Notice("refused", f"a {other} was refused: {reason}", now_ns, "error", {"reason": reason})
        case PeerRefused(reason, by_peer):
            sender = f"the {other}" if by_peer else f"a {other} that is not this side's peer"
            return Notice("refused", f"{sender} refuses this side: {reason}", now_ns, "error", {"reason": reason})
        case Unproven(reason):
            return Notice("unproven", f"a {other} is ignored: {reason}", now_ns, "warning", {"reason": reason})
        case Contradiction(kind, detail):
            text = f"another sender uses the {other}'s name ({detail}): it is not known whether this run is passive"
            return Notice("contradiction", text, now_ns, "error", {"kind": kind})
        case PeerSilent(since_ns):
            silence_s = (now_ns - since_ns) * NANO
            effect = "holding its last position" if on_silence == "hold" else "releasing the spring"
            text = f"no data from the {other} for {seconds(round(silence_s, 2))} s; {effect}"
            return Notice("silent", text, now_ns, "warning", {"since_ns": since_ns, "silence_s": silence_s})
        case PeerHeard(silence_ns, recovery_ns, missing):
            text = f"data from the {other} again after {seconds(round(silence_ns * NANO, 2))} s"
            if recovery_ns:
                text += f", {recovery_ns * 1e-6:.0f} ms after its first message"
            if missing:
                text += f"; {missing} position{' is' if missing == 1 else 's are'} missing"
            values = {"silence_s": silence_ns * NANO, "recovery_s": recovery_ns * NANO, "missing": missing}
            return Notice("heard", text, now_ns, values=values)
    return None
