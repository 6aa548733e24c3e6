"""Check that a device's force and its positions agree: short pulses along each axis, and a fit of the response.

Each axis is pushed by +F, -F, +F for h, 2h, h seconds, then in reverse: a free handle of mass m moves by up
to F h^2 / m and rests again. The law of motion, integrated twice from the first reading, is linear in the unknowns:

    x = (1/m) II F(t - d) - (b/m) I x - (k/m) II x + a cubic polynomial in t

with I the integral and II the double integral: b and k describe device and hand, the polynomial is the motion of the
hand itself. Every four pulses are fitted separately: a hand's motion is close to a cubic only for that long. Least
squares find 1/m for each delay d; the delay with the best fit is used. A hand's own motion differs much from
pulses of 14 to 28 Hz, so the sign is known from a tenth of a millimetre on.

If a reading is late because the computer was busy, its exact time and that of the force's change are not known:
position and velocity may jump there and after it, at the cost of four more unknowns. If that leaves too few readings,
the axis is pushed again.

No clock: times are arguments.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hapnet.checks import Array, Vector

PULSE_S = 0.016
"""h, and at least `_LEAST_TICKS` of the servo's periods."""
FARTHEST_M = 0.01
"""If the handle moves farther from the start of a group of four pulses, it is not pushed until the next group."""
PLAUSIBLE_KG = 0.002, 20.0
"""If the handle seems lighter or heavier, its positions or forces are in a wrong unit."""
LATE_TICKS = 2
"""A delay in readings from which on a force is late; less is normal, as a device may read and apply at once."""

UNEVEN = 2.5
"""A reading is late if it comes after more than this many times the usual interval."""
MOST_ATTEMPTS = 8
"""Most rounds of pushes on an axis until its response is known, if readings are late."""

_LEAST_TICKS = 3
_LEAST_ROWS = 24
_PULSES = (1, -1, -1, 1, -1, 1, 1, -1)
_MOST_LATE = 8
_SURE, _SURE_LATE, _SHOWS_LATE = 6.0, 25.0, 0.002
_VELOCITY_SHARE = 0.2, 5.0
_HEAVIER, _LIGHTER = 1.7, 0.6


class Response(NamedTuple):
    """The response of an axis: apparent mass [kg], below zero if it moves against the force; the delay of the force, in
    readings; the mass over its standard error; reported velocity over that of the positions, None: not known; the
    number of readings at which position and velocity may jump.
    """

    mass: float
    late: int
    sure: float
    velocity: float | None
    stood_still: bool
    gaps: int = 0

    @property
    def known(self) -> bool:
        """Whether the force showed in the positions."""
        return not self.stood_still and self.sure >= _SURE


