"""The grammar: tc's words to a profile and back, what is refused and how, and command-line overrides."""

import pickle
import subprocess
import sys
from decimal import Decimal

import pytest
from hypothesis import given, strategies as st

from netem import PRESETS, LinkProfile, NetemError, ProfileError, compose, units
from netem.effects import FourStateLoss, GilbertElliottLoss, RandomLoss, Slot
from tests.netem.support import fractions, profiles


@given(profiles())
def test_words_round_trip(profile: LinkProfile) -> None:
    assert LinkProfile.parse(str(profile)) == profile


@given(fractions)
def test_fractions_round_trip_exactly(fraction: float) -> None:
    assert units.parse_fraction("loss", units.format_fraction(fraction)) == fraction


@given(st.integers(0, units.MAX_TIME_NS), st.integers(0, units.MAX_RATE_BIT_S))
def test_times_and_rates_round_trip_exactly(ns: int, bit_s: int) -> None:
    assert units.parse_time("delay", units.format_time(ns)) == ns
    assert units.parse_rate("rate", units.format_rate(bit_s)) == bit_s


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("", LinkProfile()),
        ("delay 40ms", LinkProfile(delay_ns=40_000_000)),
        ("latency 1.5msec 200usecs 25%", LinkProfile(delay_ns=1_500_000, jitter_ns=200_000, delay_correlation=0.25)),
        ("delay 0", LinkProfile()),
        ("delay 1s 1ms distribution pareto", LinkProfile(delay_ns=10**9, jitter_ns=10**6, distribution="pareto")),
        ("loss 5%", LinkProfile(loss=RandomLoss(0.05))),
        ("loss 5", LinkProfile(loss=RandomLoss(0.05))),
        ("loss random 5% 25%", LinkProfile(loss=RandomLoss(0.05, 0.25))),
        ("drop 0.3%", LinkProfile(loss=RandomLoss(0.003))),
        ("loss state 1%", LinkProfile(loss=FourStateLoss(0.01, 0.99, 0.0, 1.0, 0.0))),
        ("loss state 1% 20% 3% 40% 5%", LinkProfile(loss=FourStateLoss(0.01, 0.20, 0.03, 0.40, 0.05))),
        ("loss gemodel 1%", LinkProfile(loss=GilbertElliottLoss(0.01, 0.99, 1.0, 0.0))),
        ("loss gemodel 1% 20% 70% 0.1%", LinkProfile(loss=GilbertElliottLoss(0.01, 0.20, 0.70, 0.001))),
        ("corrupt 1% 5%", LinkProfile(corrupt=0.01, corrupt_correlation=0.05)),
        (
            "delay 10ms reorder 25% 50% gap 5",
            LinkProfile(delay_ns=10_000_000, reorder=0.25, reorder_correlation=0.5, gap=5),
        ),
        ("gap 5 delay 10ms", LinkProfile(delay_ns=10_000_000, reorder=1.0, gap=5)),
        ("rate 1mbit", LinkProfile(rate_bit_s=1_000_000)),
        ("rate 1000", LinkProfile(rate_bit_s=1000)),
        ("rate 64kbps -14 48 5", LinkProfile(rate_bit_s=512_000, overhead=-14, cell_size=48, cell_overhead=5)),
        ("rate 2KiBit", LinkProfile(rate_bit_s=2048)),
        ("slot 10ms", LinkProfile(slot=Slot(10_000_000, 10_000_000))),
        ("slot 1ms 2ms packets 3 bytes 900", LinkProfile(slot=Slot(1_000_000, 2_000_000, "", 3, 900))),
        ("slot distribution normal 8ms 1ms bytes 9", LinkProfile(slot=Slot(8_000_000, 1_000_000, "normal", 0, 9))),
        ("limit 7 seed 12", LinkProfile(limit=7, seed=12)),
    ],
)
def test_tc_words(words: str, expected: LinkProfile) -> None:
    assert LinkProfile.parse(words) == expected


@pytest.mark.parametrize(
    ("words", "named"),
    [
        ("dely 40ms", "did you mean delay?"),
        ("delay", "delay"),
        ("delay 40", "40"),
        ("delay 40parsec", "40parsec"),
        ("delay -3ms", "-3ms"),
        ("delay 1e999s", "1e999s"),
        ("delay nan", "nan"),
        ("delay 40ms 10ms 25% 7", "7"),
        ("loss 101%", "101%"),
        ("loss state", "loss state"),
        ("loss state 60% 10% 3% 4% 50%", "p14"),
        ("delay 1ms 1ms distribution cauchy", "cauchy"),
        ("distribution normal", "normal"),
        ("delay 40ms distribution normal", "normal"),
        ("reorder 25%", "reorder"),
        ("delay 1ms delay 2ms", "delay"),
        ("rate fast", "fast"),
        ("rate 0.5bit", "0.5bit"),
        ("rate 1mbit 0 48 -49", "-49"),
        ("slot 2ms 1ms", "slot"),
        ("slot distribution normal 1ms", "slot"),
        ("limit 0", "0"),
        ("limit 1.5", "1.5"),
        ("seed -1", "-1"),
        ("delay \u0663ms", "\u0663ms"),
    ],
)
def test_malformed_words_are_named(words: str, named: str) -> None:
    with pytest.raises(ProfileError) as caught:
        LinkProfile.parse(words)
    assert named in str(caught.value)
    assert "did you mean" in named or "allowed: " in str(caught.value) or caught.value.why
    assert "\n" not in str(caught.value)


