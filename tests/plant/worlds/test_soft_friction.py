"""Coulomb's friction of a soft body's points together: of a ball that slides or is held, and of a block on solids.

The truth is mu times the push, of each point's force by its own normal, and Newton's law for the block.
"""

import numpy as np
import pytest

from hapnet.checks import Array
from hapnet.ext.soft import soft_mesh
from hapnet.ext.soft.soft_body import Body, Material
from hapnet.ext.soft.soft_contacts import Skin, SoftContacts
from hapnet.ext.solids.rigid_contacts import Solid
from hapnet.ext.solids.shapes import HalfSpace
from hapnet.plant.integrator import PassiveIntegrator
from tests.conftest import mostly_slow

K, B, M = 500.0, 14.0, 0.02
G = 9.81
SPEED = 0.05


class Pressed:
    """A ball beside a block that is held at its back, pressed in to `aim` [m]."""

    def __init__(self, mu: float, nodes: int = 216, radius: float = 0.01, aim: float = 0.006) -> None:
        places, tets = soft_mesh.block((0.06, 0.06, 0.06), nodes)
        places[:, 0] += radius + 1e-9 - places[:, 0].min()
        pinned = places[:, 0] > places[:, 0].max() - 1e-9
        body = Body(places, tets, pinned, Material(gravity=(0.0, 0.0, 0.0)))
        self.contacts, self.mu, self.aim = SoftContacts(body, Skin(friction=mu, radius=radius), 3), mu, aim
        self.mass = PassiveIntegrator(M, B, K, (0.0, -0.012, 0.0))
        self.rubs = self.most = self.points = 0.0

    def step(self, dt: float, y: float) -> None:
        """Step with the set-position at y aside, and sum up the friction and mu N of all points [N]."""
        contacts = self.contacts
        begun = contacts.places(contacts.body.x) - self.mass.position
        self.mass.step(dt, (self.aim, y, 0.0), contacts)
        n = begun + contacts.places(contacts.body.x) - self.mass.position
        n /= np.linalg.norm(n, axis=1)[:, None]
        pushes = (contacts.forces * n).sum(axis=1)
        self.rubs = float(np.linalg.norm(contacts.forces - pushes[:, None] * n, axis=1).sum())
        self.most, self.points = self.mu * float(pushes.sum()), int((pushes > 0.0).sum())


CASES = [
    (216, 0.007, 0.003, 10.0, 0.3), (343, 0.01, 0.006, 30.0, 0.1), (343, 0.01, 0.006, 10.0, 1.0),
    (1000, 0.01, 0.006, 10.0, 0.3), (216, 0.007, 0.003, 1.0, 0.3),
    *((nodes, radius, aim, dt, mu)
      for dt in (30.0, 10.0, 1.0)
      for nodes, radius, aim in ((216, 0.007, 0.003), (343, 0.01, 0.006), (1000, 0.01, 0.006))
      for mu in (0.1, 0.3, 1.0)),
]  # fmt: skip


@pytest.mark.parametrize(("nodes", "radius", "aim", "step_ms", "mu"), mostly_slow(CASES, 3, 17))
@pytest.mark.long
def test_a_ball_that_slides_is_rubbed_by_mu_times_its_push(
    nodes: int, radius: float, aim: float, step_ms: float, mu: float
) -> None:
    run, dt = Pressed(mu, nodes, radius, aim), 1e-3 * step_ms
    rubs, most = [], []
    for k in range(round(0.7 / dt)):
        run.step(dt, -0.012 + SPEED * max(0.0, k * dt - 0.2))
        if k * dt > 0.4:
            rubs.append(run.rubs)
            most.append(run.most)
    assert np.sum(rubs) == pytest.approx(np.sum(most), rel=0.03)


