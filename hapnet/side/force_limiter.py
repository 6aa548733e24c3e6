"""The limit on a real device's force: no force while its dead-man switch is released, then a growing share of it.

The limiter acts between the servo's law and the device. The energy account counts the limited force, so passivity
does not depend on the limiter. It has no clock: the time is an argument.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from hapnet.checks import Vector


class ForceLimiter:
    """Limits a force before it goes to the actuators.

    ramp_s : the force grows from zero over this time after `restart`, and after the dead-man switch was pressed [s].
    dead_man : number of the button that must be held; None: there is no such switch.
    peak : maximum force of the actuators [N]. continuous : their maximum force without a time limit [N]; None: `peak`.
    thermal_s : time constant of the actuators' heating [s].
    rendered : the number of the force's components, the first ones, that have an actuator; None: all.

    The heat is the mean of the squared force over `thermal_s` (a first-order lag). Between 0.8 and 1 times the heat of
    the continuous force, the limit falls from `peak` to `continuous`.
    """

    def __init__(
        self,
        *,
        ramp_s: float = 0.0,
        dead_man: int | None = None,
        peak: float = math.inf,
        continuous: float | None = None,
        thermal_s: float = 10.0,
        rendered: int | None = None,
    ) -> None:
        self._ramp_s, self._dead_man = ramp_s, dead_man
        self._peak, self._continuous, self._thermal_s = peak, continuous, thermal_s
        self._rendered = rendered
        self._heat = 0.0
        self._share = 0.0 if ramp_s else 1.0
        self.released: bool = dead_man is not None
        """Whether there is a dead-man switch that is not pressed."""
        self.limited_s: float = 0.0
        """The total time for which the force was reduced because the actuators were hot [s]."""

    @property
    def has_switch(self) -> bool:
        """Whether there is a dead-man switch."""
        return self._dead_man is not None

    def restart(self) -> None:
        """Start the force from zero again; it then grows."""
        self._share = 0.0 if self._ramp_s else 1.0

    def is_held(self, buttons: Sequence[bool]) -> bool:
        """Whether the dead-man switch is pressed, or there is none."""
        return self._dead_man is None or (self._dead_man < len(buttons) and bool(buttons[self._dead_man]))

    def permit(self, dt: float, force: Vector, buttons: Sequence[bool]) -> Vector:
        """The part of `force` [N] that may be rendered from now on, `dt` seconds after the last call."""
        self.released = not self.is_held(buttons)
        if self._rendered is not None:
            force = (*force[: self._rendered], *(0.0,) * (len(force) - self._rendered))
        if self.released:
            self.restart()
            self._heat_up(dt, 0.0)
            return (0.0,) * len(force)
        if self._share < 1.0:
            self._share = min(1.0, self._share + dt / self._ramp_s)
        length = self._share * math.hypot(*force)
        most = self._most()
        if length > most:
            if most < self._peak:
                self.limited_s += dt
            share = self._share * most / length
        else:
            share = self._share
        self._heat_up(dt, min(length, most))
        return force if share == 1.0 else tuple([share * component for component in force])

    def _most(self) -> float:
        if self._continuous is None or self._continuous >= self._peak:
            return self._peak
        hot = min(1.0, max(0.0, (self._heat / self._continuous**2 - 0.8) / 0.2))
        if hot == 0.0:
            return self._peak
        if self._peak == math.inf:
            return self._continuous / hot
        return self._peak + hot * (self._continuous - self._peak)

    def _heat_up(self, dt: float, length: float) -> None:
        if self._continuous is not None:
            self._heat += (length * length - self._heat) * -math.expm1(-dt / self._thermal_s)
