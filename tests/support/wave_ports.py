"""A wave line between two ports whose motions are given: what both ports put in, over any link."""

import heapq
from typing import NamedTuple

import numpy as np

from hapnet.control.coupling import WaveSample
from hapnet.ext.laws.parts.wave_integral import WaveReceiver
from hapnet.ext.laws.parts.wave_port import WaveDevice, WaveWorld

TICK = 1e-3


class PutIn(NamedTuple):
    """Energies [J]."""

    lowest: float
    """The least that both ports together had put in at any time."""
    last: float
    debt: float
    """The most that the hold had leaked and that was not paid back yet."""


def wander(rng: np.random.Generator, ticks: int, time: float, speed: float = 0.1) -> list[float]:
    """Velocities at every tick [m/s]: from rest, of this typical size, changing over `time` seconds."""
    keep = np.exp(-TICK / time)
    v = rng.normal(size=ticks)
    for _ in range(2):  # smoothed twice, so that no velocity jumps
        v[0] = 0.0
        for i in range(1, ticks):
            v[i] = keep * v[i - 1] + (1.0 - keep) * v[i]
    return (v * speed / v.std()).tolist()


def reported(waves: list[WaveSample]) -> list[WaveSample]:
    """These waves with their integrals, as their receiver gets them."""
    total = total_s = 0.0
    found = []
    for wave in waves:
        total += wave.value[0] * wave.span
        total_s += wave.span
        found.append(wave._replace(total=(total,), total_s=total_s))
    return found


def put_in(
    device_line: WaveReceiver,
    world_line: WaveReceiver,
    seed: int,
    *,
    delay: int = 40,
    jitter: int = 0,
    loss: float = 0.0,
    time: float = 0.05,
    seconds: float = 5.0,
    force_limit: float = 3.3,
    released: float = 0.0,
) -> PutIn:
    """Both ports move at random. `delay` and `jitter` in ms; `loss`, `released`: chances a message or tick."""
    rng = np.random.default_rng(seed)
    device = WaveDevice(5.0, (0.0,), device_line)
    world = WaveWorld(5.0, 500.0, 5.0, (0.0,), world_line)
    ticks = round(seconds / TICK)
    hand, mass = wander(rng, ticks, time), wander(rng, ticks, time)
    up: list[tuple[int, int, WaveSample]] = []
    down: list[tuple[int, int, WaveSample]] = []
    number = 0

    sent = {id(up): WaveSample((0.0,), 0.0, (0.0,), 0.0), id(down): WaveSample((0.0,), 0.0, (0.0,), 0.0)}

    def send(way: list[tuple[int, int, WaveSample]], now: int, wave: WaveSample) -> None:
        nonlocal number
        number += 1
        last = sent[id(way)]
        total = last.total[0] + wave.value[0] * wave.span
        wave = sent[id(way)] = wave._replace(total=(total,), total_s=last.total_s + wave.span)
        if rng.random() >= loss:
            heapq.heappush(way, (now + delay + int(rng.integers(-jitter, jitter + 1)), number, wave))

    work = lowest = debt = x = y = held = 0.0
    began, ends = 0, int(rng.integers(10, 51))
    latched: list[WaveSample] = []
    for now in range(1, ticks):
        while up and up[0][0] <= now:
            latched.append(heapq.heappop(up)[2])
        if now == ends:
            dt, vhat = (now - began) * TICK, mass[now]
            drag, push = world.impedance(dt)
            work -= (push[0] - drag * vhat) * vhat * dt  # what moves the mass works against the coupling
            y += vhat * dt
            world.moved(dt, (vhat,), (y,), (vhat,))
            for wave in latched:
                world.receive(wave)
            latched.clear()
            world.begin()
            send(down, now, world.next_sample())
            began, ends = now, now + int(rng.integers(10, 51))
        while down and down[0][0] <= now:
            device.receive(heapq.heappop(down)[2])
        x += hand[now] * TICK
        work -= held * hand[now] * TICK
        if rng.random() < released:
            device.release(TICK, (x,), (held,))
            held = 0.0
        else:
            force = device.force(TICK, (x,), (hand[now],), (held,))[0]
            held = max(-force_limit, min(force_limit, force))
        if now % 5 == 0:
            send(up, now, device.next_sample((x,), (hand[now],)))
        lowest, debt = min(lowest, work), min(debt, device.energies[0])
    return PutIn(lowest, work, debt)


class Counted:
    """A line with one axis and its account: the energy and the displacement that came and went."""

    def __init__(self, line: WaveReceiver) -> None:
        self._line = line
        self.came = self.went = 0.0
        self.spare = 0.0
        """The least by which what came was above what went, at any time [J]."""
        self.moved_in = self.moved_out = 0.0

    def push(self, wave: WaveSample) -> None:
        self._line.push(wave)
        self.came += wave.value[0] ** 2 * wave.span / 2.0
        self.moved_in += wave.value[0] * wave.span

    def take(self, dt: float) -> tuple[float, ...]:
        value = self._line.take(dt)
        self.went += value[0] ** 2 * dt / 2.0
        self.moved_out += value[0] * dt
        self.spare = min(self.spare, self.came - self.went)
        return value

    def clear(self) -> None:
        self._line.clear()


def shake(line: Counted, seed: int, *, seconds: float = 20.0, loss: float = 0.0, jitter: float = 0.0) -> None:
    """Waves of irregular spans come, some late and in bursts, some never; slots of irregular lengths take them."""
    rng = np.random.default_rng(seed)
    now = sent = 0.0
    under_way: list[tuple[float, WaveSample]] = []
    while now < seconds:
        slot = float(rng.choice([0.001, 0.005, rng.uniform(0.01, 0.05)]))
        now += slot
        while sent < now:
            span = float(rng.uniform(0.001, 0.05))
            sent += span
            if rng.random() >= loss:
                wave = WaveSample((float(rng.normal() + 2.0 * np.sin(sent)),), span)
                heapq.heappush(under_way, (sent + float(rng.uniform(0.0, jitter)), wave))
        while under_way and under_way[0][0] <= now:
            line.push(heapq.heappop(under_way)[1])
        line.take(slot)
