"""Checks of a running device: its positions change at all, and its motor still pushes in the commanded direction.

A handle that moves against its force may be pushed by a hand, or by a motor whose sign has changed. In slow motion the
two look alike. So during such motion the force is reduced for two pulses, and the handle's response is fitted as at the
start (`hapnet.plant.actuator_check`). A force that is only ever made smaller cannot make the coupling active.

If the handle accelerates against its force as only a very fast hand could do it, or if a fit speaks against the motor
without certainty, at most `PUSH_N` are rendered until that is decided: so the handle does not move far meanwhile.

No clock: times are arguments.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from hapnet.checks import Vector
from hapnet.plant.actuator_check import LATE_TICKS, PLAUSIBLE_KG, ActuatorCheck, pushed
from hapnet.records.vectors import inner

AGAINST_M, LEAST_N = 0.001, 0.25
"""If the handle has moved this far [m] against a force of at least this size [N], the force is cut."""
SHOWN_M = 0.0025
"""The distance after a probe has shown that the motor is right."""
BARELY_M, SELDOM_S = 0.0002, 0.3
"""The distance if the last probe was at least this long ago [s]."""
CUT, CUT_N = 0.35, 0.5
"""The share of the force that is cut, but at least this many newtons, up to the whole force."""
PUSH_N = 0.8
"""Force between two cuts if the cuts remove the whole force."""
SUDDEN, SUDDEN_N = 0.5, 0.8
"""If the handle accelerates against a force of at least this size [N], by at least this share of the acceleration that
the force alone could cause, the whole force is cut."""
SURE, SURE_TOGETHER = 15.0, 12.0
"""If 1/m is this many standard errors below zero in one probe, or in two to four together, the motor is reversed."""
RIGHT = 6.0
"""If 1/m is this many standard errors above zero, the motor is right."""
HEAVIEST = 8.0
"""With a hand on it the handle's apparent mass is at most this many times its own mass."""

_PULSES = (1, 0, 1, 0)
_PULSE_S, _COARSE_PULSE_S = 0.008, 0.012
_LEAST_TICKS = 3
_BEFORE, _SINCE = 12, 5
_PROBES = 4
_GROWS_S = 0.01
_FADES_S = 0.3
_PAUSE_S = 0.1
_DOUBT = 1.5
_UNEVEN = 2.5
"""A reading that is late by this many periods makes a probe useless: its time is not known well enough."""


class ForceProbe:
    """Watches force and position of a device, and cuts its force for some hundredths of a second.

    period_s : of the readings. resolution : of the encoders [m].
    mass : the handle's, the smallest over all axes [kg]; None: not known.
    """

    def __init__(self, period_s: float, mass: float | None, resolution: float = 0.0) -> None:
        self.share: float = 1.0
        """The part of the force that may be rendered from now on."""
        self._pulse_s = max(_COARSE_PULSE_S if resolution else _PULSE_S, _LEAST_TICKS * period_s)
        self._most_dt = _UNEVEN * period_s
        self._uneven = False
        self._mass = mass
        self._rows: deque[tuple[float, Vector, Vector]] = deque(maxlen=_BEFORE + 4 * max(40, _LEAST_TICKS) * 4)
        self._against_m, self._enough_m = 0.0, AGAINST_M
        self._at_s = self._began_s = self._ended_s = 0.0
        self._along: Vector = ()
        self._shares = (1.0, 1.0)  # between the cuts, and during them
        self._doubt, self._probes = 0.0, 0

    def wrong(self, dt: float, acted: Vector, x: Vector) -> str:
        """Take a reading, and the force that acted for `dt` seconds before it; returns an error message, or ""."""
        if dt > GAP_S or not self._rows:
            self._forget(acted, x)
            self.share, self._enough_m, self._doubt, self._probes = 1.0, AGAINST_M, 0.0, 0
            return ""
        self._at_s += dt
        moved = [one - two for one, two in zip(x, self._rows[-1][2], strict=True)]
        self._rows.append((self._at_s, acted, x))
        if self._along:
            self._uneven = self._uneven or dt > self._most_dt
            return self._probe()
        while len(self._rows) > _BEFORE:
            self._rows.popleft()
        self.share = min(1.0, self.share + dt / _GROWS_S)
        size = math.hypot(*acted)
        self._against_m *= math.exp(-dt / _FADES_S)
        if size >= LEAST_N:
            self._against_m = max(0.0, self._against_m - inner(acted, moved) / size)
        if self._is_sudden(acted, size):
            while len(self._rows) > _SINCE:
                self._rows.popleft()  # before them the motor may have been right
            self._cut(PUSH_N / size, 0.0, acted)
        elif size >= LEAST_N and self._is_due():
            self._cut(1.0, 1.0 - max(CUT, CUT_N / size), acted)
        return ""

    def _is_due(self) -> bool:
        """Whether the handle has moved far enough against its force."""
        rested_s = self._at_s - self._ended_s
        return rested_s >= _PAUSE_S and self._against_m >= (BARELY_M if rested_s >= SELDOM_S else self._enough_m)

    def _cut(self, between: float, inside: float, acted: Vector) -> None:
        """Begin to render two shares of the present force in turn, and record the handle's motion along it."""
        size = math.hypot(*acted)
        self._along = tuple([one / size for one in acted])
        self._shares = self.share * min(1.0, between), self.share * max(0.0, inside)
        self._began_s, self._uneven = self._at_s, False
        self.share = self._shares[1]

    def _forget(self, acted: Vector, x: Vector) -> None:
        self._rows.clear()
        self._rows.append((self._at_s, acted, x))
        self._against_m, self._along = 0.0, ()

    def _is_sudden(self, acted: Vector, size: float) -> bool:
        """Whether the handle accelerates against its force as fast as the force alone could make it."""
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
            self.share = self._shares[_PULSES[pulse]]
            return ""
        rows = [(t, inner(force, self._along), inner(x, self._along)) for t, force, x in self._rows]
        _, acted, x = self._rows[-1]
        self._forget(acted, x)
        self.share = self._shares[0]
        if self._uneven:
            self._rest()  # else it would cut the force again at once, and on a busy machine all the time
            return ""
        time, force, place = (np.asarray(column) for column in zip(*rows, strict=True))
        gain, sure = pushed(time, force, place, LATE_TICKS)
        heaviest = PLAUSIBLE_KG[1] if self._mass is None else HEAVIEST * self._mass
        reversed_ = gain < 0.0 and PLAUSIBLE_KG[0] <= -1.0 / gain <= heaviest
        self._probes += 1
        self._doubt += sure if reversed_ else -sure
        if reversed_ and self._doubt >= (SURE if self._probes == 1 else SURE_TOGETHER):
            return "its handle moves against its force: is the motor reversed?"
        right = gain > 0.0 and sure >= RIGHT
        if self._doubt >= _DOUBT and not right and self._probes < _PROBES and (size := math.hypot(*acted)):
            self._cut(PUSH_N / size, 0.0, acted)
            return ""
        self._rest()
        self._enough_m = SHOWN_M if gain > 0.0 and sure >= SURE else AGAINST_M
        return ""

    def _rest(self) -> None:
        """Probe no more for a while, and forget the doubt."""
        self._doubt, self._probes, self._ended_s = 0.0, 0, self._at_s


