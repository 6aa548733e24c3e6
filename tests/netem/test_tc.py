"""The texts of the kernel's selftests of netem, and what ``tc qdisc show`` prints for them, are read.

The texts are those of tools/testing/selftests/tc-testing/tc-tests/qdiscs/netem.json in torvalds/linux; the order and
the labels of what is printed are those of iproute2's tc/q_netem.c.
"""

from pathlib import Path

import pytest

from netem import LinkProfile, NetemError, models, survey, tc
from netem.cli import main
from netem.delay_table import DelayTable

# the options that a selftest gives, and those that tc prints after the limit
SELFTESTS = {
    "cb28": ("", ""),
    "a089": ("limit 200", ""),
    "3449": ("delay 100ms", "delay 100ms"),
    "3782": ("delay 100ms 10ms distribution normal corrupt 1%", "delay 100ms  10ms corrupt 1%"),
    "2b82": ("delay 100ms 10ms distribution normal duplicate 1%", "delay 100ms  10ms duplicate 1%"),
    "a932": ("delay 100ms 10ms distribution pareto loss 1%", "delay 100ms  10ms loss 1%"),
    "e01a": (
        "delay 100ms 10ms distribution paretonormal loss state 1",
        "delay 100ms  10ms loss state p13 1% p31 99% p32 0% p23 100% p14 0%",
    ),
    "ba29": ("loss gemodel 1%", "loss gemodel p 1% r 99% 1-h 100% 1-k 0%"),
    "0492": ("delay 100ms 10ms reorder 2% gap 100", "delay 100ms  10ms reorder 2% gap 100"),
    "7862": ("rate 20000", "rate 20Kbit"),
    "7235": ("slot 10 200 packets 2000 bytes 9000", "slot 10ns 200ns packets 2000 bytes 9000"),
    "5439": ("slot distribution pareto 1ms 0.1ms", "slot distribution 1ms 100us"),
    "5029": ("delay 100ms 10ms distribution normal loss 2%", "delay 100ms  10ms loss 2%"),
    "3785": ("delay 200ms 10ms", "delay 200ms  10ms"),
    "1676": ("gap 1 limit 1 duplicate 100% delay 1us reorder 100%", "delay 1us duplicate 100% reorder 100% gap 1"),
    "d34d": ("duplicate 50%", "duplicate 50%"),
}


@pytest.mark.parametrize("name", SELFTESTS)
def test_the_selftests_and_what_tc_prints_for_them(name: str) -> None:
    given, printed = SELFTESTS[name]
    asked = LinkProfile.parse(given)
    line = f"qdisc netem 1: dev dummy0 root refcnt 2 limit {asked.limit} {printed} "
    assert LinkProfile.parse(f"tc qdisc add dev dummy0 handle 1: root netem {given}") == asked
    slot = None if asked.slot is None else asked.slot.distribution and "uniform"
    shown = LinkProfile.parse(line)
    assert shown.replace(distribution=asked.distribution, slot=asked.slot) == asked
    assert shown.distribution == "uniform"
    assert shown.slot is None or shown.slot.distribution == slot
    assert LinkProfile.parse(f"{line}\n Sent 55 bytes 5 pkt (dropped 0)\n backlog 0b 0p requeues 0") == shown
    # what tc does not print is named, and nothing else
    lost = asked.jitter_ns > 0, bool(asked.slot and asked.slot.distribution)
    assert [("of a delay" in note, "of a slot" in note) for note in tc.left_out(line)] == [
        pair for pair, there in zip(((True, False), (False, True)), lost, strict=True) if there
    ]
    assert not tc.left_out(given)


