"""Decide which messages of the peer's stream are new, which are late, and which are no part of it.

An honest sender's numbers and time stamps rise together. If a message has a higher number than the newest and an
earlier stamp, or the reverse, then one of the two is forged or damaged. The same holds for a number that no
servo can have reached by then. Such a message is doubtful. It is dropped, but it may be the first of another run of
numbers. Of two runs, the run that goes on is accepted:

* `RUN` doubtful messages in a row, with rising numbers and stamps and no message of the first run between them, are the
  peer's: the first run was forged. One forged message is no run. Copies of old messages are never doubtful, since
  their numbers and stamps are both lower.
* A message that comes much too early to be true is used, as the path may have become shorter. But until `PROOF`
  messages have continued its run, the run that it displaced returns if it goes on, by the same rule. This also holds
  for a run that took over ahead of the first. So a forged number far ahead cannot silence a peer.
* Nor can a forged number in the very first message: until `PROOF` messages have continued its run, late messages
  are another run if `LATE_RUN` of them come in a row, over `LATE_RUN_NS`.
"""

from __future__ import annotations

from hapnet.records.record import Record, equation

NEW, AGAIN, LATE, DOUBTFUL, SEEN = range(5)
"""The place of a message in the run so far: newer than all before; the first of another run, which is accepted from now
on; older than an earlier message; no part of the run; a copy of an earlier message (see `hapnet.wire.path.arrive`)."""

MIN_PERIOD_NS, MOST_AT_ONCE = 50_000, 2_000
"""In the long run a sender's messages are at least this far apart; at most this many may come ahead of that."""

RUN = 2
"""This many messages that continue each other are a run. Every side sends a message at least every 0.1 s, a world every
50 ms: so a run is detected within 0.2 s, unless messages are lost."""

PROOF = 20
"""After this many messages a run is beyond doubt."""

LATE_RUN, LATE_RUN_NS = 10, 100_000_000
"""An honest sender never has this many late messages in order, over this time, with nothing new between them."""

EARLY_NS = 60_000_000
"""A message is too early to be true if its delay is below the minimum so far by this and twice the mean excess."""

WARM = 32
"""The minimum delay is used once this many messages have come."""

WINDOW_NS = 10_000_000_000
"""The minimum delay is taken over the last one to two such windows, since clocks drift."""


class Numbering(Record):
    """The run of one peer's numbers; a new pair begins a new one.

    Attributes
    ----------
    newest, stamp_ns, heard_ns : the highest number of the run, -1 before the first message; its stamp and arrival.
    min_ns : the smallest difference, lately, of the time of arrival and the sender's stamp. It contains the difference
        of the clocks. mean_ns, count : the mean difference, of so many messages.
    before_ns, lately_ns, roll_ns : the minimum of the last window and of the present one, and when that ends.
    other_number, other_stamp_ns, other_came_ns : number, stamp and arrival of the last doubtful message.
    others, others_ns : how many doubtful ones came in a row, 0 if the run goes on, and since when.
    displaced : the last number of the run that this one has displaced; -1: it has displaced none.
    proof : how many messages have continued the run, up to `PROOF`.
    """

    newest: int
    stamp_ns: int
    heard_ns: int
    min_ns: int
    mean_ns: int
    count: int
    before_ns: int
    lately_ns: int
    roll_ns: int
    other_number: int
    other_stamp_ns: int
    other_came_ns: int
    others: int
    others_ns: int
    displaced: int
    proof: int

    def __init__(self) -> None:
        super().__init__()
        self.newest = self.displaced = -1

    @equation
    def place(self, now_ns: int, number: int, sent_ns: int) -> int:
        """Return how the message relates to the run. If it is `NEW` or `AGAIN`, it is the newest from now on."""
        newest, stamp_ns = self.newest, self.stamp_ns
        if newest < 0:
            _measure_anew(self, now_ns, now_ns - sent_ns)
            self.newest, self.stamp_ns, self.heard_ns = number, sent_ns, now_ns
            return NEW
        if newest < number <= newest + _most(now_ns - self.heard_ns) and sent_ns >= stamp_ns:
            _go_on(self, now_ns, number, sent_ns)
            return NEW
        late = number <= newest and sent_ns <= stamp_ns
        if late and (self.proof >= PROOF or number <= self.displaced):
            return LATE
        if not _is_run(self, now_ns, number, sent_ns, not late or self.displaced >= 0):
            return LATE if late else DOUBTFUL
        self.others = self.proof = 0
        self.displaced = newest if number > newest else -1
        self.newest, self.stamp_ns, self.heard_ns = number, sent_ns, now_ns
        return AGAIN


@equation
def _measure_anew(numbers: Numbering, now_ns: int, offset_ns: int) -> None:
    numbers.min_ns = numbers.mean_ns = numbers.before_ns = numbers.lately_ns = offset_ns
    numbers.roll_ns = now_ns + WINDOW_NS
    numbers.count = 1


@equation
def _go_on(numbers: Numbering, now_ns: int, number: int, sent_ns: int) -> None:
    offset_ns = now_ns - sent_ns
    numbers.others = 0
    if numbers.proof < PROOF:
        numbers.proof += 1
    if numbers.displaced >= 0:
        if numbers.proof == PROOF:
            numbers.displaced = -1
            _measure_anew(numbers, now_ns, offset_ns)
    elif numbers.count >= WARM and offset_ns < 3 * numbers.min_ns - 2 * numbers.mean_ns - EARLY_NS:
        numbers.displaced, numbers.proof = numbers.newest, 0
    else:
        numbers.count += 1
        numbers.mean_ns += (offset_ns - numbers.mean_ns) // min(numbers.count, 64)
        if now_ns >= numbers.roll_ns:
            numbers.before_ns, numbers.lately_ns = numbers.lately_ns, offset_ns
            numbers.roll_ns = now_ns + WINDOW_NS
            numbers.min_ns = min(numbers.before_ns, offset_ns)
        elif offset_ns < numbers.lately_ns:
            numbers.lately_ns = offset_ns
            if offset_ns < numbers.min_ns:
                numbers.min_ns = offset_ns
    numbers.newest, numbers.stamp_ns, numbers.heard_ns = number, sent_ns, now_ns


@equation
def _is_run(numbers: Numbering, now_ns: int, number: int, sent_ns: int, sure: bool) -> bool:
    """Whether this message, with the doubtful ones before it, is a run. `sure`: no honest sender sends such a
    message.
    """
    before, waited_ns = numbers.other_number, now_ns - numbers.other_came_ns
    goes_on = before < number <= before + _most(waited_ns) and numbers.other_stamp_ns < sent_ns
    numbers.other_number, numbers.other_stamp_ns, numbers.other_came_ns = number, sent_ns, now_ns
    if numbers.others and goes_on:
        numbers.others += 1
    else:
        numbers.others, numbers.others_ns = 1, now_ns
    if sure:
        return numbers.others >= RUN
    return numbers.others >= LATE_RUN and now_ns - numbers.others_ns >= LATE_RUN_NS


@equation
def _most(waited_ns: int) -> int:
    """The most by which a sender's number can have risen in that time."""
    return MOST_AT_ONCE + waited_ns // MIN_PERIOD_NS


place = Numbering.place
"""These methods as functions, for calls from equations."""
