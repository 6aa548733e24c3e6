"""Coulomb's friction of a tool that touches at many points, beside the force of the spring and damper that pull it.

All forces are own sums of set-position, pose and stiffness; the solids' reports are not used.
"""

from collections.abc import Callable
from itertools import product
from math import cos, pi, sin

import numpy as np
import pytest

from hapnet.checks import Array, Vector
from hapnet.ext.solids.hole import Hole
from hapnet.ext.solids.rigid_contacts import Solid
from hapnet.ext.solids.shapes import HalfSpace
from hapnet.ext.tools.body import RigidBody, Touched, settle
from hapnet.ext.tools.body_step import step
from hapnet.ext.tools.contacts import ToolContacts
from hapnet.ext.tools.mass import ToolMass
from hapnet.ext.tools.tool import Tool
from hapnet.mechanics import pose as poses
from hapnet.mechanics.pose import ARM_M, AXES, nearest
from hapnet.records.record import zero
from tests.conftest import mostly_slow

K, B, M = 500.0, 14.0, 0.02
HEIGHT, RADIUS, DEPTH = 0.002, 0.02, 0.004
TURN = 2.0 * ARM_M**2  # Nm/rad for a stiffness of 1 N/m of the arms


def ring(count: int) -> Tool:
    """A flat tool that touches with a ring of points."""
    turns = [2.0 * pi * k / count for k in range(count)]
    return Tool("ring", tuple((RADIUS * cos(a), RADIUS * sin(a), -HEIGHT) for a in turns), (0.04, 0.04, 0.004))


def disc(rings: int) -> Tool:
    """Points that stand for equal shares of a disc's area."""
    points = [(0.0, 0.0, -HEIGHT)]
    for i in range(1, rings):
        inner, outer = RADIUS * (i - 0.5) / (rings - 0.5), RADIUS * (i + 0.5) / (rings - 0.5)
        middle = 2.0 / 3.0 * (outer**3 - inner**3) / (outer**2 - inner**2)
        count = 8 * i  # the innermost point has 1 part of (2 rings - 1)^2, ring i has 8 i
        points += [(middle * cos(2 * pi * k / count), middle * sin(2 * pi * k / count), -HEIGHT) for k in range(count)]
    return Tool("disc", tuple(points), (0.04, 0.04, 0.004))


def on_a_plane(tool: Tool, mu: float) -> ToolMass:
    plane = Solid(HalfSpace((0.0, 0.0, -1.0), HEIGHT), 3000.0, 10.0, mu)
    return ToolMass(ToolContacts(tool, [plane], ARM_M), M, B, K, (0.0,) * AXES)


def pull_after(mass: ToolMass, dt: float, y: Vector) -> Array:
    """Step, and return the mean pull of the spring and the damper on each coordinate in the step (12,) [N]."""
    begun = np.array(mass.position)
    mass.step(dt, y, mass.contacts)
    ended = np.array(mass.position)
    return K * (np.array(y) - 0.5 * (begun + ended)) - B * (ended - begun) / dt


def rest(mass: ToolMass, dt: float, y: Callable[[float], Vector], seconds: float) -> None:
    for k in range(round(seconds / dt)):
        mass.step(dt, y(k * dt), mass.contacts)


BY_DEFAULT = [(3, 1.0, 1.0), (8, 10.0, 0.3), (24, 30.0, 0.1)]
"""Each number of points, step and friction once; the longer tests take all combinations."""

SLIDING = [
    *BY_DEFAULT,
    (8, 1.0, 1.0),
    *(case for case in product((3, 8, 24), (30.0, 10.0), (0.1, 0.3, 1.0)) if case not in BY_DEFAULT),
    *(case for case in product((3, 8, 24), (1.0,), (0.1, 0.3, 1.0)) if case not in BY_DEFAULT),
]


@pytest.mark.parametrize(("count", "step_ms", "mu"), mostly_slow(SLIDING, 3, 20))
@pytest.mark.long
def test_a_sliding_tool_is_held_back_by_mu_times_its_load(count: int, step_ms: float, mu: float) -> None:
    mass, dt, speed = on_a_plane(ring(count), mu), 1e-3 * step_ms, 0.05
    rest(mass, dt, lambda t: (0.0, 0.0, -DEPTH * min(1.0, 5.0 * t), *(0.0,) * 9), 0.4)
    pulls = []
    for k in range(round(0.6 / dt)):
        pull = pull_after(mass, dt, (speed * (k + 1) * dt, 0.0, -DEPTH, *(0.0,) * 9))
        if k * dt > 0.4:
            pulls.append(pull)
    along, _, load = np.mean(pulls, axis=0)[:3]
    assert along == pytest.approx(mu * -load, rel=0.01)


