"""A change of a tool's planes puts no energy into the device's spring; the planes of a point take effect in full."""

import numpy as np
import pytest

from hapnet.checks import MOST_PLANES, MOST_TOOL_PLANES, Array, Vector
from hapnet.control.added_damping import AddedDamping
from hapnet.control.contact_model import ContactModel
from hapnet.control.coupling import ProxySample
from hapnet.control.plane_changes import LENT_J
from hapnet.control.self_motion import SelfMotion
from hapnet.ext.tools.contacts import different
from hapnet.mechanics.plane import Plane, checked
from hapnet.mechanics.pose import AXES

K_WORLD, K_WALL, K, TICK = 500.0, 3000.0, 600.0, 1e-3
FELT = K * K_WALL / (K_WORLD + K_WALL)
"""The stiffness with which a device in contact is pushed back [N/m]."""


def model(n: int) -> ContactModel:
    eye = np.eye(n)
    return ContactModel(
        (0.0,) * n,
        compliance=(eye / K_WORLD).tolist(),
        lead=np.zeros((n, n)).tolist(),
        self_motion=SelfMotion(),
        added=AddedDamping((eye * K).tolist(), (eye / K).tolist(), 0.0, 5.0),
    )


def wall(n: int, axis: int, deep_m: float) -> Plane:
    """A plane across an axis, in which the origin is so deep."""
    return Plane(tuple(np.eye(n)[axis].tolist()), -deep_m, K_WALL, 0.0)


def answer(m: ContactModel, *planes: Plane, at: Vector) -> None:
    m.receive(ProxySample(at, 1.0, (0.0,) * len(at), planes, 0.05, 1.0), 0.0, 0.0)


def strain(m: ContactModel, x: Vector, seconds: float = 0.0) -> Array:
    """x - y [m] after so long at rest."""
    for _ in range(1 + round(seconds / TICK)):
        y = m.step(TICK, x)
    return np.array(x) - np.array(y)


def spring_J(e: Array) -> float:
    return 0.5 * K * float(e @ e)


@pytest.mark.parametrize(("n", "appears"), [(3, True), (AXES, False)])
def test_a_plane_that_the_device_is_deep_in_appears_for_a_point_and_not_for_a_tool(n: int, appears: bool) -> None:
    m, home = model(n), (0.0,) * n
    assert spring_J(strain(m, home)) == 0.0
    answer(m, wall(n, 1, 0.02), at=home)
    full_J = 0.5 * FELT * FELT / K * 0.02**2
    assert full_J > 20.0 * LENT_J
    assert spring_J(strain(m, home, 2.0)) == pytest.approx(full_J if appears else LENT_J, rel=1e-6)


def test_further_motion_into_a_tools_plane_meets_its_full_stiffness() -> None:
    m, home = model(AXES), (0.0,) * AXES
    answer(m, wall(AXES, 1, 0.02), at=home)
    before = strain(m, home, 0.9)  # an answer older than 1 s is damped
    deeper = strain(m, (0.0, 0.001, *home[2:]), 0.0)
    assert K * (deeper - before)[1] == pytest.approx(FELT * 0.001, rel=0.05)


def test_planes_that_turn_keep_the_springs_energy() -> None:
    """Whatever planes each answer has, the spring never has more energy than at first and what may be lent."""
    m, home = model(AXES), (0.0,) * AXES
    rng = np.random.default_rng(5104)
    answer(m, wall(AXES, 0, 0.003), at=home)
    first = most = spring_J(strain(m, home, 0.5))
    for _ in range(60):
        answer(m, *[wall(AXES, axis, rng.uniform(-0.02, 0.03)) for axis in rng.permutation(AXES)[:4]], at=home)
        for _ in range(30):
            most = max(most, spring_J(strain(m, home)))
    assert 0.5 * LENT_J < first <= most <= first + 2.0 * LENT_J


@pytest.mark.long
def test_a_plane_that_lets_go_lets_go_and_pays_for_the_next() -> None:
    m, home = model(AXES), (0.0,) * AXES
    answer(m, wall(AXES, 1, 0.02), at=home)
    assert spring_J(strain(m, home, 5.0)) > 0.0
    answer(m, at=home)
    assert spring_J(strain(m, home, 5.0)) < 1e-12
    answer(m, wall(AXES, 2, 0.02), at=home)
    assert spring_J(strain(m, home, 5.0)) == pytest.approx(LENT_J, rel=1e-3)


def test_a_tools_planes_are_of_different_directions_first() -> None:
    def tilted(angle: float, deep_m: float) -> Plane:
        return Plane((np.cos(angle), np.sin(angle), *(0.0,) * (AXES - 2)), -deep_m, K_WALL, 0.0)

    one_side = [tilted(0.01 * k, 0.02 - 1e-4 * k) for k in range(12)]
    others = [tilted(angle, 0.0) for angle in (1.5, 3.0, 4.5)]
    chosen = different([*one_side, *others])
    assert chosen == (one_side[0], *others, *one_side[1:5])
    assert checked(chosen, AXES) == chosen
    assert len(chosen) == MOST_TOOL_PLANES == 2 * MOST_PLANES
    assert len(checked(chosen[:1] * 9, AXES)) == MOST_TOOL_PLANES
