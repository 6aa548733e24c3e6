"""`hapnet simulate --seeds A:B`: many seeds at once, one table."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

from hapnet.commands import output
from hapnet.commands.progress import Progress
from hapnet.errors import InvalidParameter
from hapnet.params import Params
from hapnet.summary.structure import DIRECTIONS, SIDES, Direction, SidePart, Summary
from hapnet.wire.messages import Role

if TYPE_CHECKING:
    from rich.table import Table

    from hapnet.simulation.batch import BatchRun

LONG_S = 1000.0
"""From this total simulated time on [s], several processes are started."""


_WIDE = 100
"""In a terminal of at least this width [columns] the table has quartiles."""


def seed_range(text: str) -> range:
    """The seeds of ``A:B``, from A to B - 1.

    Raises InvalidParameter: the text is not two whole numbers, or B is not above A.
    """
    found = re.fullmatch(r"(\d{1,18}):(\d{1,18})", text.strip())
    seeds = range(int(found[1]), int(found[2])) if found else range(0)
    if not seeds:
        raise InvalidParameter("--seeds", text, "A:B, the seeds from A to B - 1, of 18 digits at most, such as 0:1000")
    return seeds


def main(params: Params, seeds: range, json_to: str | None, workers: int) -> int:
    """Simulate every seed in `workers` processes (0: chosen here); print a table, write one JSON object per seed."""
    from hapnet.assembly.build import prepare
    from hapnet.processes.pool import usable_cores
    from hapnet.simulation.batch import simulate_batch

    if params.duration_s <= 0.0:
        raise InvalidParameter("duration_s", params.duration_s, "above 0 in virtual time")
    if not workers:
        workers = usable_cores() if len(seeds) * params.duration_s > LONG_S else 1
    words = output.console(json_to)
    setup = prepare(params, "continuous")
    output.show_warnings(words, setup.warnings)
    with Progress(output.progress_console(words), "simulating", len(seeds), "seeds") as bar:
        runs = simulate_batch(params, seeds, workers=workers, progress=lambda share: bar.update(share * len(seeds)))
    words.print(_table(runs, words.width))
    verdicts = Counter(run.summary["verdict"]["passive"] for run in runs)
    style = "bold red" if verdicts[False] else "bold yellow" if verdicts[None] else "bold green"
    words.print(f"of {len(runs)} scenarios {verdicts[True]} were passive, {verdicts[False]} were not", style=style)
    if verdicts[None]:
        words.print(f"not known: {verdicts[None]}; the first is {_first(runs, None)}", style="yellow", markup=False)
    if verdicts[False]:
        words.print(f"the first not passive is {_first(runs, False)}", style="red", markup=False)
    if why_not := next((run.not_compiled for run in runs if run.not_compiled is not None), None):
        output.show_kernel(words, why_not)
    output.write_json([as_dict(run) for run in runs], json_to)
    written = output.Written()
    written.missing += setup.missing
    for run in runs:
        written.judge(run.summary, run.params, virtual=True)
    del written.broken[1:]
    return written.code()


def _first(runs: list[BatchRun], passive: bool | None) -> str:
    """The seed and the reason of the first run with this verdict."""
    run = next(run for run in runs if run.summary["verdict"]["passive"] is passive)
    return f"seed {run.seed}, {run.summary['verdict']['reason']}"


def as_dict(run: BatchRun) -> dict[str, Any]:
    """A run's summary, with the final states of both sides."""
    final = {"device": run.device._asdict(), "world": run.world._asdict()}
    return {**run.summary, "final": final}


def _table(runs: list[BatchRun], width: int) -> Table:
    """Median, extremes and, in a terminal of `_WIDE` columns, quartiles over the runs."""
    import numpy as np
    from rich.markup import escape
    from rich.table import Table

    wanted = {"median": 0.5, "least": 0.0, "q1": 0.25, "q3": 0.75, "most": 1.0}
    shares = [(name, share) for name, share in wanted.items() if width >= _WIDE or name not in ("q1", "q3")]
    table = Table("", *(name for name, _ in shares))
    for name, value, scale in _figures():
        known = [scale * float(x) for x in (value(run.summary) for run in runs) if x is not None]
        if known:
            table.add_row(escape(name), *(_words(float(np.quantile(known, share))) for _, share in shares))
    return table


def _figures() -> Iterator[tuple[str, Callable[[Summary], float | None], float]]:
    """The table's rows: label, the summary's value, and the factor that scales it."""
    yield "came out of both ports, most [mJ]", lambda of: of["theorem"]["energy_out_J"], 1e3
    yield "margin at the end [mJ]", lambda of: of["theorem"]["margin_end_J"], 1e3
    yield "free motion, error (rms) [mm]", lambda of: of["motion"]["free_rms_m"], 1e3
    yield "contact, error (rms) [mm]", lambda of: of["motion"]["contact_rms_m"], 1e3
    yield "largest force [N]", lambda of: of["motion"]["peak_force_N"], 1.0
    for side in SIDES:
        yield from _of_side(side)
    for direction in DIRECTIONS:
        yield from _of_direction(direction)


def _of_side(side: Role) -> Iterator[tuple[str, Callable[[Summary], float | None], float]]:
    def part(of: Summary) -> SidePart:
        found = of[side]
        assert found is not None, "a simulated run has both sides"
        return found

    yield f"{side} gave out, most [mJ]", lambda of: part(of)["ledger"]["energy_out_J"], 1e3
    yield f"{side} slack [mJ]", lambda of: part(of)["ledger"]["slack_J"], 1e3
    yield f"{side} reservoir minimum [mJ]", lambda of: part(of)["reservoir_min_J"], 1e3


def _of_direction(direction: Direction) -> Iterator[tuple[str, Callable[[Summary], float | None], float]]:
    yield f"sent {direction} [mJ]", lambda of: of["energy"][direction]["sent_nJ"], 1e-6
    yield f"credited {direction} [mJ]", lambda of: of["energy"][direction]["credited_nJ"], 1e-6
    yield f"lost {direction}", lambda of: None if (link := of["links"][direction]) is None else link["lost"], 1.0


def _words(value: float) -> str:
    """The value with four digits; smaller values than 1e-6 are rounding errors, and shown as 0."""
    return f"{round(value, 6) + 0.0:.4g}"
