"""An arm that hand and coupling hold joint by joint: beside an independent integrator, at stops and torque limits."""

import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from hapnet.checks import Array, Vector
from hapnet.errors import InvalidParameter
from hapnet.ext.arms import motion
from hapnet.ext.arms.device import SimulatedArm
from hapnet.ext.arms.made import arm_of
from hapnet.ext.arms.table import ArmTable, omni
from hapnet.plant.operator import Impedance, Rest, Sine
from tests.conftest import mostly_slow
from tests.plant.arms.references import in_mujoco, random_arm, vector
from tests.plant.arms.test_arm_device import Account, Proud, check, run
from tests.plant.arms.test_motion import T, energy, loose, with_joints

HAND = Impedance(0.006, 0.06, 1.4)
"""In each joint: kg m^2, Nms/rad, Nm/rad."""


def reference(table: ArmTable, rates: Array, push: Array, ticks: int) -> Array:
    """The angles at each tick's end by DOP853 on the equations of motion, with MuJoCo's M, C and g."""
    import mujoco

    model, data = in_mujoco(table)
    n = len(table.joints)
    M, home = np.zeros((n, n)), np.array(table.home)
    damping = np.array([joint.damping for joint in table.joints])

    def slope(t: float, state: Array) -> Array:
        q, v = state[:n], state[n:]
        data.qpos[:], data.qvel[:] = q, v
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, M)
        pull = HAND.stiffness * (rates * t - (q - home)) + HAND.damping * (rates - v) + push
        torque = pull - data.qfrc_bias - damping * v
        return np.concatenate([v, np.linalg.solve(M + HAND.mass * np.eye(n), torque)])

    times = T * np.arange(1, ticks + 1)
    begin = np.concatenate([home, np.zeros(n)])
    solved: Any = solve_ivp(slope, (0.0, ticks * T), begin, "DOP853", times, rtol=1e-10, atol=1e-11)
    return solved.y[:n].T


@pytest.mark.parametrize("n", mostly_slow([3, 7], 1))
@pytest.mark.long
def test_trajectories_are_those_of_an_independent_integrator(n: int) -> None:
    """Within 1e-5 rad at 1 ms; and the energy of each tick to 1e-14 J, with weight and damping."""
    rng = np.random.default_rng(n)
    table = with_joints(loose(random_arm(rng, n)), damping=0.05)
    rates, push, ticks = rng.normal(size=n) * 0.5, rng.normal(size=n) * 0.1, 300
    arm = arm_of(table, HAND, T, 4, compensated=False, by_joints=True)
    arm.commanded[:n] = push.tolist()
    found, closure = [], 0.0
    for k in range(ticks):
        before, x, lost = energy(arm), arm.x[:n], arm.lost
        work = motion.tick(arm, [vector(rates * k * T), vector(rates * (k + 1) * T)], 0)
        done = sum(f * (new - old) for f, new, old in zip(arm.force[:n], arm.x[:n], x, strict=True))
        closure = max(closure, abs(work + done - (energy(arm) - before) - (arm.lost - lost)))
        found.append(arm.q[:n])
    apart = np.abs(np.array(found) - reference(table, rates, push, ticks)).max()
    assert apart <= 1e-5
    assert closure <= 1e-14


def test_one_joint_alone_is_a_damped_spring() -> None:
    """A joint against its hand: (I + M_h) q'' + B_h q' + K_h q = F, in closed form."""
    table = with_joints(loose(omni()), damping=0.0)
    arm = arm_of(table, HAND, T, 4, by_joints=True)
    inertia = arm.chain.inertia[0][0]  # the waist's, with the hand's; the others hardly move
    F, decay = 0.02, HAND.damping / (2.0 * inertia)
    swing = math.sqrt(HAND.stiffness / inertia - decay * decay)
    assert 1e-3 < inertia - HAND.mass < 1e-2
    arm.commanded[0] = F
    for k in range(1, 101):
        motion.tick(arm, [(0.0,) * 3] * 2, 0)
        t = k * T
        left = math.exp(-decay * t) * (math.cos(swing * t) + decay / swing * math.sin(swing * t))
        assert arm.x[0] == pytest.approx(F / HAND.stiffness * (1.0 - left), abs=2e-6)


