"""Why a pair of robots vibrates, from the recording of a run, and what to set.

Measured are the vibration of the leader's force in the last two seconds, in which its hand should rest, the round trip,
the follower's friction and the stiffness of its contact. Masses, dampings and gains are those of the run's parameters;
the hand is assumed to hold the leader loosely, which is the worst. Four causes are compared with their bounds
(`hapnet.ext.doctor.pair_bounds`):

| cause | bound |
|---|---|
| stiffness | the leader on its held spring: a growing motion without any link |
| rate | the same at the follower, whose servo is slow for its spring |
| delay | the loop over the link: Nyquist, with the measured round trip |
| friction | a law takes more friction for known than the follower has, and pushes on by itself |

If several apply, the one whose frequency is nearest to the measured one is named.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from hapnet.checks import Array
from hapnet.couplings.registry import coupling
from hapnet.couplings.rendering import largest
from hapnet.couplings.spec import RENDERED_DAMPING
from hapnet.errors import RecordingError
from hapnet.ext.doctor.machine import OK, SKIPPED, WARNING, Check
from hapnet.ext.doctor.pair_bounds import MARGIN, LinearRobot, Loop, held_loop, largest_stiffness, smallest_rate
from hapnet.param_values import flatten
from hapnet.params import RELAXED_HAND, Params, follows, known_damping
from hapnet.recording.opened import Recorded, fitting, opened
from hapnet.recording.samples import Recording

FELT_N = 0.1
"""A vibration of a smaller amplitude is hardly felt [N]."""

LAST_S = 2.0
_LOWEST_HZ = 1.5
_KNOWN = 1.15
"""A known friction above this share of the measured one counts as too much."""
_PART_S = 0.01


class Vibration(NamedTuple):
    """Of the leader's force: amplitude [N] and frequency [Hz]."""

    amplitude_N: float
    hz: float


