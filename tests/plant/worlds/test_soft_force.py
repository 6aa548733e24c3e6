"""A soft body's force on a ball is that of its material; a free body keeps its momentum."""

import numpy as np
import pytest

from hapnet.checks import Array
from hapnet.ext.soft import soft_mesh
from hapnet.ext.soft.soft_body import Body, Material
from hapnet.ext.soft.soft_contacts import Skin, SoftContacts
from hapnet.plant.integrator import PassiveIntegrator
from tests.conftest import mostly_slow

DEPTHS_M = np.array([0.002, 0.003, 0.004, 0.006, 0.008, 0.01])
HARD_N = {
    0.3: (0.2614, 0.4744, 0.7256, 1.3076, 1.9770, 2.7044),
    0.4: (0.2811, 0.5095, 0.7782, 1.4002, 2.1137, 2.8891),
    0.49: (0.3114, 0.5616, 0.8552, 1.5391, 2.3111, 3.1642),
}
"""Forces of converged finite elements with hard contact, by ``python -m tests.measure soft_reference``: 6 cells along
the contact, and 4 for nu 0.49. They differ by less than 0.8 % from those with fewer cells and from a round block of the
same area with axial symmetry."""


def hard_N(poisson: float, depth: float) -> float:
    """Interpolated."""
    shape = np.polyfit(DEPTHS_M, np.array(HARD_N[poisson]) / DEPTHS_M**1.5, 3)
    return float(np.polyval(shape, depth) * depth**1.5)


OTHER_BALLS = {
    (0.007, 0.3): {0.002: 0.2151, 0.003: 0.3909, 0.005: 0.8184},
    (0.007, 0.45): {0.002: 0.2432, 0.003: 0.4414, 0.005: 0.9218},
    (0.015, 0.3): {0.002: 0.3262, 0.004: 0.9030, 0.006: 1.6446, 0.01: 3.4505},
    (0.015, 0.45): {0.002: 0.3666, 0.004: 1.0102, 0.006: 1.8327, 0.01: 3.8253},
}
"""The same with 4 cells, for balls of 7 and 15 mm: forces [N] by depth [m]. No constant was chosen on them."""


def pressed(
    poisson: float, aim: float, aside: tuple[float, float] = (0.0, 0.0), radius: float = 0.01
) -> tuple[float, float]:
    """The depth [m] and the force [N] of a ball without friction at rest, of about 1,000 nodes."""
    places, tets = soft_mesh.block((0.06, 0.06, 0.06), 1000)
    places[:, 0] += radius + 1e-12 - places[:, 0].min()
    pinned = places[:, 0] > places[:, 0].max() - 1e-9
    body = Body(places, tets, pinned, Material(poisson=poisson, beta_s=0.05, gravity=(0.0, 0.0, 0.0)))
    contacts = SoftContacts(body, Skin(friction=0.0, radius=radius), 3)
    mass = PassiveIntegrator(0.02, 50.0, 2000.0, (0.0, *aside))
    for k in range(24):
        step = mass.step(0.05, (aim * min(1.0, (k + 1) / 8.0), *aside), contacts)
    return step.position[0], -step.force[0]


@pytest.mark.parametrize(
    ("poisson", "aim", "within"),
    mostly_slow(
        [
            (0.4, 0.0032, 0.06), (0.49, 0.0066, 0.05),
            (0.3, 0.0021, 0.12), (0.49, 0.0112, 0.08), (0.3, 0.0066, 0.05), (0.49, 0.0021, 0.12),
            (0.3, 0.0032, 0.06), (0.49, 0.0032, 0.06), (0.4, 0.0066, 0.05), (0.4, 0.0021, 0.12), (0.3, 0.0112, 0.08),
            (0.4, 0.0112, 0.08),
        ],
        2, 6,
    ),
)  # fmt: skip
@pytest.mark.long
def test_a_ball_feels_the_material(poisson: float, aim: float, within: float) -> None:
    depth, force = pressed(poisson, aim)
    assert force == pytest.approx(hard_N(poisson, depth), rel=within)


@pytest.mark.parametrize("poisson", [0.3, 0.4, 0.49])
@pytest.mark.parametrize(
    ("aside", "aim", "within"),
    mostly_slow(
        [
            ((0.0017, 0.0025), 0.0032, 0.05), ((0.00333, 0.00333), 0.0021, 0.08),
            *((aside, aim, within) for aside in ((0.00333, 0.00333), (0.0017, 0.0025), (0.00333, 0.0))
              for aim, within in ((0.0021, 0.08), (0.0032, 0.05), (0.0066, 0.05), (0.0112, 0.08))),
        ],
        0, 2,
    ),
)  # fmt: skip
def test_it_feels_the_same_at_each_place_of_the_mesh(
    poisson: float, aside: tuple[float, float], aim: float, within: float
) -> None:
    depth, force = pressed(poisson, aim, aside)
    assert force == pytest.approx(hard_N(poisson, depth), rel=within)


