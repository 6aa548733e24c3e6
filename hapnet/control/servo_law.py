"""The device's side of the coupling, for the two kinds of servo.

Continuous: (2) acts within the tick (only a simulated device can do that); it is the paper's device, harvested by (10).
Sampled: the torque is computed once a tick from what the encoders say, and held, as on hardware; harvested by
measurement (or by (10), which then needs damping of the device's own).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from operator import mul, sub
from typing import Literal

from hapnet.checks import Vector
from hapnet.control.coupling import Coupling
from hapnet.control.harvest import MeasuredHarvest, dissipated_by_range
from hapnet.control.pspm import Modulation

Harvest = Literal["range", "measured"]
HARVESTS: tuple[Harvest, ...] = ("range", "measured")

Extremes = Callable[[], tuple[Vector, Vector]]

TICK_SLACK_S = 1e-9  # s: a clock of whole nanoseconds may call a period a nanosecond short


class ContinuousServo:
    """PSPM for a device whose coupling acts continuously between ticks.

    Parameters
    ----------
    coupling : the set-position's way.
    damping : B's diagonal [Ns/m].
    period : PSPM runs at least this often [s], and at once on the tick after data.
    """

    def __init__(self, coupling: Coupling, *, damping: Vector, period: float) -> None:
        self.coupling = coupling
        self.damping = damping
        self._due = period - TICK_SLACK_S
        self._elapsed = 0.0

    def tick(
        self, dt: float, x: Vector, extremes: Extremes, work: float, kinetic: float, *, release: bool = False
    ) -> Modulation | None:
        """A tick `dt` seconds after the last; what PSPM did, if it ran. `release`: let the spring go (ybar = x).

        `extremes` gives the extremes of the position since it was last called [m], both ends included. The ledger is
        at the human's port: `work` is what the hand put in over the tick [J], `kinetic` the device's kinetic energy
        now [J].
        """
        self.rest(dt, x, work, kinetic)
        coupling, elapsed = self.coupling, self._elapsed
        if elapsed < self._due and not coupling.has_datum and not release:
            return None
        dissipated = dissipated_by_range(self.damping, *extremes(), elapsed)
        result = coupling.release(x, dissipated) if release else coupling.update(elapsed, x, dissipated)
        self._elapsed = 0.0
        coupling.ledger.observe(kinetic + coupling.potential(x), coupling.account)
        return result

    def resting(self, dt: float) -> int:
        """How many ticks `dt` seconds apart PSPM has nothing to do in, if no data come: `rest` is all of each."""
        if self.coupling.has_datum:
            return 0
        ticks, elapsed = 0, self._elapsed + dt
        while elapsed < self._due:
            ticks += 1
            elapsed += dt
        return ticks

    def rest(self, dt: float, x: Vector, work: float, kinetic: float) -> None:
        """What every tick begins with: the account. The arguments are those of `tick`."""
        self._elapsed += dt
        coupling = self.coupling
        ledger = coupling.ledger
        ledger.put_in(work)
        stored = kinetic + coupling.spring.between(coupling.modulator.set_position, x)
        ledger.observe(stored, coupling.account)


class SampledServo:
    """PSPM and force of a device whose torque is held from tick to tick; its ledger is at the actuator's port.

    Parameters
    ----------
    coupling, damping, period : as in `ContinuousServo`.
    harvest : "measured" (default) or "range".
    trusted_damping : lower bound of the device's own damping to harvest too [Ns/m] an axis, with "measured".
    force_limit : longest force the actuator may be asked for [N]; the spring should saturate a little below.
    resolution : of the encoders [m].
    position : the first measured position [m].
    """

    def __init__(
        self,
        coupling: Coupling,
        *,
        damping: Vector,
        period: float,
        position: Vector,
        harvest: Harvest = "measured",
        trusted_damping: Vector | None = None,
        force_limit: float | None = None,
        resolution: float = 0.0,
    ) -> None:
        self.coupling = coupling
        self.damping = damping
        self._due = period - TICK_SLACK_S
        self.harvest = harvest
        self.force_limit = math.inf if force_limit is None else force_limit
        self.resolution = resolution
        self.force: Vector = (0.0,) * len(position)
        """The force held now [N]."""
        self.trusted_damping = trusted_damping or self.force
        self._measured = MeasuredHarvest(self.trusted_damping, resolution)
        self._position = position
        self._low = self._high = position
        self._elapsed = 0.0
        self._clipped = False
        self._potential = coupling.potential(position)
        self._torque_path = 0.0
        self._boundary = 0.0

    @property
    def quantisation(self) -> float:
        """How far the true slack can lie below the measured one, because positions are whole counts [J].

        The true position is a count plus at most r/2 an axis. Summing the torque's work by parts, the difference is at
        most r/2 for every newton that the held torque ever changed by, plus the spring's curvature at the end.
        """
        r = self.resolution
        if r == 0.0:
            return 0.0
        return r / 2.0 * (self._torque_path + self._boundary) + r * r / 8.0 * self.coupling.spring.curvature_bound()

    @property
    def account(self) -> float:
        """The reservoir's content with the harvest of the running interval [J]: what the ledger counts."""
        return self.coupling.account + self._pending

    @property
    def _pending(self) -> float:
        """Harvest of the running interval, not yet in the reservoir [J]."""
        if self.harvest == "range":
            return 0.0
        return self._measured.work - (self.coupling.potential(self._position) - self._potential)

    def tick(self, dt: float, x: Vector, v: Vector, *, release: bool = False) -> Modulation | None:
        """A tick `dt` seconds after the last at measured position x [m] and velocity v [m/s].

        Sets `force`, to zero if told to `release` (ybar = x); returns what PSPM did, if it ran. What was harvested up
        to a release is measured in any case: (10) knows nothing of a torque held for so long.
        """
        coupling = self.coupling
        ledger = coupling.ledger
        ledger.put_in(self._measured.hold(self.force, self._position, x, dt))
        self._position = x
        ledger.observe(coupling.potential(x), self.account)
        self._elapsed += dt
        self._low = tuple(map(min, self._low, x))
        self._high = tuple(map(max, self._high, x))
        result = None
        if coupling.has_datum or self._elapsed >= self._due or release:
            dissipated = self._measured_now(x) if release else self._dissipated(x)
            result = coupling.release(x, dissipated) if release else coupling.update(self._elapsed, x, dissipated)
            self._potential = coupling.potential(x)
            self._elapsed = 0.0
            self._low = self._high = x
            ledger.observe(self._potential, coupling.account)
        if release:
            self.stop()
        else:
            self._render(x, v)
        return result

    def _measured_now(self, x: Vector) -> float:
        return self._measured.take(self.coupling.potential(x) - self._potential)

    def _dissipated(self, x: Vector) -> float:
        if self.harvest == "measured":
            return self._measured_now(x)
        self._measured.take(0.0)
        if self._clipped:  # the damper did not act in full
            self._clipped = False
            return 0.0
        return dissipated_by_range(self.damping, self._low, self._high, self._elapsed, self.resolution)

    def _render(self, x: Vector, v: Vector) -> None:
        spring = self.coupling.spring.force(tuple(map(sub, x, self.coupling.set_position)))
        force = tuple(map(sub, spring, map(mul, self.damping, v)))
        length = math.hypot(*force)
        if length > self.force_limit:
            share = self.force_limit / length
            force = tuple([share * component for component in force])
            self._clipped = True
        if self.resolution:
            self._torque_path += sum(map(abs, map(sub, force, self.force)))
            self._boundary = max(self._boundary, sum(map(abs, map(sub, force, spring))))
        self.force = force

    def stop(self) -> None:
        """No force from now until the next tick, the energy account still right."""
        if self.resolution:
            spring = self.coupling.spring.force(tuple(map(sub, self._position, self.coupling.set_position)))
            self._torque_path += sum(map(abs, self.force))
            self._boundary = max(self._boundary, sum(map(abs, spring)))
        self.force = (0.0,) * len(self.force)
