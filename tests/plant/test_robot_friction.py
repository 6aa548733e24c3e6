"""A simulated robot with Coulomb friction, and with a position servo of its own."""

import numpy as np
import pytest

from hapnet import Params, simulate
from hapnet.errors import InvalidParameter
from hapnet.ext.robots.follower import Mechanics, Robot
from hapnet.ext.robots.friction import friction_drag
from hapnet.ext.robots.robot_scene import RobotContacts
from hapnet.mechanics.frame import Frame
from hapnet.plant.integrator import PassiveIntegrator
from hapnet.plant.worlds.walls import Contacts, Wall

MASS, T = 0.5, 1e-3


def robot(
    own: Mechanics, walls: tuple[Wall, ...] = (), v: float = 0.0, scales: tuple[float, float] = (1.0, 1.0)
) -> Robot:
    body = PassiveIntegrator(MASS, 1.0, 100.0, (0.0,), (v,))
    contacts = Contacts(walls, 1)
    body.set_contacts(contacts)
    return Robot(body, contacts, Frame(*scales, (0.0,)), own, 0.0, held=True, engine=False, here=False)


def pushed(one: Robot, force: float, steps: int, dt: float = T) -> None:
    around = RobotContacts(one, sees=False)
    for _ in range(steps):
        one.push(dt, 0.0, (force,), around)


def test_a_sliding_robot_stops_where_coulomb_says() -> None:
    """It slides v^2 m/(2 F), and rests there."""
    one = robot(Mechanics(friction=0.5, mass=MASS), v=0.2)
    pushed(one, 0.0, 1000)
    assert one.body.position[0] == pytest.approx(0.2**2 * MASS / (2.0 * 0.5), rel=1e-2)
    assert abs(one.body.velocity[0]) < 1e-12


@pytest.mark.parametrize("share", [0.5, 0.99])
def test_it_sticks_below_its_friction(share: float) -> None:
    one = robot(Mechanics(friction=0.5, mass=MASS))
    pushed(one, share * 0.5, 2000)
    assert abs(one.body.position[0]) < 1e-8


def test_it_slides_with_what_is_left_of_the_force() -> None:
    """With F_c = 0.5 N and 1.5 N it has a = 2 m/s^2; with a damping of 2 Ns/m it ends at 0.5 m/s."""
    one = robot(Mechanics(friction=0.5, mass=MASS))
    pushed(one, 1.5, 100)
    assert one.body.velocity[0] == pytest.approx(2.0 * 0.1, rel=1e-6)
    one = robot(Mechanics(2.0, 0.5, MASS))
    pushed(one, 1.5, 5000)
    assert one.body.velocity[0] == pytest.approx(0.5, rel=1e-6)


def test_friction_only_dissipates_whatever_the_force() -> None:
    """The work of the held force covers kinetic and contact energy at every instant."""
    rng = np.random.default_rng(4)
    one = robot(Mechanics(0.3, 0.8, MASS), (Wall((1.0,), 0.01, 3000.0, 0.0),))
    around = RobotContacts(one, sees=False)
    given, turned = 0.0, 0
    for _ in range(5000):
        before, force = one.body.position[0], float(rng.normal(0.0, 2.0))
        one.push(T, 0.0, (force,), around)
        given += force * (one.body.position[0] - before)
        spare = given - around.stored_J(one.position)
        assert spare >= -1e-12
        turned += one.body.velocity[0] * (one.body.position[0] - before) < 0.0
    assert spare > 0.01
    assert turned > 10


def test_friction_is_a_drag_and_never_negative() -> None:
    rng = np.random.default_rng(5)
    for _ in range(2000):
        v, force = (tuple(rng.normal(0.0, 10.0 ** rng.uniform(-6, 0), 2).tolist()) for _ in range(2))
        assert friction_drag(0.3, MASS, 1.0, T, v, force) >= 0.0
    assert friction_drag(0.0, MASS, 1.0, T, (0.1,), (1.0,)) == 0.0


@pytest.mark.parametrize("scales", [(1.0, 1.0), (0.5, 3.0)])
def test_a_position_servo_is_a_spring_and_a_damper_within_the_tick(scales: tuple[float, float]) -> None:
    """A tick of 50 ms: the place a is held, and the robot swings to it as m x'' = K (a - x) - B x' is solved."""
    K, B, tick = 200.0, 4.0, 0.05
    one = robot(Mechanics(0.0, 0.0, MASS, K, B), scales=scales)
    around = RobotContacts(one, sees=False)
    done = one.push(tick, 0.0, one.frame.coupled_force((0.02 * K,)), around)
    w, decay = np.sqrt(K / MASS - (B / (2 * MASS)) ** 2), B / (2 * MASS)
    exact = 0.02 * (1.0 - np.exp(-decay * tick) * (np.cos(w * tick) + decay / w * np.sin(w * tick)))
    assert one.body.position[0] == pytest.approx(exact, rel=1e-3)
    work = done.coupling_force[0] * done.position[0]
    assert work == pytest.approx(one.moving_J + 0.0, rel=1e-6)  # nothing dissipates but the servo, which is counted
    assert one.done_J == pytest.approx(-work)


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({"follower.friction_N": 0.1}, "friction_N"),
        ({"follower.position_servo": True}, "position_servo"),
    ],
)
def test_what_acts_only_on_a_held_force_is_refused_elsewhere(changes: dict[str, object], name: str) -> None:
    with pytest.raises(InvalidParameter, match=rf"^follower\.{name} is .*; allowed: .* with a continuous servo"):
        simulate(Params().set({"follower.robot": "simulated", "follower.servo": "continuous", **changes}), seed=1)
