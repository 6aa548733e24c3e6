"""The turn of a light tool on a stiff damper: the exact solution, whatever the step, and no spin that reverses.

For small turns about a principal axis ``I theta'' + b theta' + k (theta - goal) = torque``, with k = 2 K l^2 and
b = 2 B l^2; scipy's exponential of the matrix, or the formula, has the exact solution.
"""

from decimal import Decimal, localcontext
from itertools import product
from math import cos, exp, pi, sin

import numpy as np
import pytest
from scipy.linalg import expm

from hapnet.checks import Array, Vector
from hapnet.errors import InvalidParameter
from hapnet.ext.tools.body import RigidBody, Touched, weigh, weight
from hapnet.ext.tools.body_step import step
from hapnet.ext.tools.contacts import ToolContacts
from hapnet.ext.tools.mass import ToolMass
from hapnet.ext.tools.tool import box, peg, stick
from hapnet.mechanics import pose as poses
from hapnet.mechanics.pose import ARM_M, AXES
from hapnet.records.record import zero
from tests.conftest import mostly_slow

HOME: Vector = (0.0,) * AXES
K, B, M = 500.0, 14.0, 0.02
k, b = 2.0 * K * ARM_M**2, 2.0 * B * ARM_M**2
TOOLS = {"box": box((0.04, 0.03, 0.02)), "peg": peg(0.005, 0.03), "stick": stick(0.08)}
INERTIA = {  # [kg m^2], by the formulas of a box and of a cylinder
    "box": [M * (0.03**2 + 0.02**2) / 12.0, M * (0.04**2 + 0.02**2) / 12.0, M * (0.04**2 + 0.03**2) / 12.0],
    "peg": [*[M * (3.0 * 0.005**2 + 0.03**2) / 12.0] * 2, M * 0.005**2 / 2.0],
    "stick": [*[M * (3.0 * 0.002**2 + 0.08**2) / 12.0] * 2, M * 0.002**2 / 2.0],
}
CASES = list(product(TOOLS, range(3), (1.0, 10.0, 30.0)))
SMALL = 1e-4
"""A turn or a spin this small is linear to 1e-8 of itself."""


def in_the_air(tool: str, mass: float | Vector = M) -> ToolMass:
    return ToolMass(ToolContacts(TOOLS[tool], [], ARM_M), mass, B, K, HOME)


def turned(axis: int, angle: float) -> Vector:
    q = [cos(0.5 * angle), 0.0, 0.0, 0.0]
    q[1 + axis] = sin(0.5 * angle)
    return poses.coordinates((0.0, 0.0, 0.0), q)


def angle_of(x: Vector, axis: int) -> float:
    return float(poses.rotation_vectors(x)[axis])


@pytest.mark.parametrize("tool", TOOLS)
def test_a_tool_has_the_inertia_of_its_solid(tool: str) -> None:
    """Beside a sum over small cells of a uniform solid."""
    size, n = np.array(TOOLS[tool].size), 80
    cells = np.stack(np.meshgrid(*[(np.arange(n) + 0.5) / n - 0.5] * 3), axis=-1).reshape(-1, 3)
    if tool != "box":
        cells = cells[np.hypot(cells[:, 0], cells[:, 1]) < 0.5]
    square = np.mean((cells * size) ** 2, axis=0)
    assert in_the_air(tool).body.inertia == pytest.approx(M * (square.sum() - square), rel=2e-3)
    assert in_the_air(tool).body.inertia == pytest.approx(INERTIA[tool], rel=1e-12)


def test_a_robot_that_carries_a_tool_has_its_own_inertia() -> None:
    """Its mass at the arms' ends; of two different numbers the arms' counts, and all else is refused."""
    mass = in_the_air("box", (0.3,) * 3 + (0.1,) * 9)
    assert mass.body.mass == 0.3
    assert mass.body.inertia == pytest.approx([2.0 * 0.1 * ARM_M**2] * 3)
    with pytest.raises(InvalidParameter, match="one number above 0 for the point"):
        in_the_air("box", (0.3, *(0.1,) * 11))


