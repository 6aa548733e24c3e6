"""The table of the parts that the core takes from the extensions that come with hapnet.

The core imports no extension. When a run needs one (an arm, a tool that turns, a robot that follows, a world that is
not made of flat walls, a picture), the core looks it up here, and only then is its module loaded. Other packages
publish theirs as entry points of `hapnet.couplings`, `hapnet.worlds` and `hapnet.devices`.
"""

from __future__ import annotations

from functools import cache
from importlib import import_module
from typing import Any

_MODULES = {
    "arms": "hapnet.ext.arms.parameters",
    "tools": "hapnet.ext.tools.parameters",
    "robots": "hapnet.ext.robots.following",
    "driven robots": "hapnet.ext.robots.robot_side",
    "compiled": "hapnet.ext.compiled.whole_runs.coverage",
    "compiled ends": "hapnet.ext.compiled.real_time",
    "compiled runs": "hapnet.ext.compiled.whole_runs.run",
    "pictures": "hapnet.ext.pictures.result",
    "mujoco": "hapnet.ext.engines.mujoco_engine",
    "soft": "hapnet.ext.soft.soft",
    "tools' worlds": "hapnet.ext.tools.scene",
    "solids": "hapnet.ext.solids.rigid",
    "own worlds": "hapnet.ext.engines.own_worlds",
}

WORLDS = ("mujoco", "soft", "tools' worlds", "solids")
"""The kinds of worlds that a text describes, in the order in which they are asked: `hapnet.plant.worlds.registry`."""


@cache
def extension(name: str) -> Any:
    """The module of an extension, by its name in the table. `hapnet.assembly` and `hapnet.simulation` use it."""
    return import_module(_MODULES[name])