@dataclass(frozen=True)
class VibrationCause:
    """A cause of a vibration.

    hz : the frequency that it would have [Hz]; 0: any. why : in words. settings : what to set, by parameters' names.
    """

    name: str
    hz: float
    why: str
    settings: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class PairMeasures:
    """The measures of a pair in a run. friction_N : of the follower, measured [N]; NaN: it did not move enough."""

    params: Params
    tuning: Mapping[str, Any]
    round_trip_s: float
    vibration: Vibration
    friction_N: float
    contact_N_m: float

    @property
    def leader(self) -> LinearRobot:
        device, own = self.params.device, self.tuning
        hand = (float(RELAXED_HAND[f"operator_model.{name}"]) for name in ("mass", "damping", "stiffness"))
        K = own.get("leader_stiffness_N_m", 0.0) or largest(device.stiffness)
        B = own.get("leader_damping_Ns_m", largest(device.damping))
        return LinearRobot(device.mass, known_damping(self.params), K, B, device.servo_hz, *hand)

    @property
    def follower(self) -> LinearRobot:
        robot, world = self.params.follower, self.params.world
        hz = math.inf if robot.position_servo else robot.servo_hz
        return LinearRobot(robot.mass, robot.own_damping, largest(world.stiffness), largest(world.damping), hz)

    @property
    def accelerates(self) -> bool:
        """Whether the law controls accelerations, not springs."""
        return "position_gain" in self.tuning

    def causes(self) -> Iterator[VibrationCause]:
        """The causes whose bound is exceeded."""
        yield from self._friction()
        if not self.accelerates:
            yield from self._held()
        yield from self._delay()

    def _friction(self) -> Iterator[VibrationCause]:
        known = float(self.tuning.get("follower_friction_N", 0.0))
        share = known / self.params.follower.friction_N if self.params.follower.friction_N else 0.0
        if share and math.isfinite(self.friction_N) and known > _KNOWN * self.friction_N:
            advised = share * self.friction_N / known
            why = f"friction: {known:.3g} N are taken for known, {self.friction_N:.3g} N were measured"
            yield VibrationCause("friction", 0.0, why, {"bilateral.friction_known": advised})

    def _held(self) -> Iterator[VibrationCause]:
        growth, hz = held_loop(self.leader)
        if growth > 1.0 and (bound := largest_stiffness(self.leader)) < self.leader.stiffness:
            why = (
                f"stiffness: {self.leader.stiffness:.4g} N/m are above the {bound:.4g} N/m of this device at "
                f"{self.leader.servo_hz:g} Hz"
            )
            yield VibrationCause("stiffness", hz, why, {"device.stiffness": bound / MARGIN})
        growth, hz = held_loop(self.follower)
        if growth > 1.0:
            rate, bound = smallest_rate(self.follower), largest_stiffness(self.follower)
            why = (
                f"rate: at {self.follower.servo_hz:g} Hz the follower bears {bound:.4g} N/m, not "
                f"{self.follower.stiffness:.4g}"
            )
            settings = {"follower.servo_hz": rate} if math.isfinite(rate) else {"world.stiffness": bound / MARGIN}
            yield VibrationCause("rate", hz, why, settings)

    def _delay(self) -> Iterator[VibrationCause]:
        trip, spec = self.round_trip_s, coupling(self.params.coupling)
        ms = 1e3 * trip
        if self.accelerates:
            gain = float(self.tuning["position_gain"])
            if trip * math.sqrt(gain) > 1.0:
                why = f"delay: a round trip of {ms:.0f} ms is long for a position gain of {gain:g} 1/s^2"
                yield VibrationCause("delay", 0.0, why, {"bilateral.position_gain": trip**-2 / MARGIN})
            return
        velocities = "leader_stiffness_N_m" in self.tuning
        for contact in dict.fromkeys((0.0, self.contact_N_m)):
            loop = Loop(self.leader, self.follower, trip, spec.senses, contact, velocities)
            if not loop.unstable():
                continue
            if spec.senses:
                advised = loop.smallest_damping(10.0 * RENDERED_DAMPING)
                why = f"delay: with a round trip of {ms:.0f} ms a contact of {contact:.4g} N/m is too stiff"
                settings = {"device.damping": advised} if math.isfinite(advised) else {}
                yield VibrationCause("delay", loop.hz(), why, settings)
            else:
                advised = loop.largest_stiffness()
                why = f"delay: with a round trip of {ms:.0f} ms {self.leader.stiffness:.4g} N/m are too stiff"
                yield VibrationCause("delay", loop.hz(), why, {"device.stiffness": advised} if advised else {})
            return

    def cause(self) -> VibrationCause | None:
        """The cause of the vibration; None: it does not vibrate, or no bound is exceeded."""
        if self.vibration.amplitude_N < FELT_N:
            return None

        def far(one: VibrationCause) -> float:
            return abs(math.log(one.hz / self.vibration.hz)) if one.hz and self.vibration.hz else 0.0

        return min(self.causes(), key=far, default=None)


def measured(what: Recorded) -> PairMeasures:
    """The measures of the pair in the recording of a run.

    Raises RecordingError: no robot followed, or a side is missing. InvalidParameter: as `opened`.
    """
    whole = opened(what).whole
    with fitting("the recording"):
        params = Params.recorded(dict(flatten(whole.meta["params"])), whole.meta.get("sources"))
        if not follows(params) or whole.device is None or whole.world is None:
            raise RecordingError("this is no run of a pair: it needs both sides, and a robot that follows (--follower)")
        friction, contact = _mechanics(whole, params)
        return PairMeasures(params, whole.meta.get("tuning") or {}, _round_trip(whole, params), _vibration(whole),
                    friction, contact)  # fmt: skip


