"""One case of a study: parameters and a seed, and what was measured (`hapnet.metrics.METRICS`)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from hapnet.checks import Array
from hapnet.couplings import registry
from hapnet.couplings.registry import ideal_stiffness
from hapnet.errors import InvalidParameter
from hapnet.metrics.contact import contact_force, pressed_wall, rendered_stiffness
from hapnet.metrics.definitions import METRICS
from hapnet.metrics.drift import drift
from hapnet.metrics.environment import environment_force, standing_force
from hapnet.metrics.force import buzz, force_error, largest_step, rms_difference
from hapnet.metrics.free_motion import drag, following_error
from hapnet.metrics.obstacles import Obstacle, obstacles
from hapnet.metrics.swing import residual_swing
from hapnet.metrics.touch import latency, touches
from hapnet.params import Params
from hapnet.plant.worlds.moving_wall import MovingWall
from hapnet.plant.worlds.protocol import World
from hapnet.recording.samples import Columns, Recording
from hapnet.side.sampled_device import SampledDeviceSide
from hapnet.simulation.simulation import Result, Simulation
from hapnet.summary.structure import LinkPart, SidePart, Summary
from hapnet.summary.verdict import ROUNDING_J, broken

Measures = dict[str, float | None]
"""Values by the names of their metrics; None where a run does not give one."""

DEADBAND = "wire.deadband"
"""The deadband's parameter: the reference run over an ideal link has no deadband either."""

_LEAST_DRAG_N = 0.01
"""A drag below this is taken as this, where forces are compared with it [N]: nobody would feel it."""

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
    """A simulated run with the motion of each tick of the servo recorded, and its scene."""

    params: Params
    result: Result
    scene: World

    @cached_property
    def walls(self) -> tuple[Obstacle, ...] | None:
        """The walls and solids of the scene; None: they are not known, and no metric that needs them is."""
        return () if isinstance(self.scene, MovingWall) else obstacles(self.scene)

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
    simulation = Simulation(params.set({"record_hz": params.device.servo_hz}), seed, motion_only=True)
    return Run(params, simulation.run(), simulation.setup.scene)


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
    wanted = _environment(run, device)
    error, true_error = force_error(recording, ideal), None
    if wanted is not None and _scalar(run.params):
        true_error = rms_difference(device, wanted)
    per_s = [(way["offered"] or 0) / (summary["duration_s"] or math.inf) for way in (up, down)]
    found = {
        "margin_J": bound + result.hand.lowest,
        "energy_out_J": max(0.0, -result.hand.lowest),
        "margin_end_J": bound + result.hand.now,
        "margin_later_J": None if result.hand.later is None else bound + result.hand.later,
        "hand_margin_J": hand_bound + result.hand.device_lowest,
        "actuator_margin_J": theorem["margin_J"] if isinstance(result.device, SampledDeviceSide) else None,
        "free_rms_mm": _following_mm(recording, wanted),
        "contact_rms_mm": _times(1e3, motion["contact_rms_m"]),
        "stiffness_percent": None if delay_ms is None else _stiffness_percent(run, delay_ms / 1e3),
        "force_error_N": None if error is None else error[0],
        "force_error_percent": None if error is None else error[1],
        "true_force_error_N": None if true_error is None else true_error[0],
        "true_force_error_percent": None if true_error is None else true_error[1],
        **_dragged(run, delay_ms),
        "swing_N": residual_swing(recording),
        "buzz_N2": buzz(device),
        "drift_mm_per_min": None if walls is None else _times(60e3, drift(recording, walls)),
        **_touched(run, delay_ms),
        "peak_force_N": motion["peak_force_N"],
        "force_step_N": largest_step(device),
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


def _following_mm(recording: Recording, wanted: Array | None) -> float | None:
    if wanted is None:
        return None
    return _times(1e3, following_error(recording, np.asarray(np.count_nonzero(wanted, axis=1) == 0)))


def _environment(run: Run, device: Columns) -> Array | None:
    """The force of the walls that stood at each time: zero where the device is in none. None: they are not known.

    Springs that are no scalars are taken as rigid, which tells no more than where the walls are.
    """
    scene, walls, springs = run.scene, run.walls, _scalar(run.params)

    def stiffness(wall: Obstacle) -> float:
        return ideal_stiffness(run.params, wall.stiffness) if springs else wall.stiffness

    if isinstance(scene, MovingWall) and scene.schedule.changes:
        since_s = (run.result.world.origin_ns or 0) / 1e9
        times = (device["time_ns"] / 1e9 - since_s).tolist()
        moving = scene.schedule
        return environment_force(
            device["position_m"], times, lambda t: () if (wall := moving.at(t)) is None else (wall,), stiffness
        )
    return None if walls is None else standing_force(device["position_m"], walls, stiffness)


def _dragged(run: Run, delay_ms: float | None) -> Measures:
    """Drag in free motion, and how much harder a contact is."""
    world = run.recording.world
    if delay_ms is None or world is None or run.walls is None:
        return {"drag_N": None, "contact_to_drag": None}
    delay_s = delay_ms / 1e3
    found = drag(run.recording, run.walls, delay_s + 2.0 * float(world["step_s"].max()))
    pushed = contact_force(run.recording, run.walls, delay_s)
    ratio = None if found is None or pushed is None else pushed / max(found, _LEAST_DRAG_N)
    return {"drag_N": found, "contact_to_drag": ratio}


def _touched(run: Run, delay_ms: float | None) -> Measures:
    """When contacts were felt, and how many were not."""
    walls = run.walls
    first = later = count = felt = None
    wall = None if walls is None else pressed_wall(run.recording.device, walls)
    if delay_ms is not None and walls is not None and (wall is None or _scalar(run.params)):
        stiffness = 0.0 if wall is None else ideal_stiffness(run.params, wall.stiffness)
        found = touches(run.recording, walls, stiffness, delay_ms / 1e3)
        first, later, count, felt = latency(found, delay_ms / 1e3)
    return {
        "first_contact_ms": _finite_ms(first),
        "first_contact_missed": None if first is None else float(math.isinf(first)),
        "later_contact_ms": _finite_ms(later),
        "later_contacts": None if count is None else float(count),
        "later_contacts_missed": None if count is None or felt is None else float(count - felt),
    }


def _finite_ms(seconds: float | None) -> float | None:
    return None if seconds is None or math.isinf(seconds) else 1e3 * seconds


def _scalar(params: Params) -> bool:
    return isinstance(params.device.stiffness, float) and isinstance(params.world.stiffness, float)


def _stiffness_percent(run: Run, round_trip_s: float) -> float | None:
    params, walls = run.params, run.walls
    if walls is None:
        return None
    wall = pressed_wall(run.recording.device, walls)
    rendered = rendered_stiffness(run.recording, walls, round_trip_s)
    if wall is None or not _scalar(params) or rendered is None:
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
