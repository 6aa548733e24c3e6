"""One case of a study: parameters and a seed, and what was measured (`hapnet.metrics.METRICS`)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

from hapnet.couplings.registry import ideal_stiffness
from hapnet.errors import InvalidParameter
from hapnet.metrics.contact import first_felt_s, pressed_wall, rendered_stiffness
from hapnet.metrics.definitions import METRICS
from hapnet.metrics.drift import drift
from hapnet.metrics.force import buzz, force_error
from hapnet.params import Params
from hapnet.plant.contact import Wall
from hapnet.recording.samples import Recording
from hapnet.side.device import SampledDeviceSide
from hapnet.simulation.simulation import Result, Simulation
from hapnet.summary.run import Summary
from hapnet.summary.verdict import ROUNDING_J, broken

Measures = dict[str, float | None]
"""Values by the names of their metrics; None where a run cannot tell."""

DEADBAND = "wire.deadband"
"""What the run over an ideal link, which a run is measured against, does without, as without the link."""

_REFERENCES = 4
"""Runs over an ideal link that are kept, a few megabytes each: cases that differ in links only follow each other."""


def was_passive(measures: Measures) -> bool:
    """Did both ports of a case stay within d^2, as far as is known, and its coupling keep what it claims?"""
    margin = measures.get("margin_J")
    return (margin is None or margin >= -ROUNDING_J) and kept(measures)


def kept(measures: Measures) -> bool:
    """Did the coupling of a case keep what it claims?"""
    return measures.get("claim_kept") != 0.0


@dataclass(frozen=True)
class Run:
    """A simulated run, each tick of the servo recorded, and the walls of its scene."""

    params: Params
    result: Result
    walls: tuple[Wall, ...]

    @property
    def recording(self) -> Recording:
        return self.result.recording


def measure(params: Params, seed: int) -> Measures:
    """Simulate, and measure every metric. Each tick is recorded, whatever `params.record_hz` says.

    The servo that is left open ("auto") is the sampled one, as of hardware: couplings side by side have the same.

    Raises
    ------
    HapnetError, netem.NetemError : the parameters do not make a run, or the sides did not find each other.
    """
    params = _studied(params)
    ideal = _ideal(params)
    measured, reference = _reference(ideal, seed)
    return dict(measured) if params == ideal else measures(simulated(params, seed), reference)


def check(params: Params) -> tuple[str, ...]:
    """The warnings of a run, which is not made; raises what `measure` does for parameters that do not make one."""
    return Simulation(_studied(params)).setup.warnings


def simulated(params: Params, seed: int) -> Run:
    """The run of a case."""
    simulation = Simulation(params.set({"record_hz": params.device.servo_hz}), seed)
    return Run(params, simulation.run(), simulation.setup.scene.walls)


def measures(run: Run, ideal: Recording) -> Measures:
    """What a run shows. `ideal` : the recording of the same one over an ideal link."""
    result, recording, walls = run.result, run.recording, run.walls
    summary = result.summary
    theorem, motion, links = summary["theorem"], summary["motion"], summary["links"]
    device = recording.device
    assert device is not None, "a simulated run has both sides"
    delays = [links[way]["delay_p50_ms"] for way in ("up", "down")]
    delay_ms = None if None in delays else sum(delays)
    felt_s = None if delay_ms is None else first_felt_s(recording, walls, delay_ms / 1e3)
    error = force_error(recording, ideal)
    up, down = (links[way]["offered"] / summary["duration_s"] for way in ("up", "down"))
    found = {
        "margin_J": theorem["bound_J"] + result.hand.lowest,
        "energy_out_J": max(0.0, -result.hand.lowest),
        "margin_end_J": theorem["bound_J"] + result.hand.now,
        "margin_later_J": None if result.hand.later is None else theorem["bound_J"] + result.hand.later,
        "hand_margin_J": summary["device"]["ledger"]["bound_J"] + result.hand.device_lowest,
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
        "packets_per_s": up + down,
        "packets_up_per_s": up,
        "packets_down_per_s": down,
        "claim_kept": float(not broken(summary, run.params, virtual=True)),
        "slack_J": _slack(summary),
    }
    return {name: found[name] for name in METRICS}


def _studied(params: Params) -> Params:
    if params.duration_s <= 0.0:
        raise InvalidParameter("duration_s", params.duration_s, "above 0 in virtual time")
    return params.set({"device.servo": "sampled"}) if params.device.servo == "auto" else params


@lru_cache(maxsize=_REFERENCES)
def _reference(ideal: Params, seed: int) -> tuple[Measures, Recording]:
    """What a run over an ideal link shows, and its recording."""
    run = simulated(ideal, seed)
    return measures(run, run.recording), run.recording


def _ideal(params: Params) -> Params:
    """The same with a link that does nothing, over which everything is sent."""
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


def _slack(summary: Summary) -> float | None:
    """Of a coupling without reservoirs the theorem's halves say nothing."""
    sides = [summary[side] for side in ("device", "world")]
    if any(side["reservoir_min_J"] is None for side in sides):
        return None
    return float(min(side["ledger"]["slack_J"] for side in sides))


def _times(factor: float, value: float | None) -> float | None:
    return None if value is None else factor * value