@pytest.mark.parametrize(
    ("count", "step_ms", "mu", "seconds"),
    mostly_slow(
        [
            (4, 10.0, 1.0, 1.0),
            (8, 30.0, 0.1, 2.0),
            (4, 1.0, 1.0, 1.0),
            (24, 10.0, 0.3, 2.0),
            (24, 30.0, 1.0, 4.0),
            (4, 10.0, 0.3, 10.0),
            (24, 30.0, 1.0, 60.0),
            (4, 10.0, 0.3, 60.0),
        ],
        2,
        6,
    ),
)
@pytest.mark.long
def test_a_tool_at_rest_is_held_by_what_stopped_it(count: int, step_ms: float, mu: float, seconds: float) -> None:
    """The set-position slides and stops: the spring's pull stays near mu N, as the tool does not creep after it."""
    mass, dt, speed = on_a_plane(ring(count), mu), 1e-3 * step_ms, 0.05
    rest(mass, dt, lambda t: (speed * max(0.0, t - 0.2), 0.0, -DEPTH * min(1.0, 5.0 * t), *(0.0,) * 9), 0.8)
    y = (speed * 0.6, 0.0, -DEPTH, *(0.0,) * 9)
    rest(mass, dt, lambda t: y, 0.5)
    stopped = K * (y[0] - mass.position[0])
    rest(mass, dt, lambda t: y, seconds)
    x = mass.position
    assert K * (y[0] - x[0]) >= (1.0 - 0.05 * seconds / 60.0) * stopped
    assert K * (y[0] - x[0]) >= 0.95 * mu * K * (x[2] - y[2])
    assert K * (y[0] - x[0]) <= 1.001 * mu * K * (x[2] - y[2])


@pytest.mark.parametrize("seconds", mostly_slow([2.0, 20.0], 1))
@pytest.mark.long
def test_a_tool_that_is_pulled_by_less_than_its_friction_does_not_creep(seconds: float) -> None:
    mass, mu = on_a_plane(ring(6), 0.3), 0.3
    rest(mass, 0.01, lambda t: (0.0, 0.0, -DEPTH * min(1.0, 5.0 * t), *(0.0,) * 9), 1.0)
    load = K * (mass.position[2] + DEPTH)
    pulled = 0.9 * mu * load / K
    rest(mass, 0.01, lambda t: (pulled * min(1.0, t), 0.0, -DEPTH, *(0.0,) * 9), 1.0)
    pulled_to = mass.position[0]
    rest(mass, 0.01, lambda t: (pulled, 0.0, -DEPTH, *(0.0,) * 9), seconds)
    assert abs(mass.position[0] - pulled_to) < 1.5e-6 * seconds
    assert abs(mass.position[0]) < 3e-5


@pytest.mark.parametrize(("rings", "step_ms"), mostly_slow([(3, 10.0), (5, 10.0), (3, 3.0), (5, 3.0), (5, 1.0)], 1, 3))
@pytest.mark.long
def test_a_spinning_disc_is_held_back_by_two_thirds_mu_n_r(rings: int, step_ms: float) -> None:
    """A disc on a uniform pressure: the integral of mu p r over its area."""
    mu, dt, rate = 0.3, 1e-3 * step_ms, 1.0
    mass = on_a_plane(disc(rings), mu)

    def turned(angle: float) -> Vector:
        return poses.coordinates((0.0, 0.0, -DEPTH), (cos(0.5 * angle), 0.0, 0.0, sin(0.5 * angle)))

    rest(mass, dt, lambda t: (0.0, 0.0, -DEPTH * min(1.0, 5.0 * t), *(0.0,) * 9), 0.4)
    torques, loads = [], []
    for k in range(round(0.9 / dt)):
        begun = poses.arms(mass.position, ARM_M)
        pull = pull_after(mass, dt, turned(rate * (k + 1) * dt))
        middle = 0.5 * (begun + poses.arms(mass.position, ARM_M))
        if k * dt > 0.7:
            torques.append(sum(np.cross(rod, f)[2] for rod, f in zip(middle, pull[3:].reshape(3, 3), strict=True)))
            loads.append(-pull[2])
    assert np.mean(torques) == pytest.approx(2.0 / 3.0 * mu * np.mean(loads) * RADIUS, rel=0.05)


