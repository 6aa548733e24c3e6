"""One case of a study: parameters and a seed, and what was measured (`hapnet.metrics.METRICS`)."""

from __future__ import annotations

import math
from functools import lru_cache

from hapnet.assembly.springs import with_springs
from hapnet.couplings import registry
from hapnet.couplings.registry import ideal_stiffness
from hapnet.errors import InvalidParameter
from hapnet.metrics.contact import contact_force, pressed_wall, rendered_stiffness
from hapnet.metrics.definitions import METRICS
from hapnet.metrics.drift import drift
from hapnet.metrics.force import buzz, force_error, largest_step
from hapnet.metrics.obstacles import rubs
from hapnet.metrics.swing import residual_swing
from hapnet.metrics.touch import latency, touches
from hapnet.params import Params
from hapnet.recording.samples import Recording
from hapnet.side.sampled_device import SampledDeviceSide
from hapnet.simulation.simulation import Simulation
from hapnet.study.over_time import at_the_world, felt_over_time
from hapnet.study.run import Measures as Measures
from hapnet.study.run import Run as Run
from hapnet.study.run import simulated as simulated
from hapnet.summary.verdict import ROUNDING_J, broken

DEADBAND = "wire.deadband"
"""The deadband's parameter: the reference run over an ideal link has no deadband either."""

_LEAST_DRAG_N = 0.01
"""A drag below this is taken as this, where forces are compared with it [N]: nobody would feel it."""

_FAST = {"world.step_min_s": 0.001, "world.step_max_s": 0.001}
"""The steps of a world that is as fast as the servo, in the reference run for walls that rub."""

_REFERENCES = 4
"""How many reference runs are kept, a few megabytes each: cases that differ only in their link follow each other."""


def was_passive(measures: Measures) -> bool:
    """Did both ports of a case stay within d^2, as far as is known, and did its coupling keep its claim?"""
    margin = measures.get("margin_J")
    return (margin is None or margin >= -ROUNDING_J) and kept(measures)


def kept(measures: Measures) -> bool:
    """Did the coupling of a case keep its claim?"""
    return measures.get("claim_kept") != 0.0


def measure(params: Params, seed: int) -> Measures:
    """Simulate, and measure every metric. Each tick is recorded, whatever `params.record_hz` is.

    "auto" stands for the sampled servo, as on hardware, so that all couplings of a comparison have the same servo.

    Raises
    ------
    HapnetError, netem.NetemError : the parameters do not make a run, or the sides did not find each other.
    """
    params = _studied(params)
    ideal = _ideal(params)
    measured, reference, local = _reference(ideal, seed)
    return dict(measured) if params == ideal else measures(simulated(params, seed), reference, local)


def check(params: Params) -> tuple[str, ...]:
    """The warnings of a run, without running it. For bad parameters it raises what `measure` raises."""
    return Simulation(_studied(params)).setup.warnings


def measures(run: Run, ideal: Recording, local: Recording | None = None) -> Measures:
    """The measures of a run. `ideal` : the recording of the same run over an ideal link.

    local : that of the same run over an ideal link with a fast world, where the walls rub; None: they do not.
    """
    result, recording, walls, device = run.result, run.recording, run.walls, run.device
    summary = result.summary
    theorem, motion, (up, down) = summary["theorem"], summary["motion"], run.links
    hand_bound = run.sides[0]["ledger"]["bound_J"]
    bound = theorem["bound_J"]
    assert bound is not None
    assert hand_bound is not None
    error = force_error(recording, ideal)
    per_s = [(way["offered"] or 0) / (summary["duration_s"] or math.inf) for way in (up, down)]
    found = {
        "margin_J": bound + result.hand.lowest,
        "energy_out_J": max(0.0, -result.hand.lowest),
        "margin_end_J": bound + result.hand.now,
        "margin_later_J": None if result.hand.later is None else bound + result.hand.later,
        "hand_margin_J": hand_bound + result.hand.device_lowest,
        "hand_energy_out_J": max(0.0, -result.hand.device_lowest),
        "actuator_margin_J": theorem["margin_J"] if isinstance(result.device, SampledDeviceSide) else None,
        "contact_rms_mm": _times(1e3, motion["contact_rms_m"]),
        "stiffness_percent": _stiffness_percent(run),
        "force_error_N": None if error is None else error[0],
        "force_error_percent": None if error is None else error[1],
        **felt_over_time(run, local),
        **at_the_world(run),
        "contact_to_drag": None,
        "swing_N": residual_swing(recording),
        "buzz_N2": buzz(device),
        "drift_mm_per_min": None if walls is None else _times(60e3, drift(recording, walls)),
        **_touched(run),
        "peak_force_N": motion["peak_force_N"],
        "force_step_N": largest_step(device),
        "packets_per_s": sum(per_s),
        "packets_up_per_s": per_s[0],
        "packets_down_per_s": per_s[1],
        "claim_kept": float(not broken(summary, run.params, virtual=True, spec=registry.coupling(run.params.coupling))),
        "slack_J": _slack(run),
    }
    found["contact_to_drag"] = _contact_to_drag(run, found["drag_N"])
    return {name: found[name] for name in METRICS}


