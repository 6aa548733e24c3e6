"""Two-port time-domain passivity: the account, the controllers, and the claim of its authors on bad links."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hapnet.assembly.build import device_session, device_side, prepare, world_session, world_side
from hapnet.checks import Vector
from hapnet.control import tdpa
from hapnet.control.coupling import Port
from hapnet.control.tdpa import PassivityObserver, TdpaDevice, TdpaWorld
from hapnet.params import Params
from hapnet.side.device import DeviceSide
from hapnet.side.endpoint import DeviceEndpoint, WorldEndpoint
from hapnet.side.world import WorldSide
from hapnet.simulation.simulation import Result, Simulation
from hapnet.study.case import measure
from tests.processes import started

TICK = 1e-3
NOTHING: dict[str, object] = {}
OFF: dict[str, object] = {
    "tdpa.velocity_floor": 1.0,
    "tdpa.damping_cap": 1e-9,
    "tdpa.force_floor": 1e9,
    "tdpa.debt_limit_J": 1e9,
    "tdpa.speed_limit": 100.0,
}
"""Both controllers switched off."""


def device(x: Vector = (0.0,), **changes: float) -> TdpaDevice:
    values = {"velocity_floor": 0.002, "damping_cap": 5.0, "debt_limit": 0.02, "stiffness": 100.0} | changes
    return TdpaDevice(position=x, **values)


def world(x: Vector = (0.0,), **changes: float) -> TdpaWorld:
    values = {"stiffness": 100.0, "damping": 3.0, "force_floor": 0.05, "speed_limit": 0.25, "debt_limit": 0.02}
    return TdpaWorld(position=x, **(values | changes))


def told(law: TdpaDevice | TdpaWorld, x: Vector = (0.0,)) -> Port:
    sample = law.next_sample(x, x) if isinstance(law, TdpaDevice) else law.next_sample()
    assert isinstance(sample, Port)
    return sample


class Watched(PassivityObserver):
    """What was granted, the most that was owed, and the most that came out of a tick or a step."""

    def __init__(self) -> None:
        super().__init__()
        self.granted = self.most_owed = self.most_given = 0.0

    def observe(self, given: float, dissipated: float) -> None:
        super().observe(given, dissipated)
        self.most_owed = max(self.most_owed, self.debt)
        self.most_given = max(self.most_given, given)

    def receive(self, energy: float) -> None:
        before = self.debt
        super().receive(energy)
        self.granted += before - self.debt


@pytest.fixture(autouse=True, scope="module")
def watched() -> Iterator[None]:
    """Every law has its account watched."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tdpa, "PassivityObserver", Watched)
        yield


def account(side: DeviceSide | WorldSide) -> Watched:
    law: Any = side.endpoint.coupling.law  # type: ignore[union-attr]
    assert isinstance(law.observer, Watched)
    return law.observer


# -- the account -----------------------------------------------------------------------------------------------------


def test_a_passive_wall_makes_both_observers_positive() -> None:
    """Push slowly into a mass that does not move, and come back: a spring K takes K d^2/2 and returns it."""
    hand, far, depth = device(), world(), 0.01
    far.receive(told(hand))
    far.begin()
    hand.receive(told(far))
    way = [depth * (1.0 - math.cos(math.pi * k / 10_000)) / 2.0 for k in range(20_001)]
    held: Vector = (0.0,)
    for k, (before, at) in enumerate(pairwise(way), 1):
        held = hand.force(TICK, (at,), ((at - before) / TICK,), held)
        assert held[0] <= 0.02, "a wall pulls"  # but for the drift
        if k % 10 == 0:
            far.impedance(10 * TICK)
            far.moved(10 * TICK, (0.0,), (0.0,), (0.0,))
            hand.receive(told(far))
            far.receive(told(hand, (at,)))
            far.begin()
        if k == 10_000:
            assert told(hand).energy == pytest.approx(100.0 * depth**2 / 2.0, rel=0.05)
            assert told(far).energy == pytest.approx(0.0, abs=1e-5)
    assert told(hand).energy == pytest.approx(100.0 * depth**2 / 2.0, rel=0.05)
    assert told(far).energy == pytest.approx(100.0 * depth**2 / 2.0, rel=0.05)


