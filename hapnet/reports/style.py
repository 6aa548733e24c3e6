"""How all figures look: for print, 180 mm wide, text of 8 points and more."""

from __future__ import annotations

from typing import Any

MM = 1 / 25.4
"""In inches, which matplotlib wants."""

DEVICE_COLOR, WORLD_COLOR = "#08306b", "#e6550d"

STYLE: dict[Any, Any] = {  # Any: matplotlib types its keys as literals
    "font.size": 8.0,
    "axes.titlesize": 9.0,
    "axes.grid": True,
    "grid.linewidth": 0.4,
    "grid.color": "0.85",
    "lines.linewidth": 1.1,
    "legend.frameon": False,
    "hatch.linewidth": 0.4,
    "path.simplify_threshold": 0.2,
}
