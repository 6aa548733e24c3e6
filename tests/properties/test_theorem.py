"""Theorem 1, over random cases: both ports stay passive whatever the links do, and a plain virtual coupling does not.

The account itself is checked against one that shares no code with it: hand, walls, springs and dampers are computed
again from their laws, in numpy, from nothing but the recorded positions.
"""

import math
from collections.abc import Callable

import numpy as np
import pytest

from hapnet.checks import Array, spd
from hapnet.control import ledger
from hapnet.control.two_port import TwoPort
from hapnet.params import Params
from hapnet.plant.operator import Impedance, Operator, Press, Sine
from hapnet.recording.samples import Columns
from hapnet.side.endpoint import WireHalf
from hapnet.simulation.simulation import Result, simulate
from hapnet.wire.events import EnergyCredited, Event
from tests.conftest import mostly_slow, random_spd
from tests.support.paper import PAPER
from tests.support.theorem_cases import TOLERANCE_J, Outcome, random_case, run_case

NJ = 1e9


def assert_passive(case: int, outcome: Outcome) -> None:
    assert outcome.device_slack >= -TOLERANCE_J, case
    assert outcome.world_slack >= -TOLERANCE_J, case
    assert outcome.margin >= -TOLERANCE_J, case
    assert outcome.reservoir >= 0.0, case
    assert outcome.credit_gap_nJ >= 0, case


def assert_credited_was_sent(here: Columns, there: Columns) -> None:
    """credited here <= sent there [nJ] at every sample: credits are whole nanojoules, so rounding cannot hide one."""
    latest = np.searchsorted(there["time_ns"], here["time_ns"], side="right") - 1
    sent = np.where(latest >= 0, there["sent_J"][np.maximum(latest, 0)], 0.0)
    assert np.all(np.rint(here["credited_J"] * NJ) <= sent * NJ + 1e-3)


def survey(cases: range, compared: range) -> tuple[int, int]:
    """Assert the theorem in `cases`; in `compared`, how many a plain coupling takes below (its halves, the bound)."""
    floor = [math.inf] * 4
    shuffled = saturated = 0
    for case in cases:
        outcome = run_case(random_case(case), case)
        assert_passive(case, outcome)
        values = (outcome.device_slack, outcome.world_slack, outcome.margin, outcome.reservoir)
        floor = [min(a, b) for a, b in zip(floor, values, strict=True)]
        summary = outcome.result.summary
        shuffled += min(summary["device"]["sent_nJ"], summary["world"]["sent_nJ"]) > 0
        spring, recording = outcome.result.device.coupling.spring, outcome.result.recording.device
        saturated += bool(recording["potential_J"].max() > 0.5 * spring.knee**2)
    halves = whole = 0
    for case in compared:
        outcome = run_case(random_case(case).set({"coupling": "zoh"}), case)
        halves += min(outcome.device_slack, outcome.world_slack) < -TOLERANCE_J
        whole += outcome.margin < -TOLERANCE_J
    print(
        f"\n{len(cases)} cases of 5 s: least slack {floor[0]:.1e} J (device) {floor[1]:.1e} J (world), "
        f"margin {floor[2]:.1e} J, reservoir {floor[3]:.1e} J; {shuffled} shuffled both ways, {saturated} saturated"
    )
    print(f"PSPM off, {len(compared)} of them: {halves} below the theorem's half, {whole} below the bound")
    assert shuffled > len(cases) / 3
    assert saturated > len(cases) / 20
    return halves, whole


@pytest.mark.parametrize(
    ("cases", "compared", "halves", "whole"),
    mostly_slow([(4, 3, 2, 1), (8, 8, 6, 4), (50, 50, 40, 25), (500, 500, 400, 250)], 1, 2),
)
def test_both_ports_are_passive_in_random_cases(cases: int, compared: int, halves: int, whole: int) -> None:
    """A plain coupling breaks at least so many of the halves, and of the bounds."""
    broken_halves, broken = survey(range(cases), range(compared))
    assert broken_halves >= halves
    assert broken >= whole


# -- the account, once more and independently ----------------------------------------------------------------------


def differences(start: Array, after: Array) -> Array:
    return np.diff(np.vstack([start, after]), axis=0)


def spring_potential(K: Array, limit: float | None, e: Array) -> Array:
    s = np.sqrt(np.einsum("ki,ij,kj->k", e, K, e))
    knee = math.inf if limit is None else limit / math.sqrt(np.linalg.eigvalsh(K)[-1])
    return np.where(s <= knee, 0.5 * s**2, (knee * s - 0.5 * knee**2) if limit else 0.0)


