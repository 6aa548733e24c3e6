"""An arm's passive step: its energy, beside an independent integrator, at stops, limits and singularities."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from hapnet.checks import Array, Vector
from hapnet.ext.arms import motion
from hapnet.ext.arms.made import LEVER_M, SLIP_RADPS, arm_of
from hapnet.ext.arms.motion import Arm
from hapnet.ext.arms.table import ArmTable, Joint, omni
from hapnet.plant.operator import Impedance
from tests.conftest import mostly_slow
from tests.plant.arms.references import cylindrical, in_mujoco, random_arm

T = 1e-3
NO_HAND = Impedance(0.0, 0.0, 0.0)
STILL: list[Vector] = [(0.0, 0.0, 0.0)] * 2


def with_joints(table: ArmTable, **changes: Any) -> ArmTable:
    return replace(table, joints=tuple(replace(joint, **changes) for joint in table.joints))


def loose(table: ArmTable) -> ArmTable:
    """Without stops, damping and limits; slides have stops, which are far."""
    changed = with_joints(table, lower=-math.inf, upper=math.inf, damping=0.0, effort=math.inf)
    pairs = zip(table.joints, changed.joints, strict=True)
    return replace(changed, joints=tuple(one if one.slides else other for one, other in pairs))


def set_going(arm: Arm, rates: Array) -> None:
    arm.rates[: arm.n] = rates.tolist()
    motion.look(arm)  # M and L at home; z is still 0
    L = np.array(arm.factor)[: arm.n, : arm.n]
    arm.z[: arm.n] = (np.tril(L).T @ rates).tolist()
    motion.look(arm)


def energy(arm: Arm) -> float:
    return motion.kinetic(arm) + motion.potential(arm)


@pytest.mark.parametrize(
    ("n", "slides"), mostly_slow([(3, (0, 2)), (3, ()), (7, (1, 4)), (2, ()), (6, ()), (7, ())], 1, 4)
)
@pytest.mark.long
def test_free_motion_keeps_its_energy(n: int, slides: tuple[int, ...]) -> None:
    """To 1e-13 J in 2 s at 1 ms, without weight and with it; with joints that slide, and with rotors."""
    rng = np.random.default_rng(n)
    table = loose(random_arm(rng, n, slides, 0.01 * len(slides)))
    for compensated in (True, False) if n < 6 and not slides else (True,):  # seven heavy links fall with 100 J
        arm = arm_of(table, NO_HAND, T, 1, compensated=compensated)
        set_going(arm, rng.normal(size=n) / n)
        start, worst = energy(arm), 0.0
        assert start != 0.0
        for _ in range(2000):
            motion.tick(arm, STILL, 0)
            worst = max(worst, abs(energy(arm) - start))
        assert worst <= 1e-13
        assert arm.unsettled == 0


RAMP = np.array([0.05, 0.03, -0.04])
PUSH = np.array([0.3, -0.2, 0.1])


def followed(arm: Arm, ticks: int) -> tuple[Array, float]:
    """The angles at each tick's end while the hand goes along a ramp, and the largest error of a tick's energy [J]."""
    found, worst = [], 0.0
    for k in range(ticks):
        before, x, lost = energy(arm), list(arm.x[:3]), arm.lost
        work = motion.tick(arm, [tuple(RAMP * k * T), tuple(RAMP * (k + 1) * T)], 0)
        done = sum(f * (new - old) for f, new, old in zip(arm.force[:3], arm.x[:3], x, strict=True))
        worst = max(worst, abs(work + done - (energy(arm) - before) - (arm.lost - lost)))
        found.append(arm.q[: arm.n])
    return np.array(found), worst


def reference(table: ArmTable, hand: Impedance, friction: float, ticks: int) -> Array:
    """The same, by scipy's DOP853 on the equations of motion, with MuJoCo's M, C, g and J."""
    import mujoco

    model, data = in_mujoco(table)
    n = len(table.joints)
    M, J, J_dot, home = np.zeros((n, n)), np.zeros((3, n)), np.zeros((3, n)), np.array(table.home)
    damping = np.array([joint.damping for joint in table.joints])
    slip = SLIP_RADPS * np.array([LEVER_M if joint.slides else 1.0 for joint in table.joints])
    data.qpos[:] = home
    mujoco.mj_forward(model, data)
    origin = data.site_xpos[0].copy()

    def slope(t: float, state: Array) -> Array:
        q, v = state[:n], state[n:]
        data.qpos[:], data.qvel[:] = q, v
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, M)
        mujoco.mj_jacSite(model, data, J, None, 0)
        mujoco.mj_jacDot(model, data, J_dot, None, data.site_xpos[0], n)
        pull = hand.stiffness * (RAMP * t - data.site_xpos[0] + origin) + hand.damping * (RAMP - J @ v) + PUSH
        rub = friction * v / np.sqrt(v * v + slip * slip)
        torque = J.T @ (pull - hand.mass * (J_dot @ v)) - data.qfrc_bias - damping * v - rub
        return np.concatenate([v, np.linalg.solve(M + hand.mass * J.T @ J, torque)])

    begin = np.concatenate([home, np.zeros(n)])
    times = T * np.arange(1, ticks + 1)
    solved: Any = solve_ivp(slope, (0.0, ticks * T), begin, "DOP853", times, rtol=1e-10, atol=1e-11)
    return solved.y[:n].T


HAND = Impedance(0.2, 3.0, 60.0)


@pytest.mark.parametrize("ticks", mostly_slow([200, 700], 1))
@pytest.mark.parametrize(("arm_table", "coarse"), [(omni, 1), (cylindrical, 2)])
@pytest.mark.long
def test_trajectories_are_those_of_an_independent_integrator(
    arm_table: Callable[[], ArmTable], coarse: int, ticks: int
) -> None:
    """A falling arm that is pushed, damped and rubs, in a hand that leads it: within 1e-5 rad, and better by
    16 with a quarter of the step. The slide's friction is stiff, so it begins with half a millisecond."""
    table = with_joints(arm_table(), friction=0.02)
    expected = reference(table, HAND, 0.02, ticks)
    errors = []
    for steps in (coarse, 4 * coarse):
        arm = arm_of(table, HAND, T, steps, compensated=False)
        arm.commanded[:3] = PUSH.tolist()
        angles, closure = followed(arm, ticks)
        errors.append(np.abs(angles - expected).max())
        assert closure <= 1e-14
        assert np.ptp(angles, axis=0).max() > 0.1 * ticks / 700
    assert errors[0] <= 1e-5
    assert errors[0] / errors[1] == pytest.approx(16.0, rel=0.3)


