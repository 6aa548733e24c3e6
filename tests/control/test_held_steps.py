"""A follower's servo in the steps of a world: late steps, and the watchdog."""

import math

import pytest

from hapnet.control.held_steps import FollowerServo, HeldSteps
from hapnet.control.limits import Silence
from hapnet.control.pspm import SetPositionModulator
from hapnet.control.set_position_coupling import SetPositionCoupling
from hapnet.control.smoothing import Pipeline
from hapnet.plant.integrator import PassiveIntegrator
from hapnet.plant.worlds.walls import Contacts, Wall

PERIOD = 1e-3


def steps(watchdog: float = math.inf) -> HeldSteps:
    modulator = SetPositionModulator(stiffness=200.0, position=(0.0,), ceiling=0.1)
    coupling = SetPositionCoupling(modulator, stages=Pipeline([]), silence=Silence("hold", 1.0))
    servo = FollowerServo(None, coupling=coupling, damping=(1.0,), period=0.005, position=(0.0,))
    return HeldSteps(servo, PERIOD, watchdog)


def walked(made: HeldSteps, lengths: list[float]) -> tuple[PassiveIntegrator, Contacts]:
    contacts = Contacts((Wall((1.0,), 0.004, 3000.0, 10.0),), 1)
    mass = PassiveIntegrator(0.05, 1.0, 1.0, (0.0,))
    mass.set_contacts(contacts)
    made.update(0.0, mass.position, 0.0)
    for k in range(300):
        made.coupling.receive((0.01,), 0.001 * k, 0.0)
        for dt in lengths:
            done = made.advance(mass, dt, contacts)
            made.update(dt, done.position, 0.0)
    return mass, contacts


def test_a_late_step_is_made_in_parts_and_each_counts() -> None:
    """The work that the account has is that of the force which was held, over the way that the robot really went."""
    made = steps()
    mass, contacts = walked(made, [PERIOD, 7.3 * PERIOD])
    ledger = made.coupling.ledger
    assert mass.position[0] > 0.004
    stored = contacts.stored_J(mass.position) + mass.kinetic_J
    assert -ledger.work >= stored - 1e-12  # a wall without damping would give an equation
    assert ledger.slack_min >= -1e-12


def test_without_walls_the_account_has_what_the_robot_has() -> None:
    made = steps()
    mass = PassiveIntegrator(0.05, 1.0, 1.0, (0.0,))
    contacts = Contacts((), 1)
    mass.set_contacts(contacts)
    made.update(0.0, mass.position, 0.0)
    for k in range(40):
        made.coupling.receive((0.01,), 0.001 * k, 0.0)
        done = made.advance(mass, 7.3 * PERIOD, contacts)
        made.update(7.3 * PERIOD, done.position, 0.0)
        assert -made.coupling.ledger.work == pytest.approx(mass.kinetic_J, abs=1e-12)
    assert made.servo.speed_max > 0.0


def test_a_servo_that_is_too_late_gives_no_force_until_it_is_on_time() -> None:
    made = steps(watchdog=5 * PERIOD)
    contacts, mass = Contacts((), 1), PassiveIntegrator(0.05, 1.0, 1.0, (0.0,))
    mass.set_contacts(contacts)
    made.update(0.0, mass.position, 0.0)
    made.coupling.receive((0.01,), 0.0, 0.0)
    forces = []
    for k, dt in enumerate((PERIOD, 6 * PERIOD, PERIOD)):
        made.coupling.receive((0.01,), 0.001 * k, 0.0)
        done = made.advance(mass, dt, contacts)
        made.update(dt, done.position, 0.0)
        forces.append(made.servo.force[0])
    assert forces[0] > 0.0
    assert forces[1] == 0.0
    assert forces[2] > 0.0
