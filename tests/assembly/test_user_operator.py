import math
from collections.abc import Callable

import pytest

from hapnet.assembly.operators import UserOperator
from hapnet.errors import HapnetError, InvalidParameter
from hapnet.params import Params
from hapnet.plant.operator import Impedance, Sine
from hapnet.simulation.simulation import simulate

HAND = Impedance(0.1, 1.0, 10.0)
Point = tuple[float, ...]


class Follower:
    """A hand that does what `then` says after 10 ms."""

    then: Callable[[], object] = staticmethod(lambda: (0.0, 0.0))

    def __init__(self, dof: int, impedance: Impedance) -> None:
        self.impedance = impedance
        self._at_rest = (0.0,) * dof

    def reference(self, t: float) -> object:
        return self._at_rest if t < 0.01 else self.then()


def fail() -> object:
    raise KeyError("muscle")


class Raising(Follower):
    then = staticmethod(fail)


class Shrinking(Follower):
    then = staticmethod(lambda: (0.1,))


class Lost(Follower):
    then = staticmethod(lambda: (0.1, math.nan))


class Silent(Follower):
    then = staticmethod(lambda: None)


class Circle(Sine):
    """The built-in hand, as one of the user's own."""

    def __init__(self, dof: int, impedance: Impedance) -> None:
        super().__init__(dof, impedance, 0.03, 0.5)


class LostAtOnce(Follower):
    def reference(self, t: float) -> object:
        return (math.inf,)


class Handless:
    def __init__(self, dof: int, impedance: Impedance) -> None:
        pass

    def reference(self, t: float) -> Point:
        return (0.0,)


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("Raising", r"reference\(0\.01\) raised KeyError: 'muscle'"),
        ("Shrinking", r"reference\(0\.01\) gave \(0\.1,\) instead of 2 finite numbers"),
        ("Lost", r"reference\(0\.01\) gave \(0\.1, nan\) instead of 2 finite numbers"),
        ("Silent", r"reference\(0\.01\) raised TypeError: .*NoneType"),
    ],
)
def test_whatever_it_does_wrong_later_names_it(name: str, says: str) -> None:
    hand = UserOperator(f"tests.assembly.test_user_operator:{name}", 2, HAND)
    assert hand.impedance is HAND
    assert hand.reference(0.009) == (0.0, 0.0)
    with pytest.raises(HapnetError, match=rf"the operator tests\.assembly\.test_user_operator:{name} failed: {says}"):
        hand.reference(0.01)


@pytest.mark.parametrize(
    ("name", "says"), [("LostAtOnce", "inf"), ("Handless", "no impedance"), ("Nobody", "Nobody"), ("HAND", "TypeError")]
)
def test_what_is_wrong_at_once_is_a_parameter(name: str, says: str) -> None:
    with pytest.raises(InvalidParameter, match=rf"operator is 'tests\.assembly\.test_user_operator:{name}'; .*{says}"):
        UserOperator(f"tests.assembly.test_user_operator:{name}", 1, HAND)


def test_a_guard_changes_nothing() -> None:
    """The same hand, guarded or not: the same bits."""
    params = Params().set({"duration_s": 1.0, "operator_model.amplitude_m": 0.03, "operator_model.frequency_hz": 0.5})
    own = simulate(params.set({"operator": "tests.assembly.test_user_operator:Circle"}), seed=1).recording
    built_in = simulate(params.set({"operator": "sine", "operator_model.start_periods": 0.0}), seed=1).recording
    for mine, theirs in ((own.device, built_in.device), (own.world, built_in.world)):
        assert (mine["position_m"] == theirs["position_m"]).all()


def test_a_simulation_ends_with_the_operators_name() -> None:
    params = Params().set({"duration_s": 1.0, "scene": "free", "dof": 2})
    with pytest.raises(HapnetError, match=r"the operator tests\.assembly\.test_user_operator:Raising failed"):
        simulate(params.set({"operator": "tests.assembly.test_user_operator:Raising"}), seed=1)
