"""Batches: many seeds, parameters or links in one call."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterable, Sequence, Sized

from hapnet.assembly.build import Setup
from hapnet.assembly.memory import require_room
from hapnet.errors import HapnetError, InvalidParameter
from hapnet.params import Params
from hapnet.simulation.batch.engine import Engine
from hapnet.simulation.batch.scenario import BatchRun, Scenario
from hapnet.simulation.compiled.coverage import NotCompiledError
from hapnet.simulation.garbage_collector import collector_paused
from hapnet.simulation.processes import Progress, dealt

SMALLEST = 32
"""Smaller groups of scenarios are faster one at a time."""
RUN_BYTES = 110_000
"""Memory that a run takes until its batch ends, as measured [bytes]."""
LARGEST = 2048
"""Largest number of scenarios that run together: more do not fit the processor's caches."""


def simulate_batch(
    params: Params | Iterable[Params] | None = None,
    seeds: Iterable[int] = range(1),
    *,
    workers: int = 1,
    progress: Progress | None = None,
) -> list[BatchRun]:
    """Simulate all `params` with all `seeds` at once, with the same results as `simulate`.

    Parameters
    ----------
    params : one or several, which may differ in anything; those that differ only in links are simulated together.
    seeds : every one of them is used with each of `params`.
    workers : processes to share the work. With more than one, the caller's main module must be importable.
    progress : called from time to time with the share that is done, 0 to 1.

    Returns
    -------
    One run for each pair; seeds vary fastest. Some scenarios are not vectorised but simulated one at a time, by the
    compiled kernel where it is there: those with a sampled servo, the user's own devices, hands or scenes, filters and
    predictors, release on silence, links with slots, traces or timelines, or links that could be full.
    `BatchRun.vectorised` is then False.

    Raises
    ------
    InvalidParameter, netem.NetemError : the parameters are not valid for a run, or there are more runs than this
        machine can hold.
    HapnetError : in some scenario the two sides did not find each other.
    """
    if workers < 1:
        raise InvalidParameter("workers", workers, "1 or more processes")
    several = [params or Params()] if params is None or isinstance(params, Params) else list(params)
    if isinstance(seeds, Sized):
        require_room("seeds", seeds, len(several) * len(seeds), RUN_BYTES, "runs")
    seed_list = list(seeds)
    cases = [(one, seed) for one in several for seed in seed_list]
    workers = min(workers, len(cases))
    if workers <= 1:
        return _simulate(cases, progress or (lambda share: None))
    return dealt(_simulate, cases, workers, progress)


def _simulate(cases: Sequence[tuple[Params, int]], progress: Progress = lambda share: None) -> list[BatchRun]:
    runs: dict[int, BatchRun] = {}

    def done(more: float) -> None:
        progress((len(runs) + more) / len(cases))

    for group in _groups(cases):
        for start in range(0, len(group), LARGEST):
            _simulate_group({k: cases[k] for k in group[start : start + LARGEST]}, runs, done)
    return [runs[k] for k in range(len(cases))]


def _groups(cases: Sequence[tuple[Params, int]]) -> list[list[int]]:
    """Groups of cases that differ only in links and seeds."""
    kinds: dict[int, str] = {}
    groups: defaultdict[str, list[int]] = defaultdict(list)
    for k, (params, _) in enumerate(cases):
        if id(params) not in kinds:
            kinds[id(params)] = json.dumps({**params.as_dict(), "link": None})
        groups[kinds[id(params)]].append(k)
    return list(groups.values())


def _alone(scenario: Scenario, params: Params, seed: int) -> BatchRun:
    """Run a loaded scenario that is not vectorised."""
    try:
        return scenario.run_on(vectorised=False)
    except NotCompiledError:
        again = Scenario(params, seed, scenario.setup, kernel=False)
        again.load()
        return again.run_on(vectorised=False)


@collector_paused()
def _simulate_group(cases: dict[int, tuple[Params, int]], runs: dict[int, BatchRun], done: Progress) -> None:
    running: dict[int, Scenario] = {}
    setups: dict[int, Setup] = {}
    for k, (params, seed) in cases.items():
        scenario = Scenario(params, seed, setups.get(id(params)))
        setups[id(params)] = scenario.setup
        try:
            ready = scenario.load()
        except HapnetError as error:
            raise HapnetError(f"seed {seed}: {error}") from error
        if ready and scenario.is_vectorised and len(cases) >= SMALLEST:
            running[k] = scenario
        else:
            runs[k] = _alone(scenario, params, seed)
            done(0.0)
    if running:
        duration_s = next(iter(cases.values()))[0].duration_s
        Engine(list(running.values())).run(lambda s: done(len(running) * min(1.0, s / duration_s)))
        for k, scenario in running.items():
            runs[k] = scenario.run_on(vectorised=True)
        done(0.0)