@pytest.mark.parametrize(
    ("step_ms", "mu", "seconds"),
    mostly_slow(
        [(30.0, 0.3, 6.0), (30.0, 0.3, 15.0), (10.0, 1.0, 3.0), (30.0, 0.3, 60.0), (10.0, 1.0, 60.0), (1.0, 0.1, 5.0)],
        1,
        3,
    ),
)
@pytest.mark.long
def test_a_ball_at_rest_is_held_by_what_stopped_it(step_ms: float, mu: float, seconds: float) -> None:
    """The pull of the spring stays as it was; the reported force is the spring's within 1 %."""
    run, dt = Pressed(mu), 1e-3 * step_ms
    for k in range(round(0.6 / dt)):
        run.step(dt, -0.012 + SPEED * max(0.0, k * dt - 0.2))
    stop = -0.012 + 0.4 * SPEED
    for _ in range(round(0.5 / dt)):
        run.step(dt, stop)
    pulled, held = stop - run.mass.position[1], run.rubs / run.most
    for _ in range(round(seconds / dt)):
        run.step(dt, stop)
        spring = K * (np.array((run.aim, stop, 0.0)) - run.mass.position)
        assert -np.array(run.mass.force) == pytest.approx(spring, abs=0.01 * float(np.linalg.norm(spring)))
    assert stop - run.mass.position[1] >= 0.95 * pulled
    assert run.rubs / run.most >= 0.95 * held
    assert run.points >= 3


def course(mu: float, share: float, dt: float, seconds: float, many: int) -> Array:
    """The places of a block on one plane, or in the corner of two, that is pulled along them by `share` of its friction
    and its load on all planes: at each step (n, ) [m]."""
    down = G * (np.array((0.0, 0.0, -1.0)) if many == 1 else np.array((0.0, 0.5**0.5, -(0.5**0.5))))
    places, tets = soft_mesh.block((0.06, 0.06, 0.03), 64)
    places += (0.5, 0.0, 0.0)
    material = Material(young=60e3, gravity=tuple(down.tolist()))
    body = Body(places, tets, np.zeros(len(places), dtype=bool), material)
    shapes = [HalfSpace((0.0, 0.0, -1.0), 0.015), HalfSpace((0.0, 1.0, 0.0), 0.03)][:many]
    contacts = SoftContacts(body, Skin(friction=mu), 3, solids=[Solid(shape, 1000.0, 2.0, mu) for shape in shapes])
    contacts.settle()
    mass, pull, found = PassiveIntegrator(M, B, K, (0.0, 0.0, 0.0)), share * mu * many**0.5 * G, []
    for k in range(round(seconds / dt)):
        body.weight[:] = body.mass[:, None] * (down + np.array((min(1.0, k * dt / 0.3) * pull, 0.0, 0.0)))
        mass.step(dt, (0.0, 0.0, 0.0), contacts)
        found.append(float(body.mass @ body.x[:, 0] / body.mass.sum()))
    return np.array(found)


@pytest.mark.parametrize(
    ("many", "mu", "step_ms", "seconds"),
    mostly_slow(
        [
            (1, 0.3, 30.0, 6.0),
            (2, 0.3, 30.0, 3.0),
            (1, 0.3, 30.0, 12.0),
            (2, 0.1, 10.0, 4.0),
            (1, 0.3, 30.0, 60.0),
            (2, 0.1, 10.0, 60.0),
        ],
        2,
        4,
    ),
)
@pytest.mark.long
def test_a_block_that_is_pulled_by_less_than_its_friction_stays(
    many: int, mu: float, step_ms: float, seconds: float
) -> None:
    dt = 1e-3 * step_ms
    places = course(mu, 0.9, dt, seconds, many)
    assert abs(places[-1] - places[round(1.5 / dt)]) < 2e-5 * seconds / 60.0


@pytest.mark.parametrize(
    ("many", "mu", "step_ms"), mostly_slow([(1, 0.3, 30.0), (2, 0.1, 10.0), (1, 0.1, 10.0), (2, 0.3, 30.0)], 2)
)
@pytest.mark.long
def test_a_block_that_is_pulled_by_more_accelerates_by_the_rest(many: int, mu: float, step_ms: float) -> None:
    """By a tenth of mu g; the mean of the places' second differences takes out what swings."""
    dt = 1e-3 * step_ms
    places = course(mu, 1.1, dt, 1.5, many)[round(0.7 / dt) :]
    accelerated = 2.0 * np.polyfit(dt * np.arange(len(places)), places, 2)[0]
    assert accelerated == pytest.approx(0.1 * mu * many**0.5 * G, rel=0.03)