@pytest.mark.parametrize(("tool", "axis", "step_ms"), mostly_slow(CASES, 11))
@pytest.mark.long
def test_an_overdamped_turn_is_the_exact_one(tool: str, axis: int, step_ms: float) -> None:
    """The set-position turns by 0.1 mrad. The exact spin never changes its sign, and neither does this.

    A step is exact for a constant torque. The spring's is that of the mean of both ends, so per step, with q = k T/b:

    * the slow motion exp(-n q) becomes ((1 - q/2)/(1 + q/2))^n;
    * the deviation of the torque within a step, at most half of its change, counts less in the last I/b: all steps
      together k I/(2 b^2) of the turn; and the spin's start, k I/b^2 of the turn, is q/2 off.
    """
    mass, dt, inertia = in_the_air(tool), 1e-3 * step_ms, INERTIA[tool][axis]
    goal, q, light = turned(axis, SMALL), k * dt / b, k * inertia / b**2
    assert light < 0.25  # overdamped
    flow, state = expm(dt * np.array([[0.0, 1.0], [-k / inertia, -b / inertia]])), np.array([-SMALL, 0.0])
    slow = max(exp(-n * q) - ((1.0 - 0.5 * q) / (1.0 + 0.5 * q)) ** n for n in range(1, 300))
    bound = SMALL * (slow + 0.5 * (1.0 + q) * light + 1e-7)
    kinetic, spring = 0.0, 0.5 * K * float(np.sum(np.square(goal)))
    for _ in range(round(0.3 / dt)):
        done = mass.step(dt, goal, mass.contacts)
        state = flow @ state
        angle, spin = angle_of(mass.position, axis), mass.body.spin[axis]
        assert angle - SMALL == pytest.approx(state[0], abs=bound)
        assert spin > -1e-12
        moved = dt * np.array(done.velocity)
        left = mass.kinetic_J + 0.5 * K * float(np.sum(np.square(np.subtract(mass.position, goal))))
        assert done.dissipated_J == pytest.approx(kinetic + spring - left, abs=1e-15)
        assert done.dissipated_J >= B * float(moved @ moved) / dt
        kinetic, spring = mass.kinetic_J, left - mass.kinetic_J


@pytest.mark.parametrize(("tool", "axis", "step_ms"), CASES)
@pytest.mark.parametrize("torque", [0.0, 1e-5])
def test_a_damper_and_a_constant_torque_give_the_exact_spin_and_turn(
    tool: str, axis: int, step_ms: float, torque: float
) -> None:
    """``W = w (1 - exp(-b t/I)) + W(0) exp(-b t/I)``, w = torque/b, and its integral."""
    dt, inertia = 1e-3 * step_ms, INERTIA[tool][axis]
    body, planes = in_the_air(tool).body, zero(Touched)
    body.hold(0.0, B, 0.0, B)
    body.spin[axis] = SMALL
    weigh(body, dt)
    about = np.zeros(3)
    about[axis] = torque
    push = poses.along_coordinates(HOME, (0.0, 0.0, 0.0), tuple(about.tolist()), ARM_M)
    for n in range(1, 6):
        assert step(body, dt, list(push), list(HOME), planes)
        left = exp(-b * n * dt / inertia)
        assert body.spin[axis] == pytest.approx(torque / b * (1.0 - left) + SMALL * left, rel=1e-6, abs=1e-15)
        angle = torque / b * n * dt + (SMALL - torque / b) * inertia / b * (1.0 - left)
        assert angle_of(tuple(body.x), axis) == pytest.approx(angle, rel=1e-6)


