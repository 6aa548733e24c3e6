"""A lower bound of a device's own damping, measured with no hand on its handle, for `device.trusted_damping`.

A soft spring, rendered with a small force, pulls the handle to a new place, and it swings (`push`). Between two moments
of rest, such as turning points, the kinetic energy does not change. So the work of the force went into the device:

    W = b int |v|^2 dt + c int |dx| + g . dx + k/2 change of |x|^2

with damping b, Coulomb friction c, weight g, a spring k of the device itself. Friction is not harvested, as it
does not grow with speed. The lower bound of a trial is b by least squares less three standard errors, or less if any
single swing took less.

The bound is the minimum over all trials, less their spread and a tenth. It cannot detect a hand that only brakes
the handle, or a device with less force than it reports. A force that acts late makes the bound smaller.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from hapnet.assembly.user_device import UserDevice
from hapnet.checks import Array, Vector
from hapnet.errors import DeviceSilent
from hapnet.ext.doctor.machine import OK, SKIPPED, WARNING, Check

NANO = 1e-9
TRIALS = 3
REACH_M = 0.02
"""The spring's end jumps by this and by shares of it; the handle moves by at most 1.5 times this to either side [m]."""
SHARES = (1.0, 1.0, 0.6, 0.6, 0.35, 0.35)
MAX_S = 2.5
"""The longest swing after a jump, and the longest damping to rest after it [s]."""
CALMING_NS_M = 3.0
FARTHEST_M, FASTEST_MPS = 3.0 * REACH_M, 1.0
"""A handle farther from its start, or faster, ends the measurement."""
SHORTEST_M = REACH_M / 4.0
"""Shorter swings are not used."""
WINDOW_S = 0.005
"""Speeds are means over this time [s]; encoders' counts make them a little too large, which only lowers the bound."""
RESTING_MPS, RESTED_S = 0.005, 0.2
"""The handle counts as at rest if it was no faster than this for so long."""
MARGIN = 0.1
WORK_ERROR, SURE = 0.02, 3.0
"""The error of each swing's work, as a share of the largest; and the number of standard errors subtracted from b."""

NAME = "own damping"


class Swing(NamedTuple):
    """The readings of a swing: for each, the time since the previous one [s], the position [m] (N, n), and the force
    that acted in between [N] (N, n).
    """

    dt: Array
    position: Array
    force: Array


class DampingEstimate(NamedTuple):
    """b, its lower bound by the standard error and by each swing [Ns/m], and the device's spring [N/m]."""

    damping: float
    minimum: float
    stiffness: float


class Unmeasured(Exception):
    """The reason for no result; `state` is that of the check."""

    def __init__(self, why: str, state: str = SKIPPED) -> None:
        super().__init__(why)
        self.state = state


def own_damping(
    device: UserDevice, rate_hz: float, clock: Callable[[], int], sleep: Callable[[float], None], most_N: float
) -> Check:
    """Measure a lower bound, the same for each axis, with at most this force [N]; the advice is the parameter to set.

    Raises HapnetError: the device fails.
    """
    try:
        trials = [
            _trial([*push(device, rate_hz, clock, sleep, most_N, axis)], most_N, axis)
            for axis in range(device.dof)
            for _ in range(TRIALS)
        ]
        dampings = [trial.damping for trial in trials]
        range_text = f"{len(trials)} trials found {min(dampings):.2g} to {max(dampings):.2g} Ns/m"
        if (bound := lower_bound(trials)) <= 0.0:
            raise Unmeasured(range_text)
    except Unmeasured as why:
        return Check(NAME, why.state, f"not known: {why}", "leave device.trusted_damping at 0")
    advice = f"--set device.trusted_damping={bound:g}, if no hand touched the handle"
    return Check(NAME, OK, f"at least {bound:g} Ns/m ({range_text})", advice)


def _trial(swings: Sequence[Swing], most_N: float, axis: int) -> DampingEstimate:
    if (trial := examined(swings)) is None:
        far = max((float(np.ptp(one.position[:, axis])) for one in swings), default=0.0)
        raise Unmeasured(f"{most_N:g} N moved the handle by {far * 1e3:.1f} mm, or too seldom: let go, or push harder")
    if trial.stiffness > most_N / REACH_M:
        raise Unmeasured(f"a spring of {trial.stiffness:.0f} N/m holds the handle: let go of it")
    return trial


def lower_bound(trials: Sequence[DampingEstimate]) -> float:
    """The damping common to all trials [Ns/m], less their spread and `MARGIN`; two digits, rounded down; 0: none."""
    dampings = [trial.damping for trial in trials]
    minimum = min(min(trial.damping, trial.minimum) for trial in trials)
    bound = (1.0 - MARGIN) * minimum - (max(dampings) - min(dampings))
    if bound <= 0.0:
        return 0.0
    digit = 10.0 ** (math.floor(math.log10(bound)) - 1)
    return float(f"{math.floor(bound / digit) * digit:.2g}")


