"""Batches: many seeds, parameters or links in one call, on several processes if asked."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence, Sized
from typing import Any, NamedTuple

from hapnet import checks
from hapnet.assembly.build import Setup, prepare
from hapnet.assembly.memory import require_room
from hapnet.checks import Vector
from hapnet.errors import HapnetError, InvalidParameter
from hapnet.loading import extension
from hapnet.params import Params, as_params
from hapnet.plant.worlds.scene import Scene
from hapnet.processes.pool import Progress, dealt
from hapnet.side.device import DeviceSide
from hapnet.side.world import WorldSide
from hapnet.simulation.simulation import Simulation
from hapnet.summary.run import Summary

RUN_BYTES = 110_000
"""Memory that a run takes until its batch ends, as measured [bytes]."""


class SideState(NamedTuple):
    """One side at the end of its run; vectors have one element per axis."""

    position_m: Vector
    velocity_mps: Vector
    set_position_m: Vector
    reservoir_J: float
    deficit_J: float
    work_J: float
    credited_J: float
    sent_J: float


class BatchRun(NamedTuple):
    """The result of one scenario of a batch."""

    params: Params
    seed: int
    summary: Summary
    """The summary, as in the result of a single run."""
    device: SideState
    world: SideState
    not_compiled: str | None
    """The reason why the compiled kernel did not run it; None: it did."""


def simulate_batch(
    params: Params | Mapping[str, object] | Iterable[Params | Mapping[str, object]] | None = None,
    seeds: Iterable[int] = range(1),
    *,
    workers: int = 1,
    progress: Progress | None = None,
) -> list[BatchRun]:
    """Simulate all `params` with all `seeds`: `simulate`, without keeping the recordings.

    Parameters
    ----------
    params : one or several, each as for `simulate`; they may differ in anything.
    seeds : each seed is used with each of `params`.
    workers : processes to share the work. With more than one, the caller's main module must be importable.
    progress : called from time to time with the share that is done, 0 to 1.

    Returns
    -------
    One run for each pair; seeds vary fastest.

    Raises InvalidParameter, netem.NetemError: the parameters are not valid for a run, or there are more runs than this
    machine can hold. HapnetError: in some scenario the two sides did not find each other.
    """
    if workers < 1:
        raise InvalidParameter("workers", workers, "1 or more processes")
    several: Any = Params() if params is None else params
    if isinstance(several, Params | Mapping | str) or not isinstance(several, Iterable):
        several = [several]
    chosen = [as_params(one) for one in several]
    given: object = seeds
    if isinstance(given, str) or not isinstance(given, Iterable):
        raise InvalidParameter("seeds", seeds, "whole numbers, such as range(100)")
    if isinstance(seeds, Sized):
        require_room("seeds", seeds, len(chosen) * len(seeds), RUN_BYTES, "runs")
    seed_list = [checks.whole("seeds", seed, at_least=0) for seed in seeds]
    cases = [(one, seed) for one in chosen for seed in seed_list]
    ticks = ((one, len(seed_list) * one.duration_s * one.device.servo_hz) for one in chosen)
    workers = min(workers, len(cases))
    with extension("compiled").background(ticks):
        if workers <= 1:
            return _simulate(cases, progress or (lambda share: None))
        return dealt(_simulate, cases, workers, progress)


def _simulate(cases: Sequence[tuple[Params, int]], progress: Progress = lambda share: None) -> list[BatchRun]:
    runs: list[BatchRun] = []
    known: tuple[Params, Setup] | None = None
    for params, seed in cases:
        if known is None or known[0] is not params or not _is_reusable(known[1]):
            known = params, prepare(params, "continuous")

        def report(simulated_s: float, params: Params = params) -> None:
            progress((len(runs) + simulated_s / params.duration_s) / len(cases))

        try:
            runs.append(_run(params, seed, known[1], report))
        except HapnetError as error:
            raise HapnetError(f"seed {seed}: {error}") from error
        progress(len(runs) / len(cases))
    return runs


def _is_reusable(setup: Setup) -> bool:
    """Whether several runs may share it. Worlds other than walls at rest, and a user's own hand, have a state."""
    return type(setup.scene) is Scene and setup.hand is None


def _run(params: Params, seed: int, setup: Setup, report: Progress) -> BatchRun:
    simulation = Simulation(params, seed, setup, motion_only=True)
    result = simulation.run(None if simulation.not_compiled is None else report)  # fast, and reports at its end
    mass = result.world.mass
    x, v = result.device.device.read()
    device, world = _state(result.device, x, v), _state(result.world, mass.position, mass.velocity)
    return BatchRun(params, seed, result.summary, device, world, simulation.not_compiled)


def _state(side: DeviceSide | WorldSide, x: Vector, v: Vector) -> SideState:
    coupling, ledger = side.coupling, side.coupling.ledger
    return SideState(
        x, v, coupling.set_position, coupling.reservoir, coupling.deficit, ledger.work, ledger.credited, ledger.sent
    )
