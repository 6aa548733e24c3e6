"""Draws the energy that came out with PSPM and with other laws, where they differ; `table` makes the numbers.

python -m examples.pictures.compare --out DIR
python -m examples.pictures.compare --table DIR --out DIR       # from the comparisons in DIR/lying and DIR/moving
"""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import TYPE_CHECKING

from examples.pictures.drawing import canvas, options, saved
from hapnet.ext.pictures.style import COLOURS, NOT_PASSIVE

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FILE = Path(__file__).resolve().parents[1] / "compared.csv"
NAMES = {
    "pspm": "hapnet (PSPM)",
    "eba:rendering=hapnet": "energy bounding",
    "popc:rendering=hapnet": "passivity observer",
    "zoh": "plain spring",
    "pd:rendering=hapnet": "damped soft spring",
    "two-layer:rendering=hapnet": "energy tanks",
}
WORLDS = {
    "lying": "false wall positions from the world (20 hands)",
    "moving": "a wall that moves and softens (8 hands)",
}
MEASURES = {  # column: metric, and the factor to its unit
    "out_mJ": ("energy_out_J", 1e3), "hand_out_mJ": ("hand_energy_out_J", 1e3),
    "world_out_mJ": ("world_energy_out_J", 1e3), "stiffness_percent": ("stiffness_percent", 1.0),
    "force_error_percent": ("true_force_error_percent", 1.0), "free_mm": ("free_rms_mm", 1.0),
    "drag_N": ("drag_N", 1.0),
}  # fmt: skip
BOUND_MJ, MOST_MJ, SHORT_MJ = 150.0, 450.0, 60.0


def table(compared: Path) -> list[dict[str, object]]:
    """A row for each case of the comparisons that `hapnet compare` wrote into folders with the names of `WORLDS`."""
    rows: list[dict[str, object]] = []
    for world in WORLDS:
        (file,) = (compared / world).glob("*/compare.json")
        for case in json.loads(file.read_text("utf-8"))["cases"]:
            if case["coupling"] not in NAMES:
                continue  # the local wall
            about = {"world": world, "coupling": case["coupling"], "operator": case["operator"], "seed": case["seed"]}
            values = {name: (case["measures"][metric], factor) for name, (metric, factor) in MEASURES.items()}
            rows.append(about | {name: "" if value is None else f"{factor * value:.5g}"
                                 for name, (value, factor) in values.items()})  # fmt: skip
    return rows


def most_out(world: str, coupling: str) -> float:
    """The most energy that came out of both ports in a case of the file [mJ]."""
    with FILE.open(encoding="utf-8", newline="") as file:
        rows = [row for row in csv.DictReader(file) if (row["world"], row["coupling"]) == (world, coupling)]
    return max(float(row["out_mJ"]) for row in rows)


def bars(panel: Axes, world: str) -> None:
    """A bar for each law; one that is too long ends at the edge, with its value."""
    values = [most_out(world, coupling) for coupling in NAMES]
    colours = [COLOURS[0], *("0.4" for _ in values[1:])]
    panel.barh(list(NAMES.values()), [min(value, MOST_MJ) for value in values], color=colours, height=0.66)
    for place, value in enumerate(values):
        words = f"{value:,.0f} mJ" + " →" * (value > MOST_MJ)
        where = {"x": min(value, MOST_MJ) - 4.0, "ha": "right", "color": "white"}
        if value < SHORT_MJ:
            where = {"x": value + 4.0, "ha": "left", "color": "black"}
        panel.text(y=place, s=words, va="center", fontsize=8, **where)
    panel.axvspan(BOUND_MJ, MOST_MJ, alpha=0.35, **NOT_PASSIVE)
    panel.axvline(BOUND_MJ, color="#cb181d", linewidth=1.4)
    panel.text(BOUND_MJ + 6.0, -0.62, f"limit: {BOUND_MJ:.0f} mJ", color="#cb181d", fontsize=8, va="center")
    panel.set(xlim=(0.0, MOST_MJ), ylim=(len(values) - 0.5, -0.9))
    panel.grid(visible=False)
    panel.tick_params(axis="y", length=0.0)
    panel.set_title(WORLDS[world])
    panel.set_xlabel("most energy in any case [mJ]")


def main() -> None:
    given = options()
    if given.table:
        rows = table(given.table)
        with (given.out / FILE.name).open("w", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)
        return
    figure = canvas(180.0, 68.0)
    figure.suptitle("Energy that comes out over 4G, all with the same stages and limits", fontsize=10)
    for panel, world in zip(figure.subplots(1, 2, sharey=True), WORLDS, strict=True):
        bars(panel, world)
    saved(figure, "compare.png")


if __name__ == "__main__":
    main()