@given(st.lists(st.floats(0.0, 10.0), min_size=1, max_size=20), st.randoms())
def test_loss_and_reordering_never_grant_more_than_what_went_in(energies: list[float], shuffle: Any) -> None:
    totals = np.cumsum(energies).tolist()
    arriving = [total for total in totals if shuffle.random() < 0.5]
    shuffle.shuffle(arriving)
    observer = PassivityObserver()
    for total in arriving:
        observer.receive(total)
        assert -observer.debt <= totals[-1] * (1.0 + 1e-12)
    first = arriving[0] if arriving else 0.0
    assert -observer.debt == pytest.approx(max(arriving, default=0.0) - first)


def test_what_was_granted_to_one_peer_is_not_granted_to_the_next() -> None:
    observer = PassivityObserver()
    observer.observe(-3.0, 0.0)
    observer.receive(0.0)
    observer.receive(2.0)
    observer.observe(0.5, 0.0)
    observer.on_peer_changed()
    assert observer.put_in == 3.0
    observer.receive(7.0)
    assert observer.debt == 0.5 - 2.0
    observer.receive(7.25)
    observer.receive(7.125)
    assert observer.debt == 0.5 - 2.0 - 0.25
    observer.observe(-1.0, 0.0)
    assert observer.put_in == 4.0


# -- the device ------------------------------------------------------------------------------------------------------


def test_the_device_damps_what_it_owes_and_pays_what_the_damper_took() -> None:
    """f <- f + alpha v with alpha = debt/(T v^2), on the device -f - alpha v; then E_out less the true dissipation."""
    law = device(debt_limit=1e6)
    law.receive(Port((-2.0,), 0.0))
    assert law.force(TICK, (0.0,), (0.05,), (0.0,)) == (2.0,)
    dx = 4.0e-6
    owed = 2.0 * dx  # moved along with the force, and nothing went in at the other port
    v = 0.05
    alpha = owed / (TICK * v**2)
    assert 0.0 < alpha < 5.0
    held = law.force(TICK, (dx,), (v,), (2.0,))
    assert held[0] == pytest.approx(2.0 - alpha * v, rel=1e-7)
    more = 5.0e-6
    law.force(TICK, (dx + more,), (v,), held)
    assert law.observer.debt == pytest.approx(owed + 2.0 * more - alpha * v * more, rel=1e-6)


@pytest.mark.parametrize(("v", "damping"), [(0.0019, 0.0), (0.0021, 5.0), (-0.1, 5.0)])
def test_the_device_damps_with_at_most_the_cap_and_not_below_the_floor(v: float, damping: float) -> None:
    law = device(debt_limit=1e6)
    law.receive(Port((-2.0,), 0.0))
    law.force(TICK, (0.001,), (v,), (2.0,))
    assert law.force(TICK, (0.001,), (v,), (2.0,))[0] == pytest.approx(2.0 - damping * v, rel=1e-6)


def test_a_device_that_owes_all_it_may_renders_nothing_until_energy_comes() -> None:
    law = device()
    law.receive(Port((-2.0,), 0.0))
    assert law.force(TICK, (0.011,), (0.0,), (2.0,)) == (0.0,)
    law.receive(Port((-2.0,), 0.012))
    assert law.force(TICK, (0.011,), (0.0,), (0.0,))[0] == pytest.approx(2.0 * 0.5)
    law.receive(Port((-2.0,), 0.022))
    assert law.force(TICK, (0.011,), (0.0,), (0.0,)) == (2.0,)


def test_its_set_position_makes_the_force_so_a_larger_deadband_sends_less() -> None:
    law = device((0.1, 0.0))
    assert law.set_position == (0.1, 0.0)
    law.receive(Port((-2.0, 0.5), 0.0))
    assert law.set_position == pytest.approx((0.12, -0.005))
    sent = []
    for fraction in (0.1, 0.5, 1.0):
        _, result = simulated("ideal", "sine", 2.0, {"wire.deadband": fraction})
        sent.append(result.summary["links"]["up"]["offered"])
    assert sent[1] < 0.9 * sent[0]
    assert 2 * 20 < sent[2] < 0.8 * sent[1], "signs of life are sent every 0.1 s, of any fraction"


