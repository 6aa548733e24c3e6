"""The messages from the wire half of a side to its control half."""

from __future__ import annotations

from typing import Protocol

from hapnet.control.coupling import CouplingSample
from hapnet.wire.fields import Signal


class ControlInbox(Protocol):
    """The control half as the wire half sees it; it may be in another thread or another process."""

    def pair(self, restarted: bool, leads_robot: bool = False) -> None:
        """A peer was found. The first lets control start; a later one replaces the one before.

        `restarted`: the peer was paired before, with another side in this side's place. `leads_robot`: this side's
        device leads a robot there.
        """

    def on_sample(self, sample: CouplingSample, sent_ns: int, came_ns: int, took_ns: int) -> None:
        """A sample [m] left at `sent_ns`, on its sender's clock, and came at `came_ns`; `took_ns` is an estimate."""

    def echo(self, sent_ns: int, came_ns: int) -> None:
        """The next messages echo this stamp of the peer, whose message came at `came_ns`, used or not."""

    def credit(self, credited_nJ: int) -> None:
        """Shuffled energy came [nJ]."""

    def on_signal(self, name: str, value: Signal) -> None:
        """The peer reports another value beside the stream."""

    def reported(self) -> tuple[str, Signal] | None:
        """Take a signal that is to be sent to the peer; None if there is none."""

    def shuffled(self) -> float:
        """Take surplus energy that is to be shuffled [J]; 0 if there is none."""

    @property
    def has_shuffled(self) -> bool: ...

    @property
    def has_reported(self) -> bool: ...
