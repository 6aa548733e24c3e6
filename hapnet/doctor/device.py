"""What a device really does: how fast it answers, how it reads when it rests, and what a force does to its handle.

The force is zero unless it is asked for: a ramp, with a hand on the handle, or pushes, with none, which show the
device's own damping (`own_damping`). Clock and sleep are arguments.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np

from hapnet.assembly.user_device import UserDevice
from hapnet.checks import Vector
from hapnet.doctor.machine import OK, SKIPPED, WARNING, Check
from hapnet.doctor.own_damping import NAME, own_damping
from hapnet.errors import DeviceSilent, HapnetError

NANO = 1e-9
_PAGE = Path(__file__).parents[1] / "devices" / "README.md"
"""Which watchdog the hardware needs. Pages beside the code are part of the package."""
READINGS = 2000
RAMP_S, RAMPS = 1.0, 3
_WINDOW = 50
_REST_SPEED = 0.01
"""Slower than this the handle rests [m/s]."""


class Readings:
    """A device read `count` times at its own rate, with no force on it.

    clock : a monotonic clock [ns]. sleep : sleeps a number of seconds.
    """

    def __init__(
        self,
        device: UserDevice,
        rate_hz: float,
        clock: Callable[[], int],
        sleep: Callable[[float], None],
        count: int = READINGS,
    ) -> None:
        blocking = bool(getattr(device.device, "blocking", False))
        self.at_ns: list[int] = []
        self.took_ns: list[int] = []
        self.positions: list[Vector] = []
        self.velocities: list[Vector] = []
        self.missed: int = 0
        due_ns = clock()
        for _ in range(count):
            if not blocking:
                due_ns += round(1.0 / rate_hz / NANO)
                sleep(max(0.0, (due_ns - clock()) * NANO))
            before_ns = clock()
            try:
                x, v = device.read()
                device.apply((0.0,) * device.dof)
            except DeviceSilent:
                self.missed += 1
                continue
            self.at_ns.append(clock())
            self.took_ns.append(self.at_ns[-1] - before_ns)
            self.positions.append(x)
            self.velocities.append(v)


def examine_device(
    device: UserDevice,
    rate_hz: float,
    clock: Callable[[], int],
    sleep: Callable[[float], None],
    ramp_N: float = 0.0,
    damping_N: float = 0.0,
) -> Iterator[Check]:
    """Yields a line for each thing that was measured.

    ramp_N : press the hand with up to this force; damping_N : push the free handle with it; 0: do not.

    Raises
    ------
    HapnetError : the device fails.
    """
    found = Readings(device, rate_hz, clock, sleep)
    if len(found.at_ns) < 3:
        raise HapnetError(f"the device {device.name} gave {len(found.at_ns)} readings of {READINGS}")
    yield _rate(found, rate_hz)
    took = sorted(found.took_ns)
    p50, p99 = (took[round(share * (len(took) - 1))] * 1e-3 for share in (0.5, 0.99))
    yield Check("reading and command", OK, f"{p50:.0f} us, p99 {p99:.0f} us")
    yield _resolution(found, device.resolution)
    yield _noise(found)
    yield _velocity(found)
    if device.watchdog_s is None:
        advice = f"the hardware must take the force away by itself: see {_PAGE}"
        yield Check("watchdog", WARNING, "none declared", advice)
    else:
        yield Check("watchdog", OK, f"{device.watchdog_s * 1e3:g} ms, declared")
    buttons = device.buttons()
    shown = " ".join("pressed" if pressed else "released" for pressed in buttons) or "none"
    if (switch := device.dead_man) is None:
        yield Check("buttons", OK, shown)
    else:
        held = switch < len(buttons) and buttons[switch]
        advice = "" if held else "hold it: without it there is no force"
        yield Check("buttons", OK if held else WARNING, f"{shown}; button {switch} is the dead-man switch", advice)
    if ramp_N > 0.0 or damping_N > 0.0:
        device.begin()
    if damping_N > 0.0:
        yield own_damping(device, rate_hz, clock, sleep, damping_N)
    else:
        yield Check(NAME, SKIPPED, "not measured", "--damping 0.3, with no hand on the handle")
    if ramp_N > 0.0:
        yield _ramp(device, rate_hz, clock, sleep, ramp_N)


def _rate(found: Readings, wanted_hz: float) -> Check:
    gaps = sorted(b - a for a, b in pairwise(found.at_ns))
    rate_hz = 1.0 / (statistics.median(gaps) * NANO)
    p99_ms = gaps[round(0.99 * (len(gaps) - 1))] * 1e-6
    value = f"{rate_hz:.0f} Hz, p99 of the period {p99_ms:.2f} ms, {found.missed} of {READINGS} readings missed"
    if rate_hz < 0.95 * wanted_hz or found.missed > READINGS // 100:
        return Check("rate", WARNING, value, f"run it with --servo-hz {max(10, math.floor(rate_hz / 10) * 10)} or less")
    return Check("rate", OK, value)


def _resolution(found: Readings, declared_m: float) -> Check:
    steps = [abs(b - a) for x, y in pairwise(found.positions) for a, b in zip(x, y, strict=True) if a != b]
    if not steps:
        return Check(
            "resolution", OK, f"the handle did not move; {declared_m * 1e6:g} um declared", "move it meanwhile"
        )
    least = min(steps)
    value = f"smallest change {least * 1e6:.3g} um, {declared_m * 1e6:g} um declared"
    one_axis = len(found.positions[0]) == 1  # several encoders that a linkage mixes make steps as small as you like
    if declared_m and one_axis and least < 0.5 * declared_m:
        return Check("resolution", WARNING, value, "its readings are finer than it declares: is the unit right?")
    if declared_m and least > 1000.0 * declared_m:
        return Check("resolution", WARNING, value, "its readings are much coarser than it declares: is the unit right?")
    return Check("resolution", OK, value)


def _noise(found: Readings) -> Check:
    if max(math.hypot(*v) for v in found.velocities) > _REST_SPEED:
        return Check("noise", OK, "not measured: the handle moved")
    spread = [statistics.pstdev(axis) for axis in zip(*found.positions, strict=True)]
    return Check("noise", OK, f"{max(spread) * 1e6:.3g} um rms at rest")


def _velocity(found: Readings) -> Check:
    """Do the velocities fit the positions, over windows long enough for the encoders' counts not to matter?"""
    along = square = 0.0
    for start in range(0, len(found.at_ns) - _WINDOW, _WINDOW):
        window = slice(start + 1, start + _WINDOW + 1)
        elapsed_s = (found.at_ns[start + _WINDOW] - found.at_ns[start]) * NANO
        mean = [statistics.fmean(axis) for axis in zip(*found.velocities[window], strict=True)]
        for begin, end, speed in zip(found.positions[start], found.positions[start + _WINDOW], mean, strict=True):
            slope = (end - begin) / elapsed_s
            along += slope * speed
            square += slope * slope
    if square < (READINGS // _WINDOW) * (0.1 * _REST_SPEED) ** 2:
        return Check("velocity", OK, "not checked: the handle hardly moved", "move it meanwhile")
    value = f"{along / square:.2f} of what its positions say"
    if not 0.8 < along / square < 1.25:
        return Check("velocity", WARNING, value, "sign or unit of position or velocity are wrong")
    return Check("velocity", OK, value)


def _ramp(
    device: UserDevice, rate_hz: float, clock: Callable[[], int], sleep: Callable[[float], None], most_N: float
) -> Check:
    """Press along the first axis, harder and back, several times, against the hand that holds the handle still.

    The compliance is the slope of the position over the force, beside a drift of the hand: a least-squares fit.
    """
    period_s = 1.0 / rate_hz
    blocking = bool(getattr(device.device, "blocking", False))
    rows: list[tuple[float, float, float]] = []  # force [N], time [s], position [m]
    force_N = 0.0
    try:
        start_ns = clock()
        while (age_s := (clock() - start_ns) * NANO) < RAMPS * 2.0 * RAMP_S:
            if not blocking:
                sleep(period_s)
            try:
                x, _ = device.read()
                rows.append((force_N, age_s, x[0]))
                force_N = most_N * (1.0 - abs(age_s / RAMP_S % 2.0 - 1.0))
                device.apply((force_N, *(0.0,) * (device.dof - 1)))
            except DeviceSilent:
                continue
    finally:
        device.apply((0.0,) * device.dof)
    if len(rows) < _WINDOW:
        return Check("force ramp", WARNING, "the device was silent")
    table = np.array(rows)
    terms = np.column_stack((table[:, 0], table[:, 1], np.ones(len(table))))
    fitted, *_ = np.linalg.lstsq(terms, table[:, 2], rcond=None)
    rest_m = float(np.std(table[:, 2] - terms @ fitted))
    moved_m = float(fitted[0]) * most_N
    value = f"{most_N:g} N move the handle by {moved_m * 1e3:+.2f} mm"
    if abs(moved_m) <= 2.0 * rest_m:
        still = "hold the handle still, or give more force: its own motion hides what the force does"
        return Check("force ramp", WARNING, f"{value}, its own motion is {rest_m * 1e3:.2f} mm", still)
    if moved_m < 0.0:
        return Check("force ramp", WARNING, value, "the force acts the wrong way round: check the motor's wires")
    return Check("force ramp", OK, f"{value} ({most_N / moved_m:.0f} N/m of hand)")