# -- the world -------------------------------------------------------------------------------------------------------


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=12, deadline=None)
def test_a_yielding_step_is_the_coupling_in_series_with_a_damper(seed: int) -> None:
    """Against the 3 n linear equations of a step, and the coupling's own balance of energy, for any T and any debt."""
    rng = np.random.default_rng(seed)
    n, R = int(rng.integers(1, 4)), 0.2 * float(rng.integers(2))
    K, B, D = 10.0 ** rng.uniform(0, 3), 10.0 ** rng.uniform(-1, 1), 10.0 ** rng.uniform(-4, 1)
    law = world((0.0,) * n, stiffness=K, damping=B, debt_limit=D, force_floor=1e-9, speed_limit=1e3, recovery=R)
    x = np.zeros(n)
    yielded = 0
    for _ in range(60):
        T = 10.0 ** rng.uniform(-3, -1)
        law.receive(Port(tuple(rng.normal(0.0, 0.03, n).tolist()), 10.0 ** rng.uniform(-6, -1) * rng.integers(2)))
        law.begin()
        y, debt = np.array(law.set_position), law.observer.debt
        offset = y + np.array(law.drift) - np.array(law._goal)
        g, p = law.impedance(T)
        vhat = rng.normal(0.0, 0.3, n)
        f = np.array(p) - g * vhat
        v_y_commanded = np.array(law._way) / T
        law.moved(T, tuple(vhat.tolist()), tuple((x + T * vhat).tolist()), tuple(vhat.tolist()))
        v_y = (np.array(law.set_position) - y) / T
        a = B + K * T / 2
        beta = (1 / (g / a) - 1) / a
        assert 0.0 <= beta <= 1 / a * (1 + 1e-9)
        yielded += beta > 0.0
        # unknowns f, v_y; f = a (v_y - vhat) + K (y - x),  v_y = commanded - beta f
        matrix = np.block([[np.eye(n), -a * np.eye(n)], [beta * np.eye(n), np.eye(n)]])
        solution = np.linalg.solve(matrix, np.concatenate([K * (y - x) - a * vhat, v_y_commanded]))
        np.testing.assert_allclose(np.concatenate([f, v_y]), solution, rtol=1e-7, atol=1e-9)
        x1, y1 = x + T * vhat, y + T * v_y
        stored = K / 2 * (np.sum((y1 - x1) ** 2) - np.sum((y - x) ** 2))
        balance = stored + B * np.sum((v_y - vhat) ** 2) * T + f @ vhat * T
        assert f @ v_y * T == pytest.approx(balance, rel=1e-9, abs=1e-12)
        out, dissipated = f @ v_y_commanded * T, beta * f @ f * T
        assert law.observer.debt - debt == pytest.approx(max(out, 0.0) - dissipated, rel=1e-6, abs=1e-12)
        np.testing.assert_allclose(told(law).value, K * (y1 - x1) + B * (v_y - vhat), rtol=1e-7, atol=1e-9)
        # what was commanded is where y is, and what it lost
        np.testing.assert_allclose(y1 + np.array(law.drift) - np.array(law._goal), offset, atol=1e-9)
        x = x1
    assert yielded


def test_a_step_gives_just_what_it_may_if_the_mass_does_as_it_did() -> None:
    """A mass held fast, a device that has put in a known energy: what comes out is that energy."""
    law = world(force_floor=1e-6, speed_limit=10.0)
    law.receive(Port((0.0,), 0.0))
    law.begin()
    law.impedance(0.03)
    law.moved(0.03, (0.0,), (0.0,), (0.0,))
    energy = 0.0
    for k in range(1, 30):
        energy += 1e-4
        law.receive(Port((0.002 * k,), energy))
        law.begin()
        y = law.set_position[0]
        _, (p,) = law.impedance(0.03)
        law.moved(0.03, (0.0,), (0.0,), (0.0,))
        if k > 3:  # the first step has no force yet, and so no brake: what it owes must be paid back first
            assert p * (law.set_position[0] - y) <= 1e-4 * (1 + 1e-6) + 1e-9
    assert law.observer.debt == pytest.approx(0.0, abs=1e-9)
    assert law.drift[0] > 0.005


