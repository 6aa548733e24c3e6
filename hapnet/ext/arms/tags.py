"""Each tag and attribute of URDF, and what happens to it; the page `URDF.md` has the same list.

An attribute is written ``joint/limit@lower``. What the list does not have is named in a warning.
"""

from __future__ import annotations

from collections.abc import Iterator
from xml.etree import ElementTree

from hapnet.errors import InvalidParameter

USED, NAMED, REFUSED, UNNEEDED = "used", "named in a warning", "refused", "not needed"
"""UNNEEDED: motion does not depend on it, and no message names it, whatever it contains."""

DRAKE = "{http://drake.mit.edu}"
"""The namespace of Drake's tags, as ElementTree writes it; here and on the page they begin with ``drake:``."""

TAGS = {
    "robot@name": UNNEEDED,
    "robot@version": UNNEEDED,
    "link@name": USED,
    "link/inertial/origin@xyz": USED,
    "link/inertial/origin@rpy": USED,
    "link/inertial/origin@quat_xyzw": REFUSED,
    "link/inertial/mass@value": USED,
    "link/inertial/inertia@ixx": USED,
    "link/inertial/inertia@ixy": USED,
    "link/inertial/inertia@ixz": USED,
    "link/inertial/inertia@iyy": USED,
    "link/inertial/inertia@iyz": USED,
    "link/inertial/inertia@izz": USED,
    "link/visual": UNNEEDED,
    "link/collision": UNNEEDED,
    "joint@name": USED,
    "joint@type": USED,
    "joint/origin@xyz": USED,
    "joint/origin@rpy": USED,
    "joint/origin@quat_xyzw": REFUSED,
    "joint/parent@link": USED,
    "joint/child@link": USED,
    "joint/axis@xyz": USED,
    "joint/limit@lower": USED,
    "joint/limit@upper": USED,
    "joint/limit@effort": USED,
    "joint/limit@velocity": USED,
    "joint/dynamics@damping": USED,
    "joint/dynamics@friction": USED,
    "joint/dynamics@armature": USED,
    "joint/mimic@joint": USED,
    "joint/mimic@multiplier": USED,
    "joint/mimic@offset": USED,
    "joint/safety_controller@soft_lower_limit": USED,
    "joint/safety_controller@soft_upper_limit": USED,
    "joint/safety_controller@k_position": USED,
    "joint/safety_controller@k_velocity": NAMED,
    "joint/calibration": UNNEEDED,
    "material": UNNEEDED,
    "sensor": UNNEEDED,
    "transmission/joint@name": USED,
    "transmission/actuator/drake:rotor_inertia@value": USED,
    "transmission/actuator/drake:gear_ratio@value": USED,
    "transmission": UNNEEDED,
    "gazebo": NAMED,
    "mujoco": NAMED,
    "ros2_control": NAMED,
    "xacro:*": REFUSED,
}

_PLAIN = "plain URDF (`xacro FILE > arm.urdf` expands a xacro file)"
_INNER = {
    "/".join(path[:k])
    for path in (key.partition("@")[0].split("/") for key in TAGS if "@" in key)
    for k in range(1, len(path) + 1)
}
"""The tags that are searched for others."""


def not_used(root: ElementTree.Element, name: str) -> list[str]:
    """The tags and attributes of a file that are named in a warning, each once; name : of the file.

    Raises InvalidParameter: a tag or attribute is refused, or a tag that has to be the only one is there twice.
    """
    for element in root.iter():
        if "xacro" in element.tag.partition("}")[0]:
            raise InvalidParameter(f"a tag of {name}", f"<xacro:{_short(element.tag)}>", _PLAIN)
    found = _below(root, "", name)
    return list(dict.fromkeys(found))


def _below(element: ElementTree.Element, path: str, name: str) -> Iterator[str]:
    for key, value in element.attrib.items():
        fate = TAGS.get(f"{path or 'robot'}@{key}", NAMED)
        whose = f"{_short(key)} of <{_short(element.tag)}>"
        if "${" in value or "$(" in value:
            raise InvalidParameter(f"{whose} in {name}", value, _PLAIN)
        if fate == REFUSED:
            raise InvalidParameter(f"{whose} in {name}", value, "xyz and rpy")
        if fate == NAMED:
            yield whose
    seen = set()
    for inner in element:
        own = f"{path}/{inner.tag}" if path else inner.tag
        if TAGS.get(own) == UNNEEDED:
            continue
        if own in _INNER:
            if path and own in seen:
                where = f"{_short(element.tag)} {element.get('name', '')}".strip()
                raise InvalidParameter(f"<{inner.tag}> of {name}'s {where}", "there twice", "one")
            seen.add(own)
            yield from _below(inner, own, name)
        elif TAGS.get(own, NAMED) == NAMED:
            yield f"<{_short(inner.tag)}>"


def _short(tag: str) -> str:
    """A tag without the address of its namespace."""
    return tag.rpartition("}")[2]