def test_a_torque_is_cut_to_what_each_motor_has() -> None:
    """The largest multiple that no motor limits is held, and known after the tick."""
    table = with_joints(loose(omni()), effort=0.5)
    device = SimulatedArm(table, Rest(3, HAND), by_joints=True)
    device.apply((0.8, 0.4, -0.2))
    device.advance()
    share = device.state.torque[0] / 0.8
    assert device.arm.limited
    assert tuple(device.state.torque) == pytest.approx((0.8 * share, 0.4 * share, -0.2 * share), rel=1e-12)
    assert 0.49 < device.state.torque[0] <= 0.5


def test_it_begins_where_the_hand_is() -> None:
    start = (0.1, -0.2, 0.3)
    device = SimulatedArm(omni(), Rest(3, HAND, start), by_joints=True)
    assert device.position == pytest.approx(start, abs=1e-15)
    assert device.angles == pytest.approx([a + b for a, b in zip(omni().home, start, strict=True)], abs=1e-15)
    for _ in range(50):
        device.advance()
    assert device.position == pytest.approx(start, abs=1e-12)
    with pytest.raises(InvalidParameter, match=r"start at omni's joint waist \[rad\] is 1\.5; .* stops, -0.98 to 0.98"):
        SimulatedArm(omni(), Rest(3, HAND, (1.5, 0.0, 0.0)), by_joints=True)
    with pytest.raises(InvalidParameter, match="dof is 2; allowed: 3, the joints of omni"):
        SimulatedArm(omni(), Rest(2, HAND), by_joints=True)


def test_encoders_count_each_joint() -> None:
    count = 2.0 * np.pi / 4096
    device = SimulatedArm(omni(), Rest(3, HAND), resolution=count, by_joints=True)
    device.apply((0.05, 0.05, 0.05))
    seen: set[Vector] = set()
    for _ in range(100):
        device.advance()
        x, _ = device.read()
        angles = np.array(device.angles)
        assert np.abs(np.array(x) + omni().home - angles).max() <= count / 2 + 1e-12
        seen.add(x)
    assert 3 < len(seen) < 100


def held(table: ArmTable, *, amplitude: float = 0.3, kind: type[SimulatedArm] = SimulatedArm, reach: float) -> Account:
    """An arm under PSPM in each joint, its targets up to `reach` [rad] from home."""
    hand = Sine(len(table.joints), HAND, amplitude, 1.0, start_s=0.2)
    arm = kind(table, hand, substeps=1, by_joints=True)
    return run(arm, stiffness=2.0, damping=0.002, reach=reach)


@pytest.mark.long
def test_passive_at_stops_and_torque_limits() -> None:
    at_stops = held(omni(), amplitude=1.2, reach=0.5)
    check(at_stops)
    assert at_stops.beyond > 0.02
    limited = held(with_joints(omni(), effort=0.2), reach=1.0)
    check(limited)
    assert limited.limited > 200


@pytest.mark.long
def test_passive_with_seven_joints() -> None:
    check(held(with_joints(random_arm(np.random.default_rng(7), 7), effort=6.0, lower=-0.3, upper=0.3), reach=2.0))


@pytest.mark.long
def test_a_torque_limit_that_is_not_in_the_account_is_caught() -> None:
    """The servo detects no fault; the hand's port, and the energy of each tick, tell."""
    account = held(with_joints(omni(), effort=0.05), kind=Proud, reach=1.0)
    assert account.closure > 1e-4
    assert account.hand < -1e-3
    assert account.servo >= -1e-13
