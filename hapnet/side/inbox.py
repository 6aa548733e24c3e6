"""The messages from the wire half of a side to its control half."""

from __future__ import annotations

from typing import Protocol

from hapnet.control.coupling import CouplingSample
from hapnet.wire.fields import Signal


class ControlInbox(Protocol):
    """The methods of the control half that the wire half calls; control may be in another thread or process."""

    def pair(self, restarted: bool, leads_robot: bool = False) -> None:
        """A peer was paired. The first peer lets control start; a later peer replaces the previous peer.

        `restarted`: the peer was paired before, with another side in this side's place. `leads_robot`: this side's
        device leads a robot at the peer.
        """

    def on_sample(self, sample: CouplingSample, sent_ns: int, came_ns: int, took_ns: int) -> None:
        """A sample [m] was sent at `sent_ns`, on its sender's clock, and came at `came_ns`; `took_ns` is estimated."""

    def echo(self, sent_ns: int, came_ns: int) -> None:
        """Echo this stamp in the next messages: the peer's message with it came at `came_ns`, used or not."""

    def credit(self, credited_nJ: int) -> None:
        """Credit shuffled energy that has arrived [nJ]."""

    def on_signal(self, name: str, value: Signal) -> None:
        """Take a signal of the peer: a value sent beside the stream."""

    def reported(self) -> tuple[str, Signal] | None:
        """Take the next signal to send to the peer; None: there is none."""

    def shuffled(self) -> float:
        """Take the next surplus energy to shuffle [J]; 0: there is none."""

    @property
    def has_shuffled(self) -> bool: ...

    @property
    def has_reported(self) -> bool: ...