@pytest.mark.parametrize(
    ("mu", "stages"), mostly_slow([(0.3, 5), (0.2, 5), (0.5, 10), (0.3, 20), (0.2, 20), (0.5, 20)], 1, 3)
)
@pytest.mark.long
def test_a_tilted_peg_jams_at_the_two_point_angle(mu: float, stages: int) -> None:
    """A peg that touches its hole at two points: with its side at the rim, with its tip on the other side.

    The tilt of its set-position presses it on both. It is held while friction can carry the push along the hole
    (Whitney, J. Dyn. Sys. Meas. Control 104, 1982): the plane problem's two equations, of forces across the hole and of
    moments, give both normal forces at the limit, and the third the push. The tilt is reduced until it slides in,
    by 2 mrad in so many steps.
    """
    radius, half, deep, goal, dt = 0.005, 0.015, 0.012, 0.015, 0.01
    turns = [0.25 * pi * k for k in range(8)]
    points = tuple((radius * cos(a), radius * sin(a), z) for z in (-half, 0.0, half) for a in turns)
    tool = Tool("peg", points, (2.0 * radius, 2.0 * radius, 2.0 * half), (2e-5,) * 3, round=True, closed=True)
    hole = Solid(Hole((0.0, 0.0, -half), (0.0, 0.0, -1.0), radius + 0.001), 20000.0, 10.0, mu)
    mass = ToolMass(ToolContacts(tool, [hole], ARM_M), M, B, K, (0.0,) * AXES)

    def y(down: float, tilt: float) -> Vector:
        return poses.coordinates((0.0, 0.0, -down), (cos(0.5 * tilt), 0.0, sin(0.5 * tilt), 0.0))

    def held_N(tilt: float) -> tuple[float, float]:
        """The push along the hole, and the largest that two points can hold at this place [N]."""
        x, z = mass.position[0], mass.position[2]
        turned = float(poses.rotation_vectors(mass.position, ARM_M)[1])
        axis, side = np.array([sin(turned), cos(turned)]), np.array([cos(turned), -sin(turned)])
        rim = radius * side + (-half - z + radius * sin(turned)) / cos(turned) * axis
        tip = -radius * side - half * axis
        at_rim, at_tip = mu * axis - side, np.array([1.0, mu])  # forces for a normal force of 1 N
        moments = [place[1] * f[0] - place[0] * f[1] for place, f in ((rim, at_rim), (tip, at_tip))]
        loads = np.array([K * x, -TURN * K * sin(tilt - turned)])
        normal = np.linalg.solve(np.array([[at_rim[0], at_tip[0]], moments]), loads)
        return K * (goal + z), float(normal @ [at_rim[1], at_tip[1]])

    first = 0.25
    rest(mass, dt, lambda t: y(deep * min(1.0, 2.0 * t), 0.0), 0.7)
    rest(mass, dt, lambda t: y(deep, first * min(1.0, 2.0 * t)), 0.7)  # it touches at two points
    rest(mass, dt, lambda t: y(deep + (goal - deep) * min(1.0, 2.0 * t), first), 0.7)  # it jams
    jammed, tilt = mass.position[2], first
    push, limit = held_N(tilt)
    assert 0.0 < push < 0.8 * limit
    while mass.position[2] > jammed - 3e-4:
        tilt -= 2e-3
        set_position = y(goal, tilt)
        for _ in range(stages):
            mass.step(dt, set_position, mass.contacts)
    push, limit = held_N(tilt)
    assert push == pytest.approx(limit, rel=0.1)