def mutated(change: Callable[[Arm], None]) -> float:
    """The error of the angles [rad] with M and C changed after each evaluation."""
    table = loose(omni())
    expected = reference(table, HAND, 0.0, 300)
    arm = arm_of(table, HAND, T, 1, compensated=False)
    arm.commanded[:3] = PUSH.tolist()
    true = motion.matrices

    def wrong(chain: Any, q: Any, rates: Any) -> None:
        true(chain, q, rates)
        change(arm)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(motion, "matrices", wrong)
        angles, _ = followed(arm, 300)
    return float(np.abs(angles - expected).max())


@pytest.mark.long
def test_a_wrong_sign_of_c_is_caught() -> None:
    """Energy is kept even so, as only C's skew part acts: the trajectory tells."""

    def turn(arm: Arm) -> None:
        for row in arm.chain.coriolis:
            row[:] = [-value for value in row]

    assert mutated(lambda arm: None) <= 1e-5
    assert mutated(turn) > 1e-4


def bounced(table: ArmTable, steps: int) -> tuple[float, float, float]:
    """An arm that is thrown at its stops: the error of its energy [J], how far it goes in [rad], and by how much a
    stop's torque changes in a step, at most [Nm]."""
    arm = arm_of(table, NO_HAND, T, steps)
    set_going(arm, np.array([8.0, -6.0, 7.0]))
    start, worst, deepest, jump, before = energy(arm), 0.0, 0.0, 0.0, [0.0] * 3
    for _ in range(300 * steps):
        arm.steps, arm.period = 1, arm.h
        motion.tick(arm, STILL, 0)
        worst = max(worst, abs(energy(arm) + arm.lost - start))
        deepest = max(deepest, *(max(arm.q[i] - arm.upper[i], arm.lower[i] - arm.q[i]) for i in range(3)))
        jump = max(jump, *(abs(arm.stop_force[i] - before[i]) for i in range(3)))
        before = arm.stop_force[:3]
    assert arm.lost > 0.0
    return worst, deepest, jump