# -- Pushing ----------------------------------------------------------------------------------------------------------


def push(
    device: UserDevice,
    rate_hz: float,
    clock: Callable[[], int],
    sleep: Callable[[float], None],
    most_N: float,
    axis: int,
) -> Iterator[Swing]:
    """Let the handle swing along an axis, once for each of `SHARES`; afterwards the force is zero.

    Raises Unmeasured: the handle ran away, or the device renders no force. HapnetError: the device fails.
    """
    spring = _Spring(device, rate_hz, clock, sleep, most_N)
    try:
        before = spring.until_rest(CALMING_NS_M)
        for number, share in enumerate(SHARES):
            spring.move(axis, (0.5 if number % 2 == 0 else -0.5) * share * REACH_M)
            rested = before[-round(RESTED_S * rate_hz) :]
            rows = rested + spring.until_rest(0.0)
            before = spring.until_rest(CALMING_NS_M)
            if len(rows) > 2:
                yield Swing(*(np.array(column) for column in zip(*rows, strict=True)))
    finally:
        with suppress(DeviceSilent):
            device.apply((0.0,) * device.dof)


class _Spring:
    """A soft spring to a place near the handle's start, with a damper on demand."""

    def __init__(
        self,
        device: UserDevice,
        rate_hz: float,
        clock: Callable[[], int],
        sleep: Callable[[float], None],
        most_N: float,
    ) -> None:
        self._device, self._clock, self._sleep = device, clock, sleep
        self._period_s = 0.0 if getattr(device.device, "blocking", False) else 1.0 / rate_hz
        self._most_N, self._stiffness = most_N, most_N / REACH_M
        self._held = self._offset = self._velocity = (0.0,) * device.dof
        self._start: Vector | None = None
        self._last: Vector | None = None
        self._last_ns = clock()

    def move(self, axis: int, offset: float) -> None:
        """Move the spring's end to `offset` from the start along an axis [m]."""
        self._offset = tuple([offset if i == axis else 0.0 for i in range(self._device.dof)])

    def until_rest(self, damping: float) -> list[tuple[float, Vector, Vector]]:
        """Pull, with a damper [Ns/m], until the handle rests; returns dt, position and force of the readings."""
        rows: list[tuple[float, Vector, Vector]] = []
        begin_ns = self._clock()
        while (self._clock() - begin_ns) * NANO < MAX_S and not _rest(rows):
            if (row := self._step(damping)) is not None:
                rows.append(row)
        return rows

    def _step(self, damping: float) -> tuple[float, Vector, Vector] | None:
        device = self._device
        if self._period_s:
            self._sleep(max(0.0, (self._last_ns - self._clock()) * NANO + self._period_s))
        try:
            x, _ = device.read()
        except DeviceSilent:
            return None
        before, now_ns = self._last, self._clock()
        dt = device.interval() or (now_ns - self._last_ns) * NANO
        acted = device.acted()
        row = (dt, x, self._held if acted is None else acted)
        self._last, self._last_ns = x, now_ns
        if before is not None and dt > 0.0:
            share = min(1.0, dt / WINDOW_S)
            speeds = zip(self._velocity, before, x, strict=True)
            self._velocity = tuple([v + share * ((b - a) / dt - v) for v, a, b in speeds])
        with suppress(DeviceSilent):  # then the previous force stays
            self._pull(x, damping)
        return row if before is not None and dt > 0.0 else None

    def _pull(self, x: Vector, damping: float) -> None:
        device, start = self._device, self._start or x
        self._start = start
        if (switch := device.dead_man) is not None and not any(device.buttons()[switch : switch + 1]):
            raise Unmeasured("its dead-man switch is not held; hold it without touching the handle")
        if why := device.braked():
            raise Unmeasured(f"the device renders no force ({why})")
        if math.dist(x, start) > FARTHEST_M or math.hypot(*self._velocity) > FASTEST_MPS:
            why = "the handle ran away: something pushes it, or the force acts in reverse (see --ramp)"
            raise Unmeasured(why, WARNING)
        places = zip(start, self._offset, x, self._velocity, strict=True)
        force = tuple([self._stiffness * (a + b - c) - damping * v for a, b, c, v in places])
        if (length := math.hypot(*force)) > self._most_N:
            force = tuple([self._most_N / length * f for f in force])
        applied = device.apply(force)
        self._held = force if applied is None else applied


def _rest(rows: Sequence[tuple[float, Vector, Vector]]) -> bool:
    """Whether the handle has moved slowly for the last `RESTED_S`."""
    span = 0.0
    for dt, x, _ in reversed(rows):
        span += dt
        if math.dist(x, rows[-1][1]) > RESTING_MPS * RESTED_S:
            return False
        if span >= RESTED_S:
            return True
    return False


# -- Evaluation -------------------------------------------------------------------------------------------------------