def examine_pair(what: Recorded) -> Iterator[Check]:
    """One check: whether the pair vibrates, why, and what to set. Raises as `measured`."""
    pair = measured(what)
    shown = pair.vibration
    if shown.amplitude_N < FELT_N:
        value = f"no vibration: {shown.amplitude_N:.2g} N, round trip {1e3 * pair.round_trip_s:.0f} ms"
        yield Check("pair", OK, value)
        return
    it_vibrates = f"vibrates at {shown.hz:.1f} Hz with {shown.amplitude_N:.2g} N"
    if (cause := pair.cause()) is None:
        why = "no bound of delay, stiffness, rate or friction is exceeded"
        advice = "let the hand rest for the last two seconds of the run, and ask again"
        yield Check("pair", SKIPPED, f"{it_vibrates}; {why}", advice)
        return
    ways = [f"--set {name}={value:.3g}" for name, value in cause.settings.items()]
    if pair.tuning.get("port") == "bare":
        ways.append("--set bilateral.port=pspm")
    yield Check("pair", WARNING, f"{it_vibrates}; {cause.why}", " or ".join(ways))


def _vibration(run: Recording) -> Vibration:
    assert run.device is not None
    time_s, force = run.device["time_s"], run.device["force_N"]
    last = time_s > time_s[-1] - LAST_S
    hz, strongest = 0.0, 0.0
    for along in force[last].T:
        n = len(along)
        window, still = np.hanning(n), along - np.polyval(np.polyfit(time_s[last], along, 2), time_s[last])
        lines = np.abs(np.fft.rfft(still * window)) ** 2
        rates = np.fft.rfftfreq(n, float(np.median(np.diff(time_s[last]))))
        lines[rates < _LOWEST_HZ] = 0.0
        amplitude = math.sqrt(4.0 * float(lines.sum()) / (n * float(np.sum(window * window))))
        if amplitude > strongest:
            hz, strongest = float(rates[int(np.argmax(lines))]), amplitude
    return Vibration(strongest, hz)


def _round_trip(run: Recording, params: Params) -> float:
    """The link's, and the times for which both sides hold what they have [s]."""
    assert run.device is not None
    assert run.world is not None
    both = [float(np.nanmedian(side["transit_s"])) for side in (run.device, run.world)]
    link = sum(one for one in both if math.isfinite(one))
    return link + params.device.pspm_period_s + 1.0 / params.follower.servo_hz


def _mechanics(run: Recording, params: Params) -> tuple[float, float]:
    """The follower's Coulomb friction [N], and its contact's stiffness [N/m]: least squares over parts of the run.

    In a part in which it moves one way, ``m dv = int (F + f) dt - b dx - F_c sign(v) dt``.
    """
    assert run.world is not None
    world = run.world
    every = max(1, round(_PART_S * params.follower.servo_hz))
    friction, contact = [], 0.0
    for axis in range(world["position_m"].shape[1]):
        x, v = world["position_m"][:, axis], world["velocity_mps"][:, axis]
        force, touch = world["coupling_force_N"][:, axis], world["contact_force_N"][:, axis]
        rows = []
        for begin in range(0, len(x) - every, every):
            part = slice(begin + 1, begin + every + 1)
            one_way = np.all(v[begin : begin + every + 1] > 1e-3) or np.all(v[begin : begin + every + 1] < -1e-3)
            if one_way and np.all(touch[part] == 0.0):
                dt = float(np.sum(world["step_s"][part]))
                rows.append((
                    v[begin + every] - v[begin], x[begin + every] - x[begin], math.copysign(dt, v[begin]),
                    float(np.sum((force[part] + touch[part]) * world["step_s"][part])),
                ))  # fmt: skip
        if len(rows) >= 10:
            known = np.array(rows)
            friction.append(float(np.linalg.lstsq(known[:, :3], known[:, 3], rcond=None)[0][2]))
        contact = max(contact, _slope(x, touch))
    return (max(0.0, float(np.median(friction))) if friction else math.nan), contact


def _slope(x: Array, force: Array) -> float:
    """-df/dx where a force acts [N/m]; 0: none does."""
    there = np.abs(force) > 0.2 * max(1e-9, float(np.abs(force).max()))
    if np.count_nonzero(there) < 10 or float(np.ptp(x[there])) == 0.0:
        return 0.0
    return max(0.0, -float(np.polyfit(x[there], force[there], 1)[0]))