def test_the_first_position_is_where_the_set_position_is() -> None:
    law = world((0.1,))
    law.receive(Port((0.5,), 0.0))
    for _ in range(5):
        law.begin()
        assert law.impedance(0.02)[1] == (0.0,)
        law.moved(0.02, (0.0,), (0.1,), (0.0,))
    assert law.set_position == (0.1,)
    law.on_peer_changed()
    law.receive(Port((-0.3,), 0.0))
    law.begin()
    assert law.impedance(0.02)[1] == (0.0,)


@given(st.lists(st.tuples(st.floats(0.01, 0.05), st.booleans()), min_size=5, max_size=40))
@settings(max_examples=25, deadline=None)
def test_without_force_nothing_is_lost_of_the_way_whatever_the_link_loses(steps: list[tuple[float, bool]]) -> None:
    """A free mass that goes along: at rest again, y has moved as far as the device has."""
    law, x = world(), 0.0
    law.receive(Port((0.0,), 0.0))
    law.begin()
    at = 0.0
    for dt, lost in [*steps, *[(0.03, False)] * 60]:
        at = at + 0.1 * dt if len(steps) and at < 0.1 * sum(s for s, _ in steps) - 1e-12 else at
        y = law.set_position[0]
        law.impedance(dt)
        vhat = law._way[0] / dt
        x = y + vhat * dt
        law.moved(dt, (vhat,), (x,), (vhat,))
        if not lost:
            law.receive(Port((at,), 0.0))
        law.begin()
    assert law.set_position[0] == pytest.approx(at, abs=1e-6)
    assert law.drift[0] == pytest.approx(0.0, abs=1e-12)


def test_a_step_between_two_messages_goes_on_as_the_device_did_and_not_for_longer_than_a_tenth_of_a_second() -> None:
    """A device of constant speed, told every 5 ms and then no more, to a world of 1 ms steps."""
    law, v, way = world(force_floor=1e9, debt_limit=1e9), 0.1, []
    for k in range(600):
        if k % 5 == 0 and k < 400:
            law.receive(Port((v * k * TICK,), 0.0))
        law.begin()
        y = law.set_position[0]
        law.impedance(TICK)
        law.moved(TICK, (v,), (law.set_position[0],), (v,))
        way.append(law.set_position[0] - y)
    assert way[300:400] == pytest.approx([v * TICK] * 100, rel=1e-3)
    assert law.set_position[0] == pytest.approx(v * (395 * TICK + 0.1), rel=1e-3)
    assert way[500:] == pytest.approx([0.0] * 100, abs=1e-15)


def test_a_fast_world_renders_as_stiff_a_wall_as_a_slow_one() -> None:
    """Steps of 1 to 2 ms have a new position of the device in every third step, those of 10 to 50 ms in each."""
    case = Params().set({"coupling": "tdpa", "operator": "press", "duration_s": 4.0, "link.up": "", "link.down": ""})
    slow, fast = (
        measure(case.set({"world.step_min_s": least, "world.step_max_s": most}), 0)["stiffness_percent"]
        for least, most in ((0.010, 0.050), (0.001, 0.002))
    )
    assert slow is not None
    assert fast is not None
    assert fast > 0.95 * slow > 60.0