@pytest.mark.parametrize("tool", TOOLS)
@pytest.mark.long
def test_a_tool_without_a_damper_keeps_its_momentum_and_energy(tool: str) -> None:
    mass = in_the_air(tool)
    mass.body.spin[:] = [0.02, 8.0, -0.03]
    momentum, energy = np.array(mass.body.momentum), mass.kinetic_J
    for _ in range(1000):
        assert mass.push(1e-3, 0.0, HOME, mass.contacts).dissipated_J == 0.0
    assert np.abs(np.array(mass.body.momentum) - momentum).max() <= 1e-11 * np.linalg.norm(momentum)
    assert mass.kinetic_J == pytest.approx(energy, rel=1e-11)


@pytest.mark.parametrize("dt", [1e-3, 1e-2, 5e-2])
def test_what_a_tumbling_tool_loses_is_counted(dt: float) -> None:
    """By an own sum: ``B |v|^2 T``, and ``(a - 1/2) I (W1 - W0)^2`` about each axis; nothing else, and never a gain."""
    rng, planes, rounds = np.random.default_rng(11), zero(Touched), list[int]()
    for _ in range(100):
        body = RigidBody(M, INERTIA["box"], poses.coordinates(rng.normal(0.0, 0.02, 3), rng.normal(size=4)))
        damping = float(np.exp(rng.uniform(np.log(1e-3), np.log(20.0))))
        body.hold(K, B, K, damping)
        body.spin[:] = rng.normal(0.0, 3.0, 3).tolist()
        weigh(body, dt)
        y, push = np.array(body.x) + rng.normal(0.0, 0.005, AXES), rng.normal(0.0, 0.3, AXES)
        x, spin, before = np.array(body.x), np.array(body.spin), energy(body, y)
        if not step(body, dt, push.tolist(), y.tolist(), planes):
            continue
        rounds.append(body.rounds)
        moved, more = np.array(body.x) - x, np.array(body.spin) - spin
        z = 2.0 * damping * ARM_M**2 * dt / np.array(INERTIA["box"])
        lost = float(np.sum((1.0 / -np.expm1(-z) - 1.0 / z - 0.5) * INERTIA["box"] * more**2))
        assert lost >= 0.0
        assert body.lost == pytest.approx(lost, rel=1e-6, abs=1e-15)
        damped = (B * float(moved[:3] @ moved[:3]) + damping * float(moved[3:] @ moved[3:])) / dt
        scale = 1.0 + before + damped
        assert float(push @ moved) - damped - body.lost == pytest.approx(energy(body, y) - before, abs=1e-14 * scale)
    assert len(rounds) > 80
    if dt == 1e-3:
        assert np.mean(rounds) < 9.0  # Newton's method with the right derivatives


def energy(body: RigidBody, y: Array) -> float:
    return body.kinetic + 0.5 * K * float(np.sum((np.array(body.x) - y) ** 2))


def test_the_weight_beside_sixty_digits() -> None:
    for z in (1e-9, 1e-4, 0.003, 0.009999, 0.010001, 0.1, 1.0, 10.0, 336.0, 3e4):
        with localcontext(prec=60):
            exact = float(1 / (1 - (-Decimal(z)).exp()) - 1 / Decimal(z))
        assert weight(z) == pytest.approx(exact, rel=5e-14, abs=0.0)
    assert weight(0.0) == 0.5


@pytest.mark.long
def test_a_turn_of_half_a_circle_settles_without_a_swing() -> None:
    """As far as the spring can pull: b theta' = -2 K l^2 sin(theta), so tan(theta/2) falls by exp(-k t/b)."""
    mass, dt = in_the_air("peg"), 1e-3
    begun, goal = 0.9 * pi, turned(2, 0.9 * pi)
    for n in range(1, 301):
        mass.step(dt, goal, mass.contacts)
        left = 2.0 * np.arctan(np.tan(0.5 * begun) * exp(-k * n * dt / b))
        assert begun - angle_of(mass.position, 2) == pytest.approx(left, abs=2e-3)
        assert mass.body.spin[2] > -1e-12
