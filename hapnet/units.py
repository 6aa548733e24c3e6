"""The unit of each axis, metre or radian, and what follows from it: the unit of its force, the name of its column.

A world declares its units, and whoever works with it must have the same: the device, the parameters and the other side.
They are a text, ``m``, ``rad``, or one for each axis as in ``m,m,rad``. Names in code end in the units of metres
(`position_m`, `force_N`): an axis in radians has its values there in rad, rad/s, Nm, Nm/rad, Nms/rad and kg m^2.

The twelve coordinates of a pose (`hapnet.mechanics.pose`), all in metres, are the text ``pose``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hapnet.errors import InvalidParameter

METRES, RADIANS, POSE = "m", "rad", "pose"

POSE_AXES = 12

RADIANS_FOR = {"m": "rad", "mm": "mrad", "m/s": "rad/s", "mps": "radps", "N": "Nm", "N/m": "Nm/rad"}
"""What a unit of an axis in metres is for one in radians; ``mps`` as fields' names have it."""


def units_of(declared: object, dof: int, name: str = "units") -> tuple[str, ...]:
    """The unit of each of `dof` axes, of a text as above.

    Raises InvalidParameter: it is no such text.
    """
    if declared == POSE and dof == POSE_AXES:
        return (METRES,) * dof
    parts = tuple([part.strip() for part in declared.split(",")]) if isinstance(declared, str) else ()
    if len(parts) not in (1, dof) or not set(parts) <= {METRES, RADIANS}:
        raise InvalidParameter(name, declared, f"m or rad, for all axes or one for each of {dof}, as in m,m,rad")
    return parts * dof if len(parts) == 1 else parts


def text_of(units: tuple[str, ...]) -> str:
    """The text of these units: one word where all are the same."""
    return ",".join(units if len(set(units)) > 1 else units[:1])


def one_text(declared: object, dof: int, name: str = "units") -> str:
    """The text that all have who mean these units. Raises InvalidParameter, as `units_of`."""
    units = units_of(declared, dof, name)
    return POSE if declared == POSE else text_of(units)


def text_in(meta: Mapping[str, Any], dof: int) -> str:
    """The text in a recording's description; metres where it says nothing that fits."""
    params = meta.get("params")
    try:
        return one_text(params.get("units") if isinstance(params, Mapping) else METRES, dof)
    except InvalidParameter:
        return METRES


def units_in(meta: Mapping[str, Any], dof: int) -> tuple[str, ...]:
    """The units of `text_in`."""
    return units_of(text_in(meta, dof), dof)


def within(units: str | None, unit: str) -> str:
    """The unit of a value, for axes in `units` (a text as above; None: metres): `unit`, that of radians, or both."""
    words = [RADIANS_FOR.get(unit, unit) if one == RADIANS else unit for one in (units or METRES).split(",")]
    return " or ".join(dict.fromkeys(words))


def column(field: str, unit: str) -> str:
    """The name of an axis's column of a field: position_m of an axis in rad is position_rad."""
    stem, _, ending = field.rpartition("_")
    return f"{stem}_{RADIANS_FOR[ending]}" if unit == RADIANS else field