# -- both ends -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [0, 1, 2, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(3, 30))])
def test_two_ports_never_give_more_than_what_their_sides_owe_whatever_happens(seed: int) -> None:
    """Any motion of the hand and of the mass, any clipping, any link, with an account of its own.

    What is owed is bounded by D and the largest work of one held force, at either end. Now and then one end starts
    anew, and leaves its debt unpaid. The new one hears the other before that knows of it, as after a handshake.
    """
    rng = np.random.default_rng([seed, 2010])
    n, D = int(rng.integers(1, 4)), 0.02
    start = (0.0,) * n
    hand, far = device(start), world(start)
    up: list[tuple[int, Port]] = []
    down: list[tuple[int, Port]] = []
    delay, loss = int(rng.integers(1, 300)), rng.uniform(0.0, 0.5)
    x, x_w, held = np.zeros(n), np.zeros(n), np.zeros(n)
    energy = unpaid = 0.0
    renewed: tuple[int, TdpaDevice | TdpaWorld] | None = None
    tick_work = step_work = 0.0
    owed = [0.0, 0.0]
    began, T = 0, int(rng.integers(10, 50))
    frequency, phase = rng.uniform(0.2, 8.0, n), rng.uniform(0.0, 6.3, n)
    for k in range(1, 6001):
        x1 = 0.03 * np.sin(frequency * k * TICK * 6.28 + phase) - 0.03 * np.sin(phase)
        work = float(held @ (x1 - x))
        energy -= work
        tick_work = max(tick_work, abs(work))
        v = (x1 - x) / TICK
        x = x1
        for arriving, law in ((up, far), (down, hand)):
            for at, sample in [item for item in arriving if item[0] <= k]:
                arriving.remove((at, sample))
                if renewed is None or law is not renewed[1]:
                    law.receive(sample)
        force = np.array(hand.force(TICK, tuple(x.tolist()), tuple(v.tolist()), tuple(held.tolist())))
        held = force * min(1.0, 1.0 / max(float(np.linalg.norm(force)), 1e-9))  # clipped to 1 N
        if k % 5 == 0 and rng.random() > loss:
            up.append((k + int(delay * rng.uniform(0.5, 1.5)), told(hand, tuple(x.tolist()))))
        if k == began + T:
            dt = T * TICK
            y = np.array(far.set_position)
            g, p = far.impedance(dt)
            vhat = rng.normal(0.0, 0.05, n) - 0.5 * x_w
            f = np.array(p) - g * vhat
            x_w = x_w + dt * vhat
            step_work = max(step_work, float(np.abs(f) @ np.abs(far._way)))
            far.moved(dt, tuple(vhat.tolist()), tuple(x_w.tolist()), tuple(vhat.tolist()))
            energy -= float(f @ (np.array(far.set_position) - y))
            far.begin()
            if rng.random() > loss:
                down.append((k + int(delay * rng.uniform(0.5, 1.5)), told(far)))
            began, T = k, int(rng.integers(10, 50))
        if k % 1000 == 0 and rng.random() < 0.7:
            up.clear()
            down.clear()
            if rng.random() < 0.6:
                unpaid += max(0.0, far.observer.debt)
                far, began, renewed = world(tuple(x_w.tolist())), k, (k + delay, hand)
            else:
                unpaid += max(0.0, hand.observer.debt)
                hand, held, renewed = device(tuple(x.tolist())), np.zeros(n), (k + delay, far)
        if renewed is not None and k == renewed[0]:
            renewed[1].on_peer_changed()
            renewed = None
        debts = [max(0.0, law.observer.debt) for law in (hand, far)]
        owed = [max(pair) for pair in zip(owed, debts, strict=True)]
        assert energy >= -sum(debts) - unpaid - tick_work - 1e-9  # this tick's work is known to the device at the next
    assert owed[0] <= D + tick_work + 1e-12
    assert owed[1] <= D + step_work + 1e-12


def simulated(
    link: str, operator: str, duration: float, changes: dict[str, object] = NOTHING, *, seed: int = 1
) -> tuple[float, Result]:
    """The least energy put in at both ports [J], and the result."""
    params = Params().set(
        {
            "coupling": "tdpa", "operator": operator, "duration_s": duration, "link.up": link, "link.down": link,
            "record_hz": 100.0, **changes,
        }
    )  # fmt: skip
    run = Simulation(params, seed)
    result = run.run()
    return run.two_port.lowest, result


def assert_claimed(lowest: float, result: Result) -> None:
    """No side owes more than D and the work of one held force, and both ports give no more than what both owe."""
    device_end, world_end = ends = account(result.device), account(result.world)
    for end in ends:
        assert end.most_owed <= Params().tdpa.debt_limit_J + end.most_given
    one_tick = device_end.most_given  # which the device's law knows at the next one
    assert lowest >= -device_end.most_owed - world_end.most_owed - one_tick - 1e-9


