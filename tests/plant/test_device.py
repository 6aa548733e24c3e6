"""The simulated device: its energy account is exact, its dynamics are right, in both directions of computing it
agree."""

import math
from itertools import chain

import numpy as np
import pytest
from scipy.linalg import expm

from hapnet.checks import Array
from hapnet.errors import InvalidParameter
from hapnet.mechanics.spring import Spring
from hapnet.plant.device import SimulatedDevice
from hapnet.plant.operator import Impedance, Operator, Rest, Sine
from hapnet.plant.tick import TickResult
from tests.conftest import mostly_slow, random_spd

HAND = Impedance()


class Away(Rest):
    """A hand that pulls from afar: at rest at the origin at t = 0, then elsewhere."""

    def reference(self, t: float) -> tuple[float, ...]:
        return self._position if t > 0.0 else (0.0,) * len(self._position)


@pytest.mark.parametrize("n", mostly_slow([1, 2, 3], 1))
@pytest.mark.parametrize("limit", [None, 0.4])
@pytest.mark.parametrize("general", [False, True])
@pytest.mark.long
def test_the_hands_work_is_all_accounted_for(n: int, limit: float | None, general: bool) -> None:
    """Without damping, W = change of kinetic + potential to 1e-13 J over 5 s, also where the spring saturates."""
    K = random_spd(np.random.default_rng(n), n, 40.0, 300.0) if general else np.eye(n) * 100.0
    device = SimulatedDevice(Sine(n, HAND, amplitude=0.03), damping=0.0)
    spring = Spring(K, n, limit)
    held = tuple(0.002 * i for i in range(n))
    device.couple(K, 0.0, held, limit)

    def stored() -> float:
        return device.kinetic + spring.potential(tuple(np.array(device.position) - held))

    before, work, saturated = stored(), 0.0, 0
    for _ in range(5000):
        work += device.advance()
        saturated += math.sqrt(spring.ellipsoid.square(tuple(np.array(device.position) - held))) > spring.knee
    assert work == pytest.approx(stored() - before, abs=1e-13)
    assert (saturated > 500) == (limit is not None)


@pytest.mark.parametrize(("n", "general"), [(1, False), (3, False), (2, True)])
@pytest.mark.parametrize("limit", [None, 0.4])
def test_ticks_in_a_row_are_ticks_one_by_one(n: int, general: bool, limit: float | None) -> None:
    """Also where the spring begins to saturate amid a run; one axis is the same to the bit."""
    K = random_spd(np.random.default_rng(n), n, 40.0, 300.0) if general else np.eye(n) * 100.0
    one, row = (SimulatedDevice(Sine(n, HAND, amplitude=0.03)) for _ in range(2))
    for device in (one, row):
        device.couple(K, 0.1, (0.0,) * n, limit)
    for ticks in (1, 4, 7) * 100:
        single = [(one.advance(), one.position, one.velocity, one.hand_force, one.actuator_force) for _ in range(ticks)]
        together = row.run(ticks)
        assert together == single if n == 1 else np.allclose(_flat(together), _flat(single), rtol=1e-12, atol=1e-15)
        assert np.allclose(row.passage()[:2], one.passage()[:2], rtol=1e-12, atol=1e-15)
        assert row.time == one.time


def test_ticks_of_a_held_torque_are_those_of_a_coupling_without_stiffness() -> None:
    """`advance` has a shorter way where no coupling acts within the tick."""
    rng = np.random.default_rng(3)
    alone, row = (SimulatedDevice(Sine(3, HAND, amplitude=0.03)) for _ in range(2))
    for torque in rng.normal(size=(200, 3)).tolist():
        alone.apply(tuple(torque))
        row.apply(tuple(torque))
        single = [(alone.advance(), alone.position, alone.velocity, alone.hand_force, alone.actuator_force)]
        assert row.run(1) == single
        assert row.time == alone.time


def _flat(ticks: list[TickResult]) -> list[float]:
    return [value for work, *vectors in ticks for value in (work, *chain(*vectors))]


def test_damping_dissipates_exactly_what_the_account_leaves() -> None:
    """Over a tick of one substep: W - change of energy = (B + b) vhat^2 h, vhat = dx / h."""
    device = SimulatedDevice(Sine(1, HAND), damping=0.3, substeps=1)
    device.couple(100.0, 0.1, (0.01,))
    spring = Spring(100.0, 1)
    for _ in range(1000):
        x, kinetic = device.position[0], device.kinetic
        work = device.advance()
        change = device.kinetic - kinetic + spring.potential((device.position[0] - 0.01,))
        change -= spring.potential((x - 0.01,))
        assert work - change == pytest.approx(0.4 * (device.position[0] - x) ** 2 / 1e-3, abs=1e-16)


def exact_motion(K: Array, B: Array, t: float, goal: Array, device: SimulatedDevice) -> Array:
    """Matrix exponential of the linear device, hand and coupling from rest at 0, the hand pulling to `goal`."""
    n = len(goal)
    inertia = device.mass + HAND.mass
    A = np.zeros((2 * n, 2 * n))
    A[:n, n:] = np.eye(n)
    A[n:, :n] = -(K + np.eye(n) * HAND.stiffness) / inertia
    A[n:, n:] = -(B + np.eye(n) * (device.damping + HAND.damping)) / inertia
    fixed = -np.linalg.solve(A, np.concatenate([np.zeros(n), HAND.stiffness * goal / inertia]))
    return np.asarray((fixed - expm(A * t) @ fixed)[:n])


