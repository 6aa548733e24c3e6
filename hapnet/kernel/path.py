"""Numbers, silences and the path as one side sees them: `hapnet.wire.numbering`, `peer_monitor` and `path`."""

from __future__ import annotations

from typing import Annotated

from hapnet.histogram import Histogram
from hapnet.records.equation import equation
from hapnet.records.record import Record, WholeRows, Wholes
from hapnet.wire import numbering as reference
from hapnet.wire.path import LONGEST_NS, STALL_NS

BINS = len(Histogram().counts)
TRIPS, JITTER, AGES = range(3)
"""The histograms of a path."""

NEW, AGAIN, LATE, DOUBTFUL = range(4)
"""`hapnet.wire.numbering.Place`."""

_LEAST_PERIOD_NS, _MOST_AT_ONCE = reference.LEAST_PERIOD_NS, reference.MOST_AT_ONCE
_RUN, _PROOF, _LATE_RUN, _LATE_RUN_NS = reference.RUN, reference.PROOF, reference.LATE_RUN, reference.LATE_RUN_NS
_EARLY_NS, _WARM, _WINDOW_NS = reference.EARLY_NS, reference.WARM, reference.WINDOW_NS
_LONGEST_NS, _STALL_NS, _LAST_BIN = LONGEST_NS, STALL_NS, BINS - 1


class Path(Record):
    """`Numbering`, `PeerMonitor` and `Path`.

    has_... : is the value that follows known? counts, highest : of the three histograms. messages, came, overtaken,
    stalls and longest_stall_ns are those of `Counts`, where `messages` is `sent` and `overtaken` is `late`.
    """

    newest: int
    least_ns: int
    has_stamp: int
    stamp_ns: int
    run_heard_ns: int
    mean_ns: int
    before_ns: int
    lately_ns: int
    roll_ns: int
    count: int
    has_other: int
    other_number: int
    other_stamp_ns: int
    other_came_ns: int
    others: int
    others_ns: int
    has_displaced: int
    displaced: int
    proof: int
    silence_ns: int
    heard_ns: int
    has_sign: int
    sign_ns: int
    silences: int
    longest_ns: int
    total_ns: int
    recovery_max_ns: int
    received: int
    missing: int
    counts: Annotated[WholeRows, (3, BINS)]
    highest: Annotated[Wholes, (3,)]
    messages: int
    came: int
    overtaken: int
    stalls: int
    longest_stall_ns: int
    has_trip: int
    least_trip_ns: int
    since_ns: int
    has_last: int
    last_came_ns: int
    last_stamp_ns: int


@equation
def place(path: Path, now_ns: int, number: int, sent_ns: int) -> int:
    """`Numbering.place`."""
    if path.newest < 0:
        _measure_anew(path, now_ns, now_ns - sent_ns)
        _lead(path, now_ns, number, sent_ns)
        return NEW
    later = path.has_stamp == 0 or sent_ns >= path.stamp_ns
    if path.newest < number <= path.newest + _most(now_ns - path.run_heard_ns) and later:
        _go_on(path, now_ns, number, sent_ns)
        return NEW
    late = number <= path.newest and (path.has_stamp == 0 or sent_ns <= path.stamp_ns)
    if late and (path.proof >= _PROOF or (path.has_displaced != 0 and number <= path.displaced)):
        return LATE
    if not _is_run(path, now_ns, number, sent_ns, not late or path.has_displaced != 0):
        return LATE if late else DOUBTFUL
    path.has_other = path.proof = 0
    path.has_displaced = 1 if number > path.newest else 0
    path.displaced = path.newest
    _lead(path, now_ns, number, sent_ns)
    return AGAIN


@equation
def _lead(path: Path, now_ns: int, number: int, sent_ns: int) -> None:
    """This message is the newest from now on."""
    path.newest, path.stamp_ns, path.run_heard_ns, path.has_stamp = number, sent_ns, now_ns, 1


@equation
def _most(waited_ns: int) -> int:
    """By how much a sender's number can have risen in that time."""
    return _MOST_AT_ONCE + waited_ns // _LEAST_PERIOD_NS


@equation
def _measure_anew(path: Path, now_ns: int, offset_ns: int) -> None:
    """`Numbering._measure_anew`."""
    path.least_ns = path.mean_ns = path.before_ns = path.lately_ns = offset_ns
    path.roll_ns = now_ns + _WINDOW_NS
    path.count = 1


