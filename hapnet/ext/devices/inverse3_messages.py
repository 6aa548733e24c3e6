"""The messages of Haply's Inverse Service 3.5, without input and output. Its page is inverse3.md.

Values that are missing, of another type or not finite are never guessed: such a message has no state.
"""

from __future__ import annotations

import json
from math import hypot, isfinite
from typing import Any, NamedTuple

from hapnet.checks import Vector

SPELLINGS = ("vector", "values")
"""The name of the force in a command: in service 3.5, and in earlier ones."""

NO_FRAME = "defaults"
"""The preset with the origin at the arm's base: the only one of services before 3.5."""

_GRIPS = ("wireless_verse_grip", "custom_verse_grip", "verse_grip")
_ARMS = ("inverse3", "minverse")
_HEALTHY = ("awake", "connected", "ready")
_UNIT = 0.01
"""The greatest difference of a quaternion's length from 1."""


class Inverse3State(NamedTuple):
    """The state of an arm and of its grip."""

    position: Vector
    """The position (3,) [m]."""
    velocity: Vector
    """The velocity (3,) [m/s]."""
    calibrated: bool
    powered: bool
    """Whether it has power; without it there is no force."""
    buttons: tuple[bool, ...]
    """The grip's buttons, in the order of their names."""
    orientation: Vector | None
    """The grip's orientation: a unit quaternion (w, x, y, z); None: not known."""
    force: Vector | None
    """The force that acts now, as the service reports it [N]; None: not reported."""
    grip: str
    """The id of the grip; empty: there is none."""


class ForceEvent(NamedTuple):
    """An event of the service that concerns the force."""

    what: str
    """The event's name, or for a safety event its `safety_type`."""
    device: str
    """The id of its device; empty: not reported."""
    level: str
    """The severity: info, notice, warning, error, critical, panic."""


def parsed(raw: bytes) -> dict[str, Any] | None:
    """The object in a message; None if there is none."""
    try:
        found = json.loads(raw)
    except (ValueError, RecursionError):
        return None
    return found if isinstance(found, dict) else None


def kind_of(message: dict[str, Any], device: str) -> str:
    """The kind under which a message lists the arm, inverse3 or minverse; empty: it does not."""
    return next((kind for kind in _ARMS for arm in _entries(message, kind) if arm.get("device_id") == device), "")


def preset_of(message: dict[str, Any], device: str) -> str | None:
    """The preset of an arm in a message with its configuration; None: there is none."""
    for arm in _entries(message, kind_of(message, device)):
        if arm.get("device_id") == device and isinstance(config := arm.get("config"), dict):
            preset = config.get("preset")
            return _text(preset.get("preset") if isinstance(preset, dict) else preset) or None
    return None


def spelling_of(inventory: dict[str, Any], device: str) -> str:
    """The name of a force in the service with this inventory: if it has presets, it is version 3.5."""
    return SPELLINGS[0] if "session_id" in inventory or preset_of(inventory, device) else SPELLINGS[1]


def arms(message: dict[str, Any]) -> list[str]:
    """The ids of the arms that a message lists."""
    listed = [_text(entry.get("device_id")) for kind in _ARMS for entry in _entries(message, kind)]
    return [name for name in listed if name]


def state(message: dict[str, Any], device: str) -> Inverse3State | None:
    """The state of the arm `device`, and of the first grip with a state; None: it is not in the message."""
    for kind in _ARMS:
        for entry in _entries(message, kind):
            if entry.get("device_id") == device:
                return _state(message, entry)
    return None


def command(device: str, force: Vector, spelling: str = SPELLINGS[0], kind: str = _ARMS[0]) -> bytes:
    """The command of a force (3,) to the arm [N], which the service answers with one state."""
    return b'{%b:[{"device_id":%b,"commands":{%b}}]}' % (_quoted(kind), _quoted(device), _force(force, spelling))


