"""Does a running device's motor still push the way that it is told? Its force is interrupted shortly, where that shows.

A handle that moves against its force may be pushed by a hand, or by a motor whose sign has changed. In slow motion the
two look alike. So while it does so, the force is cut to a part of it for two pulses, and what the handle does is fitted
as at the start (`hapnet.plant.actuator_check`). A force that is only ever made smaller cannot make the coupling active.

No clock: times are arguments.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from hapnet.checks import Vector
from hapnet.plant.actuator_check import LATE_TICKS, PLAUSIBLE_KG, pushed
from hapnet.plant.agreement import GAP_S
from hapnet.records.vectors import inner

AGAINST_M, LEAST_N = 0.001, 0.25
"""The handle has moved so far against its force, of so much at least: the force is cut."""
CUT = 0.35
"""The share of the force that is cut."""
SUDDEN = 0.5
"""Where the handle accelerates against its force by so much of what the force alone could do, all of it is cut."""
SUDDEN_N = 0.8
SURE = 15.0
"""Standard errors of 1/m below zero: then the motor is reversed."""

HEAVIEST = 8.0
"""With a hand on it the handle seems no heavier than so many times its own mass."""

_PULSES = (1, 0, 1, 0)
_PULSE_S, _COARSE_PULSE_S = 0.008, 0.012
_LEAST_TICKS = 3
_BEFORE = 12
_FADES_S = 0.3
_PAUSE_S = 0.1
_DOUBT = 1.5
_UNEVEN = 2.5
"""A reading that is late by so many periods makes a probe worthless: when it was taken is not known well enough."""


class ForceProbe:
    """Watches force and position of a device, and cuts its force for some hundredths of a second.

    period_s : of the readings. resolution : of the encoders [m].
    mass : the handle's, the smallest of several axes' [kg]; None: not known.
    """

    def __init__(self, period_s: float, mass: float | None, resolution: float = 0.0) -> None:
        self.share: float = 1.0
        """The part of the force that may be rendered from now on."""
        self._pulse_s = max(_COARSE_PULSE_S if resolution else _PULSE_S, _LEAST_TICKS * period_s)
        self._most_dt = _UNEVEN * period_s
        self._uneven = False
        self._mass = mass
        self._rows: deque[tuple[float, Vector, Vector]] = deque(maxlen=_BEFORE + 4 * max(40, _LEAST_TICKS) * 4)
        self._against_m = 0.0
        self._at_s = self._began_s = 0.0
        self._along: Vector = ()
        self._depth = 0.0
        self._rests_until_s = 0.0

    def wrong(self, dt: float, acted: Vector, x: Vector) -> str:
        """Take a reading, and the force that acted for `dt` seconds before it; says what is wrong, or nothing."""
        if dt > GAP_S or not self._rows:
            self._forget(acted, x)
            return ""
        self._at_s += dt
        moved = [one - two for one, two in zip(x, self._rows[-1][2], strict=True)]
        self._rows.append((self._at_s, acted, x))
        if self._along:
            self._uneven = self._uneven or dt > self._most_dt
            return self._probe()
        while len(self._rows) > _BEFORE:
            self._rows.popleft()
        size = math.hypot(*acted)
        self._against_m *= math.exp(-dt / _FADES_S)
        if size >= LEAST_N:
            self._against_m = max(0.0, self._against_m - inner(acted, moved) / size)
        sudden = self._is_sudden(acted, size)
        if sudden or (self._against_m >= AGAINST_M and size >= LEAST_N and self._at_s >= self._rests_until_s):
            self._cut(1.0 if sudden else CUT, tuple([one / size for one in acted]))
        return ""

    def _cut(self, depth: float, along: Vector) -> None:
        """Begin to cut so much of the force."""
        self._along, self._depth, self._began_s, self._uneven = along, depth, self._at_s, False
        self.share = 1.0 - depth

    def _forget(self, acted: Vector, x: Vector) -> None:
        self._rows.clear()
        self._rows.append((self._at_s, acted, x))
        self._against_m, self._along, self.share = 0.0, (), 1.0

    def _is_sudden(self, acted: Vector, size: float) -> bool:
        """Does the handle accelerate against its force as fast as the force alone could make it?"""
        if self._mass is None or size < SUDDEN_N or len(self._rows) < 7:
            return False
        rows = self._rows
        (s, _, a), (t, _, b), (u, _, c) = rows[-7], rows[-4], rows[-1]
        if u - s > 0.05 or t <= s or u <= t:
            return False
        bends = [2.0 * ((r - q) / (u - t) - (q - p) / (t - s)) / (u - s) for p, q, r in zip(a, b, c, strict=True)]
        return -inner(bends, acted) / size >= SUDDEN * size / self._mass

    def _probe(self) -> str:
        pulse = int((self._at_s - self._began_s) / self._pulse_s)
        if pulse < len(_PULSES):
            self.share = 1.0 - self._depth * _PULSES[pulse]
            return ""
        rows = [(t, inner(force, self._along), inner(x, self._along)) for t, force, x in self._rows]
        along, depth, uneven = self._along, self._depth, self._uneven
        self._forget(self._rows[-1][1], self._rows[-1][2])
        if uneven:
            return ""
        time, force, x = (np.asarray(column) for column in zip(*rows, strict=True))
        gain, sure = pushed(time, force, x, LATE_TICKS)
        most = PLAUSIBLE_KG[1] if self._mass is None else HEAVIEST * self._mass
        if gain >= 0.0 or not PLAUSIBLE_KG[0] <= -1.0 / gain <= most or sure < _DOUBT:
            self._rests_until_s = self._at_s + _PAUSE_S
            return ""
        if sure < SURE:
            if depth < 1.0:
                self._cut(1.0, along)
            return ""
        return "its handle moves against its force: is the motor reversed?"
