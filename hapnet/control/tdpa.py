"""Two-port time-domain passivity (J.-H. Ryu, J. Artigas, C. Preusche, Mechatronics 20, 2010), with a slow world.

By default with drift compensation, as later work on this law has, since the law of that paper drifts with every
contact; with a recovery of 0 there is none, as published.

The device sends its position; the world sends the force of a spring and damper between the virtual mass and a
set-position y that moves as the device does. With the reaction f to the device's velocity v, and f_c to the
set-position's v_y, the power into what lies between is P = f.v at the device and P = -f_c.v_y at the world. An observer
at each port sums it up by its sign, and each side sends its E_in with its data:

    P > 0: E_in += T P,    else E_out -= T P

What comes out at one port must have gone in at the other, or else its controller damps, or yields:

    device: E_out^d <= E_in^w,    f <- f + alpha v,        alpha = (E_out^d - E_in^w) / (T v^2)
    world:  E_out^w <= E_in^d,    v_y <- v_y - beta f_c,   beta = (E_out^w - E_in^d) / (T f_c^2)

E_in only grows, so the newest that arrived is a safe bound, whatever the link loses or reorders. What the controllers
really dissipated is subtracted from E_out; what floors and caps kept them from is a debt, and stays. P is the power of
all axes together, with one alpha and one beta: so the account is the same in any coordinates.

Derived here, for steps of any length. In a step beta acts at once: with a = B + K T/2, and y - x at the step's onset,

    f_c = s f_1,    f_1 = a (v_y - vhat) + K (y - x),    s = 1/(1 + a beta)

which is a damper 1/beta in series with the coupling, and passive for any T. It takes s (1 - s) f_1^2 T/a, most at
s = 1/2: a larger beta pays no more, and that is its cap. And floors and caps must not leave a debt to grow: the
device's f and the world's v_y fade with it, to nothing at its limit D. So no port ever owes more than D and the work of
one held force, and the energy put in at both ports together never falls below minus the sum of what they owe.
"""

from __future__ import annotations

from math import hypot, sqrt
from operator import add, mul, neg, sub

from hapnet.checks import Vector
from hapnet.control.coupling import CouplingSample, Port

_RATE_S = 0.03
"""Time constant of the world's estimate of the device's velocity [s]: a typical step of the world."""
_LONGEST_S = 0.1
"""No device is taken to go on as it did for longer than this after what it last told [s]."""


class PassivityObserver:
    """The account of one port: what went in, and what it owes, having given off more than went in at the other one.

    A total may be granted to several peers, one after the other, but no joule of it twice. So E_in never starts anew,
    and the first total that comes from a peer grants nothing: those after it are counted from it. All that the old peer
    was granted came before. (For less, the message would have to be older than the old peer's newest, and have been
    under way while the new one started and shook hands.) It costs hardly anything: until a world has heard of its
    device it commands no way and makes no force, so neither port has taken in anything yet; only the device that comes
    to a world whose spring is tense may have. Debt and credit outlive the peer, as what they stand for really came out
    or went in here. A side that ends leaves its debt unpaid, which is bounded like any.
    """

    def __init__(self) -> None:
        self.debt = 0.0
        """E_out, less what the controller dissipated, less the peers' E_in as far as it was granted here [J]."""
        self.put_in = 0.0
        """E_in [J]."""
        self._newest: float | None = None

    def observe(self, given: float, dissipated: float) -> None:
        """Over a tick or a step: what came out here [J], below 0 if it went in; what of it the controller took [J]."""
        if given > 0.0:
            self.debt += given
        else:
            self.put_in -= given
        self.debt -= dissipated

    def receive(self, energy: float) -> None:
        """The peer's E_in [J], in any order."""
        if self._newest is None:
            self._newest = energy
        elif energy > self._newest:
            self.debt -= energy - self._newest
            self._newest = energy

    def on_peer_changed(self) -> None:
        """Another peer, with a count of its own."""
        self._newest = None


