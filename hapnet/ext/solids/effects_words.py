"""Effects of a solid's surface from its properties."""

from __future__ import annotations

from hapnet.checks import wrong_effects
from hapnet.errors import InvalidParameter
from hapnet.ext.solids.grain_file import read_grain
from hapnet.ext.solids.properties import UNITS, Properties, value_of
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