def _studied(params: Params) -> Params:
    if params.duration_s <= 0.0:
        raise InvalidParameter("duration_s", params.duration_s, "above 0 in virtual time")
    return with_springs(params.set({"device.servo": "sampled"}) if params.device.servo == "auto" else params)


@lru_cache(maxsize=_REFERENCES)
def _reference(ideal: Params, seed: int) -> tuple[Measures, Recording, Recording | None]:
    """The reference run over an ideal link: its measures and its recording, and that of `measures`' `local`."""
    run = simulated(ideal, seed)
    local = simulated(ideal.set(_FAST), seed).recording if rubs(run.scene) else None
    return measures(run, run.recording, local), run.recording, local


def _ideal(params: Params) -> Params:
    """The same parameters with an ideal link and without a deadband."""
    nothing = {"link.up": "", "link.down": "", "link.up_timeline": "", "link.down_timeline": ""}
    return params.set({**nothing, DEADBAND: 0.0})


def _contact_to_drag(run: Run, drag_N: float | None) -> float | None:
    """How much harder a contact is than free motion."""
    if run.delay_s is None or run.walls is None or drag_N is None:
        return None
    pushed = contact_force(run.recording, run.walls, run.delay_s)
    return None if pushed is None else pushed / max(drag_N, _LEAST_DRAG_N)


def _touched(run: Run) -> Measures:
    """When contacts were felt, and how many were not."""
    walls, delay_s = run.walls, run.delay_s
    first = later = count = felt = None
    wall = None if walls is None else pressed_wall(run.device, walls)
    if delay_s is not None and walls is not None and (wall is None or run.scalar):
        stiffness = 0.0 if wall is None else ideal_stiffness(run.params, wall.stiffness)
        found = touches(run.recording, walls, stiffness, delay_s)
        first, later, count, felt = latency(found, delay_s)
    return {
        "first_contact_ms": _finite_ms(first),
        "first_contact_missed": None if first is None else float(math.isinf(first)),
        "later_contact_ms": _finite_ms(later),
        "later_contacts": None if count is None else float(count),
        "later_contacts_missed": None if count is None or felt is None else float(count - felt),
    }


def _finite_ms(seconds: float | None) -> float | None:
    return None if seconds is None or math.isinf(seconds) else 1e3 * seconds


def _stiffness_percent(run: Run) -> float | None:
    if run.walls is None or run.delay_s is None:
        return None
    wall = pressed_wall(run.device, run.walls)
    rendered = rendered_stiffness(run.recording, run.walls, run.delay_s)
    if wall is None or not run.scalar or rendered is None:
        return None
    return 100.0 * rendered / ideal_stiffness(run.params, wall.stiffness)


def _slack(run: Run) -> float | None:
    """The least slack of both sides; None for a coupling without reservoirs, for which it has no meaning."""
    slacks = [side["ledger"]["slack_J"] for side in run.sides]
    if any(side["reservoir_min_J"] is None for side in run.sides):
        return None
    return min(slack for slack in slacks if slack is not None)


def _times(factor: float, value: float | None) -> float | None:
    return None if value is None else factor * value
