"""Worlds of a rigid tool with six degrees of freedom, from text: ``tool:peg?radius=5mm + hole?radius=5.2mm``.

The first part is the tool and its size, the others are solids, in the syntax of `hapnet.ext.solids.rigid`. A tool
without solids moves freely.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, partial
from itertools import chain

import numpy as np
from numpy.typing import ArrayLike

from hapnet.checks import Array, Vector
from hapnet.errors import InvalidParameter
from hapnet.ext.engines.mujoco_model import PREFIX as MUJOCO
from hapnet.ext.solids.outlines import cuboid, cylinder
from hapnet.ext.solids.properties import Properties, kind_of
from hapnet.ext.solids.rigid import parts_in, solids_of
from hapnet.ext.solids.rigid_contacts import Solid
from hapnet.ext.solids.secant import friction_of
from hapnet.ext.solids.shapes import Cylinder
from hapnet.ext.solids.shapes_picture import parts_of
from hapnet.ext.tools.contacts import ToolContacts
from hapnet.ext.tools.mass import ToolMass
from hapnet.ext.tools.mujoco_tool import mujoco_tool_world
from hapnet.ext.tools.tool import Tool, box, peg, place, stick
from hapnet.mechanics.pose import ARM_M, AXES, DOF, nearest, pose
from hapnet.plant.worlds.picture import Color, Part, StillDefaults, Touch, part, shared
from hapnet.plant.worlds.protocol import World, WorldDefaults
from hapnet.plant.worlds.scene import STEP_MAX_S, STEP_MIN_S, Scene
from hapnet.plant.worlds.walls import WALL_DAMPING, WALL_STIFFNESS, Wall
from hapnet.units import POSE

KIND = "tool"
FIRST_WORDS = (KIND,)
"""The first words of texts that describe such a world."""

_HALVINGS = 12

TOOLS: dict[str, tuple[Callable[[Properties], Tool], str]] = {
    "box": (lambda given: box(given.lengths("size", (0.04, 0.03, 0.02))), "size=40mm,30mm,20mm"),
    "peg": (lambda given: peg(given.length("radius", 0.005), given.length("length", 0.03)), "radius=5mm, length=30mm"),
    "stick": (lambda given: stick(given.length("length", 0.08)), "length=80mm"),
}
"""The tools by name: the function that makes the tool, and the help on its properties."""
OFFERED = tuple((f"{KIND}:{name}", words) for name, (_, words) in TOOLS.items())
"""The worlds that need no file, each with the help on its properties."""


class ToolScene(WorldDefaults):
    """A world in which the proxy is a rigid tool, among solids at rest. An object serves one run.

    name : in summaries and figures. tool : it starts at home. solids : may be none. min_s, max_s : range of the step
    time T_k [s], which is drawn uniformly. arm_m : the length of the pose's arms [m].

    Raises InvalidParameter.
    """

    dof: int = AXES
    moves_proxy: bool = True
    units: str = POSE
    start: Vector = (0.0,) * AXES

    def __init__(
        self,
        name: str,
        tool: Tool,
        solids: tuple[Solid, ...] = (),
        min_s: float = STEP_MIN_S,
        max_s: float = STEP_MAX_S,
        arm_m: float = ARM_M,
    ) -> None:
        self.name, self.tool, self.arm_m = name, tool, arm_m
        self.contacts: ToolContacts = ToolContacts(tool, solids, arm_m)
        self.contacts.require_outside(self.start)
        self._steps = Scene(name, 1, (), min_s, max_s)

    @property
    def stiffnesses(self) -> tuple[float, ...]:
        return tuple([solid.stiffness for solid in self.contacts.solids])

    def next_step_s(self, rng: np.random.Generator) -> float:
        """Draw the duration of the next step, T_k [s]: uniform in [min_s, max_s]."""
        return self._steps.next_step_s(rng)

    def proxy(self, mass: ArrayLike, damping: ArrayLike, stiffness: ArrayLike) -> ToolMass:
        return ToolMass(self.contacts, mass, damping, stiffness, self.start)

    def picture(self) -> ToolPicture:
        return ToolPicture(self.contacts)

    def towards(self, position: Vector) -> Vector:
        """The pose nearest to `position`, or else the farthest free pose on the way there from the start."""
        low, high, path = 0.0, 1.0, position
        if self._is_free(found := nearest(position, self.arm_m)):
            return found
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            pose = nearest([middle * part for part in path], self.arm_m)
            low, high = (middle, high) if self._is_free(pose) else (low, middle)
        return nearest([low * part for part in path], self.arm_m)

    def _is_free(self, pose: Vector) -> bool:
        return self.contacts.penetration(pose) == 0.0


def tool_scene(
    text: str,
    *,
    dof: int = DOF,
    stiffness: float = WALL_STIFFNESS,
    damping: float = WALL_DAMPING,
    step_min_s: float = STEP_MIN_S,
    step_max_s: float = STEP_MAX_S,
) -> World:
    """The world that `text` describes (see above); `stiffness` and `damping` are the defaults of solids."""
    if dof not in (DOF, AXES):
        raise InvalidParameter("dof", dof, f"{DOF} with a tool: it turns")
    first, *others = parts_in(text)
    tool = tool_of(first)
    if any(part.startswith(MUJOCO) for part in others):
        if len(others) > 1:
            raise InvalidParameter("scene", text, f"a tool and one {MUJOCO}FILE.xml, or a tool and solids")
        return mujoco_tool_world(text, others[0], tool, step_min_s, step_max_s)
    given = {"stiffness": stiffness, "damping": damping}
    solids = tuple(chain.from_iterable(solids_of(part, given)[0] for part in others))
    try:
        return ToolScene(text, tool, solids, step_min_s, step_max_s)
    except InvalidParameter as error:
        if error.name != "start":
            raise
        raise error.renamed(f"scene {text}: start") from error


def tool_of(spec: str) -> Tool:
    """The tool that a text such as ``tool:box?size=40mm,30mm,20mm`` names. Raises InvalidParameter."""
    _, name, text = kind_of(spec)
    if name not in TOOLS:
        raise InvalidParameter(f"scene {spec}", name, f"tool:NAME, one of {', '.join(TOOLS)}", TOOLS)
    make, words = TOOLS[name]
    properties = Properties(spec, text)
    try:
        made = make(properties)
    except InvalidParameter as error:
        if error.name.startswith("scene "):
            raise
        raise error.renamed(f"scene {spec}: {error.name}") from error
    properties.finish(words)
    return made


def seen_by_the_hand(scene: World) -> Scene:
    """The scene for a generated hand that moves a point: a wall where the point would meet the first solid.

    For an engine's world it is a floor, as the solids are not known.
    """
    if not isinstance(scene, ToolScene):
        return Scene(scene.name, 3, (Wall((0.0, 0.0, -1.0), 1.0, WALL_STIFFNESS),))
    if not scene.contacts.solids:
        return Scene(scene.name, 3, ())
    solid = scene.contacts.solids[0]
    distance, gradient = solid.shape.near((0.0, 0.0, 0.0))
    return Scene(scene.name, 3, (Wall(tuple([-part for part in gradient]), distance, solid.stiffness),))


def builder(text: str) -> Callable[..., World] | None:
    """A function that makes the world that `text` describes; None: the text describes no world with a tool."""
    kinds = [kind_of(part)[0] for part in parts_in(text)]
    if KIND in kinds[1:]:
        raise InvalidParameter("scene", text, "the tool first, as in tool:peg + plane")
    return partial(tool_scene, text) if kinds[0] == KIND else None


TOOL: Color = (234, 88, 12, 230)


class ToolPicture(StillDefaults):
    """A picture of the solids at rest, and of the tool after the last step."""

    def __init__(self, contacts: ToolContacts) -> None:
        self._contacts = contacts

    @cached_property
    def parts(self) -> tuple[Part, ...]:
        tool = self._contacts.tool
        width, _, length = tool.size
        form = cylinder(Cylinder((0.0, 0.0, 0.0), width / 2.0, length)) if tool.round else cuboid(tool.size)
        return (part(*form, TOOL, 0), *parts_of(self._contacts.solids))

    def poses(self) -> Array:
        place, quaternion = pose(self._contacts.at, self._contacts.arm_m)
        return np.array([[*place, *quaternion]])

    def touches(self, position: Vector, force: Vector) -> list[Touch]:
        """The places where the tool is inside solids."""
        if not any(force) or len(position) != self._contacts.dof:
            return []
        found = []
        for distance, point, normal, solid in self._contacts.within(position, 0.0):
            x = place(position, point, self._contacts.arm_m)
            at = tuple([a + distance * n for a, n in zip(x, normal, strict=True)])
            found.append((at, tuple([-part for part in normal]), friction_of(solid, x)))
        return shared(tuple(force[:3]), found)
