"""The messages of Haply's Inverse Service 3.5, and no input or output. inverse3.md beside it is its page.

What is missing, of another type or not finite is never guessed: such a message has no state in it.
"""

from __future__ import annotations

import json
from math import hypot, isfinite
from typing import Any, NamedTuple

from hapnet.checks import Vector

SPELLINGS = ("vector", "values")
"""What a command calls its force: service 3.5, and those before."""

NO_FRAME = "defaults"
"""The preset of an arm whose origin is its base: that of services before 3.5, which have no others."""

_GRIPS = ("wireless_verse_grip", "custom_verse_grip", "verse_grip")
_ARMS = ("inverse3", "minverse")
_HEALTHY = ("awake", "connected", "ready")
_UNIT = 0.01
"""A quaternion's length may differ from 1 by so much."""


class Inverse3State(NamedTuple):
    """An arm's state, and that of the grip on it."""

    position: Vector
    """[m], shape (3,)."""
    velocity: Vector
    """[m/s], shape (3,)."""
    calibrated: bool
    powered: bool
    """Has it its power supply? Without it there is no force."""
    buttons: tuple[bool, ...]
    """Of the grip, by their names' order."""
    orientation: Vector | None
    """Of the grip: a unit quaternion (w, x, y, z); None: not known."""
    force: Vector | None
    """The one that acts now, as the service believes [N]; None: not reported."""
    grip: str
    """The id of the grip; empty: there is none."""


class ForceEvent(NamedTuple):
    """An event of the service that concerns the force."""

    what: str
    """The event's name, or for a safety event its `safety_type`."""
    device: str
    """Which device it concerns; empty: it does not say."""
    level: str
    """How bad it is: info, notice, warning, error, critical, panic."""


def parsed(raw: bytes) -> dict[str, Any] | None:
    """The object in a message; None if it is none."""
    try:
        found = json.loads(raw)
    except (ValueError, RecursionError):
        return None
    return found if isinstance(found, dict) else None


def kind_of(message: dict[str, Any], device: str) -> str:
    """Under which name the message has the arm: an inverse3 or a minverse; empty: it has not."""
    return next((kind for kind in _ARMS for arm in _entries(message, kind) if arm.get("device_id") == device), "")


def preset_of(message: dict[str, Any], device: str) -> str | None:
    """The preset of an arm in a message with its configuration; None: it has none."""
    for arm in _entries(message, kind_of(message, device)):
        if arm.get("device_id") == device and isinstance(config := arm.get("config"), dict):
            reported = config.get("preset")
            return _text(reported.get("preset") if isinstance(reported, dict) else reported) or None
    return None


def spelling_of(inventory: dict[str, Any], device: str) -> str:
    """How the service that sent this inventory spells a force: one that has presets is a 3.5."""
    return SPELLINGS[0] if "session_id" in inventory or preset_of(inventory, device) else SPELLINGS[1]


def arms(message: dict[str, Any]) -> list[str]:
    """The ids of the arms that a message lists."""
    listed = [_text(entry.get("device_id")) for kind in _ARMS for entry in _entries(message, kind)]
    return [name for name in listed if name]


def state(message: dict[str, Any], device: str) -> Inverse3State | None:
    """The state of the arm `device`, and of the first grip that reports its own; None: it is not in the message."""
    for kind in _ARMS:
        for entry in _entries(message, kind):
            if entry.get("device_id") == device:
                return _state(message, entry)
    return None


def command(device: str, force: Vector, spelling: str = SPELLINGS[0], kind: str = _ARMS[0]) -> bytes:
    """A force for the arm [N], shape (3,). The service answers it with one state."""
    return b'{%b:[{"device_id":%b,"commands":{%b}}]}' % (_quoted(kind), _quoted(device), _force(force, spelling))


def greeting(device: str, preset: str, spelling: str = SPELLINGS[0], kind: str = _ARMS[0]) -> bytes:
    """The first message: a name for the session, the maker's own frame, the arm's preset, and no force."""
    session = b'{"configure":{"profile":{"name":"hapnet"},"basis":{"permutation":"XYZ"}}}'
    arm = b'"device_id":%b,"configure":{"preset":{"preset":%b}}' % (_quoted(device), _quoted(preset))
    force = _force((0.0, 0.0, 0.0), spelling)
    return b'{"session":%b,%b:[{%b,"commands":{%b}}]}' % (session, _quoted(kind), arm, force)


def whole(device: str, spelling: str = SPELLINGS[0], kind: str = _ARMS[0]) -> bytes:
    """The second message: asks for the configuration once more, as it is now; and no force."""
    force = _force((0.0, 0.0, 0.0), spelling)
    arm = b'{"device_id":%b,"commands":{%b}}' % (_quoted(device), force)
    return b'{"session":{"force_render_full_state":{}},%b:[%b]}' % (_quoted(kind), arm)


def notice(raw: bytes) -> ForceEvent | None:
    """The event in a message of the event socket; None if it is none."""
    if (message := parsed(raw)) is None or not (name := _text(message.get("name"))):
        return None
    data = message.get("data")
    reported = data if isinstance(data, dict) else {}
    return ForceEvent(
        _text(reported.get("safety_type")) or name, _text(reported.get("device_id")), _text(message.get("level"))
    )


def _force(force: Vector, spelling: str) -> bytes:
    x, y, z = force
    return f'"set_cursor_force":{{"{spelling}":{{"x":{x!r},"y":{y!r},"z":{z!r}}}}}'.encode("ascii")


def _quoted(text: str) -> bytes:
    return json.dumps(text).encode("ascii")


def _state(message: dict[str, Any], entry: dict[str, Any]) -> Inverse3State | None:
    reported, status = entry.get("state"), entry.get("status")
    if not isinstance(reported, dict):
        return None
    position, velocity = _vector(reported.get("cursor_position")), _vector(reported.get("cursor_velocity"))
    if position is None or velocity is None:
        return None
    status = status if isinstance(status, dict) else {}
    calibrated, powered = status.get("calibrated") is not False, status.get("power_supply") is not False
    buttons, orientation, grip = _grip(message)
    force = _vector(reported.get("current_cursor_force"))
    return Inverse3State(position, velocity, calibrated, powered, buttons, orientation, force, grip)


def _grip(message: dict[str, Any]) -> tuple[tuple[bool, ...], Vector | None, str]:
    """Buttons, orientation and id. Of a grip that sleeps, is lost or not ready the buttons are released."""
    for kind in _GRIPS:
        for entry in _entries(message, kind):
            if isinstance(reported := entry.get("state"), dict):
                buttons, name = _buttons(reported), _text(entry.get("device_id"))
                status = entry.get("status")
                if isinstance(status, dict) and any(status.get(flag) is False for flag in _HEALTHY):
                    return (False,) * len(buttons), None, name
                return buttons, _quaternion(reported.get("orientation")), name
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
