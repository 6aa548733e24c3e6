"""Which message of the peer's stream is new, which is late, and which is no part of it.

An honest sender's numbers and time stamps rise together. If a message has a higher number than the newest and an
earlier stamp, or the other way round, then one of the two is forged or damaged. The same holds for a number that no
servo can have reached by then. Such a message is doubtful. It is dropped, but it may be the first of another run of
numbers. Of two runs the one that goes on is believed:

* `RUN` doubtful messages in a row, with rising numbers and stamps and no message of the first run between them, are the
  peer's: the first run was forged. One forged message is no run. Copies of old messages are never doubtful, since
  their numbers and stamps are both lower.
* A message that comes much too early to be true is used, as the path may have become shorter. But until `PROOF`
  messages have continued its run, the run that it displaced returns if it goes on, by the same rule. This also holds
  for a run that took over ahead of the first. So a forged number far ahead silences nobody.
* Neither does a forged number in the very first message: until `PROOF` messages have continued its run, late messages
  are another run if `LATE_RUN` of them come in a row, over `LATE_RUN_NS`.
"""

from __future__ import annotations

from enum import Enum

LEAST_PERIOD_NS, MOST_AT_ONCE = 50_000, 2_000
"""In the long run a sender's messages are at least this far apart; at most this many may come ahead of that."""

RUN = 2
"""This many messages that continue each other are a run. Every side sends a message at least every 0.1 s, a world every
50 ms: so a run is known within 0.2 s, unless messages are lost."""

PROOF = 20
"""After this many messages a run is beyond doubt."""

LATE_RUN, LATE_RUN_NS = 10, 100_000_000
"""An honest sender never has this many late messages in order, over this time, with nothing new between them."""

EARLY_NS = 60_000_000
"""A message is too early to be true if it beats the least delay so far by this and twice the mean above it."""

WARM = 32
"""The least delay means something once this many messages have come."""

WINDOW_NS = 10_000_000_000
"""The least delay is that of the last one to two such windows, since clocks drift."""


class Place(Enum):
    """How a message relates to the run so far."""

    NEW = "newer than all before"
    AGAIN = "the first of another run, which is believed from here on"
    LATE = "older than one before"
    DOUBTFUL = "no part of the run"


class Numbering:
    """The run of one peer's numbers; a new pair begins a new one.

    Attributes
    ----------
    newest : the highest number of the run; -1 before the first message.
    least_ns : the least difference, lately, of the time of arrival and the sender's stamp. It contains the difference
        of the clocks.
    """

    def __init__(self) -> None:
        self.newest: int = -1
        self.least_ns: int = 0
        self._stamp_ns: int | None = None  # the newest message's; None: not known
        self._heard_ns = 0
        self._mean_ns = self._before_ns = self._lately_ns = self._roll_ns = 0
        self._count = 0
        self._other: tuple[int, int, int] | None = None  # number, stamp and arrival of the last doubtful message
        self._others = self._others_ns = 0  # how many doubtful ones came in a row, and since when
        self._displaced: int | None = None  # the last number of the run that this one has displaced
        self._proof = 0

    def place(self, now_ns: int, number: int, sent_ns: int) -> Place:
        """How the message relates to the run. If it is `NEW` or `AGAIN`, it is the newest from now on."""
        newest, stamp_ns = self.newest, self._stamp_ns
        if newest < 0:
            self._measure_anew(now_ns, now_ns - sent_ns)
            self.newest, self._stamp_ns, self._heard_ns = number, sent_ns, now_ns
            return Place.NEW
        later = stamp_ns is None or sent_ns >= stamp_ns
        if newest < number <= newest + _most(now_ns - self._heard_ns) and later:
            self._go_on(now_ns, number, sent_ns)
            return Place.NEW
        late = number <= newest and (stamp_ns is None or sent_ns <= stamp_ns)
        if late and (self._proof >= PROOF or (self._displaced is not None and number <= self._displaced)):
            return Place.LATE
        if not self._is_run(now_ns, number, sent_ns, sure=not late or self._displaced is not None):
            return Place.LATE if late else Place.DOUBTFUL
        self._other, self._proof = None, 0
        self._displaced = newest if number > newest else None
        self.newest, self._stamp_ns, self._heard_ns = number, sent_ns, now_ns
        return Place.AGAIN

    def resume(self, now_ns: int, newest: int) -> None:
        """The run has reached this number, beyond doubt; its stamp is not known."""
        self.newest, self._heard_ns, self._stamp_ns, self._proof = newest, now_ns, None, PROOF

    def _measure_anew(self, now_ns: int, offset_ns: int) -> None:
        self.least_ns = self._mean_ns = self._before_ns = self._lately_ns = offset_ns
        self._roll_ns = now_ns + WINDOW_NS
        self._count = 1

    def _go_on(self, now_ns: int, number: int, sent_ns: int) -> None:
        offset_ns = now_ns - sent_ns
        self._other = None
        if self._proof < PROOF:
            self._proof += 1
        if self._displaced is not None:
            if self._proof == PROOF:
                self._displaced = None
                self._measure_anew(now_ns, offset_ns)
        elif self._count >= WARM and offset_ns < 3 * self.least_ns - 2 * self._mean_ns - EARLY_NS:
            self._displaced, self._proof = self.newest, 0
        else:
            self._count += 1
            self._mean_ns += (offset_ns - self._mean_ns) // min(self._count, 64)
            if now_ns >= self._roll_ns:
                self._before_ns, self._lately_ns = self._lately_ns, offset_ns
                self._roll_ns = now_ns + WINDOW_NS
                self.least_ns = min(self._before_ns, offset_ns)
            elif offset_ns < self._lately_ns:
                self._lately_ns = offset_ns
                if offset_ns < self.least_ns:
                    self.least_ns = offset_ns
        self.newest, self._stamp_ns, self._heard_ns = number, sent_ns, now_ns

    def _is_run(self, now_ns: int, number: int, sent_ns: int, *, sure: bool) -> bool:
        """Is this message, with the doubtful ones before it, a run? `sure`: no honest sender sends such a message."""
        before, self._other = self._other, (number, sent_ns, now_ns)
        if before is not None and before[0] < number <= before[0] + _most(now_ns - before[2]) and before[1] < sent_ns:
            self._others += 1
        else:
            self._others, self._others_ns = 1, now_ns
        return self._others >= (RUN if sure else LATE_RUN) and (sure or now_ns - self._others_ns >= LATE_RUN_NS)


def _most(waited_ns: int) -> int:
    """By how much a sender's number can have risen in that time."""
    return MOST_AT_ONCE + waited_ns // LEAST_PERIOD_NS
