"""How much faster than real time the simulation runs, one scenario at a time and many at once."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial

from hapnet.ext.bench.references import plain_substeps
from hapnet.ext.bench.row import Distribution, Limit, Options, Row
from hapnet.params import Params
from hapnet.processes.pool import usable_cores
from hapnet.simulation.batch import simulate_batch
from hapnet.simulation.simulation import simulate

_SIMULATED_S = 10.0
_SCENARIOS = 1000
_BATCH_S = 30.0
_WORDS: dict[int, dict[str, object]] = {1: {}, 3: {"scene": "box", "operator": "sine"}}


def simulate_ndof(axes: int, options: Options) -> Row:
    """`hapnet.simulate` with its defaults: continuous servo, 4 substeps, ledgers, recording."""
    seconds = max(_SIMULATED_S, options.seconds)
    params = Params().set({"duration_s": seconds, **_WORDS[axes]})
    runs = [
        (seconds / _elapsed(simulate, params, seed), seconds / _elapsed(plain_substeps, axes, seconds))
        for seed in range(max(5, options.rounds))
    ]
    subject, bare = ([Distribution.of(run[i] for run in runs)] for i in (0, 1))
    return Row(
        f"simulate_{axes}dof", "x real time", f"simulation with ledgers and recording, {axes}-DOF", subject,
        "the substeps alone, written out", bare,
        limits=(Limit("median", 100.0 if axes == 1 else 40.0, at_least=True),), higher_is_better=True,
    )  # fmt: skip


def batch_1000(options: Options) -> Row:
    """`simulate_batch` with a thousand seeds of the 1-DOF default on all cores, beside one seed at a time on one."""
    params, workers = Params().set({"duration_s": _BATCH_S}), usable_cores()
    subject, bare = [], []
    for _ in range(options.rounds):
        took_s = _elapsed(partial(simulate_batch, workers=workers), params, range(_SCENARIOS))
        subject.append(Distribution.of([_SCENARIOS * _BATCH_S / took_s]))
        bare.append(Distribution.of([_BATCH_S / _elapsed(simulate, params, seed) for seed in range(3)]))
    return Row(
        f"batch_{_SCENARIOS}", "scenario-s/s", f"{_SCENARIOS} scenarios at once, 1-DOF, {workers} workers", subject,
        "one scenario at a time", bare,
        limits=(Limit("median", 2000.0, at_least=True),), higher_is_better=True,
    )  # fmt: skip


def _elapsed(call: Callable[..., object], *args: object) -> float:
    began = time.perf_counter()
    call(*args)
    return time.perf_counter() - began