def running(work: Array) -> Array:
    return np.asarray(np.cumsum(work))


def hands_work(params: Params, hand: Operator, device: Columns) -> tuple[Array, Array, Array]:
    """(W after each tick, kinetic energy, |dx|^2 per axis) from positions alone, one substep a tick.

    The midpoint rule's mean velocity is dx/h; with it come v by recursion, and the hand's force by its own law.
    """
    h = 1.0 / params.device.servo_hz
    x = device["position_m"]
    times = np.arange(len(x) + 1) * h
    wanted = np.array([hand.reference(t) for t in times.tolist()])
    dx = differences(wanted[0], x)
    v = np.zeros((len(x) + 1, x.shape[1]))
    for k, mean in enumerate(dx / h):
        v[k + 1] = 2.0 * mean - v[k]
    middle = (np.vstack([wanted[0], x[:-1]]) + x) / 2.0
    arm = hand.impedance
    force = arm.stiffness * ((wanted[1:] + wanted[:-1]) / 2.0 - middle)
    force += arm.damping * (np.diff(wanted, axis=0) / h - dx / h) - arm.mass * np.diff(v, axis=0) / h
    assert force == pytest.approx(device["operator_force_N"], abs=1e-6)
    kinetic = 0.5 * params.device.mass * np.sum(v[1:] ** 2, axis=1)
    return running(np.sum(force * dx, axis=1)), kinetic, dx**2


def worlds_work(params: Params, n: int, world: Columns) -> tuple[Array, Array, Array]:
    """(W after each step, kinetic energy, D of each step): Newton's law of the virtual mass gives the walls' force."""
    M, B, K = (spd("", value, n) for value in (params.world.mass, params.world.damping, params.world.stiffness))
    zero = np.zeros(n)
    T = world["step_s"][:, None]
    dx = differences(zero, world["position_m"])
    dv = differences(zero, world["velocity_mps"])
    ybar = np.vstack([zero, world["set_position_m"][:-1]])
    middle = world["position_m"] - dx / 2.0 - ybar
    force = dv / T @ M + dx / T @ B + middle @ K
    assert force == pytest.approx(world["contact_force_N"], abs=1e-6)
    kinetic = 0.5 * np.einsum("ki,ij,kj->k", world["velocity_mps"], M, world["velocity_mps"])
    return running(np.sum(force * dx, axis=1)), kinetic, np.sum(dx / T * (dx @ B), axis=1)


def assert_account(side: Columns, work: Array, kinetic: Array, potential: Array, ceiling: float) -> Array:
    """The recorded margin and slack, from their definitions; the slack is returned."""
    margin = work + ceiling + side["credited_J"] - side["sent_J"]
    slack = margin - kinetic - potential - side["reservoir_J"]
    assert side["margin_J"] == pytest.approx(margin, abs=1e-10)
    assert side["slack_J"] == pytest.approx(slack, abs=1e-10)
    assert np.all(slack >= -TOLERANCE_J)
    return np.asarray(slack)


def audited(seed: int) -> tuple[Params, Callable[[], Operator], int]:
    rng = np.random.default_rng(seed)
    n = 1 + seed % 3
    arm = Impedance()
    params = PAPER.set(
        {
            "duration_s": 2.5, "dof": n, "record_hz": 1000.0, "scene": "wall", "operator": ("sine", "press")[seed % 2],
            "operator_model.start_m": -0.01, "operator_model.goal_m": 0.04,
            "device.substeps": 1, "device.stiffness": random_spd(rng, n, 50.0, 300.0).tolist(),
            "device.damping": rng.uniform(0.05, 1.0, n).tolist(), "device.force_limit_N": 0.0 if seed < 3 else 1.0,
            "device.shuffle": ("harvested", "all")[seed % 2], "world.shuffle": ("harvested", "all")[seed % 2],
            "world.mass": random_spd(rng, n, 0.01, 0.2).tolist(), "world.step_min_s": 0.002,
            "world.damping": random_spd(rng, n, 5.0, 20.0).tolist(),
            "world.stiffness": random_spd(rng, n, 200.0, 2000.0).tolist(),
        }
    )  # fmt: skip
    start, goal = (-0.01, *(0.0,) * (n - 1)), (0.04, *(0.0,) * (n - 1))
    return params, lambda: Press(start, goal, arm) if seed % 2 else Sine(n, arm, start_s=1.0), n


