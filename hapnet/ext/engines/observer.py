"""An observer for surroundings that need not be passive: it keeps their account, and damping pays their debt.

The relative velocity of the proxy and an obstacle has a mean w over a step of length T. With the compliance G (the
inverse of A if no obstacle moves) and the velocity w_0 without any force

    w = w_0 + G f

The work -f . w T of a force f is known exactly for any law. The observer sums it up. If its account
would fall below zero, a damper b is solved together with the step: ``(I + b G) w = w_0 + G f``, the smallest that pays.
So it is passive for any T. If a force pushes from rest, there is no motion to damp: then only a share of it is applied.

This is time-domain passivity (Hannaford, Ryu, "Time-domain passivity control of haptic interfaces", IEEE Trans.
Robotics and Automation 2002) inside the world, but the debt is paid in the step that would make it, not in later ones.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from hapnet.checks import Array
from hapnet.mechanics.contacts import Observed

_ROUNDS = 40
"""The rounds of the bisection for b: more than a float's digits."""

_STRONGEST = 1e3
"""The strongest damper, in units of the proxy's own resistance."""

_ROUNDING = 1e-13
"""The share by which the applied force is reduced, so that rounding does not make a debt."""


class Observer:
    """The account of forces that need not be passive.

    energy_J : energy that they may give out from the start [J].
    """

    def __init__(self, energy_J: float = 0.0) -> None:
        self.energy_J: float = energy_J
        self.start_J: float = energy_J
        """The energy left to give out [J]; below 0 is a debt, which only `charge` can make."""
        self.given_J: float = 0.0
        self.paid_J: float = 0.0

    @property
    def observed(self) -> Observed:
        return Observed(self.given_J, self.paid_J)

    @property
    def stored_J(self) -> float:
        """The rest of the energy at the start [J]; energy beyond it does not count, and a debt counts as 0."""
        return max(0.0, min(self.start_J, self.energy_J))

    def charge(self, energy_J: float) -> None:
        """Enter energy that went in by another way; negative: energy that went out unobserved [J]."""
        self.energy_J += energy_J

    def passive(self, dt: float, force: Array, free: Array, compliance: Array) -> tuple[Array, Array]:
        """Return the part of `force` that is applied, with its damper, and the relative velocity w. Both go into the
        account.

        dt : T [s]. force : (m,) [N]. free : (m,) w_0 [m/s]. compliance : (m, m) G [m/s per N].
        """
        w = free + compliance @ force
        left = self.energy_J - dt * float(force @ w)
        if left >= 0.0:
            self.energy_J = left
            return force, w
        self.given_J += -left - max(0.0, -self.energy_J)
        b = self._damper(dt, force, free, compliance)
        damped = np.linalg.inv(np.eye(len(free)) + b * compliance)
        rest, pushed = damped @ free, damped @ (compliance @ force)
        share = self._share(dt, b, force, rest, pushed)
        w = rest + share * pushed
        applied = share * force - b * w
        self.paid_J += dt * b * float(w @ w)
        self.energy_J -= dt * float(applied @ w)
        return applied, w

    def _damper(self, dt: float, force: Array, free: Array, compliance: Array) -> float:
        """The smallest b that pays, or the strongest [Ns/m]."""
        # In the eigenbasis of G each b is a division, so a bisection costs little.
        values, basis = np.linalg.eigh(compliance)
        f, moved = basis.T @ force, basis.T @ (free + compliance @ force)

        def left(b: float) -> float:
            w = moved / (1.0 + b * values)
            return self.energy_J + dt * float(b * (w @ w) - f @ w)

        low, high = 0.0, _STRONGEST / float(values[-1])
        if left(high) < 0.0:
            return high
        for _ in range(_ROUNDS):
            middle = 0.5 * (low + high)
            low, high = (low, middle) if left(middle) >= 0.0 else (middle, high)
        return high

    def _share(self, dt: float, b: float, force: Array, rest: Array, pushed: Array) -> float:
        """The largest share of `force` that the account pays for, with the damper b; 0 in debt."""
        c0 = self.energy_J + dt * b * float(rest @ rest)
        c1 = dt * float(2.0 * b * (rest @ pushed) - force @ rest)
        c2 = dt * float(b * (pushed @ pushed) - force @ pushed)
        if c0 + c1 + c2 >= 0.0:
            return 1.0
        if c0 <= 0.0:
            return 0.0
        # c0 > 0 > c0 + c1 + c2: one root between 0 and 1, written without cancellation
        root = sqrt(max(0.0, c1 * c1 - 4.0 * c0 * c2))
        share = 2.0 * c0 / (root - c1) if c1 < root else 0.0
        return max(0.0, min(1.0, share)) * (1.0 - _ROUNDING)
