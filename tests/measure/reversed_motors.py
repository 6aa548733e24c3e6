"""A motor whose sign flips at a random moment of a run, in virtual time: how soon it is named, after how many mm.

``python -m tests.measure reversed_motors`` counts 40 flips and 80 honest devices, from seed 1000 on, each
with an exact encoder and with one of 20 um. Hands are soft or firm, slow or fast, of one mass or two; the set-position
is at a wall, with the hand, or rests.

A flip shows nowhere before there is a force. So the time counts from the first tick after the flip in which `SHOWS_N`
are asked for, and the distance from where the handle then is. Where a hand moves by itself, only what the handle moved
farther than its twin counts, whose motor has no force from that tick on: that is what a perfect watch would do.
"""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import numpy as np

from hapnet.assembly.build import device_session, device_side, prepare
from hapnet.checks import Vector
from hapnet.errors import HapnetError
from hapnet.params import Params
from hapnet.side.endpoint import DeviceEndpoint
from hapnet.side.real_device import RealDeviceSide

MS = 1_000_000
SHOWS_N = 0.25
AFTER_MS = 1200
NEVER_NS = 1 << 62
ENCODERS_M = 0.0, 2e-5
WITHIN_S, WITHIN_M = 0.5, 0.01
SCENES = ("wall", "free", "place")
HANDS = ("soft", "firm", "two masses")
PACES = ("slow", "fast")


