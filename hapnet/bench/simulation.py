"""How much faster than real time the simulation runs, one scenario at a time and many at once."""

from __future__ import annotations

import time
from collections.abc import Callable

import hapnet
from hapnet.bench.references import plain_substeps
from hapnet.bench.row import Distribution, Limit, Options, Row, row
from hapnet.params import Params
from hapnet.runtime.virtual import simulate

_SIMULATED_S = 10.0
_SCENARIOS = 1000
_BATCH_S = 2.0
_WORDS: dict[int, dict[str, object]] = {1: {}, 3: {"scene": "box", "operator": "sine"}}


def simulate_ndof(axes: int, options: Options) -> Row:
    """`hapnet.simulate` as it comes: continuous servo, 4 substeps, ledgers, recording."""
    seconds = max(_SIMULATED_S, options.seconds)
    params = Params().set({"duration_s": seconds, **_WORDS[axes]})
    runs = [
        (seconds / _elapsed(simulate, params, seed), seconds / _elapsed(plain_substeps, axes, seconds))
        for seed in range(max(5, options.rounds))
    ]
    subject, bare = ([Distribution.of(run[i] for run in runs)] for i in (0, 1))
    return row(
        f"simulate_{axes}dof", "x real time", f"simulation with ledgers and recording, {axes}-DOF", subject,
        "the substeps alone, written out", bare,
        limits=(Limit("median", 100.0 if axes == 1 else 40.0, at_least=True),), higher_is_better=True,
    )  # fmt: skip


def batch_1000(options: Options) -> Row:
    """`hapnet.simulate_batch` with a thousand seeds of the 1-DOF default, beside one seed at a time."""
    name, unit = f"batch_{_SCENARIOS}", "scenario-s/s"
    what, against = f"{_SCENARIOS} scenarios at once, 1-DOF", "one scenario at a time"
    simulate_batch = getattr(hapnet, "simulate_batch", None)
    if simulate_batch is None:
        note = "not available: hapnet.simulate_batch is missing"
        return Row(name, unit, what, against, note=note, higher_is_better=True)
    params = Params().set({"duration_s": _BATCH_S})
    subject, bare = [], []
    for _ in range(options.rounds):
        batch = _SCENARIOS * _BATCH_S / _elapsed(simulate_batch, params, range(_SCENARIOS))
        subject.append(Distribution.of([batch]))
        bare.append(Distribution.of([_BATCH_S / _elapsed(simulate, params, seed) for seed in range(3)]))
    return row(
        name, unit, what, subject, against, bare,
        limits=(Limit("median", 2000.0, at_least=True),), higher_is_better=True,
    )  # fmt: skip


def _elapsed(call: Callable[..., object], *args: object) -> float:
    began = time.perf_counter()
    call(*args)
    return time.perf_counter() - began