@pytest.mark.parametrize(("radius", "poisson"), OTHER_BALLS)
@pytest.mark.parametrize(
    ("aside", "which"),
    mostly_slow(
        [
            ((0.0, 0.0), 0),
            *((aside, which) for aside in ((0.00333, 0.00333), (0.0017, 0.0025), (0.0, 0.0))
              for which in (1, 2, -1, 0)),
        ],
        0, 1,
    ),
)  # fmt: skip
def test_other_balls_feel_it_less_well(radius: float, poisson: float, aside: tuple[float, float], which: int) -> None:
    """A small ball touches a circle as large as a triangle."""
    forces = OTHER_BALLS[radius, poisson]
    shape = np.polyfit(list(forces), [force / depth**1.5 for depth, force in forces.items()], 2)
    depth, force = pressed(poisson, 1.07 * list(forces)[which], aside, radius)
    assert force == pytest.approx(float(np.polyval(shape, depth)) * depth**1.5, rel=0.18 if radius < 0.01 else 0.1)


def test_the_reference_agrees_with_hertz() -> None:
    """On a body that is much larger than the contact; the block's sides and its depth lower deeper forces."""
    for poisson, forces in HARD_N.items():
        hertz = 4.0 / 3.0 * 20e3 / (1.0 - poisson**2) * 0.01**0.5 * DEPTHS_M**1.5
        assert forces[0] == pytest.approx(hertz[0], rel=0.02)
        assert np.all(np.diff(np.array(forces) / hertz) < 0.0)


def momenta(body: Body) -> tuple[Array, Array]:
    """The momentum, and the angular momentum about the centre of mass."""
    arms = body.x - body.mass @ body.x / body.mass.sum()
    return body.mass @ body.v, (body.mass[:, None] * np.cross(arms, body.v)).sum(axis=0)


@pytest.mark.parametrize(
    ("dt", "spin"),
    mostly_slow([(0.05, (5.0, 10.0, 15.0)), (0.02, (0.0, 0.0, 20.0)), (0.02, (2.0, 3.0, 8.0))], 1),
)
@pytest.mark.long
def test_a_free_body_keeps_its_momentum(dt: float, spin: tuple[float, float, float]) -> None:
    """For ten seconds; its account closes meanwhile."""
    places, tets = soft_mesh.block((0.06, 0.05, 0.04), 64)
    places += (0.5, 0.0, 0.0)
    body = Body(places, tets, np.zeros(len(places), dtype=bool), Material(gravity=(0.0, 0.0, 0.0)))
    contacts, mass = SoftContacts(body, Skin(), 3), PassiveIntegrator(0.02, 14.0, 500.0, (0.0, 0.0, 0.0))
    body.v[:] = np.cross(spin, body.x - body.x.mean(axis=0))
    body.v += 0.01, -0.005, 0.002
    stored, (straight, angular) = contacts.stored_J(()), momenta(body)
    for _ in range(round(10.0 / dt)):
        lost = contacts.discarded_J
        mass.step(dt, (0.0, 0.0, 0.0), contacts)
        now, lost = contacts.stored_J(()), contacts.discarded_J - lost
        assert lost >= 0.0
        assert now + lost == pytest.approx(stored, abs=1e-12)
        stored = now
    after, turned = momenta(body)
    assert after == pytest.approx(straight, abs=1e-9 * float(np.linalg.norm(straight)))
    assert turned == pytest.approx(angular, abs=1e-9 * float(np.linalg.norm(angular)))


def test_a_body_that_falls_and_spins_falls_as_a_point() -> None:
    places, tets = soft_mesh.block((0.06, 0.05, 0.04), 64)
    places += (0.5, 0.0, 0.0)
    body = Body(places, tets, np.zeros(len(places), dtype=bool), Material())
    contacts, mass = SoftContacts(body, Skin(), 3), PassiveIntegrator(0.02, 14.0, 500.0, (0.0, 0.0, 0.0))
    body.v[:] = np.cross((2.0, 3.0, 8.0), body.x - body.x.mean(axis=0))
    contacts.stored_J(())
    _, angular = momenta(body)
    height = float(body.mass @ body.x[:, 2] / body.mass.sum())
    for _ in range(50):
        mass.step(0.02, (0.0, 0.0, 0.0), contacts)
    fallen, turned = float(body.mass @ body.x[:, 2] / body.mass.sum()), momenta(body)[1]
    assert fallen - height == pytest.approx(-0.5 * 9.81, rel=1e-9)
    assert turned == pytest.approx(angular, abs=1e-9 * float(np.linalg.norm(angular)))
