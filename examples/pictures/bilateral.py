"""Draws the energy that laws between two robots gave out over each link, bare and behind PSPM; `table` makes it.

python -m examples.pictures.bilateral --out DIR
python -m examples.pictures.bilateral --table DIR --out DIR     # from the comparison in DIR
"""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path
from typing import TYPE_CHECKING

from examples.pictures.drawing import canvas, options, saved
from hapnet.ext.study.sections import ARMS

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FILE = Path(__file__).resolve().parents[1] / "bilateral.csv"
LAWS = {"pp": "position-position", "pf": "position-force", "four-channel": "four channels"}
PORTS = {"": "bare", ":bilateral.port=pspm": "behind PSPM"}
MEASURES = {  # column: metric, and the factor to its unit
    "out_mJ": ("energy_out_J", 1e3), "hand_out_mJ": ("hand_energy_out_J", 1e3),
    "force_error_percent": ("true_force_error_percent", 1.0), "free_mm": ("free_rms_mm", 1.0),
    "drag_N": ("drag_N", 1.0),
}  # fmt: skip
BOUND_MJ = 150.0


def table(compared: Path) -> list[dict[str, object]]:
    """A row for each case of the comparison that `hapnet compare --bench arms` wrote."""
    (file,) = compared.glob("arms/compare.json")
    names = {operator: name for name, operator in ARMS.items()}
    rows: list[dict[str, object]] = []
    for case in json.loads(file.read_text("utf-8"))["cases"]:
        law, colon, port = case["coupling"].partition(":")
        about = {"law": law, "port": PORTS[colon + port], "link": case["link"], "arm": names[case["operator"]]}
        values = {name: (case["measures"][metric], factor) for name, (metric, factor) in MEASURES.items()}
        rows.append(about | {name: "" if value is None else f"{factor * value:.5g}"
                             for name, (value, factor) in values.items()})  # fmt: skip
    return rows


def rows() -> list[dict[str, str]]:
    with FILE.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def fields(panel: Axes, port: str, cases: list[dict[str, str]]) -> None:
    """A field for each arm and law, and each link, with the energy that came out [mJ]; red: above the bound."""
    links = list(dict.fromkeys(case["link"] for case in cases))
    lines = [(law, arm) for law in LAWS for arm in ARMS]
    out = {(c["law"], c["arm"], c["link"]): float(c["out_mJ"]) for c in cases if c["port"] == port}
    for row, (law, arm) in enumerate(lines):
        for column, link in enumerate(links):
            value = out[law, arm, link]
            over = value > BOUND_MJ
            deep = min(1.0, math.log10(value / BOUND_MJ) / 2.0) if over else 0.0
            colour = (1.0 - 0.2 * deep, 0.75 - 0.62 * deep, 0.68 - 0.55 * deep) if over else (0.90, 0.95, 0.90)
            panel.fill([column, column + 1, column + 1, column], [row, row, row + 1, row + 1], color=colour)
            words = f"{value / 1e3:.1f} J" if value >= 1e3 else f"{value:.0f}"
            panel.text(column + 0.5, row + 0.5, words, ha="center", va="center", fontsize=5.5,
                       color="white" if deep > 0.5 else "black")  # fmt: skip
    for edge in range(0, len(lines) + 1, len(ARMS)):
        panel.axhline(edge, color="black", linewidth=0.7)
    panel.set(xlim=(0, len(links)), ylim=(len(lines), 0))
    panel.set_xticks([column + 0.5 for column in range(len(links))], links, rotation=55, ha="right", fontsize=6)
    panel.set_yticks(
        [row + 0.5 for row in range(len(lines))], [f"{LAWS[law]}, {arm}" for law, arm in lines], fontsize=6
    )
    panel.tick_params(length=0.0)
    panel.grid(visible=False)
    broken = sum(value > BOUND_MJ for value in out.values())
    panel.set_title(f"{port}: not passive in {broken} of {len(out)} cases")


def main() -> None:
    given = options()
    if given.table:
        made = table(given.table)
        with (given.out / FILE.name).open("w", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, list(made[0]), lineterminator="\n")
            writer.writeheader()
            writer.writerows(made)
        return
    figure = canvas(190.0, 78.0)
    panels = figure.subplots(1, 2, sharey=True)
    cases = rows()
    for panel, port in zip(panels, PORTS.values(), strict=True):
        fields(panel, port, cases)
    figure.supxlabel("energy that came out of both ports [mJ]; red: more than the 150 mJ allowed", fontsize=7)
    saved(figure, "bilateral.png")


if __name__ == "__main__":
    main()
