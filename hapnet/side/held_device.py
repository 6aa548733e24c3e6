"""A simulated device under a force that is held from tick to tick, and the accounts of its true work."""

from __future__ import annotations

from typing import Any

from hapnet.control import ledger as ledgers, set_position_coupling as couplings, set_position_servo as servos
from hapnet.control.harvest import MeasuredHarvest, hold
from hapnet.control.ledger import Ledger
from hapnet.control.set_position_coupling import SetPositionCoupling
from hapnet.control.set_position_servo import SampledServo
from hapnet.plant import device as devices
from hapnet.plant.device import Hand, SimulatedDevice, advance
from hapnet.records.record import OfAxes, Record, compiled_as, equation
from hapnet.records.vectors import copy


class HeldDevice(Record):
    """A simulated device under held forces, with a servo of any law.

    Attributes
    ----------
    true_ledger : the account with the true positions, at the actuator's port; at the hand's port if the servo harvests
        by (10) (`ranged`). true_work : the harvest at the actuator's port. hand : the account at the hand's port.
    before : the position at the tick's begin [m]. hand_work, work : the energy put in at the hand's and the actuator's
        port in this tick [J]. cut_ticks : the number of ticks in which the actuators held less than the
        servo's force.
    """

    plant: SimulatedDevice
    servo: SampledServo
    coupling: SetPositionCoupling
    true_ledger: Ledger
    true_work: MeasuredHarvest
    hand: Ledger
    ranged: int
    before: OfAxes
    hand_work: float
    work: float
    cut_ticks: int

    def __init__(self, plant: SimulatedDevice, servo: Any, hand: Ledger) -> None:
        self.plant, self.servo, self.coupling, self.hand = plant, servo, servo.coupling, hand
        self.true_work = MeasuredHarvest(servo.trusted_damping)
        self.ranged = int(servo.harvest == "range")
        self.before, self.hand_work, self.work, self.cut_ticks = list(plant.position), 0.0, 0.0, 0
        self.true_ledger = Ledger(_stored(self), servo.coupling.account)


@equation
def live(side: HeldDevice, hand: Hand | None, periods: int) -> None:
    """Advance the device by this number of periods."""
    copy(side.plant.dof, side.plant.state.position, side.before)
    side.hand_work = 0.0
    for _ in range(periods):
        side.hand_work += advance(side.plant, hand)
    _take_over(side)
    ledgers.put_in(side.hand, side.hand_work)


@equation
def _take_over(side: HeldDevice) -> None:
    """Let the servo know the force that was really held: an arm's motors may have cut it."""
    cut = 0
    for i in range(side.plant.dof):
        if side.plant.state.torque[i] != side.servo.held[i]:
            cut = 1
    side.cut_ticks += cut
    copy(side.plant.dof, side.plant.state.torque, side.servo.held)


@equation
def count(side: HeldDevice, dt: float) -> None:
    """Count the work of the force that was held for `dt` seconds."""
    side.work = hold(side.true_work, side.servo.held, side.before, side.plant.state.position, dt)


@equation
def apply(side: HeldDevice) -> None:
    """Let the device hold the servo's force from now on, as far as its actuators can."""
    devices.apply(side.plant, side.servo.held)
    copy(side.plant.dof, side.plant.state.torque, side.servo.held)
    observe(side)


@equation
def observe(side: HeldDevice) -> None:
    """Count a tick in the account with the true positions."""
    ledger, own = side.true_ledger, side.coupling.ledger
    ledgers.put_in(ledger, side.hand_work if side.ranged else side.work)
    ledger.credited, ledger.sent = own.credited, own.sent
    ledgers.observe(ledger, _stored(side), account(side))


@equation
def _stored(side: HeldDevice) -> float:
    """The energy that is stored on the coupling's side of the account's port [J]."""
    if side.ranged:
        return potential(side) + devices.kinetic_at(side.plant, side.plant.state.velocity)
    return potential(side)


def _compiled_potential(side: HeldDevice) -> float:
    return couplings.potential(side.coupling, side.plant.state.position)


@compiled_as(_compiled_potential)
def potential(side: HeldDevice) -> float:
    """The potential energy of the servo's spring [J]; in plain Python for any servo."""
    return side.coupling.potential(side.plant.position)


def _compiled_account(side: HeldDevice) -> float:
    return servos.account(side.servo, side.coupling)


@compiled_as(_compiled_account)
def account(side: HeldDevice) -> float:
    """The servo's account [J]; in plain Python for any servo."""
    return side.servo.account
