"""The unit of each axis, metre or radian, and with it the unit of its force and the name of its column.

A world declares its units; the device, the parameters and the other side must have the same units. They are a text:
``m``, ``rad``, or a unit for each axis as in ``m,m,rad``. Names in code end in the units for metres
(`position_m`, `force_N`); for an axis in radians these values are in rad, rad/s, Nm, Nm/rad, Nms/rad and kg m^2.

The twelve coordinates of a pose (`hapnet.mechanics.pose`), all in metres, are the text ``pose``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hapnet.errors import InvalidParameter

METRES, RADIANS, POSE = "m", "rad", "pose"

POSE_AXES = 12

RADIANS_FOR = {"m": "rad", "mm": "mrad", "m/s": "rad/s", "mps": "radps", "N": "Nm", "N/m": "Nm/rad"}
"""For an axis in radians: the unit that replaces each unit of an axis in metres; ``mps`` occurs in names of fields."""


def units_of(declared: object, dof: int, name: str = "units") -> tuple[str, ...]:
    """The unit of each of `dof` axes, from a text in the module's form.

    Raises InvalidParameter: `declared` does not have this form.
    """
    if declared == POSE and dof == POSE_AXES:
        return (METRES,) * dof
    parts = tuple([part.strip() for part in declared.split(",")]) if isinstance(declared, str) else ()
    if len(parts) not in (1, dof) or not set(parts) <= {METRES, RADIANS}:
        raise InvalidParameter(name, declared, f"m or rad, for all axes or one for each of {dof}, as in m,m,rad")
    return parts * dof if len(parts) == 1 else parts


def text_of(units: tuple[str, ...]) -> str:
    """The text of these units: a single word if all are equal."""
    return ",".join(units if len(set(units)) > 1 else units[:1])


def one_text(declared: object, dof: int, name: str = "units") -> str:
    """The canonical text of these units. Raises InvalidParameter, as `units_of`."""
    units = units_of(declared, dof, name)
    return POSE if declared == POSE else text_of(units)


def text_in(meta: Mapping[str, Any], dof: int) -> str:
    """The units' text in a recording's description; metres if it has none that fits."""
    params = meta.get("params")
    declared = params.get("units") if isinstance(params, Mapping) else None
    if declared is None:  # for each sample of a recording: an exception would take as long as writing it
        return METRES
    try:
        return one_text(declared, dof)
    except InvalidParameter:
        return METRES


def units_in(meta: Mapping[str, Any], dof: int) -> tuple[str, ...]:
    """The units of `text_in`."""
    return units_of(text_in(meta, dof), dof)


def within(units: str | None, unit: str) -> str:
    """The unit of a value for axes in `units` (None: metres): `unit`, its counterpart for radians, or both."""
    words = [RADIANS_FOR.get(unit, unit) if axis == RADIANS else unit for axis in (units or METRES).split(",")]
    return " or ".join(dict.fromkeys(words))


def column(field: str, unit: str) -> str:
    """The name of a field's column for an axis in `unit`: for rad, position_m becomes position_rad."""
    stem, _, ending = field.rpartition("_")
    return f"{stem}_{RADIANS_FOR[ending]}" if unit == RADIANS else field