class TdpaDevice:
    """The device's end: the world's reaction, and the damping that the energy calls for.

    Parameters
    ----------
    position : (n,) where the device is [m].
    velocity_floor : slower than this it does not damp [m/s]. damping_cap : the most that alpha may be [Ns/m].
    debt_limit : D [J]. stiffness : K of the world's coupling [N/m].
    """

    def __init__(
        self, *, position: Vector, velocity_floor: float, damping_cap: float, debt_limit: float, stiffness: float
    ) -> None:
        self.observer = PassivityObserver()
        self._x = position
        self._compliance = 1.0 / stiffness
        self._force = self._damper = self._none = (0.0,) * len(position)
        self._floor_square = velocity_floor * velocity_floor
        self._cap = damping_cap
        self._debt_limit = debt_limit

    @property
    def set_position(self) -> Vector:
        """Where a spring K to the device would make the world's reaction, x - f/K [m]: it tells no position itself."""
        return tuple([x + self._compliance * f for x, f in zip(self._x, self._force, strict=True)])

    def receive(self, sample: CouplingSample) -> None:
        assert isinstance(sample, Port)
        self._force = tuple(map(neg, sample.value))
        self.observer.receive(sample.energy)

    def on_peer_changed(self) -> None:
        self.observer.on_peer_changed()
        self._force = self._none

    def force(self, dt: float, x: Vector, v: Vector, held: Vector) -> Vector:
        """See `DeviceLaw.force`: -(f + alpha v)."""
        self._settle(x, held)
        self._damper = self._none
        debt = self.observer.debt
        if debt <= 0.0:
            return self._force
        share = max(0.0, 1.0 - debt / self._debt_limit)
        square = sum(map(mul, v, v))
        if square < self._floor_square:
            return tuple([share * f for f in self._force])
        alpha = min(self._cap, debt / (dt * square))
        self._damper = tuple([-alpha * u for u in v])
        return tuple([share * f - alpha * u for f, u in zip(self._force, v, strict=True)])

    def next_sample(self, x: Vector, v: Vector) -> CouplingSample:
        return Port(x, self.observer.put_in)

    def release(self, dt: float, x: Vector, held: Vector) -> None:
        self._settle(x, held)
        self._damper = self._none

    def _settle(self, x: Vector, held: Vector) -> None:
        """Observe what was held since the last tick, exactly: its whole work, and the damper's share of it apart."""
        way = tuple(map(sub, x, self._x))
        self._x = x
        damped = -sum(map(mul, self._damper, way))
        self.observer.observe(sum(map(mul, held, way)) + damped, damped)


