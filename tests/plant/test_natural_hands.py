"""Fast strokes and handwriting: their speeds and places, by number, and what is refused."""

import numpy as np
import pytest

from hapnet.assembly.operators import operator
from hapnet.assembly.scenes import scene_of
from hapnet.errors import InvalidParameter
from hapnet.params import Params
from hapnet.plant.natural_hands import LASTS_S, WALL_M, Strokes, Writing
from hapnet.plant.operator import Impedance

TIMES = np.arange(0.0, 60.0, 1e-3)


def named(name: str, **changes: object) -> Strokes | Writing:
    params = Params().set({"operator": name, **changes})
    found = operator(params, scene_of(params))
    assert isinstance(found, Strokes | Writing)
    return found


@pytest.mark.parametrize("number", [1, 51])
def test_strokes_have_their_speeds_and_touch_a_wall(number: int) -> None:
    """Peaks of 0.3 to 0.9 m/s, as the finite differences show without the tremor's 18 mm/s; half end in the wall."""
    path = named(f"strokes-{number}").path(TIMES)[:, 0]
    speeds = np.abs(np.diff(path)) / 1e-3
    assert 0.6 < speeds.max() < 0.9 + 0.02
    assert 0.2 < np.mean(path > WALL_M) < 0.8
    assert path.max() < 2.0 * WALL_M + 1e-3


def test_a_pen_touches_and_lifts() -> None:
    """1.1 times a second, by 6 mm at most; along the wall it moves at writing speed."""
    path = named("writing-3", scene="plane").path(TIMES)[3000:]
    touching = path[:, 0] > WALL_M
    assert np.count_nonzero(np.diff(touching.astype(int)) == 1) == pytest.approx(1.1 * 57.0, abs=2)
    assert np.ptp(path[:, 0]) <= 0.008
    assert 0.02 < np.abs(np.diff(path[:, 1])).max() / 1e-3 < 0.3


@pytest.mark.long
def test_a_number_is_a_motion_and_a_grip_is_a_parameter() -> None:
    stiff = named("strokes-7", **{"operator_model.stiffness": 900.0})
    assert stiff.impedance.stiffness == 900.0
    same, other = named("strokes-7"), named("strokes-8")
    assert np.array_equal(stiff.path(TIMES), same.path(TIMES))
    assert not np.array_equal(same.path(TIMES), other.path(TIMES))
    assert same.reference(12.3) == tuple(same.path(np.array([12.3]))[0])


@pytest.mark.parametrize("make", [Strokes, Writing])
def test_the_motion_goes_on_for_ten_minutes(make: type[Strokes | Writing]) -> None:
    path = make(2, Impedance(), np.random.default_rng(5)).path(np.array([0.0, 600.0, LASTS_S + 100.0]))
    assert np.isfinite(path).all()
    assert np.abs(path).max() < 0.2


@pytest.mark.parametrize("name", ["strokes-0", "strokes-", "writing-x"])
def test_a_wrong_number_is_refused(name: str) -> None:
    with pytest.raises(InvalidParameter, match="strokes-N, writing-N"):
        named(name)
