"""The two terminations of a wave line."""

from math import sqrt

import numpy as np
import pytest
from hypothesis import given, strategies as st

from hapnet.control.coupling import WaveSample
from hapnet.ext.laws.digital_wave import Replay
from hapnet.ext.laws.parts.wave_integral import WaveReceiver
from hapnet.ext.laws.parts.wave_port import WaveDevice, WaveWorld
from hapnet.ext.laws.wave import DelayLine
from tests.support.wave_ports import TICK, put_in

number = st.floats(-3.0, 3.0)
impedance = st.floats(0.5, 20.0)
step = st.floats(0.001, 0.05)


class Constant:
    """A line that always gives the same."""

    def __init__(self, *wave: float) -> None:
        self.wave = wave

    def push(self, wave: WaveSample) -> None:
        raise AssertionError("nothing is sent here")

    def take(self, dt: float) -> tuple[float, ...]:
        return self.wave

    def clear(self) -> None:
        pass


@given(v=number, wave=number, b=impedance)
def test_at_constant_velocity_the_device_scatters_as_defined(v: float, wave: float, b: float) -> None:
    device = WaveDevice(b, (0.0,), Constant(wave))
    held = device.force(TICK, (0.0,), (v,), (0.0,))
    device.next_sample((0.0,), (v,))
    for tick in range(1, 6):
        f = -held[0]
        assert (b * v - f) / sqrt(2.0 * b) == pytest.approx(wave, abs=1e-12)
        held = device.force(TICK, (v * tick * TICK,), (v,), held)
    u, span, *_ = device.next_sample((0.0,), (v,))
    assert span == pytest.approx(5 * TICK)
    assert u[0] == pytest.approx((b * v + f) / sqrt(2.0 * b), abs=1e-9)
    assert (u[0] ** 2 - wave**2) / 2.0 == pytest.approx(f * v, abs=1e-8)


@given(us=st.lists(st.tuples(number, number, step), min_size=1, max_size=10), b=impedance, B=impedance)
@pytest.mark.long
def test_the_world_conserves_energy_exactly(us: list[tuple[float, float, float]], b: float, B: float) -> None:
    """Wave power in is the change of the spring's energy, the damper's loss and what the mass gets."""
    K = 700.0
    line = Constant(0.0)
    world = WaveWorld(b, K, B, (0.1,), line)
    x, y = 0.1, 0.1
    for u, vhat, T in us:
        line.wave = (u,)
        drag, push = world.impedance(T)
        force = push[0] - drag * vhat
        world.moved(T, (vhat,), (x + vhat * T,), (vhat,))
        vy = (world.set_position[0] - y) / T
        before, after = 0.5 * K * (y - x) ** 2, 0.5 * K * (y + vy * T - x - vhat * T) ** 2
        x, y = x + vhat * T, y + vy * T
        value, span, *_ = world.next_sample()
        scale = 1.0 + abs(u) + abs(value[0])
        assert span == T
        assert (u**2 - value[0] ** 2) / 2.0 * T == pytest.approx(
            after - before + B * (vy - vhat) ** 2 * T + force * vhat * T, abs=1e-10 * scale**2
        )
        assert (u + value[0]) / sqrt(2.0 * b) == pytest.approx(vy, abs=1e-9 * scale)


