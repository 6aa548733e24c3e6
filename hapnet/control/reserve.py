"""What a held torque can give out, the longest torque that an account can pay for, and the reserve that follows (ours).

A torque tau, computed at a tick and held for the next one, gives out ``tau . dx``. Whatever the hand does, the device
goes at most ``a = v T + r`` in one tick: v its greatest speed, T the period, r a count of its encoders. So a torque
costs at most ``|tau| a``, and no damping of the device is needed to say so. Where the force may change by D a tick at
most, a force F does not end at once: brought down by D a tick, it costs at most

    L(F) = a S(F),    S(F) = F + (F - D) + (F - 2 D) + ...      (the positive terms; S(F) = F without a limit)

Let P = phi + E be what spring and reservoir hold, the running interval's harvest counted. The servo renders torques
with ``L(|tau|) <= P`` only. At the next tick ``P' >= P - |tau| a >= L(|tau|) - |tau| a = L(|tau| - D)``: the torque
that is smaller by D may be rendered, and so on down to none. So P stays at 0 or above and no step is longer than D,
tick by tick, whatever spring and damper ask for. With nothing in the account both give nothing.

The torque must not itself break the declaration. On its way down a force F along d changes the velocity of the
smallest mass m by ``S(F) T / m d`` at most, so it is also kept to ``|x' + S(|tau|) T / m d| <= v``. (A held damper with
``B T > 2 m`` would turn the device round, faster each time.)

The reserve is what E must hold so that the account never limits the force of spring and damper. With K the largest
stiffness a spring that pulls with F_s holds at least ``F_s^2 / 2K``, and the damper adds at most ``B v``:

    reserve = max over F_s of   L(min(F_s + B v, F_max)) - F_s^2 / 2K           brought down tick by tick
              and of            (v h + r) min(F_s + B v, F_max) - F_s^2 / 2K    held for h = T + watchdog, then dropped

Software cannot act while it does not run: the second line is what it takes to outlast a servo that was stopped for as
long as the watchdog allows. Beyond that only hardware can take the torque away.
"""

from __future__ import annotations

import math
from operator import mul, sub
from typing import NamedTuple

from hapnet.checks import Vector
from hapnet.control.limits import step_towards

_SHARE = 1.0 - 1e-9
_ROUNDING_J = 1e-12
"""Of the account this is never spent: sums of floats must not look like a deficit."""


class ForceGuard:
    """Keeps a servo's force to its limits and to what the account can pay for.

    Parameters
    ----------
    limit : longest force [N]. step : largest change of the force a tick [N].
    reach : longest way in a tick, a [m]; 0: no account limits the force.
    speed : greatest speed, v [m/s]. inertia : m/T [Ns/m] of the smallest mass; infinite: not known.
    """

    __slots__ = ("_constant", "_inertia", "_limit", "_linear", "_reach", "_speed", "_square", "_step", "has_account")

    def __init__(
        self,
        *,
        limit: float = math.inf,
        step: float = math.inf,
        reach: float = 0.0,
        speed: float = math.inf,
        inertia: float = math.inf,
    ) -> None:
        self._limit = limit
        self._step = step
        self._reach = reach
        self._speed = speed
        self._inertia = inertia if speed < math.inf else math.inf
        self.has_account = reach > 0.0
        """Does the account limit the force?"""
        # S(F) <= square F^2 + linear F + constant, with equality where F is an odd number of half steps
        finite = step != math.inf
        self._square, self._linear, self._constant = (0.5 / step, 0.5, step / 8.0) if finite else (0.0, 1.0, 0.0)

    def cost(self, force: float) -> float:
        """L(F) [J]: the most that a force of this length [N] gives out until it has been brought down."""
        return self._reach * ramp(force, self._step)

    def needed(self, force: Vector) -> float:
        """What spring and reservoir must hold for this force [N] to be held for a tick and brought down [J]."""
        length = math.hypot(*force)
        return (self.cost(length) + _ROUNDING_J) / _SHARE if length > 0.0 and self._reach > 0.0 else 0.0

    def needed_after(self, force: Vector) -> float:
        """What they must hold now that this force [N] has been held, for the smaller one that comes next [J]."""
        length = math.hypot(*force) - self._step
        return (self.cost(length) + _ROUNDING_J) / _SHARE if length > 0.0 and self._reach > 0.0 else 0.0

    def admit(self, wanted: Vector, held: Vector, v: Vector, energy: float) -> Vector:
        """The force to hold from now on [N].

        Parameters
        ----------
        wanted : what spring and damper ask for [N]. held : the last force that was admitted [N].
        v : velocity [m/s]. energy : P, what spring and reservoir hold [J].
        """
        length = math.hypot(*wanted)
        ramped = length * (length * self._square + self._linear) + self._constant
        if (
            length <= self._limit
            and ramped * self._reach + _ROUNDING_J <= energy * _SHARE
            and math.dist(wanted, held) <= self._step
            and ramped <= self._inertia * (self._speed - math.hypot(*v))
        ):
            return wanted  # as nearly always; what follows is exact
        return self._limited(wanted, length, held, v, energy)

    def _limited(self, wanted: Vector, length: float, held: Vector, v: Vector, energy: float) -> Vector:
        step = self._step
        most = self._limit
        if self._reach > 0.0:
            spendable = energy * _SHARE - _ROUNDING_J
            most = min(most, longest(spendable / self._reach, step)) if spendable > 0.0 else 0.0
        if self._inertia < math.inf and length > 0.0:
            along = sum(map(mul, wanted, v)) / length
            room = math.sqrt(along * along + max(0.0, self._speed * self._speed - sum(map(mul, v, v)))) - along
            most_for_speed = longest(self._inertia * room, step)
            if length > most_for_speed:
                wanted = tuple([component * (most_for_speed / length) for component in wanted])
                length = most_for_speed
        if step != math.inf:
            wanted = step_towards(held, wanted, step)
            length = math.hypot(*wanted)
        if length <= most:
            return wanted
        return self._shortened(wanted, length, held, most)

    def _shortened(self, force: Vector, length: float, held: Vector, most: float) -> Vector:
        """The force of length `most` [N] on the way from `force` to the shortest that one step from `held` leads to.

        If that one is longer, it: the account can pay for it, see above. All of the way is within a step of `held`.
        """
        if self._step == math.inf:
            share = most / length
            return tuple([share * component for component in force])
        before = math.hypot(*held)
        if before <= self._step:
            shortest: Vector = (0.0,) * len(force)
        else:
            share = 1.0 - self._step / before
            shortest = tuple([share * component for component in held])
        way = tuple(map(sub, force, shortest))
        a, b = sum(map(mul, way, way)), sum(map(mul, shortest, way))
        c = sum(map(mul, shortest, shortest)) - most * most
        if c >= 0.0 or a == 0.0:
            return shortest
        share = (math.sqrt(b * b - a * c) - b) / a
        return tuple([s + share * w for s, w in zip(shortest, way, strict=True)])


