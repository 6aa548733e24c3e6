"""How old a sample is, by estimate."""

import math

import pytest

from hapnet.wire.path import InUse, age_s


@pytest.mark.parametrize(
    ("now_ms", "age_ms"),
    [
        pytest.param(130, 70, id="30 ms after it came"),
        pytest.param(100, 40, id="as it came"),
        pytest.param(20, 40, id="a step that begins 80 ms late has its planned time"),
    ],
)
def test_a_sample_is_as_old_as_its_transit_at_least(now_ms: int, age_ms: int) -> None:
    used = InUse()
    assert math.isnan(age_s(used, 100))
    used.came_ns, used.took_ns = 100_000_000, 40_000_000
    assert age_s(used, now_ms * 1_000_000) == pytest.approx(age_ms * 1e-3)