@given(u=number, e=st.floats(-0.05, 0.05), v0=number, f=number, T=step, b=impedance)
def test_drag_and_push_solve_the_node_and_the_mass_together(
    u: float, e: float, v0: float, f: float, T: float, b: float
) -> None:
    """Against one dense system: the node, the coupling at the step's middle, and the mass."""
    K, B, M = 500.0, 6.0, 0.02
    line = Constant(0.0)
    world = WaveWorld(b, K, B, (0.0,), line)
    world.impedance(1.0)
    world.moved(1.0, (0.0,), (-e,), (0.0,))  # the mass is carried away while the node hardly moves
    e = world.set_position[0] + e
    line.wave = (u,)
    drag, push = world.impedance(T)
    vhat = (2.0 * M / T * v0 + push[0] + f) / (2.0 * M / T + drag)
    a = B + K * T / 2.0  # unknowns: vy, f_c, vhat
    system = np.array([[b, 1.0, 0.0], [-a, 1.0, a], [0.0, -1.0, 2.0 * M / T]])
    vy, coupling, expected = np.linalg.solve(system, [sqrt(2.0 * b) * u, K * e, 2.0 * M / T * v0 + f])
    assert vhat == pytest.approx(expected, abs=1e-9 * (1.0 + abs(expected)))
    assert push[0] - drag * vhat == pytest.approx(coupling, abs=1e-8 * (1.0 + abs(coupling)))
    before = world.set_position[0]
    world.moved(T, (vhat,), (0.0,), (vhat,))
    assert (world.set_position[0] - before) / T == pytest.approx(vy, abs=1e-8 * (1.0 + abs(vy)))


def test_sign_a_hand_that_presses_on_a_wall_puts_energy_in() -> None:
    """The mass stands still, as in a rigid wall: the force opposes the hand and grows to the series stiffness."""
    device = WaveDevice(5.0, (0.0,), DelayLine(1, 1.0))
    world = WaveWorld(5.0, 500.0, 5.0, (0.0,), DelayLine(1, 1.0))
    x, v, held, work = 0.0, 0.02, 0.0, 0.0
    for tick in range(1, 3001):
        v = 0.02 if tick <= 500 else 0.0
        x += v * TICK
        work -= held * v * TICK
        held = device.force(TICK, (x,), (v,), (held,))[0]
        if tick > 200:
            assert held < 0.0
        if tick % 5 == 0:
            world.receive(device.next_sample((x,), (v,)))
        if tick % 20 == 0:
            world.impedance(0.02)
            world.moved(0.02, (0.0,), (0.0,), (0.0,))
            device.receive(world.next_sample())
    assert work > 1e-3
    round_trip = 0.021  # the world acts with what was sent in its step; the device a step later, and holds for a tick
    assert -held / x == pytest.approx(1.0 / (round_trip / 2.0 / 5.0 + 1.0 / 500.0), rel=0.01)


@pytest.mark.parametrize("limit", [0.2, 3.3])
@pytest.mark.long
def test_what_is_sent_is_paid_for_by_what_was_really_held_and_done(limit: float) -> None:
    """The account at every sending, forces clipped and released, ticks irregular: in at the port and from the line."""
    rng = np.random.default_rng(4)
    line = Constant(0.0)
    device = WaveDevice(5.0, (0.0,), line)
    x = held = came = rendered = 0.0
    for tick in range(1, 20_001):
        v = 0.2 * np.sin(tick / 150.0) + 0.05 * np.sin(tick / 7.0)
        dt = float(rng.uniform(0.0005, 0.0015))
        x += v * dt
        came += rendered - held * v * dt
        line.wave = (float(rng.normal()) * 0.3,)
        if tick % 97 == 0:
            device.release(dt, (x,), (held,))
            held = rendered = 0.0
        else:
            held = max(-limit, min(limit, device.force(dt, (x,), (v,), (held,))[0]))
            rendered = line.wave[0] ** 2 / 2.0 * dt  # a wave taken counts once the tick that renders it is over
        if tick % 5 == 0:
            (u,), span, *_ = device.next_sample((x,), (v,))
            came -= u**2 / 2.0 * span
            assert device.energies[0] == pytest.approx(came, abs=1e-9)
            assert came >= -1e-12 or u == 0.0