class Restarting(Simulation):
    """Either side may end and start anew; the energy put in by all that ever ran is held against what they owe."""

    def __init__(self, params: Params) -> None:
        super().__init__(params, 1)
        self.ended: dict[str, list[Watched]] = {"device": [], "world": []}
        self._put_in_before = 0.0
        self.pair()

    @property
    def running(self) -> dict[str, Watched]:
        return {"device": account(self.device), "world": account(self.world)}

    def restart(self, role: str, incarnation: int) -> None:
        endpoint = self.device_endpoint if role == "device" else self.world_endpoint
        self._put_in_before += endpoint.coupling.ledger.work
        self.ended[role].append(self.running[role])
        if role == "device":
            self.device_port.wire = self.device_endpoint = DeviceEndpoint(device_session(self.setup, incarnation))
            self.device = device_side(self.setup, self.device_endpoint, lambda: self.now_ns, lambda sample: None)
        else:
            rng = np.random.default_rng(incarnation)
            self.world_port.wire = self.world_endpoint = WorldEndpoint(world_session(self.setup, incarnation))
            self.world = world_side(self.setup, self.world_endpoint, rng, lambda sample: None)
        self._due[2:5] = [self.now_ns] * 3  # both sides' timers, and the world's step
        while not (self.device_endpoint.started and self.world_endpoint.started):
            self._run_to(self.now_ns + 1_000_000)

    def go_on(self, seconds: float) -> None:
        for _ in range(round(seconds / 0.01)):
            self._run_to(self.now_ns + 10_000_000)
            put_in = self.device_endpoint.coupling.ledger.work + self.world_endpoint.coupling.ledger.work
            ends = [*self.ended["device"], *self.ended["world"], *self.running.values()]
            owed = sum(max(0.0, end.debt) for end in ends)
            assert self._put_in_before + put_in >= -owed - self.running["device"].most_given - 1e-9

    def total(self, role: str) -> tuple[float, float]:
        """What was granted to all that ever ran in this role, and what they put in [J]."""
        ends = [*self.ended[role], self.running[role]]
        return sum(end.granted for end in ends), sum(end.put_in for end in ends)


RESTARTS = [
    pytest.param(roles, link, id=f"{'-'.join(roles)}-{link}", marks=() if number == other else pytest.mark.slow)
    for number, roles in enumerate((("world",), ("device",), ("world", "device")))
    for other, link in enumerate(("ideal", "4g", "delay 150ms 20ms loss 5%"))
]


@pytest.mark.parametrize(("roles", "link"), RESTARTS)
def test_no_restart_is_granted_what_another_was(roles: tuple[str, ...], link: str) -> None:
    """Six restarts: what was granted at one port, to all together, went in at the other."""
    changes = {"coupling": "tdpa", "device.servo": "sampled", "operator": "sine", "link.up": link, "link.down": link}
    run = Restarting(Params().set(changes))
    for number in range(6):
        run.go_on(1.2)
        run.restart(roles[number % len(roles)], 10 + number)
    run.go_on(1.2)
    for end in [*run.ended["device"], *run.ended["world"], *run.running.values()]:
        assert end.most_owed <= Params().tdpa.debt_limit_J + end.most_given
    (device_granted, device_put_in), (world_granted, world_put_in) = run.total("device"), run.total("world")
    assert 0.0 < world_granted <= device_put_in
    assert 0.0 < device_granted <= world_put_in


def drift_of(result: Result) -> float:
    law: Any = result.world.endpoint.coupling.law  # type: ignore[union-attr]
    assert isinstance(law, TdpaWorld)
    return law.drift[0]


BAD_LINKS = (
    "ideal", "4g", "wan-intercontinental", "delay 350ms", "delay 350ms 40ms loss 10%",
    "delay 100ms 80ms reorder 30% loss 20%",
)  # fmt: skip


@pytest.mark.parametrize("number", range(len(BAD_LINKS)), ids=BAD_LINKS)
def test_both_ports_are_passive_up_to_700_ms_round_trip(number: int) -> None:
    assert_claimed(*simulated(BAD_LINKS[number], ("press", "sine")[number % 2], 5.0))


@pytest.mark.parametrize(("link", "operator"), [("4g", "press"), ("delay 150ms", "sine")])
def test_without_its_controllers_the_same_link_is_not_passive(link: str, operator: str) -> None:
    lowest, _ = simulated(link, operator, 8.0, OFF)
    assert lowest < -0.05


def test_the_position_drifts_by_every_contact_and_more_on_a_slow_link() -> None:
    """The law's known cost: what y does not follow while the energy is still under way is not made up for."""
    alone: dict[str, object] = {"tdpa.recovery_s": 0.0}
    near, far = (drift_of(simulated(link, "press", 4.0, alone)[1]) for link in ("ideal", "delay 350ms"))
    assert 0.002 < near < 0.010
    assert 0.008 < far < 0.020
    recovered = drift_of(simulated("delay 350ms", "press", 4.0)[1])
    assert abs(recovered) < 0.25 * far