def greeting(device: str, preset: str, spelling: str = SPELLINGS[0], kind: str = _ARMS[0]) -> bytes:
    """The first message: a name for the session, the maker's frame, the arm's preset, and zero force."""
    session = b'{"configure":{"profile":{"name":"hapnet"},"basis":{"permutation":"XYZ"}}}'
    arm = b'"device_id":%b,"configure":{"preset":{"preset":%b}}' % (_quoted(device), _quoted(preset))
    force = _force((0.0, 0.0, 0.0), spelling)
    return b'{"session":%b,%b:[{%b,"commands":{%b}}]}' % (session, _quoted(kind), arm, force)


def whole(device: str, spelling: str = SPELLINGS[0], kind: str = _ARMS[0]) -> bytes:
    """The second message: requests the present configuration, with zero force."""
    force = _force((0.0, 0.0, 0.0), spelling)
    arm = b'{"device_id":%b,"commands":{%b}}' % (_quoted(device), force)
    return b'{"session":{"force_render_full_state":{}},%b:[%b]}' % (_quoted(kind), arm)


def notice(raw: bytes) -> ForceEvent | None:
    """The event in a message of the event socket; None if there is none."""
    if (message := parsed(raw)) is None or not (name := _text(message.get("name"))):
        return None
    data = message.get("data")
    details = data if isinstance(data, dict) else {}
    return ForceEvent(
        _text(details.get("safety_type")) or name, _text(details.get("device_id")), _text(message.get("level"))
    )


def _force(force: Vector, spelling: str) -> bytes:
    x, y, z = force
    return f'"set_cursor_force":{{"{spelling}":{{"x":{x!r},"y":{y!r},"z":{z!r}}}}}'.encode("ascii")


def _quoted(text: str) -> bytes:
    return json.dumps(text).encode("ascii")


def _state(message: dict[str, Any], entry: dict[str, Any]) -> Inverse3State | None:
    values, status = entry.get("state"), entry.get("status")
    if not isinstance(values, dict):
        return None
    position, velocity = _vector(values.get("cursor_position")), _vector(values.get("cursor_velocity"))
    if position is None or velocity is None:
        return None
    status = status if isinstance(status, dict) else {}
    calibrated, powered = status.get("calibrated") is not False, status.get("power_supply") is not False
    buttons, orientation, grip = _grip(message)
    force = _vector(values.get("current_cursor_force"))
    return Inverse3State(position, velocity, calibrated, powered, buttons, orientation, force, grip)


def _grip(message: dict[str, Any]) -> tuple[tuple[bool, ...], Vector | None, str]:
    """Buttons, orientation and id of the grip. If it sleeps, is lost or not ready, its buttons are released."""
    for kind in _GRIPS:
        for entry in _entries(message, kind):
            if isinstance(values := entry.get("state"), dict):
                buttons, name = _buttons(values), _text(entry.get("device_id"))
                status = entry.get("status")
                if isinstance(status, dict) and any(status.get(flag) is False for flag in _HEALTHY):
                    return (False,) * len(buttons), None, name
                return buttons, _quaternion(values.get("orientation")), name
    return (), None, ""


def _buttons(reported: dict[str, Any]) -> tuple[bool, ...]:
    if isinstance(several := reported.get("buttons"), dict):
        return tuple([several[name] is True for name in sorted(several)])
    return (reported["button"] is True,) if "button" in reported else ()


def _entries(message: dict[str, Any], kind: str) -> list[dict[str, Any]]:
    listed = message.get(kind)
    return [entry for entry in listed if isinstance(entry, dict)] if isinstance(listed, list) else []


def _text(value: object) -> str:
    return value if isinstance(value, str) else ""


def _vector(reported: object, names: str = "xyz") -> Vector | None:
    if not isinstance(reported, dict):
        return None
    values: list[Any] = [reported.get(name) for name in names]
    if any(type(value) not in (int, float) for value in values):
        return None
    try:
        found = tuple(map(float, values))
    except OverflowError:
        return None
    return found if isfinite(sum(found)) else None


def _quaternion(reported: object) -> Vector | None:
    if (found := _vector(reported, "wxyz")) is None or abs(hypot(*found) - 1.0) > _UNIT:
        return None
    length = hypot(*found)
    return tuple([part / length for part in found])
