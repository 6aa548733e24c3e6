"""The device's local contact model: y at every tick, from the own position and the planes that the world sends.

A world's answer is a round trip late. So the world sends, beside its proxy's position, the planes that the proxy
touches or is near (`ProxySample`), and the device computes at every tick where the proxy rests for its position x:

    s = x - K'^-1 sum f_i n_i,      f_i = max(0, K_i (n_i . s - w_i))                  the proxy's static equilibrium
    y = s + g K^-1 (B + b) v        only while free of contact: it cancels a part of the dampers' drag

If the world sends a surface's curvatures, n_i and w_i are those of its tangent plane at the point nearest to x at this
tick (`hapnet.mechanics.curvature`): while the device slides over a ball, a flat plane becomes wrong before the next
answer. If the world sends friction, the proxy sticks to the place where it rested at the last tick. It slides if
sticking would need more than mu f_i (`hapnet.control.friction_cone`).

PSPM then pays for y as for any other set-position (end of Section 3). So the model need not be correct: a wrong plane
feels wrong, but creates no energy. Model-mediated teleoperation (Niemeyer, Mitra 2004; Xu et al. 2016) relies on the
model for stability, so there it must be correct.

Five rules keep the model accurate:

* A new set of planes takes effect over some milliseconds: the jump of y is compensated, and the compensation fades. A
  tool's planes change at each answer; their changes put no energy into the spring (`plane_changes.py`).
* The proxy's own position and force show where its plane really was: w = n . x_p - f/K. In contact, the filtered
  difference to the plane that was sent shifts all planes (`shift`). Free of contact, the proxy must be in front.
* The world's proxy rests at a place along the surface. If the model's proxy sticks far away from there, it moves there.
* A plane that is no longer sent is kept until the world rules it out: each answer contains the distance up to which the
  world looked around the proxy. So a wall that was met once is rendered at the next touch, at any speed.
* A world that cannot send planes is felt through its proxy's position, with compensation of the device's own motion
  since the time for which that position holds (`SelfMotion`).
"""

from __future__ import annotations

from collections.abc import Sequence
from operator import add

from hapnet import checks
from hapnet.checks import Vector
from hapnet.control.added_damping import AddedDamping
from hapnet.control.contact_effects import act, grain_force, lift, pull
from hapnet.control.contact_equations import Answer, ContactState, step
from hapnet.control.contact_plane import ContactPlane, no_planes
from hapnet.control.contact_surfaces import compare_surfaces, look_at_surfaces, meet_planes, respond_among_surfaces
from hapnet.control.coupling import CouplingSample, ProxySample, vector_of
from hapnet.control.friction_cone import RubbingProxy, take_planes
from hapnet.control.plane_changes import LENT_J
from hapnet.control.self_motion import SelfMotion, place, respond_without_planes, soften
from hapnet.control.smoothing import FilteredVelocity
from hapnet.mechanics.spring import Spring
from hapnet.params import ContactModelParams
from hapnet.records.record import PLANES, Floats

_DEFAULTS = ContactModelParams()


