"""The energy that a held torque can output, the torque that an account can cover, and the reserve needed (ours).

A torque tau, computed at a tick and held until the next, outputs ``tau . dx``. Whatever the hand does, the device moves
at most ``a = v T + r`` in one tick: v is its maximum speed, T the period, r an encoder count times the root of the
number of axes, as each axis is rounded. So a torque costs at most ``|tau| a``; this needs no damping in the device. If
the force may change by at most D per tick, a force F cannot end at once: reduced by D per tick, it costs at most

    L(F) = a S(F),    S(F) = F + (F - D) + (F - 2 D) + ...      (the positive terms; S(F) = F without a limit)

Let P = phi + E be the energy in spring and reservoir, with the harvest of the current interval. The servo renders only
torques with ``L(|tau|) <= P``. At the next tick ``P' >= P - |tau| a >= L(|tau|) - |tau| a = L(|tau| - D)``: a torque
smaller by D may be rendered, and so on down to zero. So P never falls below 0 and the force never steps by more than D
in a tick, whatever the force of spring and damper. With an empty account the servo renders no force.

The torque must not accelerate the device above its declared speed. While it is reduced, a force F along d changes the
velocity of the smallest mass m by at most ``S(F) T / m d``; so the servo also keeps ``|x' + S(|tau|) T / m d| <= v``.
(A held damper with ``B T > 2 m`` would reverse the device's velocity at each tick, faster each time.)

The reserve is the energy that E must hold so that the account never limits the force of spring and damper. With K the
largest stiffness, a spring of force F_s stores at least ``F_s^2 / 2K``, and the damper adds at most ``B v``:

    reserve = max over F_s of   L(min(F_s + B v, F_max)) - F_s^2 / 2K           brought down tick by tick
              and of            (v h + r) min(F_s + B v, F_max) - F_s^2 / 2K    held for h = T + watchdog, then dropped

An account that holds less than the reserve covers a smaller force: with P in spring and reservoir together a force of
P / (v h + r), damper included, may be held (`spendable`). So a nearly empty reservoir still renders a small force: the
hand works against it, and the reservoir fills again.

Software cannot act while it does not run. The second line covers a servo that stalls for as long as the watchdog
allows. A servo that stalled for longer may stall again (`HoldTime`), and a device without a watchdog of its own then
holds the torque over ``A = v h + r``, h being that longer time. From then on the account must pay for the torque over
A: with ``F_0 = D floor(A / a)`` the guard replaces L by

    L_A(F) = A F                            up to F_0
             a (S(F) - S(F_0)) + A F_0      above

L_A(F) >= A F, so the account covers the overrun whenever it begins. And ``L_A(F) - a F >= L_A(F - D)``, so the force
still ends by steps of D. (Above F_0 this is an equality. Below, it is ``A D >= a F``. For F - D < F_0 < F, with
``m = floor(A / a)`` and F = F_0 + e, it is ``(D - e) (A - a m) >= 0``.)

An overrun that is longer than all remembered overruns may output more than the account holds: only hardware can remove
the torque then. This energy is counted, see `SampledServo.overrun_leak`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from hapnet.checks import Vector
from hapnet.control.limits import limit_step
from hapnet.records.record import Floats, Reals, Record, equation
from hapnet.records.vectors import distance, dot, length

FORGET_S = 10.0
"""The time for which an overrun is remembered in full, and the time in which it is then halved [s]."""

FARTHEST_M = 1.0
"""The largest travel of a desktop device, however long a torque is held [m]."""

_SHARE = 1.0 - 1e-9
_ROUNDING_J = 1e-12
"""This part of the account is never used, so that rounding does not look like a deficit."""


class ForceGuard(Record):
    """Limits a servo's force: its length, its change per tick, and its cost to the account.

    Parameters
    ----------
    limit : maximum force [N]. step : maximum change of the force in a tick, beyond the own motion's part [N].
    reach : maximum travel in a tick, a [m]; 0: no account limits the force.
    speed : maximum speed, v [m/s]. inertia : m/T [Ns/m] of the smallest mass; infinite: unknown.

    Attributes
    ----------
    has_account : whether the account limits the force.
    square, linear, constant : ``S(F) <= square F^2 + linear F + constant``, with equality if F is an odd number of
        half steps.
    held_m, plain, more : A, F_0 and ``A F_0 - a S(F_0)`` of L_A; 0, infinite and 0 while L applies.
    """

    limit: float
    step: float
    reach: float
    speed: float
    inertia: float
    has_account: int
    square: float
    linear: float
    constant: float
    held_m: float
    plain: float
    more: float

    def __init__(
        self,
        *,
        limit: float = math.inf,
        step: float = math.inf,
        reach: float = 0.0,
        speed: float = math.inf,
        inertia: float = math.inf,
    ) -> None:
        super().__init__()
        self.limit, self.step, self.reach, self.speed = limit, step, reach, speed
        self.inertia = inertia if speed < math.inf else math.inf
        self.has_account = int(reach > 0.0)
        finite = step != math.inf
        self.square, self.linear, self.constant = (0.5 / step, 0.5, step / 8.0) if finite else (0.0, 1.0, 0.0)
        self.plain = math.inf

    def cover(self, held_m: float) -> None:
        """From now on the account must also pay for a force held over the travel `held_m`, A [m]; 0: only per tick.

        Nothing changes if no account limits the force, or if A is no longer than the travel in a tick.
        """
        self.held_m = held_m if self.has_account and held_m > self.reach else 0.0
        if self.held_m and self.step != math.inf:
            self.plain = self.step * math.floor(held_m / self.reach)
            self.more = held_m * self.plain - self.reach * ramp(self.plain, self.step)
        else:
            self.plain, self.more = math.inf, 0.0

    def cost(self, force: float) -> float:
        """L(F), or L_A(F) [J]: the energy that a force of this length [N] needs until it has been reduced to zero."""
        return cost(self, force)

    def needed(self, force: Vector) -> float:
        """Energy needed in spring and reservoir to hold this force [N] for a tick and then reduce it to zero [J]."""
        return needed(self, length(len(force), force))

    def admit(self, wanted: Vector, held: Vector, caused: Vector, v: Vector, energy: float) -> Vector:
        """The force to hold from now on [N].

        wanted : force of spring and damper [N]. held : the last force admitted [N].
        caused : the change of the spring's force since then that the device's own motion causes [N].
        v : velocity [m/s]. energy : P, the energy in spring and reservoir [J].
        """
        force = list(wanted)
        return tuple(force) if admit(self, len(force), force, held, caused, v, energy) else wanted


@equation
def cost(guard: ForceGuard, force: float) -> float:
    """The energy that a force of this length needs until it is reduced to zero [J]: `ForceGuard.cost`."""
    if guard.held_m > 0.0 and force <= guard.plain:
        return guard.held_m * force
    return guard.reach * ramp(force, guard.step) + guard.more


@equation
def needed(guard: ForceGuard, force: float) -> float:
    """Energy needed in spring and reservoir to hold a force of this length [N] for a tick, and then end it [J]."""
    if force > 0.0 and guard.reach > 0.0:
        return (cost(guard, force) + _ROUNDING_J) / _SHARE
    return 0.0


@equation
def _affordable(guard: ForceGuard, energy: float) -> float:
    """The largest force [N] that costs no more than this energy [J]."""
    if guard.held_m > 0.0 and energy <= guard.held_m * guard.plain:
        return energy / guard.held_m
    return maximum((energy - guard.more) / guard.reach, guard.step)


@equation
def admit(guard: ForceGuard, n: int, wanted: Floats, held: Reals, caused: Reals, v: Reals, energy: float) -> bool:
    """Replace `wanted` by the force to hold: `ForceGuard.admit`. Returns whether the force changed."""
    size = length(n, wanted)
    ramped = size * (size * guard.square + guard.linear) + guard.constant
    if (
        guard.held_m == 0.0
        and size <= guard.limit
        and ramped * guard.reach + _ROUNDING_J <= energy * _SHARE
        and distance(n, wanted, held) <= guard.step
        and ramped <= guard.inertia * (guard.speed - length(n, v))
    ):
        return False  # the usual case; `_limit` computes exactly
    return _limit(guard, n, size, wanted, held, caused, v, energy)


@equation
def _limit(
    guard: ForceGuard, n: int, size: float, wanted: Floats, held: Reals, caused: Reals, v: Reals, energy: float
) -> bool:
    """Do the exact computation of `admit`. size : the length of `wanted` [N]."""
    step = guard.step
    most = guard.limit
    changed = False
    if guard.reach > 0.0:
        spendable = energy * _SHARE - _ROUNDING_J
        most = min(most, _affordable(guard, spendable)) if spendable > 0.0 else 0.0
    if guard.inertia < math.inf:
        changed = limit_speed(n, wanted, v, guard.speed, guard.inertia, step)
    if step != math.inf:
        changed = limit_step(n, held, caused, wanted, step) or changed
    if changed:
        size = length(n, wanted)
    if size <= most:
        return changed
    _shorten(guard, n, size, wanted, held, most)
    return True


@equation
def limit_speed(n: int, force: Floats, v: Reals, speed: float, inertia: float, step: float) -> bool:
    """Shorten `force` [N] so that it does not accelerate the smallest mass beyond `speed` [m/s], see the module's text.

    v : velocity [m/s]. inertia : m/T [Ns/m]. step : maximum change of the force in a tick [N]. Returns whether the
    force changed.
    """
    size = length(n, force)
    if size == 0.0:
        return False
    along = dot(n, force, v) / size
    room = math.sqrt(along * along + max(0.0, speed * speed - dot(n, v, v))) - along
    most = maximum(inertia * room, step)
    if size <= most:
        return False
    for i in range(n):
        force[i] = force[i] * (most / size)
    return True


@equation
def _shorten(guard: ForceGuard, n: int, size: float, force: Floats, held: Reals, most: float) -> None:
    """Replace `force` by the force of length `most` [N] between it and the shortest force within one step of `held`.

    If this shortest force is longer than `most`, it is the result: the account can cover it, see the module's text.
    Every force between the two is allowed by the limit of the step, as both ends are, and what it allows is convex.
    """
    if guard.step == math.inf:
        share = most / size
        for i in range(n):
            force[i] = share * force[i]
        return
    before = length(n, held)
    kept = 0.0 if before <= guard.step else 1.0 - guard.step / before
    a = b = c = 0.0
    for i in range(n):
        shortest = kept * held[i]
        gap = force[i] - shortest
        a += gap * gap
        b += shortest * gap
        c += shortest * shortest
    c -= most * most
    share = 0.0 if c >= 0.0 or a == 0.0 else (math.sqrt(b * b - a * c) - b) / a
    for i in range(n):
        shortest = kept * held[i]
        force[i] = shortest + share * (force[i] - shortest)


class HoldTime:
    """Estimates how long a torque may be held before the servo's next tick, from its overruns so far (ours).

    A servo that stalled may stall again for as long: for the longest overrun of the last `FORGET_S`. After that the
    estimate halves in each further `FORGET_S`, so that the force returns gradually.

    allowed : the time for which a torque may always be held [s].
    most : the longest overrun to consider [s]; a longer one costs no more.
    """

    __slots__ = ("_age", "_before", "_maximum", "allowed", "expected", "most")

    def __init__(self, allowed: float, most: float = math.inf) -> None:
        self.allowed, self.most = allowed, most
        self.expected: float = allowed
        """The time for which the next torque may be held [s]."""
        self._maximum = self._before = self._age = 0.0  # of the present span of FORGET_S, and of the span before

    def tick(self, dt: float, held: float) -> None:
        """Count a tick `dt` seconds after the last; a torque may have been held for `held` seconds of them."""
        self._age += dt
        if self._age > FORGET_S:
            self._before = self._maximum if self._age <= 2.0 * FORGET_S else 0.0
            self._maximum = self._age = 0.0
        self._maximum = max(self._maximum, min(held, self.most))
        fading = self.expected * 0.5 ** (dt / FORGET_S)
        self.expected = max(self.allowed, fading, self._maximum, self._before)


class Holding(NamedTuple):
    """The values from which the guard of a held torque was computed."""

    speed: float
    """Maximum speed of the device, as declared [m/s]."""
    time: float
    """The longest time for which a torque is held before it is dropped, h [s]."""
    needed: float
    """Energy that the account must hold for that torque [J]; infinite if no account is enough."""
    reserve: float
    """Energy that the account keeps for that torque [J]: `needed`, unless the ceiling is too low."""
    far: float
    """v h + r: the largest travel while a torque is held for h [m]."""
    drag: float
    """B v, the damper's largest force [N]."""

    def far_in(self, time: float) -> float:
        """The largest travel while a torque is held for `time` [s]: A, in place of `far` [m]."""
        return self.far + self.speed * (time - self.time)

    @property
    def most(self) -> float:
        """The time in which the device can move `FARTHEST_M`, at least `time` [s]."""
        return self.time + max(0.0, FARTHEST_M - self.far) / self.speed


