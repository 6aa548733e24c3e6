"""Recorded grains, from files."""

from __future__ import annotations

import numpy as np

from hapnet.checks import MOST_GRAIN
from hapnet.errors import InvalidParameter
from hapnet.ext.solids.mesh_file import require_file
from hapnet.file_content import LARGEST_TEXT, read_bytes
from hapnet.mechanics.effects import Grain

_HEADER = "distance_m,height_m"
_UNEVEN = 1e-3
"""Distances may be wrong by this share of their spacing."""


def read_grain(file: str, along: tuple[float, ...]) -> Grain:
    """A recorded grain, which repeats one spacing after its last row.

    file : a line ``distance_m,height_m``, then 2 to 256 rows of two numbers [m], the distances evenly spaced from 0.
    along : the direction (3,) of its distances.

    Raises InvalidParameter.
    """
    require_file(file)
    try:
        text = read_bytes(file, LARGEST_TEXT).decode("utf-8-sig", errors="replace")
    except OSError as error:
        raise InvalidParameter("grain", file, f"a file that can be read ({error.strerror})") from None
    header, *rows = text.replace("\r\n", "\n").strip().split("\n")
    if header.strip() != _HEADER:
        raise InvalidParameter("grain", file, f"a file whose first line is {_HEADER}")
    try:
        table = np.array([[float(part) for part in row.split(",")] for row in rows if row.strip()])
    except ValueError:
        table = np.empty((0, 0))
    if table.ndim != 2 or table.shape[1] != 2 or not np.isfinite(table).all():
        raise InvalidParameter("grain", file, f"rows of two finite numbers with a comma under {_HEADER}")
    if not 2 <= len(table) <= MOST_GRAIN:
        raise InvalidParameter("grain", f"{file}, {len(table)} rows", f"2 to {MOST_GRAIN} rows")
    spacing = (table[-1, 0] - table[0, 0]) / (len(table) - 1)
    if not spacing > 0.0 or np.abs(table[:, 0] - spacing * np.arange(len(table))).max() > _UNEVEN * spacing:
        raise InvalidParameter("grain", file, "distances that are evenly spaced from 0")
    return Grain.of(table[:, 1].tolist(), float(spacing) * len(table), along)
