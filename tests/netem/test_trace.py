"""Recorded links: mahimahi's rule for who crosses when, the real LTE traces, conditions in steps, and bad files."""

from collections import deque
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from netem import CapacityTrace, ConditionTrace, Link, LinkProfile, ProfileError, Timeline
from netem.trace import TraceLine
from tests.netem.support import drive

MS = 1_000_000
LINKS = Path(__file__).resolve().parents[2].parent / "shared" / "data" / "links"
NAMES = ["ATT-LTE-driving-2016.up", "ATT-LTE-driving-2016.down", "Verizon-LTE-short.up", "Verizon-LTE-short.down"]

traces = (
    st.lists(st.integers(0, 12), min_size=1, max_size=8)
    .map(sorted)
    .filter(lambda times: times[-1] > 0)
    .map(lambda times: CapacityTrace("made.trace", tuple(ms * MS for ms in times)))
)


def crossings(trace: CapacityTrace, messages: list[tuple[int, int]]) -> list[int]:
    """When each message (ready time, size) crosses, by walking through the opportunities one by one."""
    waiting, out, cycle = deque(messages), [], 0
    left_of_message = None
    while waiting:
        for time_ns in trace.times_ns:
            now, room = cycle * trace.times_ns[-1] + time_ns, 1500
            while room > 0 and waiting and waiting[0][0] < now:
                if left_of_message is None:
                    left_of_message = waiting[0][1]
                taken = min(room, left_of_message)
                room, left_of_message = room - taken, left_of_message - taken
                if left_of_message == 0:
                    out.append(now)
                    waiting.popleft()
                    left_of_message = None
        cycle += 1
    return out


@settings(max_examples=300)
@given(traces, st.lists(st.tuples(st.integers(0, 9), st.sampled_from([0, 1, 100, 749, 750, 1500, 1501, 4000]))))
@pytest.mark.long
def test_messages_cross_as_mahimahis_opportunities_let_them(trace: CapacityTrace, sends: list[tuple[int, int]]) -> None:
    messages, now = [], 0
    for pause_ms, size in sends:
        now += pause_ms * MS // 2
        messages.append((now, size))
    line = TraceLine(trace, 0, -1)
    assert [line.release_ns(ready, size) for ready, size in messages] == crossings(trace, messages)


@given(traces, st.integers(-(10**12), 10**12))
@pytest.mark.long
def test_the_next_opportunity_is_the_first_later_one(trace: CapacityTrace, elapsed_ns: int) -> None:
    number = trace.first_after(elapsed_ns)
    assert trace.time_ns(number - 1) <= elapsed_ns < trace.time_ns(number)


def link_over(tmp_path: Path, lines: str, words: str = "", start_ns: int | None = 0) -> Link[int]:
    path = tmp_path / "small trace.up"
    path.write_text(lines)
    return Link(LinkProfile.parse(f'{words} trace "{path}"'), 1, start_ns)


