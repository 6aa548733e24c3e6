"""Both ends of the coupling tdpa together: the claim of its authors on bad links, restarts, and long runs."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from hapnet.assembly.build import device_session, device_side, world_session, world_side
from hapnet.control.coupling import PortSample
from hapnet.ext.laws import tdpa
from hapnet.ext.laws.parts.tdpa_world import TdpaWorld
from hapnet.ext.laws.tdpa import TdpaDevice
from hapnet.params import Params
from hapnet.side.endpoint import DeviceEndpoint, WorldEndpoint
from hapnet.simulation import events
from hapnet.simulation.simulation import Result, Simulation
from tests.conftest import mostly_slow
from tests.support.tdpa_ends import OFF, TICK, Watched, account, device, reported, simulated, watched as watched, world

# -- both ends -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [0, 1, 2, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(3, 30))])
def test_two_ports_never_give_more_than_what_their_sides_owe_whatever_happens(seed: int) -> None:
    """Any motion of the hand and of the mass, any clipping, any link, with an account of its own.

    What is owed is bounded by D and the largest work of one tick's force, at either end. Now and then one end starts
    anew, and leaves its debt unpaid. The new one hears the other before that knows of it, as after a handshake.
    """
    rng = np.random.default_rng([seed, 2010])
    n, D = int(rng.integers(1, 4)), 0.02
    start = (0.0,) * n
    hand, far = device(start), world(start)
    up: list[tuple[int, PortSample]] = []
    down: list[tuple[int, PortSample]] = []
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
            up.append((k + int(delay * rng.uniform(0.5, 1.5)), reported(hand, tuple(x.tolist()))))
        if k == began + T:
            dt = T * TICK
            y = np.array(far.set_position)
            g, p = far.impedance(dt)
            vhat = rng.normal(0.0, 0.05, n) - 0.5 * x_w
            f = np.array(p) - g * vhat
            x_w = x_w + dt * vhat
            step_work = max(step_work, float(np.abs(f) @ np.abs(far.commanded)))
            far.moved(dt, tuple(vhat.tolist()), tuple(x_w.tolist()), tuple(vhat.tolist()))
            energy -= float(f @ (np.array(far.set_position) - y))
            far.begin()
            if rng.random() > loss:
                down.append((k + int(delay * rng.uniform(0.5, 1.5)), reported(far)))
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


def assert_claimed(lowest: float, result: Result) -> None:
    """No side owes more than D and the work of one tick's force, and both ports give no more than what both owe."""
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
            self.clock.due[events.TICK] = self.clock.tick_ns  # no tick waits for a device that has ended
        else:
            rng = np.random.default_rng(incarnation)
            self.world_port.wire = self.world_endpoint = WorldEndpoint(world_session(self.setup, incarnation))
            self.world = world_side(self.setup, self.world_endpoint, rng, lambda sample: None)
        self.clock.due[events.DEVICE_TIMER : events.STEP + 1] = [self.now_ns] * 3  # and the world's timer
        while not (self.device_endpoint.started and self.world_endpoint.started):
            self._until(self.now_ns + 1_000_000)

    def go_on(self, seconds: float) -> None:
        for _ in range(round(seconds / 0.01)):
            self._until(self.now_ns + 10_000_000)
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
    return law.drift[0]


BAD_LINKS = (
    "ideal", "4g", "wan-intercontinental", "delay 350ms", "delay 350ms 40ms loss 10%",
    "delay 100ms 80ms reorder 30% loss 20%",
)  # fmt: skip


@pytest.mark.parametrize("number", mostly_slow(range(len(BAD_LINKS)), 2), ids=BAD_LINKS)
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


# -- long ------------------------------------------------------------------------------------------------------------


def forgiving(method: Callable[..., Any]) -> Callable[..., Any]:
    """E_out := E_in after the controller has acted, whatever it really dissipated."""

    def forgiven(self: TdpaDevice | TdpaWorld, *arguments: object) -> object:
        result = method(self, *arguments)
        self.observer.debt = min(0.0, self.observer.debt)
        return result

    return forgiven


@pytest.mark.parametrize("seconds", mostly_slow([40.0, 100.0], 0, 1))
def test_long_runs_do_not_leak_and_forgiven_debts_would(seconds: float, monkeypatch: pytest.MonkeyPatch) -> None:
    kept = [simulated("delay 350ms", "press", duration)[0] for duration in (0.25 * seconds, seconds)]
    assert kept[1] > 2.0 * kept[0] - 0.001
    monkeypatch.setattr(tdpa.TdpaDevice, "force", forgiving(tdpa.TdpaDevice.force))
    monkeypatch.setattr(TdpaWorld, "moved", forgiving(TdpaWorld.moved))
    forgiven = [simulated("delay 350ms", "press", duration)[0] for duration in (0.25 * seconds, seconds)]
    assert forgiven[1] < -0.001 * seconds
    assert forgiven[1] < 2.5 * forgiven[0]


@pytest.mark.parametrize("operator", mostly_slow(["press", "sine"], 0, 1))
@pytest.mark.parametrize("link", BAD_LINKS)
def test_long_runs_stay_passive(link: str, operator: str) -> None:
    assert_claimed(*simulated(link, operator, 30.0, seed=2))
