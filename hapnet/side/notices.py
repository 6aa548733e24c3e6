"""Notices for the people who run a side: who came, who left, what was lost, and when."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field

from hapnet.recording.samples import Level
from hapnet.side.endpoint import NANO
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
"""Why a side leaves whose time is up."""


@dataclass(frozen=True)
class Notice:
    """Something that happened at `at_ns` on this machine's monotonic clock.

    kind, values : for programs. text : for people. level : how serious it is.
    """

    kind: str
    text: str
    at_ns: int
    level: Level = "info"
    values: Mapping[str, str | int | float] = field(default_factory=dict)


def signal_text(name: str, value: Signal) -> str:
    """A signal as events and logs show it: its name and its value as JSON."""
    return f"{name} = {json.dumps(value)}"


def notice_of(event: Event, now_ns: int, other: str, on_silence: str) -> Notice | None:
    """The notice about an event of the session; None: the event is ordinary and needs none.

    other : the other side's role. on_silence : what this side does when nothing arrives.
    """
    match event:
        case Paired(_, number, encrypts, proof, fingerprint):
            again = "" if number == 1 else f" (another process; pair {number})"
            how = ", encrypted" if encrypts else ""
            text = f"paired with the {other}{again}{how}"
            if proof == "nobody":
                text += f", key {fingerprint}; the {other} must show the same" if fingerprint else ", without a key"
                text += ": nobody has proved who it is"
            values: dict[str, str | int | float] = {"pair": number, **({"key": fingerprint} if fingerprint else {})}
            return Notice("paired", text, now_ns, values=values)
        case SignalReceived(name, value):
            return Notice("signal", signal_text(name, value), now_ns)
        case PeerLeft(reason):
            return Notice("left", f"the {other} left: {reason}", now_ns, values={"reason": reason})
        case Mismatch(reason):
            return Notice("refused", f"a {other} does not fit: {reason}", now_ns, "error", {"reason": reason})
        case PeerRefused(reason, by_peer):
            who = f"the {other}" if by_peer else f"a {other} that is not this side's peer"
            return Notice("refused", f"{who} refuses this side: {reason}", now_ns, "error", {"reason": reason})
        case Unproven(reason):
            return Notice("unproven", f"a {other} is ignored: {reason}", now_ns, "warning", {"reason": reason})
        case Contradiction(kind, detail):
            text = f"somebody else speaks in the {other}'s name ({detail}): it is not known whether this run is passive"
            return Notice("contradiction", text, now_ns, "error", {"kind": kind})
        case PeerSilent(since_ns):
            silence_s = (now_ns - since_ns) * NANO
            does = "the set-position is held" if on_silence == "hold" else "the spring is released"
            text = f"nothing from the {other} for {silence_s:.2f} s: {does}"
            return Notice("silent", text, now_ns, "warning", {"since_ns": since_ns, "silence_s": silence_s})
        case PeerHeard(silence_ns, recovery_ns, missing):
            text = f"the {other} is heard again after {silence_ns * NANO:.2f} s"
            if recovery_ns:
                text += f", {recovery_ns * 1e-6:.0f} ms after its first message"
            if missing:
                text += f"; {missing} positions are missing"
            values = {"silence_s": silence_ns * NANO, "recovery_s": recovery_ns * NANO, "missing": missing}
            return Notice("heard", text, now_ns, values=values)
    return None
