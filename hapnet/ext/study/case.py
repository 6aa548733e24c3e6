"""A case of a study: simulates parameters with a seed, and measures all metrics (`hapnet.ext.metrics.METRICS`)."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

from hapnet.assembly.choices import before_scene, choosing
from hapnet.assembly.springs import spring
from hapnet.errors import InvalidParameter
from hapnet.ext.metrics import METRICS, Measures as Measures
from hapnet.ext.metrics.measured import Measured
from hapnet.ext.metrics.obstacles import has_friction
from hapnet.param_sources import RULE
from hapnet.params import Params
from hapnet.recording.samples import Recording
from hapnet.simulation.simulation import Simulation
from hapnet.summary.verdict import ROUNDING_J
from hapnet.units import RADIANS

DEADBAND = "wire.deadband"
"""The deadband's parameter; the reference run over an ideal link has no deadband."""

_FAST = {"world.step_min_s": 0.001, "world.step_max_s": 0.001}
"""The steps of a world that is as fast as the servo, in the reference run for walls with friction."""

_REFERENCES = 4
"""The number of reference runs that are kept, a few megabytes each; cases that differ only in their link are
neighbours."""


def was_passive(measures: Measures) -> bool:
    """Whether both ports of a case stayed within d^2, if the margin is known, and its coupling kept its claim."""
    margin = measures.get("margin_J")
    return (margin is None or margin >= -ROUNDING_J) and kept(measures)


def kept(measures: Measures) -> bool:
    """Whether the coupling of a case kept its claim."""
    return measures.get("claim_kept") != 0.0


def measure(params: Params, seed: int) -> Measures:
    """Simulate, and measure every metric. Each tick is recorded, independent of `params.record_hz`.

    "auto" stands for the sampled servo, as on hardware, so that all couplings of a comparison have the same servo.

    Raises HapnetError, netem.NetemError: the parameters do not make a run, or the sides did not find each other.
    """
    params = _studied(params)
    ideal = _ideal(params)
    measured, reference, local = _reference(ideal, seed)
    if params == ideal:
        return dict(measured)
    return measures(replace(simulated(params, seed), ideal=reference, local=local))


def check(params: Params) -> tuple[str, ...]:
    """The warnings of a run, without running it. Raises as `measure` for bad parameters."""
    return Simulation(_studied(params)).setup.warnings


def measures(run: Measured) -> Measures:
    """Every metric of a run."""
    return {name: metric.find(run) for name, metric in METRICS.items()}


def simulated(params: Params, seed: int) -> Measured:
    """The run of a case, with each tick recorded. Raises InvalidParameter: an axis is not in metres."""
    simulation = Simulation(params.set({"record_hz": params.device.servo_hz}), seed, motion_only=True)
    if RADIANS in simulation.setup.units.split(","):
        raise InvalidParameter("scene", params.scene, "one with axes in metres, as metrics are in mm and N")
    return Measured(simulation.setup.params, simulation.run(), simulation.setup.scene)


def _studied(params: Params) -> Params:
    if params.duration_s <= 0.0:
        raise InvalidParameter("duration_s", params.duration_s, "above 0 in virtual time")
    if params.device.servo == "auto":
        params = params.set({"device.servo": "sampled"})
    return choosing(params, *before_scene(params), spring)


@lru_cache(maxsize=_REFERENCES)
def _reference(ideal: Params, seed: int) -> tuple[Measures, Recording, Recording | None]:
    """The reference run over an ideal link: its measures, its recording, and `Measured.local`."""
    run = simulated(ideal, seed)
    local = simulated(ideal.set(_FAST, RULE), seed).result.recording if has_friction(run.scene) else None
    whole = run.result.recording
    return measures(replace(run, ideal=whole, local=local)), whole, local


def _ideal(params: Params) -> Params:
    """The same parameters with an ideal link and without a deadband."""
    nothing: dict[str, object] = {"link.up": "", "link.down": "", "link.up_timeline": "", "link.down_timeline": ""}
    others = {name: value for name, value in (nothing | {DEADBAND: 0.0}).items() if params.get(name) != value}
    return params.set(others) if others else params