def test_displacement_that_a_clipped_force_did_not_pay_for_is_sent_later() -> None:
    """A mass dragged through honey by more than the actuator can feel is left behind, and follows in the end."""
    device = WaveDevice(5.0, (0.0,), DelayLine(1, 1.0))
    world = WaveWorld(5.0, 500.0, 5.0, (0.0,), DelayLine(1, 1.0))
    x = y = held = behind = 0.0
    for tick in range(1, 10_001):
        v = 0.3 * np.sin(tick / 100.0) if tick <= 2000 else 0.01 * np.sin(tick / 300.0)
        x += v * TICK
        held = max(-0.1, min(0.1, device.force(TICK, (x,), (v,), (held,))[0]))
        if tick % 5 == 0:
            world.receive(device.next_sample((x,), (v,)))
        if tick % 20 == 0:
            drag, push = world.impedance(0.02)
            vhat = push[0] / (drag + 10.0)
            y += vhat * 0.02
            world.moved(0.02, (vhat,), (y,), (vhat,))
            device.receive(world.next_sample())
        behind = max(behind, abs(x - y))
    assert behind > 0.02
    assert y == pytest.approx(x, abs=1e-3)


@pytest.mark.parametrize("line", [lambda: DelayLine(1, 0.3), lambda: Replay(1, 0.08)])
@pytest.mark.parametrize("time", [0.002, 0.01])
def test_what_the_hold_leaks_is_a_debt_that_is_carried(time: float, line: type[WaveReceiver]) -> None:
    """Ports that jerk within a tick, forces clipped, released: both together never put in less than the debt shows."""
    for seed in range(3):
        result = put_in(line(), line(), seed, time=time, seconds=2.0, released=0.02, force_limit=1.0)
        assert result.lowest >= result.debt - 1e-12
        assert result.debt > -1e-3


def test_axes_are_lines_of_their_own() -> None:
    def run(*axes: int) -> tuple[list[tuple[float, ...]], tuple[float, ...]]:
        n = len(axes)
        device = WaveDevice(5.0, (0.0,) * n, DelayLine(n, 1.0))
        world = WaveWorld(5.0, 500.0, 5.0, (0.0,) * n, DelayLine(n, 1.0))
        x = np.zeros(n)
        held: tuple[float, ...] = (0.0,) * n
        forces = []
        for tick in range(1, 500):
            v = np.array([0.1 * np.sin(tick / (20.0 + 30.0 * axis)) for axis in axes])
            x += v * TICK
            held = device.force(TICK, tuple(x.tolist()), tuple(v.tolist()), held)
            forces.append(held)
            if tick % 5 == 0:
                world.receive(device.next_sample(tuple(x), tuple(v)))
            if tick % 20 == 0:
                world.impedance(0.02)
                world.moved(0.02, (0.0,) * n, (0.0,) * n, (0.0,) * n)
                device.receive(world.next_sample())
        return forces, world.set_position

    both, y = run(0, 1)
    for axis in range(2):
        one, y_one = run(axis)
        assert [force[axis] for force in both] == pytest.approx([force[0] for force in one], abs=1e-15)
        assert y[axis] == pytest.approx(y_one[0], abs=1e-15)


def test_a_wave_is_sent_once_and_another_peer_begins_with_silence() -> None:
    world = WaveWorld(5.0, 500.0, 5.0, (0.0,), DelayLine(1, 1.0))
    world.receive(WaveSample((1.0,), 0.02))
    world.impedance(0.02)
    world.moved(0.02, (0.0,), (0.0,), (0.0,))
    assert world.next_sample().value != (0.0,)
    assert world.next_sample().value == (0.0,)  # a paused world
    world.receive(WaveSample((1.0,), 0.02))
    world.on_peer_changed()
    place = world.set_position
    world.impedance(0.02)
    assert world.set_position == place
    device = WaveDevice(5.0, (0.0,), DelayLine(1, 1.0))
    device.receive(WaveSample((1.0,), 0.02))
    device.on_peer_changed()
    assert device.force(TICK, (0.0,), (0.0,), (0.0,)) == (0.0,)
    assert device.next_sample((0.0,), (0.0,)).value == (0.0,)
