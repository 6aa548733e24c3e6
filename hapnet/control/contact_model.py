"""The device's local contact model: y at every tick, from the own position and the planes that the world tells.

What a world answers comes a round trip late. So the world tells, beside its proxy's position, the planes that the proxy
touches or is near (`Proxy`), and the device computes at every tick where the proxy rests for the position x now:

    s = x - K'^-1 sum f_i n_i,      f_i = max(0, K_i (n_i . s - w_i))                  the proxy's static equilibrium
    y = s + g K^-1 (B + b) v        only while free of contact: it cancels a part of the dampers' drag

Where the world tells how a surface bends, n_i and w_i are those of its tangent plane as seen from x at this tick
(`hapnet.mechanics.curvature`): while the device slides over a ball, a flat plane is wrong by the time of the next one.
Where it tells friction, the proxy sticks to the place where it rested at the last tick. It slides where sticking would
take more than mu f_i (`hapnet.control.friction_cone`).

PSPM then pays for y as for any other set-position (end of Section 3). So the model need not be right: a wrong plane
feels wrong, but creates no energy. Model-mediated teleoperation (Niemeyer, Mitra 2004; Xu et al. 2016) relies on the
model for stability, and needs it to be right.

Five things keep the model true:

* A new set of planes takes effect over some milliseconds: what y would jump by is added to y and fades.
* The proxy's own position and force say where its plane really was: w = n . x_p - f/K. While in contact, the difference
  to the plane that was told shifts all planes (`shift`), filtered. Free of contact, the proxy must be in front.
* A world that says along a surface where its proxy rests moves the place where the model's sticks, if that is far away.
* A plane that is told no more is remembered, until the world says that there is none: its answer tells how far around
  its proxy it has looked. So a wall that was met once is felt at the next touch, however fast that is.
* A world that can tell no planes is felt through its proxy's position, less the own motion since the time for which
  that position stands (`OwnMotion`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from operator import add, mul, sub

from hapnet import checks
from hapnet.checks import MOST_PLANES, Vector
from hapnet.control.added_damping import AddedDamping
from hapnet.control.coupling import CouplingSample, Proxy, vector_of
from hapnet.control.friction_cone import RubbingProxy
from hapnet.control.own_motion import OwnMotion
from hapnet.control.smoothing import FilteredVelocity, low_passed
from hapnet.control.told_plane import ToldPlane, along
from hapnet.params import ContactModelParams

_DEFAULTS = ContactModelParams()

FORGET_S = 0.5
"""Time constant with which that shift goes when there is no contact [s]."""

SETTLED_MPS = 0.02
"""A proxy that moves faster along a normal says nothing about the plane [m/s]: its force is the mean over a step, its
position the step's end. In contact it moves seven times slower than the hand, with the default springs."""

SWEEPS = 32
"""The most Gauss-Seidel sweeps over the planes. Orthogonal ones need one, and one more to see it."""

SETTLED_N = 1e-4
"""A sweep that changes no force by more than this [N] is the last."""

SLIP_M = 5e-4
"""A proxy that rubs and moves by more than this within a tick, beside the device's way, takes some milliseconds."""

ROUNDS = 2
"""How often several surfaces that bend are seen anew from where the proxy rests among their tangent planes."""


YIELDING_S = 0.3
"""Time constant with which the lead follows the level of the world's reservoir [s]: the hand must not notice."""


