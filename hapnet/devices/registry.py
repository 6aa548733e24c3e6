"""The devices by name: hapnet's own drivers, and those that other packages publish as entry points of `hapnet.devices`.

A device is given as ``NAME``, or ``NAME:OPTIONS``, or ``module:Class`` and ``module:Class,OPTIONS``. The options are
``key=value``, joined by commas; the first may be a bare value, for the driver's first option (its address, mostly):
``serial:/dev/ttyACM0``, ``inverse3:axes=xz``. They are the keywords of the driver's constructor besides `dof`.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from typing import Any

from hapnet.errors import InvalidParameter
from hapnet.loading import published

GROUP = "hapnet.devices"

BUILT_IN: Mapping[str, str] = {
    "serial": "hapnet.ext.devices.serial_axis:SerialAxis",
    "inverse3": "hapnet.ext.devices.inverse3:Inverse3",
    "dhd": "hapnet.ext.devices.force_dimension:ForceDimension",
    "touch": "hapnet.ext.devices.touch:TouchDriver",
    "franka": "hapnet.ext.robots.franka:Franka",
    "dynamixel": "hapnet.ext.robots.dynamixel:Dynamixel",
    "feetech": "hapnet.ext.robots.feetech:Feetech",
    "gamepad": "hapnet.ext.devices.gamepad:Gamepad",
    "3dmouse": "hapnet.ext.devices.space_mouse:SpaceMouse",
    "ros2": "hapnet.ext.robots.ros2:Ros2",
}
"""The drivers of hapnet: from the name to ``module:Class``."""


def known() -> dict[str, tuple[str, str]]:
    """All devices by name: the ``module:Class`` of the driver, and the package that it comes from."""
    return {name: (target, "hapnet") for name, target in BUILT_IN.items()} | {
        name: found for name, found in published(GROUP).items() if name not in BUILT_IN
    }


def resolve(text: str) -> tuple[str, str]:
    """The ``module:Class`` that `text` names, and the options behind it."""
    name, _, behind = text.partition(":")
    if name in BUILT_IN:
        return BUILT_IN[name], behind
    if name in (found := published(GROUP)):
        return found[name][0], behind
    target, _, behind = text.partition(",")
    return target, behind


def options(name: str, made: Callable[..., Any], text: str) -> dict[str, Any]:
    """The options of the device `name` as keywords for its class, each of the type of its default.

    Raises InvalidParameter: there is no such option, or its value is of another type.
    """
    known = _keywords(made)
    found: dict[str, Any] = {}
    for index, entry in enumerate(filter(None, text.split(","))):
        key, equals, value = entry.partition("=")
        if not equals:
            if index or not known:
                raise InvalidParameter("hardware", name, _allowed(known))
            key, value = next(iter(known)), entry
        if key not in known:
            raise InvalidParameter(f"hardware {name}: option", key, _allowed(known), known)
        if key in found:
            raise InvalidParameter("hardware", name, _allowed(known))
        found[key] = _converted(name, key, value, known[key])
    return found


_GIVEN = {"dof", "handle", "clock"}
"""The arguments that hapnet itself passes to a driver or an emulator."""


def _keywords(made: Callable[..., Any]) -> dict[str, Any]:
    """The options of a class, and their defaults."""
    try:
        parameters = list(inspect.signature(made).parameters.values())
    except (TypeError, ValueError):
        return {}
    named = [p for p in parameters if p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY) and p.name not in _GIVEN]
    return {p.name: None if p.default is p.empty else p.default for p in named}


def _allowed(known: Mapping[str, Any]) -> str:
    if not known:
        return "a device without options: this one takes none"
    shown = ", ".join(f"{key}={'' if default is None else default}" for key, default in known.items())
    return f"a device with these options, each at most once (and their defaults): {shown}"


_WORDS = {"true": True, "yes": True, "on": True, "1": True, "false": False, "no": False, "off": False, "0": False}


def _converted(name: str, key: str, value: str, default: Any) -> Any:
    wanted = type(default)
    try:
        if wanted is bool:
            return _WORDS[value.lower()]
        if wanted in (int, float):
            return wanted(value)
    except (KeyError, ValueError):
        kind = {bool: "yes or no", int: "a whole number", float: "a number"}[wanted]
        raise InvalidParameter("hardware", name, f"{kind} for {key}, such as {key}={default}") from None
    return value