def test_opportunities_of_a_small_trace(tmp_path: Path) -> None:
    """Two opportunities at 3 ms, one at 5 ms, which is also the end: then 8, 8, 10, and so on."""
    link = link_over(tmp_path, "3\n3\n5\n")
    for number in range(6):
        link.send(0, number, 1500)
    assert [due // MS for due, _ in link.poll(10**9)] == [3, 3, 5, 8, 8, 10]
    assert link.next_due_ns is None


def test_small_messages_share_an_opportunity_and_large_ones_take_several(tmp_path: Path) -> None:
    link = link_over(tmp_path, "1\n2\n3\n4\n")
    for number, size in enumerate((700, 700, 700, 4000, 1)):
        link.send(0, number, size)
    # 1500 = 700 + 700 + 100, then 600 + 900, 1500, 1500, 100 + 1
    assert [due // MS for due, _ in link.poll(10**9)] == [1, 1, 2, 5, 5]


def test_what_nobody_waits_for_is_lost(tmp_path: Path) -> None:
    link = link_over(tmp_path, "1\n2\n10\n")
    link.send(0, 0, 100)
    link.send(MS, 1, 100)  # comes with the first opportunity, which has gone by then
    link.send(2 * MS + 1, 2, 100)
    assert [due // MS for due, _ in link.poll(10**9)] == [1, 2, 10]


def test_delay_comes_before_the_line_and_the_order_is_kept(tmp_path: Path) -> None:
    link = link_over(tmp_path, "4\n8\n", "delay 5ms 3ms")
    plain = {number: due for due, number in drive(Link(LinkProfile.parse("delay 5ms 3ms"), 1), 60, MS, 1500)}
    out = drive(link, 60, MS, 1500)
    assert [number for _, number in out] == list(range(60))
    assert all(due % (4 * MS) == 0 and due > plain[number] for due, number in out)


def test_a_trace_starts_with_the_first_message_unless_told(tmp_path: Path) -> None:
    link = link_over(tmp_path, "3\n", start_ns=None)
    link.send(100 * MS + 7, 0, 1500)
    assert link.next_due_ns == 103 * MS + 7
    reported = link_over(tmp_path, "3\n", start_ns=MS)
    reported.send(100 * MS, 0, 1500)
    assert reported.next_due_ns == 103 * MS


def test_a_trace_starts_with_a_change_that_comes_before_the_first_message(tmp_path: Path) -> None:
    link = link_over(tmp_path, "3\n", start_ns=None)
    link.change(link.profile, 50 * MS)
    link.send(100 * MS, 0, 1500)
    assert link.next_due_ns == 101 * MS  # 50 and 17 times 3


def test_a_change_to_a_trace_and_away_from_it_keeps_what_is_in_flight_and_the_order(tmp_path: Path) -> None:
    path = tmp_path / "t"
    path.write_text("10\n")
    link: Link[int] = Link(LinkProfile.parse("rate 12mbit"), 1)
    for number in range(3):
        link.send(0, number, 1500)  # 1, 2 and 3 ms
    link.change(LinkProfile.parse(f"trace {path}"), MS)
    link.send(MS, 3, 1500)  # the trace starts at 1 ms
    link.send(MS, 4, 1500)
    link.change(LinkProfile.parse("rate 12mbit"), 2 * MS)
    link.send(2 * MS, 5, 1500)
    assert [(due // MS, number) for due, number in link.poll(10**9)] == [
        (1, 0), (2, 1), (3, 2), (11, 3), (21, 4), (22, 5)
    ]  # fmt: skip


def test_a_change_that_keeps_the_trace_does_not_restart_it(tmp_path: Path) -> None:
    link = link_over(tmp_path, "7\n", start_ns=None)
    link.send(0, 0, 750)
    link.change(link.profile.replace(delay_ns=MS), MS)
    link.send(MS, 1, 750)
    assert [due // MS for due, _ in link.poll(10**9)] == [7, 7]


@pytest.fixture(params=NAMES)
def lte(request: pytest.FixtureRequest) -> CapacityTrace:
    path = LINKS / request.param
    if not path.exists():
        pytest.skip("the recorded LTE links are not beside the project (../shared/data/links)")
    return CapacityTrace.load(str(path))


@pytest.mark.long
def test_a_saturated_lte_link_delivers_what_was_recorded(lte: CapacityTrace) -> None:
    """Full packets that always wait leave at the file's own times, in the repetition too."""
    ms = np.loadtxt(lte.path, dtype=np.int64)
    late = ms[ms > 0]  # what comes with the first message finds nobody there
    link: Link[int] = Link(LinkProfile(trace=lte, limit=10**6), start_ns=0)
    count = len(late) + len(ms)
    for number in range(count):
        link.send(0, number, 1500)
    released = np.array([due for due, _ in link.poll(10**15)])
    assert np.array_equal(released, np.concatenate((late, late[-1] + ms)) * MS)
    window = (released >= 10_000 * MS) & (released < 20_000 * MS)
    assert window.sum() * 1500 * 8 / 10 == pytest.approx(np.sum((ms >= 10_000) & (ms < 20_000)) * 1200.0)
    assert lte.mean_rate_bit_s == pytest.approx(len(ms) * 1500 * 8 / (ms[-1] * 1e-3))


def test_an_lte_outage_holds_messages_until_it_ends(lte: CapacityTrace) -> None:
    times = np.array(lte.times_ns)
    maximum = int(np.argmax(np.diff(times)))
    begin, end = int(times[maximum]), int(times[maximum + 1])
    assert end - begin > 50 * MS
    link: Link[int] = Link(LinkProfile(trace=lte), start_ns=0)
    for number in range(10):
        link.send(begin + number * (end - begin) // 10, number, 100)
    assert link.poll(end - 1) == []
    assert link.stats.in_flight == 10
    assert link.poll(end) == [(end, number) for number in range(10)]


def test_a_quarter_loaded_lte_link_is_never_faster_than_recorded(lte: CapacityTrace) -> None:
    link: Link[int] = Link(LinkProfile(trace=lte, limit=10**6), start_ns=0)
    count = len(lte.times_ns) // 4
    out = drive(link, count, lte.period_ns // count, 1500)
    assert len(out) == count
    # no opportunity carries two full packets
    used = np.unique([due for due, _ in out], return_counts=True)
    offered = dict(zip(*np.unique([t % lte.period_ns for t in lte.times_ns], return_counts=True), strict=True))
    assert all(number <= offered[time % lte.period_ns] for time, number in zip(*used, strict=True))


CSV = "time_s,delay_ms,loss_percent\n0,10,0\n2,50.5,100\n\n3,20,0\n"  # an empty line is none


def conditions(tmp_path: Path, text: str = CSV) -> ConditionTrace:
    path = tmp_path / "c.csv"
    path.write_text(text)
    return ConditionTrace.load(str(path))


def test_conditions_hold_until_the_next_and_repeat(tmp_path: Path) -> None:
    trace = conditions(tmp_path)
    assert trace.period_ns == 4 * 10**9
    seconds = {
        0: (10, 0.0),
        1.999: (10, 0.0),
        2: (50.5, 1.0),
        3: (20, 0.0),
        3.999: (20, 0.0),
        4: (10, 0.0),
        10: (50.5, 1),
    }
    for at_s, (delay_ms, loss) in seconds.items():
        assert trace.at(round(at_s * 10**9)) == (delay_ms * MS, loss)


def test_conditions_add_to_the_words(tmp_path: Path) -> None:
    conditions(tmp_path)
    link: Link[int] = Link(LinkProfile.parse(f"delay 1ms csv {tmp_path}/c.csv"), 1, start_ns=0)
    out = drive(link, 8, 500 * MS)
    assert [(due - number * 500 * MS) / MS for due, number in out] == [11, 11, 11, 11, 21, 21]
    assert (link.stats.lost, link.stats.loss_bursts) == (2, 1)


def test_conditions_of_recorded_epochs_without_loss_and_of_one_line(tmp_path: Path) -> None:
    trace = conditions(tmp_path, "\ufefftime_s, delay_ms\r\n1700000.5,1.000001\r\n1700001,2\r\n")
    assert (trace.times_ns, trace.delays_ns) == ((0, 500 * MS), (1_000_001, 2 * MS))
    assert trace.at(10**9) == (1_000_001, 0.0)
    assert trace.at(10**9 - 1) == (2 * MS, 0.0)
    assert conditions(tmp_path, "time_s,delay_ms,loss_percent\n5,7,1.5\n").at(10**15) == (7 * MS, 0.015)


def test_conditions_losses_have_their_rate_and_leave_the_other_streams(tmp_path: Path) -> None:
    conditions(tmp_path, "time_s,delay_ms,loss_percent\n0,0,20\n")
    words = "delay 40ms 10ms loss 10%"
    plain = {number: due for due, number in drive(Link(LinkProfile.parse(words), 1), 20_000, MS)}
    traced = dict(map(reversed, drive(Link(LinkProfile.parse(f"{words} csv {tmp_path}/c.csv"), 1), 20_000, MS)))
    assert all(plain[number] == due for number, due in traced.items())
    assert len(traced) == pytest.approx(0.8 * len(plain), abs=5 * (len(plain) * 0.2 * 0.8) ** 0.5)


def test_reordering_may_take_its_delay_from_conditions(tmp_path: Path) -> None:
    conditions(tmp_path)
    assert LinkProfile.parse(f"reorder 5% csv {tmp_path}/c.csv").reorder == 0.05


@pytest.mark.parametrize("name", ["plain", "with space", "semi;colon", "hash#tag", "colon:1", "délai"])
def test_files_round_trip_in_profiles_and_timelines(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_text("1\n2\n")
    (tmp_path / f"{name}.csv").write_text(CSV)
    profile = LinkProfile(trace=CapacityTrace.load(str(path)), csv=ConditionTrace.load(f"{path}.csv"), delay_ns=5)
    assert LinkProfile.parse(str(profile)) == profile
    timeline = Timeline.parse(f"at 0s: {profile}; at 1s: down")
    assert timeline.entries[0].action == profile
    assert Timeline.parse(str(timeline)) == timeline


@pytest.mark.parametrize("path", ["", 'a"b', "two\nlines"])
def test_paths_that_cannot_be_written_down_are_refused(path: str) -> None:
    with pytest.raises(ProfileError, match="file's name"):
        CapacityTrace(path, (1,))
    with pytest.raises(ProfileError, match="file's name"):
        ConditionTrace(path, (0,), (1,), (0.0,))


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("", "at least one"),
        ("0\n0\n", "after time 0"),
        ("1\n\n2\n", "line 2"),
        ("1\n3\n2\n", "line 3.*'2'"),
        ("1\nx\n", "line 2.*'x'"),
        ("-1\n", "line 1.*'-1'"),
        ("1.5\n", "line 1"),
        ("\u0663\n", "line 1"),
        ("9999999999999\n", "line 1"),
        (b"\xff\xfe1\n", "text"),
    ],
)
def test_bad_capacity_files_are_refused_by_line(text: str | bytes, named: str, tmp_path: Path) -> None:
    path = tmp_path / "bad"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(ProfileError, match=named):
        LinkProfile.parse(f"trace {path}")


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("", "line 1"),
        ("time,delay\n0,1\n", "line 1.*time_s,delay_ms,loss_percent"),
        ("time_s,delay_ms,loss_percent\n", "at least one line"),
        ("time_s,delay_ms,loss_percent\n0,1\n", "line 2"),
        ("time_s,delay_ms\n0,1,2\n", "line 2"),
        ("time_s,delay_ms\n0,1\n0,2\n", "line 3"),
        ("time_s,delay_ms\n0,nan\n", "line 2"),
        ("time_s,delay_ms\n0,-1\n", "line 2"),
        ("time_s,delay_ms\ninf,1\n", "line 2"),
        ("time_s,delay_ms,loss_percent\n0,1,101\n", "line 2"),
        ("time_s,delay_ms,loss_percent\n0,x,1\n", "line 2"),
        (b"time_s,delay_ms\n0,\xff\n", "text"),
    ],
)
def test_bad_condition_files_are_refused_by_line(text: str | bytes, named: str, tmp_path: Path) -> None:
    path = tmp_path / "bad.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(ProfileError, match=named):
        LinkProfile.parse(f"csv {path}")


@pytest.mark.parametrize(
    ("word", "text", "fine"),
    [
        ("trace", "100000000", True),
        ("trace", "100000001", False),
        ("trace", "000000000001", True),
        ("trace", "0000000000001", False),
        ("trace", "0\n0\n7\n7", True),
        ("trace", "0\n0", False),
        ("csv", "time_s,delay_ms\n100000000000000,1", True),
        ("csv", "time_s,delay_ms\n100000000000001,1", False),
        ("csv", "time_s,delay_ms\n-100000000000001,1", False),
        ("csv", "time_s,delay_ms\n0,100000000", True),
        ("csv", "time_s,delay_ms\n0,100000000.1", False),
        ("csv", "time_s,delay_ms\n0,0", True),
        ("csv", "time_s,delay_ms,loss_percent\n0,0,0\n1,1,100", True),
        ("csv", "time_s,delay_ms,loss_percent\n0,0,100.1", False),
        ("csv", "time_s,delay_ms,loss_percent\n0,0,-0.1", False),
        ("csv", "time_s,delay_ms\n0,1\n0.000000001,2", True),
        ("csv", "time_s,delay_ms\n0,1\n0.0000000001,2", False),
    ],
)
def test_the_ends_of_what_a_file_may_say(word: str, text: str, fine: bool, tmp_path: Path) -> None:
    """100,000 s at most, as for all times; a line of a trace of opportunities has 12 digits at most."""
    (tmp_path / "file").write_text(text + "\n")
    if fine:
        LinkProfile.parse(f"{word} {tmp_path}/file")
    else:
        with pytest.raises(ProfileError, match="after time 0" if text == "0\n0" else "line"):
            LinkProfile.parse(f"{word} {tmp_path}/file")


@pytest.mark.parametrize(
    ("delay_ns", "loss", "fine"),
    [(0, 0.0, True), (10**14, 1.0, True), (-1, 0.0, False), (10**14 + 1, 0.0, False), (0, -1e-9, False),
     (0, 1.0 + 1e-9, False)],
)  # fmt: skip
def test_the_ends_of_what_conditions_in_memory_may_be(delay_ns: int, loss: float, fine: bool) -> None:
    if fine:
        assert ConditionTrace("memory", (0,), (delay_ns,), (loss,)).at(5) == (delay_ns, loss)
    else:
        with pytest.raises(ProfileError):
            ConditionTrace("memory", (0,), (delay_ns,), (loss,))


@pytest.mark.parametrize(
    "words", ["trace /no/such/file", "csv /no/such/file", "trace /", 'trace "', "trace", 'trace ""']
)
def test_files_that_are_not_there_are_named(words: str) -> None:
    with pytest.raises(ProfileError) as caught:
        LinkProfile.parse(words)
    assert "\n" not in str(caught.value)


def test_a_trace_excludes_a_rate(tmp_path: Path) -> None:
    (tmp_path / "t").write_text("1\n")
    with pytest.raises(ProfileError, match="a trace sets the rate; leave rate out"):
        LinkProfile.parse(f"rate 1mbit trace {tmp_path}/t")


@pytest.mark.parametrize("times", [(), (0,), (-1, 5), (5, 4)])
def test_traces_made_in_memory_are_checked(times: tuple[int, ...]) -> None:
    with pytest.raises(ProfileError):
        CapacityTrace("memory", times)


@pytest.mark.parametrize(
    ("times", "delays", "losses"),
    [((), (), ()), ((0,), (1, 2), (0.0,)), ((1,), (1,), (0.0,)), ((0, 0), (1, 1), (0.0, 0.0)), ((0,), (-1,), (0.0,))],
)
def test_conditions_made_in_memory_are_checked(
    times: tuple[int, ...], delays: tuple[int, ...], losses: tuple[float, ...]
) -> None:
    with pytest.raises(ProfileError):
        ConditionTrace("memory", times, delays, losses)
    with pytest.raises(ProfileError):
        ConditionTrace("memory", (0,), (1,), (1.5,))


def test_mean_conditions_weigh_by_time() -> None:
    trace = ConditionTrace("memory", (0, 1, 4), (10, 20, 30), (0.0, 0.1, 0.2))
    assert trace.period_ns == 7
    mean = (1 * 10 + 3 * 20 + 3 * 30) / 7
    assert trace.mean() == pytest.approx((mean, 0.9 / 7))
    variance = (1 * (10 - mean) ** 2 + 3 * (20 - mean) ** 2 + 3 * (30 - mean) ** 2) / 7
    assert trace.delay_variance() == pytest.approx(variance)
