from math import inf, nan

import pytest
from hypothesis import given, strategies as st

from hapnet.errors import InvalidParameter
from hapnet.wire.token_bucket import TokenBucket


@given(st.lists(st.tuples(st.integers(0, 10**9), st.integers(0, 10**9)), max_size=50))
@pytest.mark.long
def test_never_more_than_burst_plus_power_times_time(asks: list[tuple[int, int]]) -> None:
    bucket = TokenBucket(power_W=0.7, burst_J=0.01)
    now = taken = 0
    for wait, wanted in asks:
        now += wait
        got = bucket.take(wanted, now)
        assert 0 <= got <= wanted
        taken += got
        assert taken * 10 <= 10**8 + 7 * now  # 1e7 nJ at once, 0.7 nJ a ns


def test_due_is_exact() -> None:
    bucket = TokenBucket(power_W=0.003, burst_J=1e-6)
    assert bucket.take(5_000, 100) == 1_000
    due = bucket.due_ns(7, 10**9)  # 7 nJ at 3 nJ/us: 2333.3 ns
    assert due == 100 + 2334
    assert bucket.take(7, due - 1) == 6
    assert bucket.take(1, due) == 1
    assert due < bucket.due_ns(10**6, 1000) <= due + 1000  # not for the whole, only for a step's worth


def test_time_that_goes_back_gives_nothing() -> None:
    bucket = TokenBucket(power_W=1.0, burst_J=1e-6)
    assert bucket.take(2_000, 10**9) == 1_000
    assert bucket.take(2_000, 0) == 0
    assert bucket.take(2_000, 10**9 + 10) == 10


@pytest.mark.parametrize("value", [0.0, -1.0, nan, inf, 1e10])
def test_bad_settings(value: float) -> None:
    with pytest.raises(InvalidParameter):
        TokenBucket(power_W=value, burst_J=1.0)
    with pytest.raises(InvalidParameter):
        TokenBucket(power_W=1.0, burst_J=value)


def test_a_bucket_has_a_lid() -> None:
    """After an hour of quiet it pays the burst and no more, and from then on what flows in."""
    bucket = TokenBucket(power_W=1.0, burst_J=1e-6)
    assert bucket.take(400, 0) == 400
    hour = 3600 * 10**9
    assert bucket.take(10**12, hour) == 1_000
    assert bucket.take(10**12, hour + 7) == 7
