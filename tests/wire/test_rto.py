import pytest

from hapnet.errors import InvalidParameter
from hapnet.wire.rto import CEILING_NS, FLOOR_NS, INITIAL_NS, RtoEstimator

# By hand from RFC 6298, (2.2) and (2.3) with alpha 1/8, beta 1/4, K 4, in ms; (rtt, SRTT, RTTVAR, RTO)
#   120: 3/4*50 + 1/4*20 = 42.5;          7/8*100 + 15 = 102.5;            102.5 + 170
#    80: 3/4*42.5 + 1/4*22.5 = 37.5;      7/8*102.5 + 10 = 99.6875;        99.6875 + 150
#   400: 3/4*37.5 + 1/4*300.3125;         7/8*99.6875 + 50 = 137.2265625;  137.2265625 + 412.8125
GOLDEN = [
    (100.0, 100.0, 50.0, 300.0),
    (120.0, 102.5, 42.5, 272.5),
    (80.0, 99.6875, 37.5, 249.6875),
    (400.0, 137.2265625, 103.203125, 550.0390625),
]


def test_golden_sequence() -> None:
    rto = RtoEstimator()
    assert rto.rto_ns == INITIAL_NS
    for rtt, srtt, rttvar, timeout in GOLDEN:
        rto.sample(round(rtt * 1e6))
        assert rto.srtt_ns == pytest.approx(srtt * 1e6, abs=2)
        assert rto.rttvar_ns == pytest.approx(rttvar * 1e6, abs=2)
        assert rto.rto_ns == pytest.approx(timeout * 1e6, abs=8)


def test_back_off_doubles_to_the_ceiling_and_a_sample_ends_it() -> None:
    rto = RtoEstimator()
    seen = []
    for _ in range(5):
        rto.back_off()
        seen.append(rto.rto_ns)
    assert seen == [2 * INITIAL_NS, 4 * INITIAL_NS, CEILING_NS, CEILING_NS, CEILING_NS]
    rto.sample(100_000_000)
    assert rto.rto_ns == 300_000_000


def test_floor_ceiling_and_granularity() -> None:
    rto = RtoEstimator(floor_ns=1)
    for _ in range(100):
        rto.sample(50_000_000)
    assert rto.rto_ns == pytest.approx(51_000_000, abs=10)  # the variance is gone, one clock tick stays
    fast = RtoEstimator()
    fast.sample(100_000)
    assert fast.rto_ns == FLOOR_NS
    fast.sample(10**12)
    assert fast.rto_ns == CEILING_NS
    fast.sample(-5)
    assert fast.srtt_ns >= 0


def test_bounds_out_of_order_are_refused() -> None:
    with pytest.raises(InvalidParameter, match="initial_ns"):
        RtoEstimator(floor_ns=2, initial_ns=1)


def test_a_round_trip_below_zero_counts_as_none() -> None:
    """A clock that is set, or a forged acknowledgement; as the first sample and as a later one."""
    rto, other = RtoEstimator(), RtoEstimator()
    rto.sample(-(10**9))
    other.sample(0)
    assert (rto.srtt_ns, rto.rttvar_ns, rto.rto_ns) == (0, 0, FLOOR_NS)
    for one, rtt in ((rto, -(10**12)), (other, 0)):
        one.sample(100_000_000)
        one.sample(rtt)
    assert (rto.srtt_ns, rto.rttvar_ns, rto.rto_ns) == (other.srtt_ns, other.rttvar_ns, other.rto_ns)