class ActuatorCheck:
    """Pushes the axes one after another; call `step` once for each reading, until `done`.

    force_N : of the pulses. period_s : of the readings. rounds : how often each axis is pushed. known_mass : an earlier
    result for each axis [kg], or for all; empty: not known. least_mass : the smallest that the device declares.
    """

    def __init__(
        self,
        dof: int,
        force_N: float,
        period_s: float,
        *,
        rounds: int = 1,
        known_mass: Vector = (),
        least_mass: float | None = None,
    ) -> None:
        self.done = False
        self.responses: list[Response] = []
        self._dof, self._force_N, self._rounds = dof, force_N, rounds
        self._pulse_s = max(PULSE_S, _LEAST_TICKS * period_s)
        self._known = known_mass * dof if len(known_mass) == 1 else known_mass
        self._minimum = least_mass
        self._rows: list[tuple[float, float, float, float]] = []
        self._age_s = self._from_m = 0.0
        self._group = -1
        self._attempts = 0

    def restart(self) -> None:
        """Begin again with the first axis."""
        self.responses.clear()
        self._rows, self._group, self._age_s, self._attempts = [], -1, 0.0, 0

    def step(self, dt: float, acted: Vector, x: Vector, v: Vector) -> Vector:
        """Take a reading, `dt` seconds after the last, with the force that acted in between; returns the next force."""
        axis = len(self.responses)
        self._age_s = self._age_s + dt if self._rows else 0.0
        self._rows.append((self._age_s, acted[axis], x[axis], v[axis]))
        pulse = int(self._age_s / self._pulse_s)
        if pulse >= len(_PULSES) * self._rounds:
            found, self._rows, self._group = response(self._rows, 2 * self._rounds), [], -1
            self._attempts += 1
            if found.known or not found.gaps or self._attempts == MOST_ATTEMPTS:
                self.responses.append(found)
                self._attempts = 0
            self.done = len(self.responses) == self._dof
            return (0.0,) * self._dof
        if (group := pulse // 4) != self._group:
            self._group, self._from_m = group, x[axis]
        near = abs(x[axis] - self._from_m) <= FARTHEST_M
        push = self._force_N * _PULSES[pulse % len(_PULSES)] if near else 0.0
        return tuple([push if i == axis else 0.0 for i in range(self._dof)])

    @property
    def masses(self) -> Vector:
        """Apparent mass of each axis [kg]; empty: not all are known."""
        found = tuple([one.mass for one in self.responses])
        return found if all(one.known and one.mass > 0.0 for one in self.responses) else ()

    @property
    def wrong_way(self) -> str:
        """A message that names the axes that move against their force; empty: none."""
        wrong = [one.known and one.mass <= -PLAUSIBLE_KG[0] for one in self.responses]
        axes = [_name(i, self._dof) for i, is_wrong in enumerate(wrong) if is_wrong]
        return f"{' and '.join(axes)} moves against its force: motor or encoder is reversed" if axes else ""

    @property
    def impossible(self) -> str:
        """A message with another reason to render no force; empty: none."""
        minimum, most = PLAUSIBLE_KG
        for i, one in enumerate(self.responses):
            name, mass = _name(i, self._dof), abs(one.mass)
            if one.stood_still:
                return f"{name} reads the same while {self._force_N:g} N push it to and fro: is its encoder connected?"
            if one.known and not minimum <= mass <= most:
                return f"{name} moves like {mass:.2g} kg: are these millimetres, or are its forces in another unit?"
        return ""

    @property
    def doubts(self) -> list[str]:
        """Describe the faults that make the account or the rendering wrong, a line each."""
        found = []
        for i, one in enumerate(self.responses):
            found += [f"{_name(i, self._dof)} {doubt}" for doubt in self._doubts(i, one)]
        return found

    def _doubts(self, axis: int, one: Response) -> list[str]:
        if not one.known or self.impossible:
            return ["could not be checked: too many of its readings came late"] if one.gaps and not one.known else []
        found, mass = [], abs(one.mass)
        if self._minimum is not None and mass < _LIGHTER * self._minimum:
            found.append(f"moves like {mass:.2g} kg, but {self._minimum:g} kg are declared: is its force larger?")
        elif self._known and not _LIGHTER <= mass / self._known[axis] <= _HEAVIER:
            found.append(f"moves like {mass:.2g} kg, earlier like {self._known[axis]:.2g} kg: another grip, or force?")
        if one.late >= LATE_TICKS:
            found.append(f"moves {one.late} readings after its force: the account counts it too early")
        if one.velocity is not None and not _VELOCITY_SHARE[0] <= one.velocity <= _VELOCITY_SHARE[1]:
            found.append(f"reports {one.velocity:.2g} times the velocity of its positions: is its sign or unit wrong?")
        return found


def response(rows: Sequence[tuple[float, float, float, float]], groups: int = 1) -> Response:
    """Return the response of an axis. Each row is a reading: time [s], the force since the last reading [N], position
    [m], velocity [m/s].

    groups : the number of groups of pulses. Each is fitted by itself, as a hand's own motion is close to a cubic only
    for that long; the differences between the fits count as blur.
    """
    time, force, x, v = (np.asarray(column, dtype=np.float64) for column in zip(*rows, strict=True))
    x = x - x[0]
    dt = np.diff(time)
    if len(rows) < 2 * len(_PULSES):
        return Response(math.inf, 0, 0.0, None, False, len(rows))
    if not np.any(force):
        return Response(math.inf, 0, 0.0, None, False)
    if not np.any(x):
        return Response(math.inf, 0, 0.0, None, True)
    late_at = np.flatnonzero(dt > UNEVEN * np.median(dt)) + 1
    gaps = np.unique(np.minimum(np.r_[late_at, late_at + 1], len(rows) - 1))  # it may be stamped late, too
    if len(gaps) > len(rows) // len(_PULSES):
        return Response(math.inf, 0, 0.0, None, False, len(gaps))
    groups = 1 if len(gaps) else max(1, min(groups, len(rows) // _LEAST_ROWS))  # four pulses with a gap are too few
    cuts = np.searchsorted(time, np.linspace(time[0], time[-1], groups + 1)[1:-1])
    ends = [0, *cuts, len(rows)]
    parts = [_Part(time[a:b], x[a:b], gaps[(gaps > a) & (gaps < b)] - a) for a, b in itertools.pairwise(ends)]
    fits = []
    for late in range(_MOST_LATE):
        forces = np.split(np.r_[np.zeros(late), force[: len(force) - late]], cuts)
        fits.append(_combined([part.fit(one) for part, one in zip(parts, forces, strict=True)]))
    left = [fit[2] for fit in fits]
    late = int(np.argmin(left))
    noise = left[late] / max(1, len(rows) - math.fsum(part.unknowns for part in parts))
    in_time = min(range(LATE_TICKS), key=left.__getitem__)
    moved = math.fsum(part.moved for part in parts)  # motion that only the force explains
    if left[in_time] - left[late] < max(_SURE_LATE * noise, _SHOWS_LATE * moved):
        late = in_time
    gain, error, _ = fits[late]
    at_once, blur, _ = fits[in_time]
    if gain * at_once < 0.0 or (gain < 0.0 and abs(at_once) < _SURE * blur):
        error = math.inf  # a hand that gives way late may look like a motor that is reversed: not known
    velocity = _velocity(x, v, dt, gaps)
    return Response(1.0 / gain if gain else math.inf, late, abs(gain) / error, velocity, False, len(gaps))


def pushed(time: Array, force: Array, x: Array, lags: int) -> tuple[float, float]:
    """1/m [1/kg] of an axis that was pushed by `force` [N] up to each reading of x [m], and 1/m over its standard
    error; with the lag below `lags` that fits best."""
    part = _Part(time, x)
    fits = [part.fit(np.r_[np.zeros(late), force[: len(force) - late]]) for late in range(lags)]
    gain, error, _ = min(fits, key=lambda fit: fit[2])
    return gain, abs(gain) / error


class _Part:
    """Consecutive readings, and the possible motions without a force in them."""

    def __init__(self, time: Array, x: Array, gaps: Array | None = None) -> None:
        self._x, self._dt = x - x[0], np.diff(time)
        span = float(time[-1] - time[0])
        s = (time - time[0]) / span
        once = _integral(self._x, self._dt)
        anew = [] if gaps is None else [(s >= s[gap]) * (s - s[gap]) ** power for gap in gaps for power in (0, 1)]
        self._base = np.column_stack([
            once / span, _integral(once, self._dt) / span**2, np.ones_like(s), s, s**2, s**3, *anew,
        ])  # fmt: skip
        self.unknowns = self._base.shape[1] + 1

    @property
    def moved(self) -> float:
        """The residual sum of squares without a force."""
        explained = self._base @ np.linalg.lstsq(self._base, self._x, rcond=None)[0]
        return float(np.sum((self._x - explained) ** 2))

    def fit(self, force: Array) -> tuple[float, float, float]:
        """1/m, its standard error, and the sum of squares that is left."""
        if not np.any(force[1:]) or len(self._x) < self.unknowns + _LEAST_TICKS:
            return 0.0, math.inf, self.moved
        return _fit(force, self._x, self._dt, self._base)


def _combined(fits: Sequence[tuple[float, float, float]]) -> tuple[float, float, float]:
    """The weighted mean of several fits; its error includes their scatter."""
    gain, error, _ = np.array(fits).T
    weight = error**-2.0
    if not np.any(weight):
        return 0.0, math.inf, math.fsum(fit[2] for fit in fits)
    mean = float(np.average(gain, weights=weight))
    spread = float(np.average((gain - mean) ** 2, weights=weight)) / max(1, len(fits) - 1)
    return mean, math.sqrt(max(1.0 / float(weight.sum()), spread)), math.fsum(fit[2] for fit in fits)


def _fit(force: Array, x: Array, dt: Array, base: Array) -> tuple[float, float, float]:
    """1/m, its standard error, and the sum of squares that is left."""
    velocity = np.r_[0.0, np.cumsum(force[1:] * dt)]
    terms = np.column_stack([_integral(velocity, dt), base])
    scale = np.linalg.norm(terms, axis=0)
    scale[scale == 0.0] = 1.0
    inverse = np.linalg.pinv(terms / scale, rcond=1e-9)
    fitted = inverse @ x
    left = float(np.sum((x - terms / scale @ fitted) ** 2))
    blur = max(left / (len(x) - terms.shape[1]), 1e-24)
    return float(fitted[0] / scale[0]), math.sqrt(blur) * float(np.linalg.norm(inverse[0])) / float(scale[0]), left


def _integral(values: Array, dt: Array) -> Array:
    return np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * dt)])


def _velocity(x: Array, v: Array, dt: Array, gaps: Array) -> float | None:
    """Reported velocity over the change of position: from their sums over a pulse, which a filter changes little, and
    without late readings."""
    window = max(1, len(x) // (2 * len(_PULSES)))
    late = np.zeros(len(x))
    late[gaps] = 1.0
    whole = np.cumsum(late)[window:] == np.cumsum(late)[:-window]
    moved = (x[window:] - x[:-window])[whole]
    reported = _integral(v, dt)
    reported = (reported[window:] - reported[:-window])[whole]
    square = float(moved @ moved)
    error = math.sqrt(max(0.0, float(reported @ reported) * square - float(reported @ moved) ** 2))
    return float(reported @ moved) / square if square > 0.0 and abs(float(reported @ moved)) > error else None


def _name(axis: int, dof: int) -> str:
    return "the handle" if dof == 1 else f"its axis {'xyz'[axis] if axis < 3 else axis}"