@pytest.mark.long
def test_a_stop_makes_no_energy_and_no_jump() -> None:
    """Four times as many steps: the torque changes by a quarter in each, as that of no jump does."""
    table = with_joints(omni(), damping=0.0)
    coarse, fine = bounced(table, 4), bounced(table, 16)
    assert max(coarse[0], fine[0]) <= 1e-13
    assert 1e-3 < fine[1] < 0.05
    assert fine[2] < 0.4 * coarse[2]


def test_a_drive_brakes_above_its_greatest_speed() -> None:
    """Pushed by 20 N for 0.2 s; the energy that the brake takes is in the account."""
    table = with_joints(loose(omni()), speed=2.0, effort=100.0)
    arm = arm_of(table, NO_HAND, T, 1)
    arm.commanded[:3] = [20.0, 0.0, 0.0]
    start, worst, done = energy(arm), 0.0, 0.0
    for _ in range(200):
        x = arm.x[0]
        motion.tick(arm, STILL, 0)
        done += arm.force[0] * (arm.x[0] - x)
        worst = max(worst, abs(energy(arm) + arm.lost - start - done))
    assert worst <= 1e-13
    assert 1.9 < abs(arm.rates[0]) < 2.2
    assert arm.unsettled == 0


def test_a_motor_shares_out_the_largest_multiple_that_it_has() -> None:
    """The elbow has 0.1 Nm beside its weight: a force that asks for more keeps its direction."""
    table = loose(omni())
    weak = replace(table, joints=(*table.joints[:2], replace(table.joints[2], effort=0.15)))
    arm = arm_of(weak, Impedance(0.1, 2.0, 50.0), T, 4)
    arm.commanded[:3] = [1.0, 2.0, 3.0]
    for _ in range(50):
        motion.tick(arm, STILL, 0)
        share = arm.force[2] / 3.0
        assert arm.limited
        assert list(arm.force[:3]) == pytest.approx([share, 2.0 * share, 3.0 * share], rel=1e-12)
        columns = np.array(arm.chain.tip.columns)[:3]
        motion.gravity(arm.chain, arm.q, arm.q, arm.load)
        asked = abs(columns[2] @ np.array(arm.force[:3])) + abs(arm.load[2])
        assert 0.98 * 0.15 < asked < 1.02 * 0.15


def test_a_motor_that_has_nothing_left_renders_nothing() -> None:
    table = loose(omni())
    arm = arm_of(with_joints(table, effort=1e-4), Impedance(0.1, 2.0, 50.0), T, 1)
    arm.commanded[:3] = [1.0, 0.0, 0.0]
    motion.tick(arm, STILL, 0)
    assert list(arm.force[:3]) == [0.0, 0.0, 0.0]


@pytest.mark.parametrize("steps", [1, 4])
def test_a_hand_without_stiffness_is_its_mass(steps: int) -> None:
    """A slide of 0.5 kg that 3 N push, in a hand of 0.2 kg, which holds back with 0.2/0.7 of them."""
    joint = Joint("a", (0.0, 0.0, 0.0), axis=(1.0, 0.0, 0.0), mass=0.5, slides=True, lower=-1.0, upper=1.0)
    arm = arm_of(ArmTable("slide", (joint,), (0.0, 0.0, 0.0), (0.0,)), Impedance(0.2, 0.0, 0.0), T, steps)
    arm.commanded[0] = 3.0
    motion.tick(arm, STILL, 0)
    assert arm.hand_force[0] == pytest.approx(-3.0 * 0.2 / 0.7)