@equation
def spendable(at_hand: float, reserve: float, held_m: float, drag_N: float, stiffness: float) -> float:
    """The most energy that the spring may hold [J], of the energy P in spring and reservoir.

    at_hand : P [J]. reserve : see the module's text [J]. held_m : v h + r [m]; 0: no force is held. drag_N : B v [N].
    stiffness : the largest eigenvalue of K [N/m].
    """
    free = at_hand - reserve
    if held_m <= 0.0 or at_hand <= 0.0:
        return free
    covered = at_hand / held_m - drag_N
    if covered <= 0.0:
        return free
    return max(free, min(at_hand, covered * covered / (2.0 * stiffness)))


@equation
def ramp(force: float, step: float) -> float:
    """S(F) [N]: the sum over ticks of a force's length while it is reduced by `step` per tick [N]."""
    if force <= 0.0:
        return 0.0
    if step == math.inf:
        return force
    steps = math.floor(force / step)
    return (steps + 1) * force - 0.5 * step * steps * (steps + 1)


@equation
def maximum(total: float, step: float) -> float:
    """The largest force [N] with ``S(F) <= total`` [N]."""
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
    rounding: float = 0.0,
    limit: float = math.inf,
    step: float = math.inf,
) -> float:
    """The energy that the reservoir must keep [J]; infinite if no energy is enough.

    stiffness, damping : the largest of K [N/m] and of B [Ns/m]. speed : maximum speed [m/s].
    period : T [s]. hold : the longest time for which a torque is held, h [s]. rounding : r [m].
    limit, step : of the force [N], as in `ForceGuard`.
    """
    reach, far = speed * period + rounding, speed * hold + rounding
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