class ContactModel(ContactState):
    """Computes y from the own position and the planes that the world sent last.

    More than twenty attributes: the received answer, the results from it, and three filters with their own states.

    position : of the device at the start [m].
    compliance : K'^-1 of the world's virtual coupling, (n, n) [m/N].
    lead : g K^-1 (B + b), (n, n) [s]: y leads the position by this times the velocity, in free motion.
    lead_s : time constant of that velocity [s]. fade_s : time constant with which a change of planes takes effect, and
        the lead fades in contact [s]. shift_s : time constant of the planes' shift in contact [s].
    yields_below : level of the world's reservoir below which the lead shrinks, so that the hand pays for the energy
        that the world's walls dissipate; 0: never. remembers : whether planes that are no longer sent are kept.
    share_without_planes : the share of the spring's stiffness with which a world without planes is felt.
    self_motion : computes y for a world that cannot send planes. added : damps the oscillations that remain.
    """

    def __init__(
        self,
        position: Vector,
        *,
        compliance: Sequence[Sequence[float]],
        lead: Sequence[Sequence[float]],
        self_motion: SelfMotion,
        added: AddedDamping,
        lead_s: float = _DEFAULTS.lead_s,
        fade_s: float = _DEFAULTS.fade_s,
        shift_s: float = _DEFAULTS.shift_s,
        yields_below: float = _DEFAULTS.yields_below,
        remembers: bool = _DEFAULTS.remembers,
        share_without_planes: float = 1.0,
    ) -> None:
        self.in_use = 1
        self.compliance, self.lead = [list(row) for row in compliance], [list(row) for row in lead]
        self.rubbing = RubbingProxy(self.compliance, position)
        self.is_isotropic = self.rubbing.is_isotropic
        self.seen = no_planes(self.compliance, len(position))
        self.own = self_motion
        self.added = added
        self.velocity = FilteredVelocity(lead_s, len(position))
        self.fade_s = checks.positive("fade_s", fade_s)
        self.shift_s = checks.positive("shift_s", shift_s)
        self.yields_below = checks.non_negative("yields_below", yields_below)
        self.remembers = int(remembers)
        self.share_without_planes = checks.positive("share_without_planes", share_without_planes)
        self.forces = [0.0] * PLANES
        self.answer = Answer()
        self._by_grain: Vector = (0.0,) * len(position)
        self.reset(position)

    def reset(self, position: Vector) -> None:
        """Forget all planes, as the world was replaced. y continues at `position` [m]."""
        n = len(position)
        self._still = (0.0,) * n
        self._know(())
        self.rubbing.reset(position)
        for name in ("shifted", "fading", "goal", "earlier", "made_fading", "leading", "before", "s"):
            setattr(self, name, [0.0] * n)
        for name in ("start", "made_x", "made_s", "made_before", "made_y"):
            setattr(self, name, list(position))
        self.starts, self.has_goal, self.has_earlier, self.touches = 1, 0, 0, 0
        self.answer.pending, self.answer.before = 0, [0.0] * n
        self.age = self.earlier_s = 0.0
        self.velocity.reset()
        self.lent_J = LENT_J
        self.freedom = self.kept = self.kept_goal = 1.0
        self.own.reset(position)

    def release(self, position: Vector) -> None:
        """Continue y at `position` [m]; keep the planes, and the present share of the lead."""
        planes, reports, kept = self.planes, self.reports, (self.kept, self.kept_goal)
        self.reset(position)
        if reports:
            self._know(planes)
            self.kept, self.kept_goal = kept
            take_planes(self.rubbing, self.planes, self.count, len(position), False, position, 0.0)

    def _know(self, planes: Sequence[ContactPlane] | None) -> None:
        """Use these planes from now on; None: the world cannot send planes."""
        self.reports = int(planes is not None)
        self.planes = list(planes or ())
        self.count = len(self.planes)
        self.bends = int(any(one.bends.count for one in self.planes))
        self.acts = int(any(one.effects is not None for one in self.planes))

    @property
    def shift(self) -> Vector:
        """The displacement of all planes with which they agree with the proxy's force [m]."""
        return tuple(self.shifted)

    @property
    def goes_on(self) -> bool:
        """True if the next step can be made on the record alone: it takes in planes without effects, or no answer."""
        answer = self.answer
        if not answer.pending:
            return not self.acts
        takes_planes = self.reports and answer.count >= 0 and not any(one.effects for one in answer.planes)
        return not self.acts and bool(takes_planes)

    def went_on(self, dt: float, x: Vector) -> None:
        """Account for a step that was made on the record."""
        self.own.observe(dt, x)

    def receive(self, sample: CouplingSample, sent_s: float, age_s: float) -> None:
        """Take in the world's newest answer and its age; see `CouplingState.receive`."""
        proxy = sample if isinstance(sample, ProxySample) else ProxySample(vector_of(sample), 0.0, self._still, None)
        answer, position = self.answer, proxy.position
        answer.pending, answer.sent_s, answer.age_s = 1, sent_s, age_s
        answer.position, answer.force = list(position), list(proxy.force)
        answer.reach_m = -1.0 if proxy.reach_m is None else proxy.reach_m
        answer.level = -1.0 if proxy.level is None else proxy.level
        answer.planes = [ContactPlane(plane, self.compliance, position) for plane in proxy.planes or ()]
        answer.count = -1 if proxy.planes is None else len(answer.planes)

    def grain_force(self, spring: Spring) -> Vector:
        """The part of this spring's force from grains [N]."""
        return grain_force(self, self._by_grain, spring)

    def step(self, dt: float, x: Vector) -> Vector:
        """y [m] at the position x [m], `dt` seconds after the last step."""
        n, y = len(x), list(x)
        self.own.observe(dt, x)
        step(self, n, dt, x, y)
        return tuple(y)

    # -- a step's parts -----------------------------------------------------------------------------------------------

    def compare(self, n: int) -> None:
        """Find the shift with which the contact planes agree with the proxy's own position and force."""
        compare_surfaces(self, n)

    def use_planes(self, n: int, count: int) -> None:
        """Use the answer's planes, and the earlier planes that were kept, from now on."""
        answer = self.answer
        self._know(answer.planes if count >= 0 else None)
        if count < 0:
            self.own.receive(tuple(answer.position), answer.age_s)
        else:
            meet_planes(self, n)

    def respond(self, n: int, dt: float, x: Vector, y: Floats) -> None:
        """Compute y."""
        if not self.reports:
            respond_without_planes(self, n, dt, x, y)
            return
        if self.acts:
            lift(self, x)
        respond_among_surfaces(self, n, dt, x, y)
        if self.acts:
            self._by_grain = act(self, n, x, y)

    def look(self, n: int, x: Vector) -> None:
        """Find where the proxy rests for the device at x [m], with effects: y without lead and fading."""
        if self.reports:
            if self.acts:
                lift(self, x)
            look_at_surfaces(self, n, x)
            if self.acts:
                self.s[:] = list(map(add, self.s, pull(self, n, x)[0]))
        else:
            place(self.own, n, x, self.s)
            soften(self.share_without_planes, n, x, self.s)