class TdpaWorld:
    """The world's end: a set-position that moves as the device does, and yields to the force as the energy calls for.

    What a step commands is the way from where the step before should have brought y to where the device will be at
    this one's end, by its newest position, its age and its rate. So a lost message costs no way, steps of 10 and 50 ms
    in turn are no jerks, and steps shorter than the device's period go on between two messages. What y yields is lost
    for good, the known drift, unless `recovery` commands it again; the law as first published has none.

    More than twenty attributes: six parameters, and two positions with their rates, ages and forces, of this end and of
    the device's newest message.

    Parameters
    ----------
    position : (n,) where the mass is [m]; the first position of a device counts as the same place.
    stiffness, damping : K [N/m] and B [Ns/m] between set-position and mass.
    force_floor : with less force than this it does not yield [N].
    speed_limit : of the set-position [m/s]; the rest of the way follows later.
    debt_limit : D [J].
    recovery : drift is made up for with this time constant, as far as the energy goes [s]; 0: never.
    """

    def __init__(
        self,
        *,
        position: Vector,
        stiffness: float,
        damping: float,
        force_floor: float,
        speed_limit: float,
        debt_limit: float,
        recovery: float = 0.0,
    ) -> None:
        self.observer = PassivityObserver()
        self._K, self._B = stiffness, damping
        self._floor_square = force_floor * force_floor
        self._speed_limit = speed_limit
        self._debt_limit = debt_limit
        self._recovery = recovery
        self._x = self._y = position
        self._none = self._vhat = self._way = self._force = self._end_force = self._drift = (0.0,) * len(position)
        self._dt = self._age = 0.0  # of the step; of the device's newest position, since a step began with it
        self._share = 1.0
        self._arrived: Vector | None = None
        self._following = False
        self._used = self._goal = position  # the device's newest position, and where the last step should have ended
        self._rate = self._none

    @property
    def set_position(self) -> Vector:
        """y [m]."""
        return self._y

    @property
    def drift(self) -> Vector:
        """How far y has stayed behind what was commanded [m]."""
        return self._drift

    def receive(self, sample: CouplingSample) -> None:
        assert isinstance(sample, Port)
        self._arrived = sample.value
        self.observer.receive(sample.energy)

    def on_peer_changed(self) -> None:
        self.observer.on_peer_changed()
        self._arrived, self._following = None, False
        self._goal, self._rate = self._used, self._none

    def begin(self) -> None:
        self._age += self._dt
        arrived, self._arrived = self._arrived, None
        if arrived is None:
            return
        if self._following:
            age = self._age
            gain = 1.0 / (_RATE_S + age)
            ways = zip(self._rate, arrived, self._used, strict=True)
            self._rate = tuple([rate + gain * (now - before - rate * age) for rate, now, before in ways])
        else:
            self._following = True
            self._goal = arrived
        self._used, self._age = arrived, 0.0

    def impedance(self, dt: float) -> tuple[float, Vector]:
        """See `WorldLaw.impedance`: g = s a, p = s (a v_y + K (y - x))."""
        self._dt = dt
        self._command(dt)
        a = self._B + 0.5 * self._K * dt
        share = self._share = self._passive_share(a)
        return share * a, tuple([share * f for f in self._unyielding(a, self._none)])

    def moved(self, dt: float, vhat: Vector, x: Vector, v: Vector) -> None:
        """See `WorldLaw.moved`: observe the step that is over."""
        a, share = self._B + 0.5 * self._K * dt, self._share
        whole = self._unyielding(a, vhat)
        self._force = force = tuple([share * f for f in whole])
        give = (1.0 - share) * dt / a  # s beta T
        yielded = tuple([give * f for f in whole])
        self.observer.observe(sum(map(mul, force, self._way)), sum(map(mul, force, yielded)))
        moved = tuple(map(sub, self._way, yielded))
        self._y = tuple(map(add, self._y, moved))
        self._drift = tuple(map(add, self._drift, yielded))
        self._x, self._vhat = x, vhat
        half = 0.5 * self._K  # with the spring's force at the end of the step, not its mean: half a step less delay
        self._end_force = tuple([f + half * (w - u * dt) for f, w, u in zip(force, moved, vhat, strict=True)])

    def next_sample(self) -> CouplingSample:
        return Port(self._end_force, self.observer.put_in)

    def _command(self, dt: float) -> None:
        """The way that y is to move: v_y T, within the limits of speed and debt."""
        goal, drift = self._goal, self._drift
        part = dt / (self._recovery + dt) if self._recovery else 0.0
        age = min(self._age + dt, _LONGEST_S)
        ahead = [at + rate * age - before for at, rate, before in zip(self._used, self._rate, goal, strict=True)]
        way = [w + part * lost for w, lost in zip(ahead, drift, strict=True)]
        far, longest = hypot(*way), self._speed_limit * dt
        cut = 1.0 if far <= longest else longest / far
        debt = self.observer.debt
        share = cut if debt <= 0.0 else cut * max(0.0, 1.0 - debt / self._debt_limit)
        self._goal = tuple([before + cut * w for before, w in zip(goal, ahead, strict=True)])
        self._way = tuple([share * w for w in way])
        kept = 1.0 - cut * part
        self._drift = tuple([kept * lost + (cut - share) * w for lost, w in zip(drift, way, strict=True)])

    def _unyielding(self, a: float, vhat: Vector) -> list[float]:
        """f_1 of the step, where the mass moves with vhat."""
        K, dt = self._K, self._dt
        rows = zip(self._way, vhat, self._y, self._x, strict=True)
        return [a * (way / dt - u) + K * (y - x) for way, u, y, x in rows]

    def _passive_share(self, a: float) -> float:
        """s that leaves no debt, if the mass goes on as in the last step: what it does instead is observed afterwards.

        The larger root of s f_1.v_y T - s (1 - s) f_1^2 T/a = -debt, within 1/2 and 1.
        """
        if sum(map(mul, self._force, self._force)) < self._floor_square:
            return 1.0
        expected = self._unyielding(a, self._vhat)
        given = max(0.0, sum(map(mul, expected, self._way)))
        debt = self.observer.debt
        most = sum(map(mul, expected, expected)) * self._dt / a
        if given <= -debt or most == 0.0:
            return 1.0
        rest = most - given
        share: float = (rest + sqrt(max(0.0, rest * rest - 4.0 * most * debt))) / (2.0 * most)
        return max(0.5, share)