class Holding(NamedTuple):
    """What a held torque was reckoned with."""

    speed: float
    """Greatest speed of the device, as declared [m/s]."""
    time: float
    """How long a torque may be held before it is dropped, h [s]."""
    resolution: float
    """Of the encoders [m]."""
    reserve: float
    """What the account must hold for it [J]; infinite where no account is enough."""


def ramp(force: float, step: float) -> float:
    """S(F) [N]: the sum of a force's lengths, tick by tick, on its way down by `step` a tick [N]."""
    if force <= 0.0:
        return 0.0
    if step == math.inf:
        return force
    steps = math.floor(force / step)
    return (steps + 1) * force - 0.5 * step * steps * (steps + 1)


def longest(total: float, step: float) -> float:
    """The longest force [N] with ``S(F) <= total`` [N]."""
    if step == math.inf or total <= step:
        return total
    steps = math.floor((math.sqrt(1.0 + 8.0 * total / step) - 1.0) / 2.0)
    return (total + 0.5 * step * steps * (steps + 1)) / (steps + 1)


def reserve(
    *,
    stiffness: float,
    damping: float,
    speed: float,
    period: float,
    hold: float,
    resolution: float = 0.0,
    limit: float = math.inf,
    step: float = math.inf,
) -> float:
    """The energy that the reservoir must keep [J]; infinite where none is enough.

    Parameters
    ----------
    stiffness, damping : the largest of K [N/m] and of B [Ns/m]. speed : greatest [m/s].
    period : T [s]. hold : how long a torque may be held before it is dropped, h [s]. resolution : r [m].
    limit, step : of the force [N], as `ForceGuard` has them.
    """
    reach, far = speed * period + resolution, speed * hold + resolution
    drag = damping * speed
    # S(F) <= (F + D/2)^2 / 2D, with equality where F is an odd number of half steps
    ramped = (
        _peak(reach / step, reach / 2.0, reach * step / 8.0, stiffness, drag, limit)
        if step != math.inf
        else _peak(0.0, reach, 0.0, stiffness, drag, limit)
    )
    return max(ramped, _peak(0.0, far, 0.0, stiffness, drag, limit))


def _peak(square: float, linear: float, constant: float, stiffness: float, drag: float, limit: float) -> float:
    """Largest ``square F^2/2 + linear F + constant - F_s^2 / 2K`` with ``F = min(F_s + drag, limit)``, F_s >= 0."""
    if drag >= limit:
        return 0.5 * square * limit * limit + linear * limit + constant
    curvature = 1.0 / stiffness - square
    spring = limit - drag
    if curvature > 0.0:
        spring = min(spring, (square * drag + linear) / curvature)
    if spring == math.inf:
        return math.inf
    force = spring + drag
    return 0.5 * square * force * force + linear * force + constant - spring * spring / (2.0 * stiffness)