@pytest.mark.parametrize("seed", range(6))
def test_the_ledgers_agree_with_an_independent_account(seed: int) -> None:
    params, make_hand, n = audited(seed)
    result = simulate(params, seed)
    device, world = result.recording.device, result.recording.world

    W, kinetic, dx2 = hands_work(params, make_hand(), device)
    K = spd("", params.device.stiffness, n)
    limit = params.device.force_limit_N * params.device.spring_share or None
    phi = spring_potential(K, limit, device["position_m"] - device["set_position_m"])
    slack = assert_account(device, W, kinetic, phi, params.device.ceiling_J)
    # The device's own damping is dissipated and never harvested: all of it must be in the slack.
    own = running(params.device.own_damping * np.sum(dx2, axis=1) * params.device.servo_hz)
    assert np.all(slack - own >= -TOLERANCE_J)
    # (10) harvests no more than the damper took, and what it took is all that can have been harvested or left behind.
    B = np.array(params.device.damping)
    taken = running(np.sum(B * dx2, axis=1) * params.device.servo_hz)
    assert np.all(slack - own <= taken + result.device.coupling.discarded + TOLERANCE_J)

    W_world, kinetic, D = worlds_work(params, n, world)
    phi = spring_potential(spd("", params.world.stiffness, n), None, world["position_m"] - world["set_position_m"])
    slack = assert_account(world, W_world, kinetic, phi, params.world.ceiling_J)
    # D is exact here, so that the slack is what was discarded and nothing else.
    assert slack[-1] == pytest.approx(result.world.coupling.discarded, abs=1e-10)
    assert D.min() >= 0.0

    assert_two_port(result, W, W_world)
    assert_credited_was_sent(device, world)
    assert_credited_was_sent(world, device)


def assert_two_port(result: Result, W_device: Array, W_world: Array) -> None:
    """Theorem 1 as written: for every tick T the world's steps that have begun by then, with or without the last."""
    device, world = result.recording.device, result.recording.world
    ended = np.searchsorted(world["time_ns"], device["time_ns"], side="right")
    before = np.concatenate([[0.0], W_world])
    begun = before[np.minimum(ended + 1, len(W_world))]
    two_port = W_device + np.minimum(before[ended], begun)
    bound = result.summary["theorem"]["bound_J"]
    margin = result.summary["theorem"]["margin_J"]
    assert margin == pytest.approx(bound + min(0.0, two_port.min()), abs=1e-9) or margin < bound + two_port.min()
    assert margin >= bound + min(0.0, two_port.min()) - np.abs(np.diff(W_device)).max() - 1e-9
    ledgers = sum(result.summary[side]["ledger"]["margin_J"] for side in ("device", "world"))
    assert margin >= ledgers - TOLERANCE_J  # the halves add up to no more than the whole


def test_the_minimum_of_both_ports_by_hand() -> None:
    """Steps of -1, +3, -2 J against the device's port at -2, +1, -3, 0 J: by definition the minimum is -3 - 1 = -4."""
    both = TwoPort()
    both.device(-2.0)
    both.world(-1.0)  # the step in which the device was down to -2
    assert both.lowest == -3.0
    both.device(1.0)
    both.device(-3.0)
    assert both.lowest == -4.0  # the running step is worth nothing yet
    both.world(2.0)
    both.device(0.0)
    both.world(0.0)
    assert both.lowest == -4.0
    both.device(-5.0)
    assert both.lowest == -5.0  # after the last step, too


# -- the check can fail ----------------------------------------------------------------------------------------------


def test_energy_credited_twice_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """The theorem's one condition on the wire, broken on purpose: the accounts on both sides show it."""
    once = WireHalf._hand_over

    def twice(self: WireHalf, events: tuple[Event, ...], now_ns: int) -> None:
        once(self, events, now_ns)
        once(self, tuple(event for event in events if isinstance(event, EnergyCredited)), now_ns)

    monkeypatch.setattr(WireHalf, "_hand_over", twice)
    params = PAPER.set({"duration_s": 2.0, "scene": "free", "operator": "sine", "record_hz": 1000.0})
    recording = simulate(params, 1, kernel=False).recording
    assert recording.device is not None
    assert recording.world is not None
    with pytest.raises(AssertionError):
        assert_credited_was_sent(recording.world, recording.device)


def test_a_half_that_is_broken_shows_in_the_slack(monkeypatch: pytest.MonkeyPatch) -> None:
    """A ledger that counts a hundredth too much of the work at its port no longer closes."""
    exact = ledger.put_in
    monkeypatch.setattr(ledger, "put_in", lambda one, work: exact(one, 1.01 * work))
    params = PAPER.set({"duration_s": 5.0, "device.shuffle": "all", "world.shuffle": "all"})
    summary = simulate(params, 1, kernel=False).summary
    assert min(summary[side]["ledger"]["slack_J"] for side in ("device", "world")) < -1e-6
