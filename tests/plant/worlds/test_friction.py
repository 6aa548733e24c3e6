"""Coulomb's friction of a point between two planes, beside the force of the spring and damper that pull it."""

from math import cos, radians, sin

import numpy as np
import pytest

from hapnet.ext.solids.rigid_contacts import RigidContacts, Solid
from hapnet.ext.solids.shapes import HalfSpace
from hapnet.plant.integrator import PassiveIntegrator
from tests.conftest import mostly_slow

K, B, M = 500.0, 14.0, 0.02
DEPTH, SPEED = 0.01, 0.05


@pytest.mark.parametrize(
    ("slope_deg", "step_ms", "mu", "held_share"),
    mostly_slow(
        [
            (70.0, 10.0, 0.1, 0.99),
            (20.0, 10.0, 0.8, 0.99),
            (70.0, 30.0, 0.8, 0.9),
            (20.0, 30.0, 0.1, 0.7),
            (20.0, 1.0, 0.8, 0.99),
        ],
        4,
    ),
)
@pytest.mark.long
def test_a_groove_holds_by_the_friction_of_both_its_sides(
    slope_deg: float, step_ms: float, mu: float, held_share: float
) -> None:
    """Each side carries the load over twice the cosine of its slope. In the step in which it stops the point goes on by
    half of its speed: 0.75 mm at 30 ms, 0.4 N less pull."""
    a, dt = radians(slope_deg), 1e-3 * step_ms
    sides = [Solid(HalfSpace((0.0, sign * sin(a), -cos(a)), 0.0), 3000.0, 10.0, mu) for sign in (1.0, -1.0)]
    contacts = RigidContacts(sides, 3)
    mass = PassiveIntegrator(M, B, K, (0.0, 0.0, 0.001))
    for k in range(round(0.5 / dt)):
        mass.step(dt, (0.0, 0.0, 0.001 - (DEPTH + 0.001) * min(1.0, 5.0 * k * dt)), contacts)
    pulls, y = [], (0.0, 0.0, -DEPTH)
    for k in range(round(1.2 / dt)):
        y = (SPEED * (k + 1) * dt, 0.0, -DEPTH)
        begun = np.array(mass.x[:3])
        mass.step(dt, y, contacts)
        ended = np.array(mass.x[:3])
        if k * dt > 0.8:
            pulls.append(K * (np.array(y) - 0.5 * (begun + ended)) - B * (ended - begun) / dt)
    along, _, down = np.mean(pulls, axis=0)
    assert along == pytest.approx(mu * -down / cos(a), rel=0.01)
    for _ in range(round(2.0 / dt)):
        mass.step(dt, y, contacts)
    held, most = K * (y[0] - mass.x[0]), mu * K * (mass.x[2] - y[2]) / cos(a)
    assert held_share * most <= held <= 1.001 * most


def test_a_point_that_was_put_elsewhere_begins_at_rest() -> None:
    """What it slid before does not count there: the step is that of solids which never saw it slide."""
    floor = [Solid(HalfSpace((0.0, 0.0, -1.0), 0.0), 3000.0, 10.0, 0.5)]
    steps = []
    for slides in (True, False):
        contacts = RigidContacts(floor, 3)
        if slides:
            moving = PassiveIntegrator(0.02, 14.0, 500.0, (0.0, 0.0, 1e-4))
            for k in range(20):
                moving.step(0.01, (1e-3 * k, 0.0, -3e-3), contacts)
            assert moving.velocity[0] > 0.05
        contacts.energy_J = 0.0
        mass = PassiveIntegrator(0.02, 14.0, 500.0, (0.3, 0.0, 1e-4))
        steps.append(mass.step(0.01, (0.3 + 2e-3, 0.0, -3e-3), contacts).force)
    assert abs(steps[1][0]) > 0.1
    np.testing.assert_allclose(steps[0], steps[1], rtol=1e-12)