@pytest.mark.parametrize("general", [False, True])
def test_second_order_convergence_to_the_exact_motion(general: bool) -> None:
    goal = np.array([0.02, -0.01])
    K = random_spd(np.random.default_rng(5), 2, 50.0, 500.0) if general else np.diag([100.0, 300.0])
    errors = []
    for substeps in (1, 2, 4):
        device = SimulatedDevice(Away(2, HAND, tuple(goal)), period=5e-3, substeps=substeps)
        device.operator = Rest(2, HAND, tuple(goal))
        device.references = [tuple(goal)]
        device.couple(K, [0.1, 0.2], (0.0, 0.0))
        for _ in range(40):
            device.advance()
        exact = exact_motion(K, np.diag([0.1, 0.2]), 0.2, goal, device)
        errors.append(float(np.linalg.norm(np.array(device.position) - exact)))
    orders = [math.log2(errors[i] / errors[i + 1]) for i in range(2)]
    assert orders == pytest.approx([2.0, 2.0], abs=0.1)


@pytest.mark.long
def test_both_ways_of_computing_a_tick_agree() -> None:
    """A diagonal K, axis by axis and as a matrix (the matrix path is forced by an off-diagonal of 1e-300)."""
    results = []
    for off in (0.0, 1e-300):
        device = SimulatedDevice(Sine(3, HAND))
        K = np.diag([100.0, 50.0, 400.0])
        K[0, 1] = K[1, 0] = off
        device.couple(K, 0.1, (0.01, 0.0, -0.01), 2.0)
        work = sum(device.advance() for _ in range(2000))
        forces = device.hand_force, device.actuator_force
        results.append((device.position, device.velocity, work, *device.passage()[:2], *forces))
    for one, other in zip(*results, strict=True):
        assert one == pytest.approx(other, rel=1e-10, abs=1e-14)


def test_a_held_force_does_the_work_of_its_travel() -> None:
    """Sampled: W of the hand = change of kinetic energy - tau dx + own damping's share, over each tick."""
    device = SimulatedDevice(Sine(2, HAND), damping=0.0)
    rng = np.random.default_rng(0)
    for _ in range(500):
        force = tuple(rng.normal(size=2))
        device.apply(force)
        x, kinetic = np.array(device.position), device.kinetic
        work = device.advance()
        done = float(np.dot(force, np.array(device.position) - x))
        assert work + done == pytest.approx(device.kinetic - kinetic, abs=1e-15)


@pytest.mark.parametrize("K", [np.eye(2) * 100.0, np.array([[100.0, 20.0], [20.0, 80.0]])], ids=["diagonal", "full"])
def test_a_coupling_takes_the_place_of_a_force_that_was_held(K: Array) -> None:
    """Without damping all that the hand gives is kinetic energy and the spring's: no held force does work beside it."""
    device = SimulatedDevice(Sine(2, HAND), damping=0.0)
    device.apply((2.0, -1.0))
    device.advance()
    spring, ybar = Spring(K, 2), (0.01, 0.0)
    device.couple(K, 0.0, ybar)

    def stored() -> float:
        return device.kinetic + spring.potential(tuple(np.array(device.position) - ybar))

    before = stored()
    work = sum(device.advance() for _ in range(300))
    assert work == pytest.approx(stored() - before, abs=1e-13)


def test_actuators_and_encoders_have_their_limits() -> None:
    device = SimulatedDevice(Sine(2, HAND), force_limit=3.3, resolution=5.5e-5)
    device.apply((30.0, 40.0))
    assert device.state.torque == pytest.approx((3.3 * 0.6, 3.3 * 0.8))
    last, _ = device.read()
    for _ in range(300):
        device.advance()
        position, velocity = device.read()
        for axis in range(2):
            counts = position[axis] / 5.5e-5
            assert counts == pytest.approx(round(counts), abs=1e-9)
            assert abs(position[axis] - device.position[axis]) <= 5.5e-5 / 2 * (1 + 1e-9)
            assert velocity[axis] == pytest.approx((position[axis] - last[axis]) / 1e-3)
        last = position


@pytest.mark.parametrize("K", [np.eye(2) * 100.0, np.array([[100.0, 20.0], [20.0, 80.0]])], ids=["diagonal", "full"])
def test_extremes_enclose_all_ticks_since_they_were_asked_for(K: Array) -> None:
    device = SimulatedDevice(Sine(2, HAND))
    device.couple(K, 0.1, (0.0, 0.0))
    for _ in range(100):
        visited = [device.position]
        for _ in range(7):
            device.advance()
            visited.append(device.position)
        low, high, _ = device.passage()
        for axis in range(2):
            assert low[axis] <= min(x[axis] for x in visited)
            assert high[axis] >= max(x[axis] for x in visited)
    assert device.passage() == (device.position, device.position, None)


@pytest.mark.parametrize("kw", [{"mass": 0.0}, {"damping": -1.0}, {"substeps": 0}, {"resolution": float("nan")}])
def test_bad_parameters_are_named(kw: dict[str, float]) -> None:
    operator: Operator = Sine(1, HAND)
    with pytest.raises(InvalidParameter, match="device"):
        SimulatedDevice(operator, **kw)  # type: ignore[arg-type]
