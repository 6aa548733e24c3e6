"""Checks of a device: its rate and latency, its noise at rest, and the motion of its handle under a force.

The force is zero unless it is requested: short pulses, which show whether force and positions agree (`ActuatorCheck`),
or slow pushes, which show the device's own damping (`own_damping`). Clock and sleep are arguments.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Iterator
from contextlib import suppress
from itertools import pairwise
from pathlib import Path

from hapnet.assembly.user_device import UserDevice
from hapnet.checks import Vector
from hapnet.errors import DeviceSilent, HapnetError
from hapnet.ext.doctor.machine import OK, SKIPPED, WARNING, Check
from hapnet.ext.doctor.own_damping import NAME, own_damping
from hapnet.plant.actuator_check import ActuatorCheck
from hapnet.units import METRES, within

NANO = 1e-9
_PAGE = Path(__file__).parents[2] / "devices" / "README.md"
"""The page on the watchdog that the hardware needs. Pages beside the code are part of the package."""
READINGS = 2000
MAX_S = 5.0
"""The longest time of the pushes, for any device [s]."""
ROUNDS = 4
"""The number of times that each axis is pushed to and fro."""
_WINDOW = 50
_REST_SPEED = 0.01
"""Below this speed the handle counts as at rest [m/s]."""


class Readings:
    """The readings of a device, read `count` times at its own rate without force.

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
        self.contacts: list[Vector] = []
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
            if (force := device.contact_force()) is not None and math.isfinite(sum(force)):
                self.contacts.append(force)


def examine_device(
    device: UserDevice,
    rate_hz: float,
    clock: Callable[[], int],
    sleep: Callable[[float], None],
    ramp_N: float = 0.0,
    damping_N: float = 0.0,
    known_mass: Vector = (),
    on_mass: Callable[[Vector], None] = lambda mass: None,
) -> Iterator[Check]:
    """Yield a check for each measurement.

    ramp_N : push the handle to and fro with this force; damping_N : push the free handle with this force; 0: do not.
    known_mass : of each axis from an earlier measurement [kg]; on_mass : called with the new one.

    Raises HapnetError: the device fails.
    """
    readings = Readings(device, rate_hz, clock, sleep)
    if len(readings.at_ns) < 3:
        raise HapnetError(f"the device {device.name} gave {len(readings.at_ns)} readings of {READINGS}")
    yield _rate(readings, rate_hz)
    took = sorted(readings.took_ns)
    p50, p99 = (took[round(share * (len(took) - 1))] * 1e-3 for share in (0.5, 0.99))
    yield Check("reading and command", OK, f"{p50:.0f} us, p99 {p99:.0f} us")
    yield _resolution(readings, device.resolution)
    yield _noise(readings)
    yield _velocity(readings)
    if readings.contacts:
        yield _contact(readings.contacts, within(getattr(device.device, "units", METRES), "N"))
    if device.watchdog_s is None:
        advice = f"the hardware must end the force by itself: see {_PAGE}"
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
        check = ActuatorCheck(
            device.dof, ramp_N, 1.0 / rate_hz, rounds=ROUNDS, known_mass=known_mass, least_mass=device.smallest_mass
        )
        why = _push(check, device, rate_hz, clock, sleep)
        yield _agreement(check, ramp_N, why)
        if check.masses and not check.wrong_way:
            on_mass(check.masses)


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
    minimum = min(steps)
    value = f"smallest change {minimum * 1e6:.3g} um, {declared_m * 1e6:g} um declared"
    one_axis = len(found.positions[0]) == 1  # a linkage combines several encoders to arbitrarily small steps
    if declared_m and one_axis and minimum < 0.5 * declared_m:
        return Check("resolution", WARNING, value, "its readings are finer than declared: check the unit")
    if declared_m and minimum > 1000.0 * declared_m:
        return Check("resolution", WARNING, value, "its readings are much coarser than declared: check the unit")
    return Check("resolution", OK, value)


def _noise(found: Readings) -> Check:
    if max(math.hypot(*v) for v in found.velocities) > _REST_SPEED:
        return Check("noise", OK, "not measured: the handle moved")
    spread = [statistics.pstdev(axis) for axis in zip(*found.positions, strict=True)]
    return Check("noise", OK, f"{max(spread) * 1e6:.3g} um rms at rest")


def _contact(forces: list[Vector], unit: str) -> Check:
    rest = tuple(map(statistics.median, zip(*forces, strict=True)))
    most = max(forces, key=lambda force: math.hypot(*force))
    median, largest = (", ".join(f"{part:.2g}" for part in force) for force in (rest, most))
    advice = "push the robot along its first axis, to +: the first is above 0"
    return Check("contact force", OK, f"{median} {unit}, up to {largest} {unit}", advice)


def _velocity(found: Readings) -> Check:
    """Check that velocities and positions agree, over windows so long that the encoders' counts do not matter."""
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
    value = f"{along / square:.2f} times the speed of its positions"
    if not 0.8 < along / square < 1.25:
        return Check("velocity", WARNING, value, "sign or unit of position or velocity are wrong")
    return Check("velocity", OK, value)


def _push(
    check: ActuatorCheck, device: UserDevice, rate_hz: float, clock: Callable[[], int], sleep: Callable[[float], None]
) -> str:
    """Push until the check is done; returns the reason if that was not possible, or an empty text."""
    blocking = bool(getattr(device.device, "blocking", False))
    none: Vector = (0.0,) * device.dof
    held, last_ns = none, clock()
    until_ns = last_ns + round(MAX_S / NANO)
    try:
        while not check.done:
            if not blocking:
                sleep(max(0.0, (last_ns - clock()) * NANO + 1.0 / rate_hz))
            if clock() > until_ns:
                return "the device was silent"
            try:
                x, v = device.read()
                now_ns = clock()
                acted = device.acted()
                dt = device.interval() or (now_ns - last_ns) * NANO
                last_ns = now_ns
                if (switch := device.dead_man) is not None and not any(device.buttons()[switch : switch + 1]):
                    return "its dead-man switch is not held"
                if why := device.braked():
                    return f"it renders no force ({why})"
                force = check.step(dt, held if acted is None else acted, x, v)
                applied = device.apply(force)
                held = force if applied is None else applied
            except DeviceSilent:
                continue
    finally:
        with suppress(DeviceSilent):
            device.apply(none)
    return ""


def _agreement(check: ActuatorCheck, force_N: float, why: str) -> Check:
    name = "force and motion"
    if why:
        return Check(name, WARNING, f"not known: {why}")
    if check.wrong_way:
        return Check(name, WARNING, check.wrong_way, "do not use it: swap the motor's wires, or the encoder's A and B")
    if check.impossible:
        return Check(name, WARNING, check.impossible)
    if doubts := check.doubts:
        return Check(name, WARNING, "; ".join(doubts))
    if not check.masses:
        hidden = f"{force_N:g} N do not show in its positions"
        return Check(name, WARNING, hidden, "let go of the handle, or push harder: --ramp " + f"{2.0 * force_N:g}")
    mass = " ".join(f"{mass:.2g}" for mass in check.masses)
    return Check(name, OK, f"{force_N:g} N move it as {mass} kg would, at the next reading")
