"""Reads the effects of a solid's surface from its properties, and recorded grains from files."""

from __future__ import annotations

import numpy as np

from hapnet.checks import MOST_GRAIN, wrong_effects
from hapnet.errors import InvalidParameter
from hapnet.ext.solids.mesh_file import require_file
from hapnet.ext.solids.properties import UNITS, Properties, value_of
from hapnet.file_content import LARGEST_TEXT, read_bytes
from hapnet.mechanics.effects import Effects, Grain

EFFECTS_WORDS = (
    "grain=HEIGHT,WAVELENGTH or FILE.csv, grain_along=0,1,0, stick=0.8, viscosity=Ns/m, snap=N,REACH (felt at the "
    "device's rate)"
)


def effects_of(properties: Properties) -> Effects | None:
    """Return the effects of a solid's surface at the device's rate; None: it has none. Raises InvalidParameter."""
    grain = _grain(properties)
    effects = Effects(properties.number("viscosity", 0.0), properties.number("stick", 0.0), *_snap(properties), grain)
    if wrong := wrong_effects(effects, 3):
        raise InvalidParameter("effects", tuple(effects[:4]), f"those of a surface ({wrong})")
    return None if effects == Effects() else effects


def _grain(properties: Properties) -> Grain | None:
    along, text = properties.numbers("grain_along", (0.0, 0.0, 0.0)), properties.text("grain")
    if text is None:
        if any(along):
            raise properties.error("grain_along", "with a grain only")
        return None
    along = along if any(along) else (0.0, 1.0, 0.0)
    if text.lower().endswith(".csv"):
        return read_grain(text, along)
    parts = [value_of(part.strip(), UNITS) for part in text.split(",")]
    if len(parts) != 2 or None in parts or not all(part and part > 0.0 for part in parts):
        raise properties.error(
            f"grain={text}", "a height and a wavelength with their units, such as grain=0.1mm,2mm, or a file FILE.csv"
        )
    height, wavelength = (part for part in parts if part is not None)
    return Grain.sine(height, wavelength, along)


def _snap(properties: Properties) -> tuple[float, float]:
    text = properties.text("snap")
    if text is None:
        return 0.0, 0.0
    force, comma, reach = text.partition(",")
    number, length = value_of(force.strip(), None), value_of(reach.strip(), UNITS)
    if number is None or length is None or not comma:
        raise properties.error(f"snap={text}", "the largest force and from how far, such as snap=1,5mm")
    return number, length


_HEADER = "distance_m,height_m"
_UNEVEN = 1e-3
"""Allowed error of the distances, as a share of their spacing."""


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
