"""Links from users' own files: what comes out has the means, quantiles and losses of what is in the file."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st

from netem import Link, LinkProfile, ProfileError, survey
from netem.cli import main
from netem.notes import notes
from netem.rate_trace import RateTrace
from tests.conftest import mostly_slow
from tests.netem.support import MS, drive

DELAYS = np.round(np.random.default_rng(5).lognormal(3.3, 0.35, 3000), 2)  # ms, about 29 ms with a tail to 90 ms


def file(tmp_path: Path, name: str, text: str) -> str:
    path = tmp_path / name
    path.write_text(text)
    return str(path)


def column(tmp_path: Path, values: object = DELAYS, name: str = "delays.txt", first: str = "") -> str:
    return file(tmp_path, name, first + "".join(f"{value}\n" for value in values))  # type: ignore[attr-defined]


def arrived(words: str, count: int = 200_000, interval_ns: int = MS) -> survey.Survey:
    return survey.run(LinkProfile.parse(words), 3, count, interval_ns, 100)


@pytest.mark.parametrize(
    ("first", "scale"),
    mostly_slow([("", 1.0), ("# ping of a lab\n\n", 1.0), ("delay_us\n", 1e-3), ("delay_s\n", 1e3)], 1),
)
def test_measured_delays_alone_are_the_link(tmp_path: Path, first: str, scale: float) -> None:
    words = f"distribution {column(tmp_path, DELAYS / scale, first=first)}"
    found = arrived(words).delays_ms
    assert found.mean() == pytest.approx(DELAYS.mean(), rel=0.01)
    assert found.std() == pytest.approx(DELAYS.std(), rel=0.01)
    for share in (0.01, 0.1, 0.5, 0.9, 0.99):
        assert np.quantile(found, share) == pytest.approx(np.quantile(DELAYS, share), rel=0.01)
    assert not set(np.round(found, 2)) - set(DELAYS)  # nothing but what was measured
    profile = LinkProfile.parse(words)
    assert LinkProfile.parse(str(profile)) == profile


def test_measured_delays_give_a_delay_with_jitter_their_shape(tmp_path: Path) -> None:
    found = arrived(f"delay 100ms 8ms distribution {column(tmp_path)}").delays_ms
    assert found.mean() == pytest.approx(100.0, rel=0.01)
    assert found.std() == pytest.approx(8.0, rel=0.01)
    shape = 100.0 + 8.0 * (DELAYS - DELAYS.mean()) / DELAYS.std()
    for share in (0.01, 0.5, 0.99):
        assert np.quantile(found, share) == pytest.approx(np.quantile(shape, share), rel=0.01)


def test_a_correlation_keeps_the_measured_distribution(tmp_path: Path) -> None:
    result = arrived(f"delay 100ms 8ms 50% distribution {column(tmp_path)}", interval_ns=10**9)
    assert result.delays_ms.std() == pytest.approx(8.0, rel=0.02)
    assert result.delay_correlation == pytest.approx(0.5, abs=0.01)


def test_equal_delays_have_no_jitter(tmp_path: Path) -> None:
    assert LinkProfile.parse(f"distribution {column(tmp_path, [20, 20])}") == LinkProfile.parse("delay 20ms")


def test_a_table_of_iproute2(tmp_path: Path) -> None:
    """Each entry x stands for delay + jitter x / 8192 and is equally likely (the kernel's tabledist)."""
    entries = np.round(8192 * (np.random.default_rng(6).exponential(1.0, 4096) - 1.0)).clip(-32768, 32767).astype(int)
    lines = "\n".join(" ".join(map(str, row)) for row in entries.reshape(-1, 8))
    path = file(tmp_path, "own.dist", f"# a comment\n{lines}\n")
    found = arrived(f"delay 50ms 10ms distribution {path}").delays_ms
    asked = 50.0 + 10.0 * entries / 8192
    assert found.mean() == pytest.approx(asked.mean(), rel=0.01)
    for share in (0.05, 0.5, 0.95):
        assert np.quantile(found, share) == pytest.approx(np.quantile(asked, share), rel=0.01)
    slotted = LinkProfile.parse(f"slot distribution {path} 5ms 1ms")
    assert LinkProfile.parse(str(slotted)) == slotted
    with pytest.raises(ProfileError, match="it needs a delay with jitter before it"):
        LinkProfile.parse(path)


@pytest.mark.slow
def test_delays_and_losses_over_time(tmp_path: Path) -> None:
    rows = [(0.0, 20.5, 0.0), (1.0, 60.25, 40.0), (1.5, 30.0, 10.0), (3.0, 25.0, 0.0)]
    text = "time_s,delay_ms,loss_percent\n" + "".join(f"{t},{d},{p}\n" for t, d, p in rows)
    result = arrived(f"{file(tmp_path, 'link.csv', text)}", 450_000)
    held = np.array([1.0, 0.5, 1.5, 1.5]) / 4.5
    delays, kept = np.array([d for _, d, _ in rows]), 1 - np.array([p for *_, p in rows]) / 100
    assert result.stats.lost / result.stats.offered == pytest.approx(1 - held @ kept, rel=0.01)
    assert np.nanmean(result.delays_ms) == pytest.approx((held * kept) @ delays / (held @ kept), rel=0.01)


def test_one_delay_per_line_in_its_order(tmp_path: Path) -> None:
    """Each holds for 10 ms, or for the time after ``every``; the whole file starts over at its end."""
    path = column(tmp_path)
    found = arrived(f"csv {path}", 60_000).delays_ms
    np.testing.assert_allclose(found, np.tile(np.repeat(DELAYS, 10), 2), atol=1e-6)
    profile = LinkProfile.parse(f"csv {path} every 4ms")
    np.testing.assert_allclose(survey.run(profile, 0, 400, MS, 1).delays_ms, np.repeat(DELAYS[:100], 4), atol=1e-6)
    assert LinkProfile.parse(str(profile)) == profile
    assert LinkProfile.parse(path) == LinkProfile.parse(f"csv {path} every 10ms")


RATES = "0.0\t1.5\n0.5\t2.25\n1.0\t0.4\n"


def test_a_rate_over_time_by_hand(tmp_path: Path) -> None:
    """1.5 Mbit/s for half a second, 2.25 for half a second, 0.4 for as long as that, and again."""
    link: Link[int] = Link(LinkProfile.parse(f"trace {file(tmp_path, 'rates.txt', RATES)}"), 0, start_ns=0)
    # a period carries 93,750 + 140,625 + 25,000 bytes
    sizes = [(0, 93_750), (0, 125_000), (0, 15_725), (3_000_000_000, 1), (3_000_000_000, 259_375 + 93_750 - 1)]
    due = [500_000_000, 944_444_445, 1_002_000_000, 3_000_005_334, 5_000_000_000]
    out = dict[int, int]()
    for number, (now_ns, size) in enumerate(sizes):
        link.send(now_ns, number, size)
    while (next_ns := link.next_due_ns) is not None:
        out |= {number: due_ns for due_ns, number in link.poll(next_ns)}
    assert [out[number] for number in range(5)] == pytest.approx(due, abs=10, rel=0)  # each is rounded up to 1 ns


@given(st.lists(st.tuples(st.integers(1, 10**6), st.integers(0, 10**7)), min_size=1, max_size=6), st.data())
def test_a_rate_over_time_carries_what_its_steps_can(steps: list[tuple[int, int]], data: st.DataObject) -> None:
    """An independent sum: between ready and release the steps carry the message's bits, and not before."""
    ends = np.cumsum([span for span, _ in steps]).tolist()
    rates = [rate for _, rate in steps]
    rates[0] = rates[0] or 1000
    trace = RateTrace("memory", (0, *ends[:-1]), tuple(rates))
    period = trace.period_ns
    line = trace.line(data.draw(st.integers(-5, 5)), -(10**6))
    start = line._start_ns

    def carried(until: int) -> int:
        """What the trace can carry from its start to a time [1e-9 bit], step by step."""
        cycle, within = divmod(until - start, period)
        spans = [
            max(0, min(end, within) - begin)
            for begin, end in zip(trace.times_ns, (*trace.times_ns[1:], period), strict=True)
        ]
        return cycle * sum(trace.carried()) + sum(r * s for r, s in zip(rates, spans, strict=True))

    free = -(10**6)
    for ready, size in data.draw(st.lists(st.tuples(st.integers(-(10**6), 10**8), st.integers(0, 3000)), max_size=5)):
        due = line.release_ns(ready, size)
        begin = max(ready, free)
        assert due >= begin
        assert carried(due) - carried(begin) >= size * 8 * 10**9
        assert size == 0 or carried(due - 1) - carried(begin) < size * 8 * 10**9
        free = due


def test_a_saturated_link_has_the_traces_mean_rate(tmp_path: Path) -> None:
    rng = np.random.default_rng(7)
    rates = np.round(rng.lognormal(0.5, 0.8, 200), 3)
    path = file(tmp_path, "lte.log", "".join(f"{0.5 * k} {rate}\n" for k, rate in enumerate(rates)))
    link: Link[int] = Link(LinkProfile.parse(f"trace {path} limit 1000000"), 0)
    period_s, size = 100.0, 1500
    out = drive(link, int(1.2 * period_s * rates.mean() * 1e6 / 8 / size), 1000, size)
    within = sum(1 for due_ns, _ in out if due_ns <= period_s * 1e9)
    assert 8 * size * within / period_s == pytest.approx(1e6 * rates.mean(), rel=0.01)
    trace = LinkProfile.parse(f"trace {path}").trace
    assert trace is not None
    assert trace.mean_rate_bit_s == pytest.approx(1e6 * rates.mean())


@pytest.mark.parametrize(
    ("words", "most"), [("limit bytes 1000", 10), ("limit 7 bytes 1kb", 7), ("limit bytes 64k", 655)]
)
def test_a_limit_in_bytes(words: str, most: int) -> None:
    """Messages of 100 bytes, all at once, over a delay: as many as fit, and as many again once these have left."""
    profile = LinkProfile.parse(f"delay 10ms {words}")
    assert LinkProfile.parse(str(profile)) == profile
    link: Link[int] = Link(profile)
    for burst in (0, 10 * MS):
        for number in range(1000):
            link.send(burst, number, 100)
    assert (link.stats.dropped_limit, len(link.poll(20 * MS))) == (2000 - 2 * most, 2 * most)


@given(st.data())
def test_a_limit_in_bytes_counts_what_is_in_flight(data: st.DataObject) -> None:
    """Whatever holds messages: jitter, slots, a rate, unordered resends, reordering, and a change between them."""
    profiles = [
        f"delay 3ms 2ms {words} limit bytes {data.draw(st.integers(1, 3000))}"
        for words in (
            "",
            "slot 1ms 2ms packets 2",
            "rate 1mbit loss 40% resend 2 2ms unordered",
            "reorder 30%",
            "rate 1mbit",
        )
    ]
    profiles.append("delay 2ms")
    link: Link[int] = Link(LinkProfile.parse(data.draw(st.sampled_from(profiles))), 1)
    now_ns = 0
    for number in range(data.draw(st.integers(1, 60))):
        now_ns += data.draw(st.integers(0, MS))
        if data.draw(st.integers(0, 9)) == 0:
            link.change(LinkProfile.parse(data.draw(st.sampled_from(profiles))), now_ns)
        if data.draw(st.booleans()):
            link.poll(now_ns)
        link.send(now_ns, number, data.draw(st.integers(0, 1500)))
        if link.limit_bytes:
            held = sum(entry[4] for entry in link.queue) + sum(entry[4] for entry in link.later)
            assert link.bytes_in_flight == held


def test_a_message_larger_than_the_limit_is_dropped_and_smaller_ones_pass() -> None:
    link: Link[int] = Link(LinkProfile.parse("delay 10ms limit bytes 1000"))
    for number, size in enumerate((900, 200, 100, 1001)):
        link.send(0, number, size)
    assert [number for _, number in link.poll(10 * MS)] == [0, 2]


@pytest.mark.parametrize(
    ("name", "text", "kind", "said"),
    [
        ("mm.trace", "0\n104\n209\n", "trace", "mahimahi"),
        ("leo.delay", "65\n67\n66.5\n", "csv", "one delay per line"),
        ("named.txt", "delay_us\n650\n670\n", "csv", "one delay per line"),
        ("rates.log", RATES, "trace", "Mbit/s"),
        ("rates.csv", "time_s,mbit_s\n0,1\n1,2\n", "trace", "Mbit/s"),
        ("leo.csv", "time_s,delay_ms\n0,20\n1,30\n", "csv", "over time"),
        ("with space.csv", "time_s,delay_ms\n0,20\n1,30\n", "csv", "over time"),
    ],
)
def test_the_name_of_a_file_alone(
    tmp_path: Path, name: str, text: str, kind: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = file(tmp_path, name, text)
    word = f'"{path}"' if " " in path else path
    assert LinkProfile.parse(f"delay 5ms {word}") == LinkProfile.parse(f"delay 5ms {kind} {word}")
    (note,) = notes(word)
    assert said in note
    assert f"{kind} {word}" in note
    assert not notes(f"{kind} {word}")
    assert main(["show", "--count", "10", word]) == 0
    shown = capsys.readouterr()
    assert shown.err == f"netem: {note}\n"
    assert f"{kind} {word}" in shown.out.splitlines()[0]


@pytest.mark.parametrize(
    ("words", "name", "text", "line", "value"),
    [
        ("distribution {}", "d.txt", "20\n21\nabc\n", 3, "abc"),
        ("distribution {}", "d.txt", "20\n-1\n", 2, "-1"),
        ("distribution {}", "d.txt", "20\n\n# so\nnan\n", 4, "nan"),
        ("distribution {}", "d.txt", "0.0 20\n0.1 21\n", 1, "0.0 20"),
        ("distribution {}", "d.txt", "delay_m\n20\n", 1, "delay_m"),
        ("delay 9ms 1ms distribution {}", "d.dist", "1 2 3\n4 5.5\n", 2, "4 5.5"),
        ("delay 9ms 1ms distribution {}", "d.dist", "1 2 3\n40000\n", 2, "40000"),
        ("csv {}", "c.txt", "20\n21\n20;5\n", 3, "20 5"),
        ("csv {}", "c.csv", "time_s,delay_ms\n0,20\n1,x\n", 3, "1,x"),
        ("trace {}", "r.txt", "0 1.5\n0.5 -2\n", 2, "0.5 -2"),
        ("trace {}", "r.txt", "0 1.5\n0.5 2\n0.5 1\n", 3, "0.5 1"),
        ("trace {}", "r.txt", "0 1.5\n0.5\n", 2, "0.5"),
        ("trace {}", "r.txt", "0 1.5\n1 2 3\n", 2, "1 2 3"),
        ("trace {}", "m.txt", "0\n5\n4\n", 3, "4"),
        ("{}", "x.txt", "1\n" + 5000 * "9" + "\n", 2, 40 * "9"),
        ("{}", "x.txt", "hello world\n", 1, "hello world"),
        ("{}", "x.txt", "\n\n1 2 3\n", 3, "1 2 3"),
    ],
)
def test_a_malformed_line_is_named(
    tmp_path: Path, words: str, name: str, text: str, line: int, value: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = file(tmp_path, name, text)
    assert main(["show", words.format(path)]) == 2
    (error,) = capsys.readouterr().err.splitlines()
    assert f"{path}, line {line}: '{value}' is not allowed; allowed: " in error


@pytest.mark.parametrize(
    ("words", "text", "named"),
    [
        ("distribution {}", "", "at least one line"),
        ("trace {}", "0 0\n1 0\n", "a rate above 0"),
        ("csv {} every 5ms", "time_s,delay_ms\n0,20\n", "the file has times of its own; leave every out"),
        ("{}", "", "a file of one kind"),
        ("distribution {}x", "1\n", "or a file"),
        ("limit bytes 0", "", "from 1 to"),
        ("limit bytes 5 kb", "", "'kb'"),
    ],
)
def test_what_is_refused_says_what_is_allowed(
    tmp_path: Path, words: str, text: str, named: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["show", words.format(file(tmp_path, "f.txt", text))]) == 2
    (error,) = capsys.readouterr().err.splitlines()
    assert named in error