STILL_N, STILL_S = 1.0, 0.3
"""A position that is constant to the last digit while its force changes by this much, for this long, is an error."""
GAP_S = 0.05
"""After a longer time without a reading the check restarts: the device was silent, or the servo stalled."""


class Agreement:
    """Checks that the position changes when the force does, along the first `axes`; None: along all.

    A jaw is left out: on a stiff object it rests whatever its force is.
    """

    def __init__(self, axes: int | None = None) -> None:
        self._axes = axes
        self._still: tuple[Vector, Vector] | None = None
        self._still_s = self._most_N = 0.0

    def wrong(self, dt: float, acted: Vector, x: Vector) -> str:
        """Take a reading, and the force that acted for `dt` seconds before it; returns an error message, or ""."""
        acted, x = acted[: self._axes], x[: self._axes]
        if dt > GAP_S:
            self._still = None
            return ""
        if self._still is None or x != self._still[0]:
            self._still, self._still_s, self._most_N = (x, acted), 0.0, 0.0
            return ""
        self._still_s += dt
        self._most_N = max(self._most_N, math.dist(acted, self._still[1]))
        if self._still_s < STILL_S or self._most_N < STILL_N:
            return ""
        return f"it reads the same position while its force changes by {self._most_N:.2g} N: is its encoder connected?"


class ForceChecks:
    """All checks of a device's force and motion, at the start and while it runs.

    start : pushes the handle before control begins; None: there is no check, or it is over. axes : as for `Agreement`.
    Other parameters as for `ForceProbe`.

    Attributes
    ----------
    masses : the results of the start [kg]; empty: none. impossible : the reason against any force that the start found.
    probe : None: nothing was pushed at the start, so nothing is probed.
    """

    def __init__(
        self,
        start: ActuatorCheck | None,
        period_s: float,
        mass: float | None,
        resolution: float,
        axes: int | None = None,
    ) -> None:
        self.start = start
        self.masses: Vector = ()
        self.impossible = ""
        self.agreement = Agreement(axes)
        self.probe = None if start is None else ForceProbe(period_s, mass, resolution)
        self._period_s, self._resolution = period_s, resolution

    @property
    def share(self) -> float:
        """The part of the force that may be rendered from now on."""
        return 1.0 if self.probe is None else self.probe.share

    def take(self, ended: ActuatorCheck) -> None:
        """Take the results of the start."""
        self.impossible = ended.impossible
        if ended.masses:
            self.masses = ended.masses
            self.probe = ForceProbe(self._period_s, min(self.masses), self._resolution)

    def wrong(self, dt: float, acted: Vector, x: Vector) -> str:
        """Take a reading, and the force that acted for `dt` seconds before it; returns an error message, or ""."""
        wrong = self.agreement.wrong(dt, acted, x)
        return self.probe.wrong(dt, acted, x) if self.probe is not None and not wrong else wrong