class ContactModel:
    """Computes y from the own position and the planes that the world told last.

    More than twenty attributes: what was told, what follows from it, and three filters each change on their own.

    Parameters
    ----------
    position : the device's at the start [m].
    compliance : K'^-1 of the world's virtual coupling, (n, n) [m/N].
    lead : g K^-1 (B + b), (n, n) [s]: y leads the position by this times the velocity, in free motion.
    lead_s : time constant of that velocity [s]. fade_s : time constant with which a change of planes takes effect, and
        the lead goes in contact [s]. shift_s : time constant of the planes' shift in contact [s].
    yields_below : level of the world's reservoir below which the lead gives way, so that the hand pays for what the
        world's walls dissipate; 0: never. remembers : do planes that are told no more stay known?
    untold_share : the share of the spring's stiffness with which a world is felt that can tell no planes.
    own_motion : computes y for a world that can tell no planes. added : the damping for what is left to swing.
    """

    def __init__(
        self,
        position: Vector,
        *,
        compliance: Sequence[Sequence[float]],
        lead: Sequence[Sequence[float]],
        own_motion: OwnMotion,
        added: AddedDamping,
        lead_s: float = _DEFAULTS.lead_s,
        fade_s: float = _DEFAULTS.fade_s,
        shift_s: float = _DEFAULTS.shift_s,
        yields_below: float = _DEFAULTS.yields_below,
        remembers: bool = _DEFAULTS.remembers,
        untold_share: float = 1.0,
    ) -> None:
        self._compliance = [tuple(row) for row in compliance]
        softest = self._compliance[0][0]
        self._rubbing = RubbingProxy(self._compliance)
        self._is_isotropic = all(
            part == (softest if i == j else 0.0) for i, row in enumerate(compliance) for j, part in enumerate(row)
        )
        self._lead = [tuple(row) for row in lead]
        self._own_motion = own_motion
        self._added = added
        self._velocity = FilteredVelocity(lead_s)
        self._fade_s = checks.positive("fade_s", fade_s)
        self._shift_s = checks.positive("shift_s", shift_s)
        self._yields_below = checks.non_negative("yields_below", yields_below)
        self._remembers = remembers
        self._untold_share = checks.positive("untold_share", untold_share)
        self.reset(position)

    def reset(self, position: Vector) -> None:
        """Forget all planes: their world was replaced. y continues at `position` [m]."""
        self._still = (0.0,) * len(position)
        self._planes: tuple[ToldPlane, ...] | None = ()
        self._rubbing.reset(position)
        self._shift = self._fading = self._still
        self._wanted_shift: Vector | None = None
        self._pending: tuple[Proxy, float, float] | None = None
        self._earlier: tuple[Vector, float] | None = None
        self._age = 0.0
        self._velocity.reset()
        self._freedom = 1.0
        self._kept = self._kept_goal = 1.0
        self._start: Vector | None = position
        self._made = position, position, self._still, position, position
        self._own_motion.reset(position)

    def release(self, position: Vector) -> None:
        """y continues at `position` [m]; what the world told stays known, and how far the lead has given way."""
        planes, kept = self._planes, (self._kept, self._kept_goal)
        self.reset(position)
        if planes is not None:
            self._planes, (self._kept, self._kept_goal) = planes, kept
            self._rubbing.told(planes, None)

    @property
    def shift(self) -> Vector:
        """By how much all planes are moved, so that they agree with what the proxy feels [m]."""
        return self._shift

    @property
    def planes_share(self) -> Vector:
        """The part of the last y - x that the planes have made, and what is left of a change of them [m]."""
        x, s, fading, _, _ = self._made
        return tuple([b - a + c for a, b, c in zip(x, s, fading, strict=True)])

    @property
    def damping_share(self) -> Vector:
        """The part of the last y - x that is added damping [m]."""
        *_, before, y = self._made
        return tuple(map(sub, y, before))

    @property
    def lead_kept(self) -> float:
        """The share of the lead that has not given way, 0 to 1."""
        return self._kept

    def receive(self, sample: CouplingSample, sent_s: float, age_s: float) -> None:
        """The world's newest answer, and how old it is; see `CouplingState.receive`."""
        if not isinstance(sample, Proxy):
            sample = Proxy(vector_of(sample), 0.0, self._still, None)
        self._pending = sample, sent_s, age_s

    def step(self, dt: float, x: Vector) -> Vector:
        """y [m] at the position x [m], `dt` seconds after the last step."""
        self._own_motion.observe(dt, x)
        self._age += dt
        if self._start is not None:
            self._fading = tuple(map(sub, self._start, x))
            self._start = None
        news = self._pending is not None
        if self._pending is not None:
            self._take(*self._pending, x)
        velocity = self._velocity.step(dt, x)
        (self._kept,) = low_passed(dt, YIELDING_S, (self._kept,), (self._kept_goal,))
        lead = tuple([self._kept * sum(map(mul, row, velocity)) for row in self._lead])
        if self._planes is None:
            self._rubbing.place = x
            lead = tuple([part / self._untold_share for part in lead])
            y = self._faded(dt, self._softened(x, self._own_motion.step(dt, x, lead)))
            damped = self._added.step(dt, x, y, self._age, 1.0, swings=True)
            self._made = x, x, self._still, y, damped
            return damped
        self._rubbing.agree(dt)
        before = self._rubbing.place
        s, touches = self._rest(x, self._planes)
        self._rubbing.place = s
        if self._rubbing.rubs and not news:
            slip = tuple([a - b - (c - d) for a, b, c, d in zip(s, before, x, self._made[0], strict=True)])
            if math.hypot(*slip) > SLIP_M:  # it has slipped off something round
                self._fading = tuple(map(sub, self._fading, slip))
        (self._freedom,) = low_passed(dt, self._fade_s, (self._freedom,), (0.0 if touches else 1.0,))
        self._settle(dt)
        y = self._faded(dt, tuple([a + self._freedom * b for a, b in zip(s, lead, strict=True)]))
        damped = self._added.step(dt, x, y, self._age, self._freedom, swings=False)
        self._made = x, s, self._fading, y, damped
        return damped

    # -- what the world told ------------------------------------------------------------------------------------------

    def _take(self, told: Proxy, sent_s: float, age_s: float, x: Vector) -> None:
        self._pending = None
        before = self._model(x)
        self._age = age_s
        level = 1.0 if told.level is None else told.level
        self._kept_goal = min(1.0, level / self._yields_below) if self._yields_below else 1.0
        if told.planes is None:
            self._own_motion.receive(told.position, age_s)
            self._planes = None
        else:
            earlier = self._planes or ()
            planes = tuple([ToldPlane(plane, self._compliance, told.position) for plane in told.planes])
            self._wanted_shift = self._shift_wanted(planes, told, self._proxy_velocity(told.position, sent_s), earlier)
            self._planes = planes + self._remembered(planes, told, earlier)
            self._rubbing.told(self._planes, told.position if told.force != self._still else None)
        after = self._model(x)
        if after != before:
            self._fading = tuple(map(add, self._fading, map(sub, before, after)))

    def _remembered(
        self, planes: Sequence[ToldPlane], told: Proxy, earlier: Sequence[ToldPlane]
    ) -> tuple[ToldPlane, ...]:
        """The earlier planes that this answer neither tells nor denies; with the told ones as many as can be told."""
        if not self._remembers or told.reach_m is None:
            return ()
        kept = [one for one in earlier if not one.withdrawn(planes, told.position, told.reach_m)]
        return tuple(kept[: MOST_PLANES - len(planes)])

    def _model(self, x: Vector) -> Vector:
        """y of the present model, but for lead and fading."""
        if self._planes is None:
            return self._softened(x, self._own_motion.at(x))
        return self._rest(x, self._planes)[0]

    def _proxy_velocity(self, position: Vector, sent_s: float) -> Vector:
        """The proxy's, since the message before [m/s]; zero with the first."""
        earlier, self._earlier = self._earlier, (position, sent_s)
        if earlier is None or sent_s <= earlier[1]:
            return self._still
        return tuple([(new - old) / (sent_s - earlier[1]) for old, new in zip(earlier[0], position, strict=True)])

    def _shift_wanted(
        self, planes: Sequence[ToldPlane], told: Proxy, velocity: Vector, earlier: Sequence[ToldPlane]
    ) -> Vector | None:
        """The shift with which the told planes agree with the proxy's own position and force; None: nothing known.

        The force is of the step that has ended, so a plane that was not there before it proves nothing yet.
        """
        wanted: list[float] = [0.0] * len(self._still)
        known = False
        touched = planes
        if self._rubbing.rubs and len(touched) > 1:  # friction on one plane may be along the normal of another
            touched = tuple([one for one in touched if one.depth(told.position) > 0.0])
            if len(touched) > 1:
                return self._shift
        for one in touched:
            moving = abs(sum(map(mul, one.normal, velocity))) > SETTLED_MPS
            if moving or not any(one.same(other.seen_from(told.position, 0.0), told.position) for other in earlier):
                return self._shift
            depth = one.depth(told.position)
            force = -sum(map(mul, one.normal, told.force))
            if force > 0.0:
                error = depth - force / one.stiffness  # the plane is really so much deeper
            elif depth > 0.0 and told.force == self._still:
                error = depth
            else:
                continue
            known = True
            for axis, n in enumerate(one.normal):
                wanted[axis] += n * error
        return tuple(wanted) if known else None

    def _settle(self, dt: float) -> None:
        """Let the shift approach what the last answer asks for."""
        goal, constant = (self._still, FORGET_S) if self._wanted_shift is None else (self._wanted_shift, self._shift_s)
        if goal == self._shift:
            return
        self._shift = low_passed(dt, constant, self._shift, goal)

    def _softened(self, x: Vector, y: Vector) -> Vector:
        """y for a world that can tell no planes: its answer is late, and a stiff spring to it would ring."""
        share = self._untold_share
        return y if share == 1.0 else tuple([a + share * (b - a) for a, b in zip(x, y, strict=True)])

    # -- y ------------------------------------------------------------------------------------------------------------

    def _rest(self, x: Vector, planes: Sequence[ToldPlane]) -> tuple[Vector, bool]:
        """Where the proxy rests for the device at x [m], and whether it touches anything there."""
        if self._rubbing.rubs:
            return self._rubbing.rest(x, planes, self._shift, self._age, ROUNDS)
        if not any(one.curvatures for one in planes):
            return self._rest_on(x, planes)
        # With springs that are alike in all directions, the point of one surface nearest to x is nearest to s too.
        rounds = 1 if self._is_isotropic and len(planes) == 1 else ROUNDS
        s, touches, forces = x, False, [0.0] * len(planes)
        for _ in range(rounds):
            place = tuple(map(sub, s, self._shift))
            s, touches = self._rest_on(x, [one.seen_from(place, self._age) for one in planes], forces)
        return s, touches

    def _rest_on(
        self, x: Vector, planes: Sequence[ToldPlane], forces: list[float] | None = None
    ) -> tuple[Vector, bool]:
        """`_rest` on flat planes; `forces` : where the search begins and what it has found [N]."""
        shift = self._shift
        if len(planes) == 1:  # mostly
            one = planes[0]
            depth = sum(map(mul, one.normal, map(sub, x, shift))) - one.now(self._age)
            if depth <= 0.0:
                return x, False
            force = depth / one.softness
            return tuple([a - force * r for a, r in zip(x, one.response, strict=True)]), True
        s = x
        if forces is None:
            forces = [0.0] * len(planes)
        for known, one in zip(forces, planes, strict=True):
            if known:
                s = along(s, one.response, -known)
        for _ in range(SWEEPS):
            moved = False
            for i, one in enumerate(planes):
                depth = sum(map(mul, one.normal, map(sub, s, shift))) - one.now(self._age)
                force = max(0.0, forces[i] + (depth - forces[i] / one.stiffness) / one.softness)
                if force != forces[i]:
                    change = force - forces[i]
                    forces[i] = force
                    s = tuple([a - change * r for a, r in zip(s, one.response, strict=True)])
                    moved = moved or abs(change) > SETTLED_N
            if not moved:
                break
        return s, any(forces)

    def _faded(self, dt: float, y: Vector) -> Vector:
        if self._fading == self._still:
            return y
        share = self._fade_s / (self._fade_s + dt)
        fading = tuple([share * part for part in self._fading])
        self._fading = fading if math.hypot(*fading) > 1e-9 else self._still
        return tuple(map(add, y, fading))
