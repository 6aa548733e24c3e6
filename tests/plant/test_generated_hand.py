"""Generated hands and their tremor: each the same everywhere, smooth, in its ranges."""

import numpy as np
import pytest

from hapnet.assembly.build import prepare
from hapnet.assembly.operators import operator
from hapnet.errors import HapnetError
from hapnet.params import Params
from hapnet.plant.generated_hand import HERTZ
from hapnet.plant.operator import Operator


def hand(name: str, dof: int = 1, **more: object) -> Operator:
    params = Params().set({"operator": name, "dof": dof, **more})
    return operator(params, prepare(params).scene)


def path(one: Operator, seconds: float = 60.0, hz: float = 200.0) -> np.ndarray:
    return np.array([one.reference(k / hz) for k in range(round(seconds * hz))])


@pytest.mark.parametrize("number", range(1, 9))
@pytest.mark.parametrize("dof", [1, 3])
def test_a_hand_reaches_into_the_wall_and_out_of_it_and_never_jumps(number: int, dof: int) -> None:
    x = path(hand(f"hand-{number}", dof))
    assert np.all(x[0] == 0.0)
    assert np.all(x[-1] == pytest.approx(np.zeros(dof), abs=1e-9))
    into = np.flatnonzero(np.diff((x[:, 0] > 0.02).astype(int)) == 1)
    assert len(into) >= 10
    assert x[:, 0].min() >= -0.02
    assert x[:, 0].max() <= 0.045
    assert np.abs(x[:, 1:]).max(initial=0.0) <= 0.02
    # the fastest: 0.065 m (and 0.04 m on each further axis) in 0.35 s; minimum jerk peaks at 1.875 times the mean
    assert (
        np.linalg.norm(np.diff(x, axis=0), axis=1).max() * 200.0
        <= 1.875 * np.hypot(0.065, 0.04 * (dof > 1) * 2**0.5) / 0.35
    )


def test_numbers_are_different_hands_and_the_same_number_the_same() -> None:
    one, again, other = (hand(f"hand-{number}") for number in (5, 5, 6))
    assert np.array_equal(path(one, 10.0), path(again, 10.0))
    assert one.impedance == again.impedance != other.impedance
    for found in (one, other):
        assert 0.1 <= found.impedance.mass <= 0.554
        assert 40.0 <= found.impedance.stiffness <= 135.0


def test_a_tremor_is_between_8_and_12_hz_and_of_its_amplitude() -> None:
    still, trembling = hand("rest", 2), hand("rest", 2, **{"operator_model.tremor_m": 3e-4})
    x = path(trembling, 20.0) - path(still, 20.0)
    assert 2e-4 < np.abs(x).max() <= 3e-4
    power = np.abs(np.fft.rfft(x[:, 0])) ** 2
    f = np.fft.rfftfreq(len(x), 1 / 200.0)
    assert power[(f > 8.0) & (f < 12.0)].sum() > 0.99 * power.sum()
    assert all(8.0 < one < 12.0 for one in HERTZ)


@pytest.mark.parametrize("name", ["hand-", "hand-x", "hand--1", "hand-1234567890"])
def test_what_is_no_hand_is_named(name: str) -> None:
    with pytest.raises(HapnetError, match="hand-N"):
        hand(name)
