"""One case of a study: parameters and a seed, and what was measured (`hapnet.metrics.METRICS`)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

from hapnet.couplings import registry
from hapnet.couplings.registry import ideal_stiffness
from hapnet.errors import InvalidParameter
from hapnet.metrics.contact import first_felt_s, pressed_wall, rendered_stiffness
from hapnet.metrics.definitions import METRICS
from hapnet.metrics.drift import drift
from hapnet.metrics.force import buzz, force_error
from hapnet.params import Params
from hapnet.plant.worlds.walls import Wall
from hapnet.recording.samples import Recording
from hapnet.side.device import SampledDeviceSide
from hapnet.simulation.simulation import Result, Simulation
from hapnet.summary.structure import LinkPart, SidePart, Summary
from hapnet.summary.verdict import ROUNDING_J, broken

Measures = dict[str, float | None]
"""Values by the names of their metrics; None where a run does not give one."""

DEADBAND = "wire.deadband"
"""The deadband's parameter: the reference run over an ideal link has no deadband either."""

_REFERENCES = 4
"""How many reference runs are kept, a few megabytes each: cases that differ only in their link follow each other."""


def was_passive(measures: Measures) -> bool:
    """Did both ports of a case stay within d^2, as far as is known, and did its coupling keep its claim?"""
    margin = measures.get("margin_J")
    return (margin is None or margin >= -ROUNDING_J) and kept(measures)


def kept(measures: Measures) -> bool:
    """Did the coupling of a case keep its claim?"""
    return measures.get("claim_kept") != 0.0


@dataclass(frozen=True)
class Run:
    """A simulated run with each tick of the servo recorded, and the walls of its scene."""

    params: Params
    result: Result
    walls: tuple[Wall, ...]

    @property
    def recording(self) -> Recording:
        return self.result.recording


def measure(params: Params, seed: int) -> Measures:
    """Simulate, and measure every metric. Each tick is recorded, whatever `params.record_hz` is.

    "auto" stands for the sampled servo, as on hardware, so that all couplings of a comparison have the same servo.

    Raises
    ------
    HapnetError, netem.NetemError : the parameters do not make a run, or the sides did not find each other.
    """
    params = _studied(params)
    ideal = _ideal(params)
    measured, reference = _reference(ideal, seed)
    return dict(measured) if params == ideal else measures(simulated(params, seed), reference)


def check(params: Params) -> tuple[str, ...]:
    """The warnings of a run, without running it. For bad parameters it raises what `measure` raises."""
    return Simulation(_studied(params)).setup.warnings


def simulated(params: Params, seed: int) -> Run:
    """The run of a case."""
    simulation = Simulation(params.set({"record_hz": params.device.servo_hz}), seed)
    return Run(params, simulation.run(), simulation.setup.scene.walls)


def measures(run: Run, ideal: Recording) -> Measures:
    """The measures of a run. `ideal` : the recording of the same run over an ideal link."""
    result, recording, walls = run.result, run.recording, run.walls
    summary = result.summary
    theorem, motion, (up, down) = summary["theorem"], summary["motion"], _links(summary)
    bound, device = theorem["bound_J"], recording.device
    (device_part, _) = _sides(summary)
    hand_bound = device_part["ledger"]["bound_J"]
    assert device is not None, "a simulated run has both sides"
    assert bound is not None
    assert hand_bound is not None
    up_ms, down_ms = up["delay_p50_ms"], down["delay_p50_ms"]
    delay_ms = None if up_ms is None or down_ms is None else up_ms + down_ms
    felt_s = None if delay_ms is None else first_felt_s(recording, walls, delay_ms / 1e3)
    error = force_error(recording, ideal)
    per_s = [(way["offered"] or 0) / (summary["duration_s"] or math.inf) for way in (up, down)]
    found = {
        "margin_J": bound + result.hand.lowest,
        "energy_out_J": max(0.0, -result.hand.lowest),
        "margin_end_J": bound + result.hand.now,
        "margin_later_J": None if result.hand.later is None else bound + result.hand.later,
        "hand_margin_J": hand_bound + result.hand.device_lowest,
        "actuator_margin_J": theorem["margin_J"] if isinstance(result.device, SampledDeviceSide) else None,
        "free_rms_mm": _times(1e3, motion["free_rms_m"]),
        "contact_rms_mm": _times(1e3, motion["contact_rms_m"]),
        "stiffness_percent": None if delay_ms is None else _stiffness_percent(run, delay_ms / 1e3),
        "force_error_N": None if error is None else error[0],
        "force_error_percent": None if error is None else error[1],
        "buzz_N2": buzz(device),
        "drift_mm_per_min": _times(60e3, drift(recording, walls)),
        "first_contact_ms": _times(1e3, felt_s),
        "peak_force_N": motion["peak_force_N"],
        "packets_per_s": sum(per_s),
        "packets_up_per_s": per_s[0],
        "packets_down_per_s": per_s[1],
        "claim_kept": float(not broken(summary, run.params, virtual=True, spec=registry.coupling(run.params.coupling))),
        "slack_J": _slack(summary),
    }
    return {name: found[name] for name in METRICS}


def _studied(params: Params) -> Params:
    if params.duration_s <= 0.0:
        raise InvalidParameter("duration_s", params.duration_s, "above 0 in virtual time")
    return params.set({"device.servo": "sampled"}) if params.device.servo == "auto" else params


@lru_cache(maxsize=_REFERENCES)
def _reference(ideal: Params, seed: int) -> tuple[Measures, Recording]:
    """The reference run over an ideal link: its measures and its recording."""
    run = simulated(ideal, seed)
    return measures(run, run.recording), run.recording


def _ideal(params: Params) -> Params:
    """The same parameters with an ideal link and without a deadband."""
    nothing = {"link.up": "", "link.down": "", "link.up_timeline": "", "link.down_timeline": ""}
    return params.set({**nothing, DEADBAND: 0.0})


def _stiffness_percent(run: Run, round_trip_s: float) -> float | None:
    params = run.params
    wall = pressed_wall(run.recording.device, run.walls)
    scalar = isinstance(params.device.stiffness, float) and isinstance(params.world.stiffness, float)
    rendered = rendered_stiffness(run.recording, run.walls, round_trip_s)
    if wall is None or not scalar or rendered is None:
        return None
    return 100.0 * rendered / ideal_stiffness(params, wall.stiffness)


def _sides(summary: Summary) -> tuple[SidePart, SidePart]:
    device, world = summary["device"], summary["world"]
    assert device is not None
    assert world is not None
    return device, world


def _links(summary: Summary) -> tuple[LinkPart, LinkPart]:
    up, down = summary["links"]["up"], summary["links"]["down"]
    assert up is not None
    assert down is not None
    return up, down


def _slack(summary: Summary) -> float | None:
    """The least slack of both sides; None for a coupling without reservoirs, for which it has no meaning."""
    sides = _sides(summary)
    slacks = [side["ledger"]["slack_J"] for side in sides]
    if any(side["reservoir_min_J"] is None for side in sides):
        return None
    return min(slack for slack in slacks if slack is not None)


def _times(factor: float, value: float | None) -> float | None:
    return None if value is None else factor * value
