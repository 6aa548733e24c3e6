"""PD over a delay: passive as far as K_d pays for the round trip, and no further."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from hapnet.control.coupling import MotionSample
from hapnet.ext.laws.pd import DevicePD, Gains, WorldPD, round_trip, tuned
from hapnet.params import Params
from hapnet.plant.integrator import PassiveIntegrator
from tests.conftest import mostly_slow
from tests.support.hand_port import LIGHT_HAND, lowest_energies


def test_both_ends_act_as_the_law_says() -> None:
    """-K_v (v - v_peer) - (K_d + P_e) v - K_p (x - x_peer), two axes; the world's at its step's middle."""
    gains = Gains(stiffness=100.0, damping=4.0, coordination=2.0, extra=1.0)
    peer = MotionSample((0.01, 0.0), (0.5, -0.1))
    x, v = (0.03, 0.02), (0.2, 0.1)
    expected = (-2.0 * (0.2 - 0.5) - 5.0 * 0.2 - 100.0 * 0.02, -2.0 * (0.1 + 0.1) - 5.0 * 0.1 - 100.0 * 0.02)
    device = DevicePD(gains, (0.0, 0.0))
    device.receive(peer)
    assert device.force(0.001, x, v, (0.0, 0.0)) == pytest.approx(expected)
    assert device.next_sample(x, v) == MotionSample(x, v)
    world = WorldPD(gains, (0.0, 0.0))
    world.receive(peer)
    world.begin()
    world.moved(0.02, v, x, (9.0, 9.0))
    assert world.next_sample() == MotionSample(x, v)
    drag, push = world.impedance(0.02)
    vhat = (0.3, -0.4)
    middle = [at + 0.01 * speed for at, speed in zip(x, vhat, strict=True)]
    for axis in range(2):
        tau = -2.0 * (vhat[axis] - peer.velocity[axis]) - 5.0 * vhat[axis]
        tau -= 100.0 * (middle[axis] - peer.position[axis])
        assert push[axis] - drag * vhat[axis] == pytest.approx(tau)


def test_at_rest_nothing_pulls_and_a_step_acts_with_what_came_before_it() -> None:
    device, world = DevicePD(Gains(100.0, 5.0), (0.1,)), WorldPD(Gains(100.0, 5.0), (0.1,))
    assert device.force(0.001, (0.1,), (0.0,), (0.0,)) == (0.0,)
    assert world.impedance(0.02)[1] == (0.0,)
    world.receive(MotionSample((0.2,), (0.0,)))
    assert world.impedance(0.02)[1] == (0.0,)
    world.begin()
    assert world.impedance(0.02)[1] == pytest.approx((10.0,))
    assert world.set_position == (0.2,)


def test_another_peer_rests_and_a_release_lets_go() -> None:
    device = DevicePD(Gains(100.0, 5.0, 2.0), (0.0,))
    device.receive(MotionSample((0.1,), (3.0,)))
    device.on_peer_changed()
    assert device.force(0.001, (0.0,), (0.0,), (0.0,)) == pytest.approx((10.0,))
    device.release(0.1, (0.05,), (0.0,))
    assert device.force(0.001, (0.05,), (0.0,), (0.0,)) == (0.0,)


@pytest.mark.parametrize("seed", range(5))
def test_the_worlds_end_is_passive_exactly_for_any_step(seed: int) -> None:
    """With x_peer held, what the mass and its wall give is spring, damper and kinetic energy: no more, no less."""
    rng = np.random.default_rng(seed)
    K_p, K_d, P_e = rng.uniform(0.1, (300.0, 20.0, 3.0)).tolist()
    gains = Gains(K_p, K_d, 0.0, P_e)
    law, peer = WorldPD(gains, (0.0,)), 0.03
    law.receive(MotionSample((peer,), (0.0,)))
    law.begin()
    mass = PassiveIntegrator(0.02, 1.0, 1.0, (0.0,))
    for _ in range(200):
        dt = float(rng.uniform(0.001, 0.1))
        before = 0.5 * gains.stiffness * (mass.position[0] - peer) ** 2 + mass.kinetic_J
        drag, push = law.impedance(dt)
        step = mass.push(dt, drag, push)
        law.moved(dt, step.velocity, step.position, mass.velocity)
        after = 0.5 * gains.stiffness * (mass.position[0] - peer) ** 2 + mass.kinetic_J
        damped = (gains.damping + gains.extra) * step.velocity[0] ** 2 * dt
        assert after + damped == pytest.approx(before, abs=1e-12)


def test_the_rule() -> None:
    """K_d = K_p R/2, and K_p lower where that would be too much to render."""
    assert round_trip(0.1, 0.005, 0.05, 0.001) == pytest.approx(0.156)
    assert tuned(100.0, 0.06, 5.0) == pytest.approx((100.0, 3.0, 0.0, 0.0))
    assert tuned(100.0, 0.2, 5.0) == pytest.approx((50.0, 5.0, 0.0, 0.0))


Trajectory = Callable[[float], float]


class TwoPort:
    """Both ends over a link, their motions given: the energy put in at both ports, summed in steps.

    The device ticks every `tick`, and sends every `period`; the world's steps are drawn from `steps`. A message takes
    `delay`, drawn anew for each, and is lost with probability `loss`; the newest wins.
    """

    def __init__(
        self,
        gains: Gains,
        device: Trajectory,
        world: Trajectory,
        *,
        delay: tuple[float, float],
        steps: tuple[float, float],
        period: float = 0.005,
        tick: float = 0.001,
        loss: float = 0.0,
        seed: int = 0,
    ) -> None:
        self.laws = DevicePD(gains, (device(0.0),)), WorldPD(gains, (world(0.0),))
        self.stored = 0.5 * gains.stiffness * (device(0.0) - world(0.0)) ** 2
        self.laws[0].receive(MotionSample((world(0.0),), (0.0,)))
        self.laws[1].receive(MotionSample((device(0.0),), (0.0,)))
        self._motions = device, world
        self._delay, self._steps, self._period, self._tick, self._loss = delay, steps, period, tick, loss
        self._rng = np.random.default_rng(seed)
        self._in_flight: tuple[list[tuple[float, float, MotionSample]], ...] = [], []
        self._newest = [-1.0, -1.0]
        self.energy = self.lowest = 0.0

    def _send(self, to: int, now: float, sample: object) -> None:
        assert isinstance(sample, MotionSample)
        due = now + float(self._rng.uniform(*self._delay))
        if self._rng.random() >= self._loss:
            self._in_flight[to].append((due, now, sample))

    def _deliver(self, to: int, now: float) -> None:
        for item in sorted(item for item in self._in_flight[to] if item[0] <= now + 1e-12):
            self._in_flight[to].remove(item)
            if item[1] > self._newest[to]:
                self._newest[to] = item[1]
                self.laws[to].receive(item[2])

    def run(self, duration: float) -> None:
        device, world = self.laws
        move, step_to = self._motions
        tick, sends = self._tick, round(self._period / self._tick)
        held = 0.0
        begun, x_world, step = 0.0, step_to(0.0), 0
        world.begin()
        next_step = max(1, round(float(self._rng.uniform(*self._steps)) / tick))
        for n in range(1, round(duration / tick) + 1):
            now, before = n * tick, (n - 1) * tick
            x = move(now)
            self.energy -= held * (x - move(before))
            v = (move(now) - move(now - 1e-6)) / 1e-6
            self._deliver(0, now)
            held = device.force(tick, (x,), (v,), (held,))[0]
            if n % sends == 0:
                self._send(1, now, device.next_sample((x,), (v,)))
            if n >= next_step:
                dt = now - begun
                drag, push = world.impedance(dt)
                to = step_to(now)
                vhat = (to - x_world) / dt
                self.energy -= (push[0] - drag * vhat) * vhat * dt  # the world moves the mass against its coupling
                world.moved(dt, (vhat,), (to,), (vhat,))
                begun, x_world, step = now, to, step + 1
                self._deliver(1, now)
                world.begin()
                self._send(0, now, world.next_sample())
                next_step = n + max(1, round(float(self._rng.uniform(*self._steps)) / tick))
                self.lowest = min(self.lowest, self.energy)


def against(omega: float, amplitude: float = 0.05) -> tuple[Trajectory, Trajectory]:
    """The two sides move against each other: the phase at which equal delays cost the most."""
    return (lambda t: amplitude * (1.0 - math.cos(omega * t))), (lambda t: amplitude * (math.cos(omega * t) - 1.0))


@pytest.mark.parametrize("share", mostly_slow([0.0, 1.0], 1))
@pytest.mark.parametrize("coordination", [0.0, 2.0])
def test_a_cycle_costs_what_the_frequency_response_says(share: float, coordination: float) -> None:
    """Constant delays, nothing held for long: the sides against each other at w with amplitude V of velocity.

    A cycle takes 2 pi/w V^2 (K_d + K_v + K_v cos(w R/2) - K_p sin(w R/2) / w), the delay being R/2 in each direction.
    """
    K, delay, omega, amplitude, T = 100.0, 0.06, 5.0, 0.05, 4e-4
    gains = Gains(K, share * K * delay, coordination)
    cycle = 2.0 * math.pi / omega
    energies = []
    for cycles in (1, 2):
        port = TwoPort(gains, *against(omega, amplitude), delay=(delay, delay), steps=(T, T), period=T, tick=T)
        port.run(cycles * cycle)
        energies.append(port.energy)
    V = omega * amplitude
    turn = omega * delay
    expected = cycle * V * V * (gains.damping + coordination * (1.0 + math.cos(turn)) - K * math.sin(turn) / omega)
    assert energies[1] - energies[0] == pytest.approx(expected, abs=0.03 * cycle * V * V * K * delay)


def slow(seed: int) -> Trajectory:
    """A smooth random motion below 2 Hz, at rest at the start."""
    rng = np.random.default_rng(seed)
    waves = [(float(rng.normal(0.0, 0.02)), float(rng.uniform(0.3, 12.0))) for _ in range(4)]
    return lambda t: sum(a * (1.0 - math.cos(w * t)) for a, w in waves)


@pytest.mark.parametrize("seed", mostly_slow(range(8), 4))
def test_with_the_rules_damping_it_is_passive_for_slow_motions_over_delays_that_vary_below_the_bound(seed: int) -> None:
    """Irregular steps of 10 to 50 ms, sending every 5 ms, delays of 10 to 60 ms that overtake one another."""
    gains = tuned(200.0, round_trip(0.12, 0.005, 0.05, 0.001), 1e9)
    pairs = [(slow(seed), slow(seed + 100)), against(1.0 + seed)]
    for device, world in pairs:
        port = TwoPort(gains, device, world, delay=(0.01, 0.06), steps=(0.01, 0.05), seed=seed)
        port.run(8.0)
        assert port.lowest >= -1e-9
        assert port.energy > 0.0


@pytest.mark.parametrize(
    ("damping", "delay", "loss"),
    [(0.0, 0.05, 0.0), (0.5, 0.05, 0.0), (1.0, 0.4, 0.0), (1.0, 0.05, 0.97)],
    ids=["no damping", "half of it", "a delay beyond the bound", "loss"],
)
def test_where_it_says_nothing_it_is_not(damping: float, delay: float, loss: float) -> None:
    """Tuned for 50 ms in each direction, with this share of the rule's damping."""
    rule = tuned(200.0, round_trip(0.1, 0.005, 0.05, 0.001), 1e9)
    gains = rule._replace(damping=damping * rule.damping)
    port = TwoPort(gains, *against(2.0), delay=(delay, delay), steps=(0.01, 0.05), loss=loss)
    port.run(8.0)
    assert port.lowest < -0.1


@pytest.mark.parametrize("link", ["delay 40ms", "wan-intercontinental", "ideal"])
def test_in_a_light_hand_it_is_passive_at_both_ports(link: str) -> None:
    params = Params().set({**LIGHT_HAND, "coupling": "pd", "link.up": link, "link.down": link})
    hand, _, both = lowest_energies(params, seed=3)
    assert hand >= -1e-9
    assert both >= -1e-9


def test_in_a_light_hand_it_is_not_without_its_damping() -> None:
    params = Params().set({**LIGHT_HAND, "coupling": "pd", "link.up": "delay 40ms", "link.down": "delay 40ms"})
    assert lowest_energies(params.set({"pd.damping": 1e-6}), seed=3)[2] < -1.0