# -- the tuning ------------------------------------------------------------------------------------------------------


def test_the_rule_damps_critically_and_what_the_user_gives_overrides_it() -> None:
    tuning = prepare(Params().set({"coupling": "tdpa"})).tuning
    assert tuning.stiffness_N_m == 100.0
    assert tuning.damping_Ns_m == pytest.approx(2.0 * math.sqrt(100.0 * 0.02))
    assert tuning.damping_cap_Ns_m == 5.0
    heavy = prepare(Params().set({"coupling": "tdpa", "world.mass": 2.0, "device.mass": 0.003})).tuning
    assert heavy.damping_Ns_m == 5.0
    assert heavy.damping_cap_Ns_m == pytest.approx(3.0)
    axes = prepare(Params().set({"coupling": "tdpa", "dof": 3, "world.mass": (0.01, 0.03, 0.02)})).tuning
    assert axes.damping_Ns_m == pytest.approx(2.0 * math.sqrt(100.0 * 0.03))
    rotated = ((0.02, 0.01, 0.0), (0.01, 0.02, 0.0), (0.0, 0.0, 0.01))  # 0.03 kg along (1, 1, 0)
    matrix = prepare(Params().set({"coupling": "tdpa", "dof": 3, "world.mass": rotated})).tuning
    assert matrix.damping_Ns_m == pytest.approx(2.0 * math.sqrt(100.0 * 0.03))
    own = prepare(
        Params().set({"coupling": "tdpa", "tdpa.stiffness": 50.0, "tdpa.damping": 1.0, "tdpa.damping_cap": 2.0})
    ).tuning
    assert (own.stiffness_N_m, own.damping_Ns_m, own.damping_cap_Ns_m) == (50.0, 1.0, 2.0)


# -- long ------------------------------------------------------------------------------------------------------------


def forgiving(method: Callable[..., Any]) -> Callable[..., Any]:
    """E_out := E_in after the controller has acted, whatever it really dissipated."""

    def forgiven(self: TdpaDevice | TdpaWorld, *arguments: object) -> object:
        result = method(self, *arguments)
        self.observer.debt = min(0.0, self.observer.debt)
        return result

    return forgiven


@pytest.mark.slow
def test_100_s_do_not_leak_and_forgiven_debts_would(monkeypatch: pytest.MonkeyPatch) -> None:
    kept = [simulated("delay 350ms", "press", duration)[0] for duration in (25.0, 100.0)]
    assert kept[1] > 2.0 * kept[0] - 0.001
    monkeypatch.setattr(tdpa.TdpaDevice, "force", forgiving(tdpa.TdpaDevice.force))
    monkeypatch.setattr(tdpa.TdpaWorld, "moved", forgiving(tdpa.TdpaWorld.moved))
    forgiven = [simulated("delay 350ms", "press", duration)[0] for duration in (25.0, 100.0)]
    assert forgiven[1] < -0.1
    assert forgiven[1] < 2.5 * forgiven[0]


@pytest.mark.slow
@pytest.mark.parametrize("operator", ["press", "sine"])
@pytest.mark.parametrize("link", BAD_LINKS)
def test_long_runs_stay_passive(link: str, operator: str) -> None:
    assert_claimed(*simulated(link, operator, 60.0, seed=2))


@pytest.mark.slow
@pytest.mark.parametrize(
    "more", [(), pytest.param(("--realtime",), marks=pytest.mark.soak)], ids=["thread", "realtime"]
)
def test_over_zenoh(more: tuple[str, ...], tmp_path: Any) -> None:
    words = ("run", "--coupling", "tdpa", "--duration", 3, "--seed", 1, "--json", "-", "--out", tmp_path / "run")
    with started(*words, *more) as program:
        code, stdout, stderr = program.end()
    assert code == 0, stderr
    summary = json.loads(stdout)
    assert summary["coupling"] == "tdpa"
    assert summary["motion"]["contacts"] >= 1
    assert summary["motion"]["peak_force_N"] > 0.1
    assert summary["theorem"]["margin_J"] > 0.0
    assert all(set(summary[side]["dropped"]) <= {"stale", "closed", "unpaired"} for side in ("device", "world"))