@given(
    st.text(max_size=60)
    | st.lists(st.sampled_from(["delay", "loss", "5%", "1ms", "gap", "slot", "rate", "3", "state"])).map(" ".join)
)
def test_any_text_is_parsed_or_refused_by_netems_error(text: str) -> None:
    try:
        profile = LinkProfile.parse(text)
    except NetemError:
        return
    assert LinkProfile.parse(str(profile)) == profile


@pytest.mark.parametrize(
    "change",
    [
        {"delay_ns": -1},
        {"delay_ns": 0.04},
        {"reorder": 1.5},
        {"corrupt": float("nan")},
        {"limit": 0},
        {"distribution": "cauchy"},
        {"rate_bit_s": -5},
    ],
)
def test_values_set_from_a_program_are_checked(change: dict[str, object]) -> None:
    with pytest.raises(ProfileError):
        LinkProfile(delay_ns=1).replace(**change)


def test_presets_parse_and_unknown_ones_list_the_names() -> None:
    for name, words in PRESETS.items():
        assert str(LinkProfile.preset(name)) or name == "ideal"
        assert LinkProfile.preset(name) == LinkProfile.parse(words)
    with pytest.raises(ProfileError) as caught:
        LinkProfile.preset("dialup")
    assert all(name in str(caught.value) for name in ("dialup", *PRESETS))


def test_every_preset_can_keep_a_kilohertz_stream_in_flight() -> None:
    """One 64-byte message a millisecond fits the rate, and what is in flight then fits the limit."""
    for name in PRESETS:
        profile = LinkProfile.preset(name)
        assert profile.rate_bit_s == 0 or profile.rate_bit_s > 64 * 8 * 1000
        assert (profile.delay_ns + 4 * profile.jitter_ns) / 1e6 < profile.limit


def test_compose_overrides_a_preset_and_adds_to_words() -> None:
    assert compose() == LinkProfile()
    assert compose(preset="wifi") == LinkProfile.preset("wifi")
    assert compose(preset="geo", delay="40ms", loss="gemodel 1% 20%") == LinkProfile.preset("geo").replace(
        delay_ns=40_000_000, loss=GilbertElliottLoss(0.01, 0.2)
    )
    assert compose("loss 1%", delay="40ms", jitter="10ms 25%", reorder="5% gap 3", rate="1mbit") == LinkProfile.parse(
        "loss 1% delay 40ms 10ms 25% reorder 5% gap 3 rate 1mbit"
    )
    assert compose("delay 40ms", jitter="1ms").jitter_ns == 1_000_000
    assert compose(preset="wifi", jitter="0ms").distribution == "uniform"


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"text": "delay 1ms", "preset": "wifi"}, "give the name wifi or words, not both"),
        ({"text": "delay 1ms", "delay": "2ms"}, "the words set it too"),
        ({"text": "delay 1ms 1ms", "jitter": "2ms"}, "the words set it too"),
        ({"text": "drop 1%", "loss": "2%"}, "the words set it too"),
        ({"text": "delay 1ms gap 3", "reorder": "2%"}, "the words set it too"),
        ({"delay": "40ms 10ms"}, "one setting"),
        ({"loss": "2% delay 4ms"}, "one setting"),
        ({"loss": ""}, "loss"),
        ({"reorder": "5%"}, "delay"),
        ({"preset": "wfi"}, "wfi"),
    ],
)
def test_compose_refuses_conflicts(options: dict[str, str], named: str) -> None:
    with pytest.raises(ProfileError, match=named):
        compose(**options)


def test_errors_survive_pickling() -> None:
    error = ProfileError("delay", "x", "a time")
    assert str(pickle.loads(pickle.dumps(error))) == str(error)


def test_decimal_input_is_not_rounded_through_floats() -> None:
    assert units.parse_time("delay", "0.000000003s") == int(Decimal("0.000000003") * 10**9)


def test_profiles_need_no_numpy() -> None:
    """A command's --help imports them."""
    check = "import sys, netem, netem.profile, netem.cli; sys.exit('numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", check], check=False).returncode == 0
