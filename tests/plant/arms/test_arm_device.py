"""An arm as a device under PSPM with a held force: passive whatever limits it, and what would be caught."""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest

from hapnet.control import set_position_servo
from hapnet.control.harvest import MeasuredHarvest
from hapnet.control.ledger import Ledger
from hapnet.control.limits import Silence
from hapnet.control.pspm import SetPositionModulator
from hapnet.control.set_position_coupling import SetPositionCoupling
from hapnet.control.set_position_servo import SampledServo
from hapnet.control.smoothing import Pipeline
from hapnet.errors import InvalidParameter
from hapnet.ext.arms.device import SimulatedArm
from hapnet.ext.arms.table import ArmTable, omni
from hapnet.plant.operator import Impedance, Rest, Sine
from hapnet.side import held_device
from hapnet.side.held_device import HeldDevice
from tests.conftest import mostly_slow
from tests.plant.arms.test_motion import loose, with_joints

T = 1e-3
CEILING_J = 0.05


class Account(NamedTuple):
    """Smallest slacks, as the servo counts it, with true positions, and at the hand's port with all that the arm
    stores and loses [J]; the largest error of a tick's energy [J]; how many ticks a motor limited; how far the arm
    went into a stop [rad]."""

    servo: float
    true: float
    hand: float
    closure: float
    limited: int
    beyond: float


def run(
    arm: SimulatedArm, *, stiffness: float = 300.0, damping: float = 1.0, reach: float = 0.1, ticks: int = 800
) -> Account:
    """Set-positions up to `reach` [m] from home, a new one every 20 ms."""
    rng = np.random.default_rng(7)
    x = arm.read()[0]
    modulator = SetPositionModulator(stiffness=stiffness, position=x, ceiling=CEILING_J)
    coupling = SetPositionCoupling(modulator, stages=Pipeline(), silence=Silence("hold", 1.0))
    servo = SampledServo(coupling, damping=(damping,) * arm.dof, period=T, position=x, resolution=arm.resolution)
    held = HeldDevice(arm, servo, Ledger(0.0, 0.0))
    start, work, hand, closure, limited, beyond = arm.kinetic + arm.potential, 0.0, 0.0, 0.0, 0, 0.0
    for k in range(ticks):
        before, place, lost = arm.kinetic + arm.potential, arm.position, arm.arm.lost
        held_device.live(held, None, 1)
        moved = [new - old for new, old in zip(arm.position, place, strict=True)]
        done = sum(f * d for f, d in zip(servo.force, moved, strict=True))
        kept = arm.kinetic + arm.potential
        closure = max(closure, abs(held.hand_work + done - (kept - before) - (arm.arm.lost - lost)))
        work += held.hand_work
        limited += arm.arm.limited
        ends = zip(arm.angles, arm.table.joints, strict=True)
        beyond = max(beyond, *(max(q - joint.upper, joint.lower - q) for q, joint in ends))
        x, v = arm.read()
        held_device.count(held, T)
        if k % 20 == 0:
            coupling.receive(tuple(rng.uniform(-reach, reach, arm.dof)), 0.0, 0.0)
        servo.tick(T, x, v)
        held_device.apply(held)
        ledger = coupling.ledger
        out = coupling.potential(arm.position) + servo.account - CEILING_J - ledger.credited + ledger.sent
        hand = min(hand, work - (arm.kinetic + arm.potential - start) - out)
    return Account(coupling.ledger.slack_min, held.true_ledger.slack_min, hand, closure, limited, beyond)


def arm_in_hand(
    table: ArmTable, *, amplitude: float = 0.05, stiffness: float = 60.0, kind: type[SimulatedArm] = SimulatedArm,
    compensated: bool = True, resolution: float = 0.0, limit: float | None = 3.3,
) -> SimulatedArm:  # fmt: skip
    hand = Sine(3, Impedance(0.1, 1.0, stiffness), amplitude, 1.0, start_s=0.2)
    return kind(table, hand, substeps=1, compensated=compensated, resolution=resolution, force_limit=limit)


WEAK = replace(omni(), joints=tuple(replace(joint, effort=0.25 * joint.effort) for joint in omni().joints))


def check(account: Account) -> None:
    """A tick's energy is off by no more than the rounding of its positions times its forces."""
    assert min(account.servo, account.true, account.hand) >= -1e-13
    assert account.closure <= 1e-14


@pytest.mark.long
def test_passive_at_stops() -> None:
    account = run(arm_in_hand(omni(), amplitude=0.25))
    check(account)
    assert account.beyond > 0.02