class Held:
    """A handle in a hand that follows a sine; from `flips_ns` on its motor pushes the other way."""

    force_limit, resolution = 3.0, 0.0
    now_ns, seed, flips_ns, ends_ns, encoder_m = 0, 0, NEVER_NS, NEVER_NS, 0.0

    def __init__(self, dof: int) -> None:
        rng = np.random.default_rng(Held.seed)
        self.dof, self.resolution = dof, Held.encoder_m
        self.hand = HANDS[Held.seed % len(HANDS)]
        self.pace = PACES[Held.seed // len(HANDS) % len(PACES)]
        self.x = self.v = self.force = self.asked = 0.0
        self.hand_x = self.hand_v = 0.0
        self.mass = float(rng.uniform(0.06, 0.2))
        self.stiffness = float(rng.uniform(20.0, 80.0) if self.hand == "soft" else rng.uniform(80.0, 400.0))
        self.damping = float(rng.uniform(2.0, 8.0))
        self.grip, self.grip_damping, self.hand_mass = rng.uniform([400.0, 3.0, 0.2], [1500.0, 10.0, 0.6])
        slow = self.pace == "slow"
        self.hertz = float(rng.uniform(0.05, 0.3) if slow else rng.uniform(0.6, 1.8))
        self.amplitude = float(rng.uniform(0.005, 0.02) if slow else rng.uniform(0.015, 0.05))
        self.tremor_N = float(rng.choice([0.0, 0.02, 0.1]))
        self._at_ns, self._begun_ns = Held.now_ns, -1
        self.gave_out_J = self.most_J = 0.0

    def begin(self) -> None:
        self._begun_ns = Held.now_ns

    def read(self) -> tuple[Vector, Vector]:
        dt, self._at_ns = (Held.now_ns - self._at_ns) * 1e-9, Held.now_ns
        if self._begun_ns >= 0:
            flipped = Held.now_ns > Held.flips_ns
            for _ in range(4):
                self._move(dt / 4, -self.force if flipped else self.force, flipped)
        read = round(self.x / Held.encoder_m) * Held.encoder_m if Held.encoder_m else self.x
        return (read,), (self.v,)

    def _move(self, dt: float, motor_N: float, flipped: bool) -> None:
        t = (self._at_ns - self._begun_ns) * 1e-9
        turn = 2.0 * math.pi * self.hertz
        goal = 0.02 * min(1.0, t) + self.amplitude * math.sin(turn * t)
        speed = self.amplitude * turn * math.cos(turn * t)
        tremor = self.tremor_N * math.sin(2.0 * math.pi * 9.0 * t)
        two = self.hand == "two masses"
        x, v = (self.hand_x, self.hand_v) if two else (self.x, self.v)
        hand_N = self.stiffness * (goal - x) + self.damping * (speed - v) + tremor
        if two:
            grip_N = self.grip * (self.hand_x - self.x) + self.grip_damping * (self.hand_v - self.v)
            self.hand_v += dt * (hand_N - grip_N) / self.hand_mass
            self.hand_x += dt * self.hand_v
            hand_N = grip_N
        self.v += dt * (motor_N + hand_N - 0.2 * self.v) / self.mass
        self.x += dt * self.v
        if flipped:
            self.gave_out_J += motor_N * self.v * dt
            self.most_J = max(self.most_J, self.gave_out_J)

    def apply(self, force: Vector) -> None:
        self.asked = force[0]
        self.force = 0.0 if Held.now_ns >= Held.ends_ns else force[0]


class Run(NamedTuple):
    """Where the handle was and the force that was asked for, each ms; what stopped it, and in how many ticks the force
    was probed [%]."""

    x: list[float]
    force: list[float]
    said: str
    probed: float
    held: Held
    scene: str
    flip_ms: int


class Found(NamedTuple):
    """A run whose motor flipped: for how long a force had shown [s], None: none did; how far the handle went since [m],
    with and without its hand's own way."""

    run: Run
    shown_s: float | None
    plain_m: float
    far_m: float

    @property
    def in_time(self) -> bool:
        return bool(self.run.said) and (self.shown_s or 0.0) <= WITHIN_S and self.far_m <= WITHIN_M


def run(seed: int, encoder_m: float, *, flips: bool, ends_ms: int | None = None) -> Run:
    """flips : its motor does. ends_ms : when it has no force any more instead."""
    rng = np.random.default_rng([seed, 1])
    flip_ms = int(rng.integers(1500, 2500))
    Held.seed, Held.now_ns, Held.encoder_m = seed, 0, encoder_m
    Held.flips_ns = flip_ms * MS if flips else NEVER_NS
    Held.ends_ns = NEVER_NS if ends_ms is None else ends_ms * MS
    scene = SCENES[seed // (len(HANDS) * len(PACES)) % len(SCENES)]
    setup = prepare(Params().set({"hardware": f"{Held.__module__}:Held", "scene": "free", "dof": 1}))
    side = device_side(setup, DeviceEndpoint(device_session(setup, 1)), lambda: Held.now_ns, lambda sample: None)
    assert isinstance(side, RealDeviceSide)
    held: Held = side.device.device  # type: ignore[attr-defined]  # the user's, inside
    side.endpoint.pair(False)
    wall, delay = float(rng.uniform(0.005, 0.03)), int(rng.integers(10, 80))
    x, force = list[float](), list[float]()
    next_ms = probed = 0
    said = ""
    for now_ms in range(1, flip_ms + AFTER_MS):
        Held.now_ns = now_ms * MS
        try:
            side.tick(Held.now_ns)
        except HapnetError as error:
            said = str(error)
        x.append(held.x)
        force.append(held.asked)
        probed += side._checks.share < 1.0
        if side.stopped is not None:
            said = side.stopped.why
        if said:
            break
        if side.origin_ns is not None and now_ms >= next_ms:
            next_ms = now_ms + int(rng.integers(10, 40))
            was = x[-delay] if len(x) >= delay else x[0]
            y = {"wall": min(was, wall), "free": was, "place": wall if now_ms > 1500 else was}[scene]
            side.coupling.receive((y,), Held.now_ns * 1e-9, 1e-3 * delay)
    return Run(x, force, said, 100.0 * probed / len(x), held, scene, flip_ms)


def flipped(seed: int, encoder_m: float) -> Found:
    found = run(seed, encoder_m, flips=True)
    x, flip_ms = found.x, found.flip_ms
    shown = next((k for k in range(flip_ms, len(x)) if abs(found.force[k]) >= SHOWS_N), None)
    if shown is None:
        return Found(found, None, 0.0, 0.0)
    plain = [abs(one - x[shown]) for one in x[shown:]]
    far = plain
    if max(plain) > WITHIN_M:
        twin = run(seed, encoder_m, flips=False, ends_ms=shown + 1)
        far = [min(abs(one - other), all_) for one, other, all_ in zip(x[shown:], twin.x[shown:], plain, strict=False)]
    return Found(found, 1e-3 * (len(x) - shown), max(plain), max(far))


def count_flips(flips: int, first: int, encoder_m: float) -> None:
    found: list[tuple[int, Found]] = []
    unseen: list[float] = []
    for seed in itertools.count(first):
        one = flipped(seed, encoder_m)
        if one.shown_s is None and not one.run.said:
            unseen.append(1e3 * one.run.held.most_J)
        else:
            found.append((seed, one))
        if len(found) == flips:
            break
    times = [one.shown_s or 0.0 for _, one in found if one.run.said]
    print(
        f"encoder {1e6 * encoder_m:g} um: {flips} flips that show: {len(times)} named, "
        f"{sum(one.in_time for _, one in found)} within {WITHIN_S} s and {1e3 * WITHIN_M:g} mm "
        f"({sum(one.in_time and one.plain_m <= WITHIN_M for _, one in found)} with the hand's own way); "
        f"{np.median(times):.3f} s in the median, at most {max(times):.3f} s, "
        f"{1e3 * max(one.far_m for _, one in found):.1f} mm, "
        f"{1e3 * max(one.run.held.most_J for _, one in found):.1f} mJ; "
        f"{len(unseen)} more had less than {SHOWS_N} N, and gave out {max(unseen, default=0.0):.1f} mJ at most"
    )
    for seed, one in found:
        if not one.in_time:
            held = one.run.held
            print(
                f"   {seed} {one.run.scene} {held.hand} {held.pace}: {one.run.said[-40:] or 'not named'}; "
                f"{one.shown_s} s, {1e3 * one.far_m:.1f} mm ({1e3 * one.plain_m:.1f}), {1e3 * held.most_J:.1f} mJ; "
                f"{held.mass:.2f} kg, {held.stiffness:.0f} N/m, {held.damping:.1f} Ns/m"
            )


def count_honest(honest: int, first: int, encoder_m: float) -> None:
    fine = [(seed, run(seed, encoder_m, flips=False)) for seed in range(first, first + honest)]
    accused = [(seed, one.said) for seed, one in fine if one.said]
    print(
        f"encoder {1e6 * encoder_m:g} um: {honest} honest, {len(accused)} accused {accused or ''}; the force was "
        f"probed in {np.mean([one.probed for _, one in fine]):.1f} % of the ticks, at most "
        f"{max(one.probed for _, one in fine):.1f} %"
    )


def main(flips: int = 40, honest: int = 80, first: int = 1000) -> None:
    for encoder_m in ENCODERS_M:
        count_flips(flips, first, encoder_m)
        count_honest(honest, first + 500, encoder_m)