@equation
def _go_on(path: Path, now_ns: int, number: int, sent_ns: int) -> None:
    """`Numbering._go_on`."""
    offset_ns = now_ns - sent_ns
    path.has_other = 0
    if path.proof < _PROOF:
        path.proof += 1
    if path.has_displaced:
        if path.proof == _PROOF:
            path.has_displaced = 0
            _measure_anew(path, now_ns, offset_ns)
    elif path.count >= _WARM and offset_ns < 3 * path.least_ns - 2 * path.mean_ns - _EARLY_NS:
        path.has_displaced, path.displaced, path.proof = 1, path.newest, 0
    else:
        path.count += 1
        path.mean_ns += (offset_ns - path.mean_ns) // min(path.count, 64)
        if now_ns >= path.roll_ns:
            path.before_ns, path.lately_ns = path.lately_ns, offset_ns
            path.roll_ns = now_ns + _WINDOW_NS
            path.least_ns = min(path.before_ns, offset_ns)
        elif offset_ns < path.lately_ns:
            path.lately_ns = offset_ns
            path.least_ns = min(path.least_ns, offset_ns)
    _lead(path, now_ns, number, sent_ns)


@equation
def _is_run(path: Path, now_ns: int, number: int, sent_ns: int, sure: bool) -> bool:
    """`Numbering._is_run`."""
    goes_on = (
        path.has_other != 0
        and path.other_number < number <= path.other_number + _most(now_ns - path.other_came_ns)
        and path.other_stamp_ns < sent_ns
    )
    path.has_other, path.other_number, path.other_stamp_ns, path.other_came_ns = 1, number, sent_ns, now_ns
    if goes_on:
        path.others += 1
    else:
        path.others, path.others_ns = 1, now_ns
    if sure:
        return path.others >= _RUN
    return path.others >= _LATE_RUN and now_ns - path.others_ns >= _LATE_RUN_NS


@equation
def on_any_message(path: Path, now_ns: int) -> None:
    """`PeerMonitor.on_any_message`."""
    if not path.has_sign and now_ns - path.heard_ns > path.silence_ns:
        path.has_sign, path.sign_ns = 1, now_ns


@equation
def on_new(path: Path, now_ns: int, since: int) -> None:
    """`PeerMonitor.on_position`."""
    path.received += 1
    path.missing = max(0, path.missing + (since - 1 if since > 0 else since))
    silence_ns = now_ns - path.heard_ns
    path.heard_ns = now_ns
    if silence_ns <= path.silence_ns:
        return
    path.silences += 1
    path.longest_ns = max(path.longest_ns, silence_ns)
    path.total_ns += silence_ns
    path.recovery_max_ns = max(path.recovery_max_ns, now_ns - path.sign_ns if path.has_sign else 0)
    path.has_sign = 0


@equation
def measure(path: Path, now_ns: int, sent_ns: int, since: int, late: bool, echo_ns: int, came_ns: int) -> int:
    """`Path.on_position`, `on_echo` and `took_ns`: how long the message was under way [ns]."""
    path.came += 1
    _add(path, JITTER, now_ns - sent_ns - path.least_ns)
    if late:
        path.overtaken += 1
    else:
        path.messages += since
    if echo_ns:
        _on_echo(path, now_ns, sent_ns, echo_ns, came_ns)
    half_ns = path.least_trip_ns // 2 if path.has_trip else 0
    return min(max(0, now_ns - sent_ns - path.least_ns), _LONGEST_NS) + half_ns


@equation
def age(path: Path, now_ns: int, sent_ns: int, since: int, new: bool) -> None:
    """The part of `Path.on_position` about the message before, which this one replaces."""
    if new and path.has_last:
        _add(path, AGES, now_ns - path.last_stamp_ns - path.least_ns)
        stall_ns = now_ns - path.last_came_ns - (sent_ns - path.last_stamp_ns if since == 1 else 0)
        if stall_ns > _STALL_NS:
            path.stalls += 1
            path.longest_stall_ns = max(path.longest_stall_ns, stall_ns)
    path.has_last, path.last_came_ns, path.last_stamp_ns = 1, now_ns, sent_ns


@equation
def _on_echo(path: Path, now_ns: int, sent_ns: int, echo_ns: int, came_ns: int) -> None:
    """`Path.on_echo`."""
    if not (path.since_ns <= echo_ns <= now_ns and came_ns <= sent_ns):
        return
    trip_ns = now_ns - echo_ns - sent_ns + came_ns
    if not 0 <= trip_ns <= _LONGEST_NS:
        return
    _add(path, TRIPS, trip_ns)
    if not path.has_trip or trip_ns < path.least_trip_ns:
        path.has_trip, path.least_trip_ns = 1, trip_ns


@equation
def _add(path: Path, which: int, value: int) -> None:
    """`Histogram.add`."""
    value = max(0, value)
    shift = 0
    while value >> shift >= 64:
        shift += 1
    path.counts[which][min((shift << 5) + (value >> shift), _LAST_BIN)] += 1
    path.highest[which] = max(path.highest[which], value)
