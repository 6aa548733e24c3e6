"""`hapnet compare --anchor NAME`: runs a published setting, and prints theirs, ours and why they differ."""

from __future__ import annotations

from dataclasses import fields
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from hapnet.commands import output
from hapnet.commands.progress import Progress
from hapnet.errors import InvalidParameter
from hapnet.ext.study.anchors import ANCHORS, THRESHOLDS, anchor, as_dict, run
from hapnet.params import Params

if TYPE_CHECKING:
    from hapnet.ext.study.commands.compare import CompareOptions

LIST = "list"
_OWN = ("bench", "coupling", "link", "trace", "operator", "deadband", "case")


def show(console: Console, options: CompareOptions, params: Params, json_to: str | None) -> int:
    """Run the anchor of `options` and print it; with "list" print what there is. Returns the exit code.

    Raises InvalidParameter: there is no such anchor, or a flag sets what the anchor sets.
    """
    name = options.anchor or LIST
    if name == LIST:
        for word, one in ANCHORS.items():
            console.print(f"{word}: {one.about}\n  {one.source}", markup=False, soft_wrap=True)
        return 0
    setting = anchor(name)
    for field in fields(options):
        if field.name in _OWN and getattr(options, field.name) != field.default:
            given = getattr(options, field.name)
            shown = " ".join(map(str, given)) if isinstance(given, list | tuple) else given
            raise InvalidParameter(f"--{field.name}", shown, "", why="--anchor sets it; leave it out")
    seed = _seed(options.seeds)
    with Progress(output.progress_console(console), "measuring", len(setting.runs), "runs") as progress:
        found = run(name, params, seed, progress.update)
    whole = as_dict(name, found)
    table = Table("", "theirs", "ours", title=escape(setting.about), title_justify="left", title_style="bold")
    for figure, row in zip(setting.figures, whole["figures"], strict=True):
        table.add_row(escape(figure.name), escape(figure.theirs), _shown(row["ours"], figure.unit, figure.digits))
    noticed = Table("people notice", "from", "ours", "source")
    for threshold, row in zip(THRESHOLDS, whole["thresholds"], strict=True):
        least = f"{threshold.noticed:g} {threshold.unit}"
        noticed.add_row(threshold.name, least, _shown(row["ours"], threshold.unit, 1), escape(threshold.source))
    console.print(table)
    console.print(f"theirs: {setting.source}", markup=False, soft_wrap=True)
    console.print(f"why they differ: {setting.why}", markup=False, soft_wrap=True)
    console.print(noticed)
    output.write_json(whole, json_to)
    return 0


def _seed(words: str | None) -> int:
    from hapnet.commands.batch import seed_range

    return 0 if words is None else seed_range(words)[0]


def _shown(value: float | None, unit: str, digits: int) -> str:
    return "–" if value is None else f"{value:.{digits}f} {unit}"