@pytest.mark.long
def test_passive_at_torque_limits() -> None:
    account = run(arm_in_hand(WEAK, limit=None), reach=0.2)
    check(account)
    assert account.limited > 700


@pytest.mark.long
def test_passive_with_its_weight_in_the_hand() -> None:
    account = run(arm_in_hand(WEAK, compensated=False, limit=None), reach=0.2)
    check(account)
    assert account.limited > 500


@pytest.mark.long
def test_passive_with_targets_outside_the_workspace() -> None:
    check(run(arm_in_hand(omni()), reach=0.8))


@pytest.mark.long
def test_passive_through_singularities() -> None:
    """Without stops and damping the hand pulls the arm straight, and the tip over the waist's axis."""
    arm = arm_in_hand(loose(omni()), amplitude=0.3)
    check(run(arm, reach=0.5, stiffness=500.0))


class Proud(SimulatedArm):
    """Says that its motors gave the force that was asked for."""

    def advance(self) -> float:
        work = super().advance()
        self.state.torque[:] = self.arm.commanded[: self.dof]
        return work


@pytest.mark.long
def test_a_torque_limit_that_is_not_in_the_account_is_caught() -> None:
    """The servo detects no fault; the hand's port, and the energy of each tick, tell."""
    account = run(arm_in_hand(WEAK, kind=Proud, limit=None), reach=0.2)
    assert account.limited > 700
    assert account.closure > 1e-4
    assert account.hand < -1e-3
    assert account.servo >= -1e-13


def test_encoders_blur_no_axis_by_more_than_half_their_resolution() -> None:
    arm = arm_in_hand(omni(), resolution=5.5e-5)
    apart = []
    for _ in range(300):
        arm.advance()
        x, _ = arm.read()
        apart.append(np.abs(np.array(x) - arm.position).max())
    assert 1e-6 < max(apart) <= 2.75e-5


def test_an_arm_begins_where_the_hand_is() -> None:
    """At rest; the tip is at the hand's reference, and stays there."""
    arm = SimulatedArm(omni(), Rest(3, Impedance(), (0.02, -0.03, 0.04)))
    assert arm.position == pytest.approx((0.02, -0.03, 0.04), abs=1e-8)
    for _ in range(50):
        arm.advance()
    assert arm.position == pytest.approx((0.02, -0.03, 0.04), abs=1e-7)


def test_what_cannot_be_is_refused() -> None:
    hand = Rest(3, Impedance())
    with pytest.raises(InvalidParameter, match="within the reach of omni"):
        SimulatedArm(omni(), Rest(3, Impedance(), (0.5, 0.0, 0.0)))
    with pytest.raises(InvalidParameter, match="3, the axes of the tip of omni"):
        SimulatedArm(omni(), Rest(2, Impedance()))
    with pytest.raises(InvalidParameter, match=r"effort of omni's joint shoulder.*above 0.0496 Nm"):
        SimulatedArm(with_joints(omni(), effort=0.04), hand)
    with pytest.raises(InvalidParameter, match="sampled with an arm"):
        SimulatedArm(omni(), hand).couple(100.0, 0.1, (0.0, 0.0, 0.0))
    assert math.isinf(SimulatedArm(omni(), hand).limit)


@pytest.mark.parametrize("by_joints", mostly_slow([True, False], 1))
@pytest.mark.long
def test_harvesting_nothing_under_clipped_torques_is_caught(by_joints: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """The spring then gives more than it has: both accounts tell, the servo's own and that with true positions."""
    joints = replace(WEAK, joints=tuple(replace(joint, effort=0.05) for joint in WEAK.joints))
    hand = Sine(3, Impedance(0.006, 0.06, 1.4), 0.3, 1.0, start_s=0.2)
    arm = SimulatedArm(joints, hand, substeps=1, by_joints=True) if by_joints else arm_in_hand(WEAK, limit=None)
    values = {"stiffness": 2.0, "damping": 0.002, "reach": 1.0} if by_joints else {"reach": 0.2}
    honest, take = run(arm, **values), set_position_servo.take
    assert honest.limited > 500
    assert min(honest.servo, honest.true) >= -1e-13
    arm.place(arm.operator.reference(0.0))
    arm.ticks, arm.time = 0, 0.0

    def nothing(harvest: MeasuredHarvest, change: float) -> float:
        """The harvest since PSPM ran last; of a tick that a motor limited nothing."""
        found = take(harvest, change)
        return 0.0 if arm.arm.limited else found

    monkeypatch.setattr(set_position_servo, "take", nothing)
    account = run(arm, **values)
    assert max(account.servo, account.true) < -1e-3
