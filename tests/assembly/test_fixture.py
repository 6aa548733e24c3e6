"""Planes in the air, as a robot's motors render them: what they give out, and whose force is whose."""

import pytest

from hapnet.assembly.fixture import LENT_J, Fixture
from hapnet.checks import Vector
from hapnet.plant.scenes.wall import wall


class Puck:
    """A mass whose force is held over each tick; it reports the force that it was given."""

    def __init__(self, mass: float, speed: float, late: bool) -> None:
        self.dof, self.mass, self.late = 1, mass, late
        self.x, self.v, self.force, self.asked = -0.001, speed, 0.0, 0.0

    def read(self) -> tuple[Vector, Vector]:
        self.x += 1e-3 * self.v + 0.5e-6 * self.force / self.mass
        self.v += 1e-3 * self.force / self.mass
        return (self.x,), (self.v,)

    def apply(self, force: Vector) -> Vector:
        self.force, self.asked = (self.asked if self.late else force[0]), force[0]
        return force

    def acted(self) -> Vector:
        return (self.force,)

    def contact_force(self) -> Vector:
        return (-0.25,)


@pytest.mark.parametrize("late", [False, True])
@pytest.mark.parametrize(("mass", "stiffness"), [(1.0, 3000.0), (0.2, 10_000.0), (4.0, 30_000.0)])
def test_a_mass_leaves_it_with_hardly_more_than_it_came_with(mass: float, stiffness: float, late: bool) -> None:
    """A spring that is held, and late, drives a light mass out faster each time; the account allows 5 mJ once."""
    puck = Puck(mass, 0.3, late)
    fixture = Fixture(puck, wall(position=0.0, stiffness=stiffness, damping=0.0).contacts)
    began = 0.5 * mass * puck.v**2
    fastest = puck.v
    for _ in range(4):  # sent back to it again and again
        for _ in range(1000):
            fixture.read()
            fixture.apply((1e-12,))
            fastest = max(fastest, abs(puck.v))
            if puck.x < -0.002:
                break
        puck.v = abs(puck.v)
    held = 0.5 * stiffness * (fastest * (2e-3 if late else 1e-3)) ** 2
    assert 0.5 * mass * puck.v**2 <= began + LENT_J + 1.01 * held


def test_what_it_adds_is_not_the_couplings(monkeypatch: pytest.MonkeyPatch) -> None:
    puck = Puck(1.0, 0.0, late=False)
    puck.x = 0.01
    fixture = Fixture(puck, wall(position=0.0, stiffness=100.0).contacts)
    assert fixture.dof == 1
    fixture.read()
    assert fixture.apply((0.5,)) == pytest.approx((0.5,))
    assert puck.force == pytest.approx(0.5 - 100.0 * 0.01)  # it is 10 mm behind the plane, less than the 5 mJ lent
    fixture.read()
    assert fixture.acted() == pytest.approx((0.5,))
    assert fixture.contact_force() == pytest.approx((-0.25 - 1.0,))  # what is there, and the plane
    monkeypatch.setattr(puck, "contact_force", lambda: (-0.25, 0.0))
    with pytest.raises(ValueError, match="zip"):  # it is not cut to fit
        fixture.contact_force()
    assert fixture.taken_J == pytest.approx(1.0 * (puck.x - 0.01))  # it goes out: what pushed it there counts
    assert fixture.apply((0.0,)) == (0.0,)  # a force that was taken away, the plane's too
    assert puck.force == 0.0