IN_ITS_HOLE = (
    ((-0.0035355, 0.0035355, -0.015), (-0.70286, 0.71133, 0.0), 5.1141e-5, 6.0476e-9),
    ((-0.005, 0.0, -0.015), (-0.99902, 0.044246, 0.0), 3.4997e-5, 7.9465e-9),
    ((0.0048629, -0.0011118, 0.0040784), (0.96965, -0.24328, -0.024558), 1.1637e-5, 1.5753e-9),
    ((0.00437, -0.0023766, 0.004084), (0.86791, -0.49606, -0.02576), 2.5568e-5, 1.0061e-9),
    ((0.0035666, -0.0034708, 0.0040805), (0.70148, -0.71225, -0.025047), 2.3334e-5, 5.1084e-10),
    ((0.0025075, -0.0043199, 0.0040681), (0.48337, -0.87513, -0.022477), 5.1254e-6, 2.3900e-10),
)
"""A peg that lies askew in its hole: place in its axes [m], normal, depth [m] and half the speed at the start [m/s]."""


@pytest.mark.parametrize("step_ms", [33.0, 1.0, 0.008])
def test_a_peg_that_hardly_moves_finds_its_step(step_ms: float) -> None:
    """Its points creep by nanometres a second, some below half of their speed and some above: the law is steep there.
    The step is found, friction is at most mu N, and the forces are the change of momentum."""
    x = nearest((9.64966e-5, -7.69576e-5, -0.0249545005, -1.867715e-5, -8.39996e-4, -8.878228e-4, 8.51767e-4,
                 -1.2506e-5, 5.24229e-4, 8.765364e-4, -5.4289e-4, -1.329e-5), ARM_M)  # fmt: skip
    y = (-1.50207e-5, -6.91046e-5, -0.0249645, -2.0901e-5, -8.38638e-4, -9.84037e-4, 8.52968e-4, -1.32395e-5,
         5.75697e-4, 9.71641e-4, -5.9638e-4, -1.625e-5)  # fmt: skip
    body, planes, dt = RigidBody(M, (2.0 * M * ARM_M**2,) * 3, x), zero(Touched), 1e-3 * step_ms
    body.stiffness = body.arms_stiffness = K
    body.damping = body.arms_damping = B
    body.velocity[:] = before = [1.4439e-9, -4.2255e-9, -3.7713e-9]
    body.spin[:] = [-7.9154e-7, 2.2021e-8, -1.2083e-7]
    settle(body)
    planes.count = len(IN_ITS_HOLE)
    for k, (place, normal, depth, slow) in enumerate(IN_ITS_HOLE):
        planes.places[k][:], planes.normals[k][:], planes.depths[k], planes.least[k] = place, normal, depth, slow
        planes.stiffnesses[k], planes.dampings[k], planes.frictions[k] = 3000.0, 10.0, 0.2
        planes.creeps[k] = 1e-6 / (2.0 * M / dt + B + 0.5 * K * dt)
    assert step(body, dt, (0.0,) * AXES, y, planes)
    moved = np.array(body.x[:3]) - x[:3]
    force = K * (np.array(y[:3]) - x[:3]) - (0.5 * dt * K + B) * moved / dt
    for k in range(planes.count):
        rub = np.array(planes.rubs[k])
        assert np.linalg.norm(rub) <= 0.2 * -planes.pushes[k] * np.linalg.norm(planes.normals[k]) * (1.0 + 1e-12)
        force += planes.pushes[k] * np.array(planes.normals[k]) + rub
    np.testing.assert_allclose(M * (np.array(body.velocity) - before) / dt, force, rtol=0.0, atol=1e-8)


def test_a_point_is_rubbed_along_any_gradient() -> None:
    """A gradient of length 1.5: the push on the point is 1.5 times the plane's number, and friction mu times that."""
    body, planes = RigidBody(M, (2.0 * M * ARM_M**2,) * 3, nearest((0.0,) * AXES, ARM_M)), zero(Touched)
    body.velocity[0] = 0.5
    settle(body)
    planes.count = 1
    planes.normals[0][:], planes.depths[0], planes.stiffnesses[0], planes.frictions[0] = (
        (0.0, 0.0, -1.5),
        2e-3,
        3e3,
        0.3,
    )
    planes.creeps[0] = 1e-8
    assert step(body, 1e-3, (0.0,) * AXES, (0.0,) * AXES, planes)
    assert planes.pushes[0] < -1.0
    assert planes.rubs[0][:] == pytest.approx([0.3 * 1.5 * planes.pushes[0], 0.0, 0.0], rel=1e-9)
