"""Signals: small named values beside the stream, such as buttons, or values of a user's own world. No clock.

A signal is a state, not an event: the newest value counts. A side sends all its signals when one has changed, and again
every `REPEAT_NS`, so that the next frame repairs a lost one. An event that must be counted is sent as a growing number.
"""

from __future__ import annotations

from hapnet.errors import BadMessage, InvalidParameter
from hapnet.wire import fields
from hapnet.wire.events import SignalReceived
from hapnet.wire.fields import Signal

STOP = "stop"
"""This signal, a text with the reason, ends the device's force for good."""

LEADS = "leads"
"""This signal, true or false: whether the device's motion leads the robot at the other side now."""

SPACING_NS = 10_000_000
"""The minimum time between two frames [ns]."""

REPEAT_NS = 200_000_000
MOST_CHARACTERS = 1024
"""The limit for all names and texts of one side together, so that a frame stays below 4096 bytes."""


class SignalExchange:
    """The signals of one side, in both directions.

    Attributes
    ----------
    reported : this side's own signals. heard : the peer's.
    """

    def __init__(self) -> None:
        self.reported: dict[str, Signal] = {}
        self.heard: dict[str, Signal] = {}
        self._sequence = 0
        self._newest = -1
        self._due_ns: int | None = None
        self._sent_ns: int | None = None

    def report(self, name: str, value: Signal) -> None:
        """Send the peer this value from now on.

        Raises InvalidParameter: it is no signal, or there would be too many.
        """
        if self.reported.get(name, self) == value and type(self.reported[name]) is type(value):
            return
        signals = {**self.reported, name: value}
        characters = sum(len(text) for item in signals.items() for text in item if isinstance(text, str))
        numbers = sum(len(each) for each in signals.values() if isinstance(each, tuple))
        try:
            fields.signals(signals)
            if characters + 9 * numbers > MOST_CHARACTERS:
                raise BadMessage("size", f"more than {MOST_CHARACTERS} characters, at 9 for a number")
        except BadMessage as error:
            raise InvalidParameter(f"signal {name}", value, f"a small value ({error.detail})") from None
        self.reported = signals
        earliest_ns = 0 if self._sent_ns is None else self._sent_ns + SPACING_NS
        self._due_ns = earliest_ns if self._due_ns is None else min(self._due_ns, earliest_ns)

    def receive(self, sequence: int, values: dict[str, Signal]) -> tuple[SignalReceived, ...]:
        """Take a frame of the peer; returns the signals that changed. BadMessage : it is older than an earlier one."""
        if sequence <= self._newest:
            raise BadMessage("stale", f"signals {sequence} come after later ones")
        self._newest = sequence
        before, self.heard = self.heard, values
        return tuple(
            SignalReceived(name, value)
            for name, value in values.items()
            if name not in before or before[name] != value or type(before[name]) is not type(value)
        )

    def poll(self, now_ns: int) -> tuple[int, dict[str, Signal]] | None:
        """The number and the values of the frame to send now; None: none is due."""
        if self._due_ns is None or now_ns < self._due_ns:
            return None
        self._sequence += 1
        self._sent_ns = now_ns
        self._due_ns = now_ns + REPEAT_NS
        return self._sequence, self.reported

    @property
    def next_due_ns(self) -> int | None:
        """The time to call `poll` next; None: this side has no signals."""
        return self._due_ns

    def change_pair(self) -> None:
        """Begin with another peer, or none: no signals were received from it yet, nor sent to it."""
        self.heard, self._newest = {}, -1
        if self.reported:
            self._due_ns = 0