def examined(swings: Sequence[Swing]) -> DampingEstimate | None:
    """Return the result of one trial; None: there are too few swings that are long enough."""
    rows = [row for swing in swings for row in _rows(swing, swings[0].position[0])]
    if len(rows) < 4:
        return None
    table = np.array(rows)
    work, terms = table[:, 0], table[:, 1:]
    fitted, unsure = _fit(terms, work)
    if fitted[1] < 0.0:  # friction cannot give energy
        fitted, _ = _fit(terms * (1.0, 0.0, *(1.0,) * (terms.shape[1] - 2)), work)
    others = work - terms[:, 2:] @ fitted[2:]
    minimum = min(float(np.min(others / terms[:, 0])), float(fitted[0] - SURE * unsure))
    return DampingEstimate(float(fitted[0]), minimum, float(fitted[-1]))


def _fit(terms: Array, work: Array) -> tuple[Array, float]:
    """Return the least-squares fit, and the standard error of its first value, b, which friction resembles."""
    scale = np.linalg.norm(terms, axis=0)
    scale[scale == 0.0] = 1.0
    fitted, *_ = np.linalg.lstsq(terms / scale, work, rcond=1e-3)
    left = work - terms / scale @ fitted
    error = max(float(np.linalg.norm(left)) / math.sqrt(max(1, len(work) - 3)), WORK_ERROR * float(np.abs(work).max()))
    spread = np.linalg.pinv(terms / scale, rcond=1e-3)[0]
    return np.asarray(fitted / scale), error * float(np.linalg.norm(spread)) / float(scale[0])


def _rows(swing: Swing, origin: Array) -> Iterator[tuple[float, ...]]:
    """For each motion from rest to rest: W, and the factors of b, c, g and k; the spring k is relaxed at `origin`."""
    step_s, x, force = _evenly(swing)
    per_window = max(1, round(WINDOW_S / step_s))
    x = _smoothed(x, per_window)
    work = np.r_[0.0, np.cumsum(np.sum(force * np.diff(x, axis=0), axis=1))]
    time: Array = step_s * np.arange(len(x), dtype=np.float64)
    main = int(np.argmax(np.ptp(x, axis=0)))
    for first, last in _rests(x[:, main], time, per_window):
        marks = np.r_[np.arange(first, last, per_window), last]
        steps, spans = np.diff(x[marks], axis=0), np.diff(time[marks])
        square = float(np.sum(np.sum(steps**2, axis=1) / spans))
        moved = x[last] - x[first]
        potential = 0.5 * float(np.sum((x[last] - origin) ** 2) - np.sum((x[first] - origin) ** 2))
        yield float(work[last] - work[first]), square, abs(float(moved[main])), *moved.tolist(), potential


def _evenly(swing: Swing) -> tuple[float, Array, Array]:
    """A time step [s], positions at that interval (N, n), and the mean forces between them (N - 1, n)."""
    time = np.r_[0.0, np.cumsum(swing.dt[1:])]
    step_s = float(np.median(swing.dt))
    even = np.arange(0.0, time[-1] + 1e-9, step_s)
    impulse = np.cumsum(np.r_[np.zeros((1, swing.force.shape[1])), swing.force[1:] * swing.dt[1:, None]], axis=0)

    def at(values: Array) -> Array:
        return np.stack([np.interp(even, time, axis) for axis in values.T], axis=1)

    return step_s, at(swing.position), np.diff(at(impulse), axis=0) / step_s


def _smoothed(x: Array, window: int) -> Array:
    """Centred means over about `window` readings: the force follows the noise of each reading, and without the means
    their product would look like work."""
    half = window // 2
    sums = np.cumsum(np.r_[np.zeros((1, x.shape[1])), np.repeat(x[:1], half, 0), x, np.repeat(x[-1:], half, 0)], axis=0)
    span = 2 * half + 1
    return np.asarray((sums[span:] - sums[:-span]) / span)


def _rests(x: Array, time: Array, window: int) -> Iterator[tuple[int, int]]:
    """Pairs of moments at rest with a long swing between them: turning points, and begin and end if it rests there."""
    marks: list[int] = []
    if _slow(x[: window + 1], time[: window + 1]):
        marks.append(0)  # at rest before the jump
    extreme, turned = 0, 0  # the farthest point of the swing so far; its direction, 0: unknown
    for i in range(1, len(x)):
        if turned == 0:
            if abs(x[i] - x[0]) >= SHORTEST_M / 2.0:
                turned, extreme = (1 if x[i] > x[0] else -1), i
        elif (x[i] - x[extreme]) * turned > 0.0:
            extreme = i
        elif (x[extreme] - x[i]) * turned >= SHORTEST_M / 2.0:
            marks.append(extreme)
            turned, extreme = -turned, i
    if _slow(x[-window - 1 :], time[-window - 1 :]):
        marks.append(len(x) - 1)
    for first, last in pairwise(marks):
        if last - first > window and abs(x[last] - x[first]) >= SHORTEST_M:
            yield first, last


def _slow(x: Array, time: Array) -> bool:
    return bool(abs(x[-1] - x[0]) <= 2.0 * RESTING_MPS * (time[-1] - time[0]))