def test_every_option_that_tc_prints() -> None:
    line = (
        "qdisc netem 8001: parent 1:3 limit 50 delay 10ms  1ms 25% loss state p13 1% p31 20% p32 3% p23 40% p14 5% "
        "duplicate 1% 2% reorder 25% 50% corrupt 3% 4% rate 5Kbit packetoverhead 20 cellsize 100 celloverhead 5 "
        "slot 1ms 2ms packets 3 bytes 900 seed 7 gap 5"
    )
    assert LinkProfile.parse(line) == LinkProfile.parse(
        "limit 50 delay 10ms 1ms 25% loss state 1% 20% 3% 40% 5% duplicate 1% 2% reorder 25% 50% gap 5 corrupt 3% 4% "
        "rate 5kbit 20 100 5 slot 1ms 2ms packets 3 bytes 900 seed 7"
    )
    assert LinkProfile.parse("rate 5Kbit celloverhead 5") == LinkProfile.parse("rate 5kbit 0 0 5")
    assert LinkProfile.parse("loss gemodel p 1% r 20% 1-h 70% 1-k 0.1%") == LinkProfile.parse(
        "loss gemodel 1% 20% 70% 0.1%"
    )


def test_the_beginnings_of_words_and_sizes_as_tc_reads_them() -> None:
    """In the order in which q_netem.c compares: d is delay, s is seed."""
    assert LinkProfile.parse("lat 9ms 1ms dist normal dup 1% l 7 drop 2% c 3% reo 5% ga 2") == LinkProfile.parse(
        "delay 9ms 1ms distribution normal duplicate 1% limit 7 loss 2% corrupt 3% reorder 5% gap 2"
    )
    assert LinkProfile.parse("d 9ms s 5 sl 1ms bytes 9k r 5%") == LinkProfile.parse(
        "delay 9ms seed 5 slot 1ms bytes 9216 reorder 5%"
    )


@pytest.mark.slow
def test_tcs_own_tables() -> None:
    """The tables that netem computes are those of iproute2; `experimental` is read from where it is installed."""
    places = [place for place in Path("/usr/lib").glob("**/tc") if (place / "normal.dist").exists()]
    if not places:
        pytest.skip("iproute2 is not installed")
    for name in ("normal", "pareto", "paretonormal"):
        file = DelayTable.load(str(places[0] / f"{name}.dist"))
        assert [round(8192 * value) for value in file.values] == sorted(models.table(name).tolist())
    profile = LinkProfile.parse("delay 9ms 1ms distribution experimental")
    assert str(profile) == f"delay 9ms 1ms distribution {places[0] / 'experimental.dist'}"


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("limit 64kb", "limit bytes 64kb"),
        ("limit -1", "from 1"),
        ("loss 1% ecn", "no ECN field to mark"),
        ("qdisc netem 1: root refcnt 2 limit 9 loss 1% ecn  gap 1", "ecn"),
        ("qdisc noqueue 0: dev lo root refcnt 2", "that of netem"),
        ("qdisc netem 1: root limit 9 qdisc netem 2: parent 1: limit 9", "one qdisc"),
        ("tc qdisc add dev eth0 root fq", "that of netem"),
        ("loss state p31 1%", "p31"),
        ("loss gemodel p 1% 1-h 70%", "1-h"),
        ("loss gemodel p", "a value after"),
        ("delay 100", "with its unit"),
    ],
)
def test_what_is_refused_is_named(text: str, named: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(NetemError, match=named):
        LinkProfile.parse(text)
    assert main(["show", text]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_show_counts_corrupted_messages() -> None:
    """5 % of 20,000, within five standard deviations; of those that are not lost."""
    for words, share in (("corrupt 5%", 0.05), ("loss 20% corrupt 5%", 0.04)):
        profile = LinkProfile.parse(words)
        result = survey.run(profile, 0, 20_000, 1_000_000, 100)
        assert abs(result.stats.corrupted - 20_000 * share) < 5 * (20_000 * share * (1 - share)) ** 0.5
        assert f"expected {100 * share:.2f} %" in next(
            line for line in survey.lines(profile, result) if line.startswith("corrupted")
        )
