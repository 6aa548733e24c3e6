"""Rigid scenes: solids around the proxy, from text such as ``sphere?radius=20mm + plane?normal=0,0,-1``.

The text is a list of solids, joined by `` + ``. A solid is a kind and, after ``?``, its properties, joined by ``&``.
Every length has a unit. All properties have defaults; by default a solid begins 20 mm in front of the start, as the
wall of the scene `wall` does.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import chain
from math import hypot

import numpy as np

from hapnet.checks import Array, Vector
from hapnet.errors import HapnetError, InvalidParameter
from hapnet.ext.solids.effects_words import EFFECTS_WORDS, effects_of
from hapnet.ext.solids.field import DistanceFunction, VoxelGrid
from hapnet.ext.solids.friction import Friction, FrictionTexture
from hapnet.ext.solids.hole import Hole
from hapnet.ext.solids.mesh import Mesh
from hapnet.ext.solids.mesh_file import read_heights, read_mesh, require_file
from hapnet.ext.solids.mesh_parts import joined
from hapnet.ext.solids.mesh_surface import SHARP_DEG, Triangles
from hapnet.ext.solids.properties import UNITS, Properties, kind_of, value_of
from hapnet.ext.solids.rigid_contacts import RigidContacts, Solid, padded
from hapnet.ext.solids.shapes import Cuboid, Cylinder, HalfSpace, Offset, Shape, Sphere, Textured
from hapnet.ext.solids.shapes_picture import SolidsPicture
from hapnet.ext.solids.volume_file import NUMPY, is_volume, read_volume
from hapnet.loading import load
from hapnet.plant.worlds.picture import Part
from hapnet.plant.worlds.protocol import WorldDefaults
from hapnet.plant.worlds.scene import STEP_MAX_S, STEP_MIN_S, Scene, checked_dof
from hapnet.plant.worlds.walls import WALL_DAMPING, WALL_STIFFNESS
from hapnet.records.vectors import added

_FRONT_M = 0.02
_SIZE_M = 0.06


class RigidScene(WorldDefaults):
    """A world of rigid solids at rest, for one run.

    name : in summaries and figures. dof : the number of axes. solids : one or more. min_s, max_s : range of the step
        time T_k [s], which is drawn uniformly. start : (n,) where the proxy starts [m], outside every solid; the origin
        by default.

    Raises InvalidParameter.
    """

    warnings: tuple[str, ...] = ()

    def __init__(
        self,
        name: str,
        dof: int,
        solids: Sequence[Solid],
        min_s: float = STEP_MIN_S,
        max_s: float = STEP_MAX_S,
        start: Vector = (),
    ) -> None:
        if not solids:
            raise InvalidParameter("solids", solids, "one or more")
        self.name = name
        self.dof: int = checked_dof(dof)
        self.contacts: RigidContacts = RigidContacts(solids, self.dof)
        self._empty = Scene(name, self.dof, (), min_s, max_s, start)
        self.start: Vector = self._empty.start
        self.contacts.require_outside(self.start)

    @property
    def has_effects(self) -> bool:
        """Whether any surface has effects, which the device renders."""
        return any(solid.effects is not None for solid in self.contacts.solids)

    @property
    def stiffnesses(self) -> tuple[float, ...]:
        return tuple([solid.stiffness for solid in self.contacts.solids])

    def next_step_s(self, rng: np.random.Generator) -> float:
        """Draw the duration of the next step, T_k [s]: uniform in [min_s, max_s]."""
        return self._empty.next_step_s(rng)

    def next_steps_s(self, rng: np.random.Generator, count: int) -> Array:
        """The next `count` durations, as `Scene.next_steps_s`."""
        return self._empty.next_steps_s(rng, count)

    def picture(self) -> SolidsPicture:
        return SolidsPicture(self.contacts.solids)

    def towards(self, position: Vector) -> Vector:
        """The farthest point on the straight line from `start` to `position` (n,) [m] before a solid."""
        path = tuple([b - a for a, b in zip(self.start, position, strict=True)])
        length = hypot(*path)
        share, place = 0.0, self.start
        while length:
            gap = min(solid.shape.near(padded(place)).distance_m / solid.shape.slope for solid in self.contacts.solids)
            if gap < _CLOSE_M:
                break
            share += (gap - 0.5 * _CLOSE_M) / length
            if share >= 1.0:
                return position
            place = tuple([a + share * b for a, b in zip(self.start, path, strict=True)])
        return place


_CLOSE_M = 1e-5


def rigid(
    text: str,
    *,
    dof: int = 3,
    stiffness: float = WALL_STIFFNESS,
    damping: float = WALL_DAMPING,
    step_min_s: float = STEP_MIN_S,
    step_max_s: float = STEP_MAX_S,
) -> RigidScene:
    """The scene that `text` describes (see above); `stiffness` and `damping` are defaults for its solids."""
    given = {"stiffness": stiffness, "damping": damping}
    made = [solids_of(part, given) for part in parts_in(text)]
    solids, notes = [solid for found, _ in made for solid in found], [note for _, note in made]
    try:
        scene = RigidScene(text, dof, solids, step_min_s, step_max_s)
    except InvalidParameter as error:
        if error.name != "start":
            raise
        raise error.renamed(f"scene {text}: start") from error
    scene.warnings = tuple(chain.from_iterable(notes))
    return scene


def builder(text: str) -> Callable[..., RigidScene] | None:
    """A function that makes the scene that `text` describes; None: `text` does not describe a rigid scene."""
    return partial(rigid, text) if describes(text) else None


def describes(text: str) -> bool:
    """Whether the text describes a rigid scene."""
    return kind_of(parts_in(text)[0])[0] in KINDS


def parts_of_words(scene: object) -> tuple[Part, ...]:
    """The parts of the scene that this text describes; empty if it is not a rigid scene, or its files are missing."""
    build = builder(scene) if isinstance(scene, str) else None
    try:
        return () if build is None else build().picture().parts
    except HapnetError:
        return ()


class SolidKind:
    """A kind of solid: the function that makes it, and the help on its properties."""

    def __init__(self, make: Callable[[Properties, str], Shape], text: str) -> None:
        self.make: Callable[[Properties, str], Shape] = make
        self.words: str = f"{text}, {_MATERIAL}"


_MATERIAL = (
    "stiffness=N/m, damping=Ns/m, friction=0.5, texture=SHARE,WAVELENGTH, relief=HEIGHT,WAVELENGTH, "
    f"layers=DEPTH,N/m (several with commas), {EFFECTS_WORDS}"
)


def solids_of(spec: str, given: Mapping[str, float]) -> tuple[list[Solid], list[str]]:
    """The solid, a further solid for each layer below its surface, and notes for the user."""
    name, file, text = kind_of(spec)
    if name not in KINDS:
        raise InvalidParameter(f"scene {spec}", name, f"one of {', '.join(KINDS)}", KINDS)
    properties = Properties(spec, text)
    if bool(file) is not (name in FROM_FILES):
        allowed = f"a file, as in {name}:FILE?unit=mm" if name in FROM_FILES else "no file"
        raise properties.error(file, f"{allowed}, or {_FUNCTION}" if name == "sdf" else allowed)
    try:
        shape = KINDS[name].make(properties, file)
        relief = properties.lengths("relief", (0.0, 1.0))
        if relief[0]:
            shape = Textured(shape, *relief)
        material = {key: properties.number(key, value) for key, value in given.items()}
        friction = _friction(properties)
        layers, effects = _layers(properties), effects_of(properties)
        properties.finish(KINDS[name].words)
        outer = Solid(shape, friction=friction, effects=effects, **material)
        inner = [Solid(Offset(shape, depth), k, outer.damping, friction) for depth, k in layers]
        return [outer, *inner], properties.notes
    except InvalidParameter as error:
        if error.name.startswith("scene "):
            raise
        raise error.renamed(f"scene {spec}: {error.name}") from error


def _layers(properties: Properties) -> list[tuple[float, float]]:
    """The depth at which each layer begins [m], and its stiffness [N/m]."""
    text = properties.text("layers")
    parts = [] if text is None else [part.strip() for part in text.split(",")]
    found = [(value_of(deep, UNITS), value_of(k, None)) for deep, k in zip(parts[::2], parts[1::2], strict=False)]
    layers = [(deep, k) for deep, k in found if deep is not None and k is not None and deep > 0.0 < k]
    if len(layers) != len(found) or len(parts) % 2:
        raise properties.error(
            f"layers={text}", "a depth with its unit and a stiffness for each, such as layers=2mm,500"
        )
    return layers


def _friction(properties: Properties) -> float | Friction:
    mu = properties.number("friction", 0.0)
    text = properties.text("texture")
    if text is None:
        return mu
    share, comma, wavelength = text.partition(",")
    number, length = value_of(share.strip(), None), value_of(wavelength.strip(), UNITS)
    if number is None or length is None or not comma or not mu:
        allowed = "a share of the friction and a length with its unit, such as friction=0.5&texture=0.8,4mm"
        raise properties.error(f"texture={text}", allowed)
    return FrictionTexture(mu, number, length)


def parts_in(text: str) -> list[str]:
    """The solids' texts."""
    return re.split(r"\s+\+\s+", text.strip())


def _middle(properties: Properties, depth: float) -> Vector:
    """The centre: given, or such that the solid begins in front of the start."""
    return properties.lengths("at", (_FRONT_M + depth, 0.0, 0.0))


def _sphere(properties: Properties, file: str) -> Sphere:
    radius = properties.length("radius", 0.5 * _SIZE_M)
    return Sphere(_middle(properties, radius), radius)


def _cuboid(properties: Properties, file: str) -> Cuboid:
    size = properties.lengths("size", (_SIZE_M,) * 3)
    return Cuboid(_middle(properties, 0.5 * size[0]), size)


def _cylinder(properties: Properties, file: str) -> Cylinder:
    radius, length = properties.length("radius", 0.5 * _SIZE_M), properties.length("length", _SIZE_M)
    axis = properties.text("axis") or "z"
    if axis not in ("x", "y", "z"):
        raise properties.error(axis, "axis: x, y or z")
    centre = _middle(properties, 0.5 * length if axis == "x" else radius)
    return Cylinder(centre, radius, length, "xyz".index(axis))


def _plane(properties: Properties, file: str) -> HalfSpace:
    normal = properties.numbers("normal", (1.0, 0.0, 0.0))
    size = hypot(*normal) or 1.0
    at = properties.lengths("at", tuple([_FRONT_M * part / size for part in normal]))
    return HalfSpace(normal, added([n * x for n, x in zip(normal, at, strict=True)]) / size)


def _hole(properties: Properties, file: str) -> Hole:
    normal = properties.numbers("normal", (0.0, 0.0, -1.0))
    size = hypot(*normal) or 1.0
    at = properties.lengths("at", tuple([_FRONT_M * part / size for part in normal]))
    return Hole(at, normal, properties.length("radius", 0.0052), properties.length("chamfer", 0.001))


_SHARP = f"sharp={SHARP_DEG:g} (degrees between triangles that meet at an edge; 0: all do)"
_FUNCTION = "a function of the position that is below 0 inside, as module:name"
_PLACE = "X,Y,Z (centre of its extent) or file (as in the file)"


def _mesh(properties: Properties, file: str) -> Mesh:
    vertices, triangles, done = joined(*read_mesh(file, _unit(properties, file)))
    if done:
        properties.notes.append(f"mesh {file}: {done}")
    mesh = _placed(properties, vertices, triangles)
    share, far = mesh.curved
    if share > 0.0:
        properties.notes.append(
            f"mesh {file}: {share:.0%} of its surface is felt as curved, at most {1e3 * far:.2g} mm from its "
            f"triangles; sharp=0 renders the triangles as they are"
        )
    return mesh


def _heights(properties: Properties, file: str) -> Mesh:
    unit, spacing = _unit(properties, file), properties.length("spacing", 0.0)
    facing = properties.text("facing") or "-x"
    if not spacing > 0.0:
        raise properties.error(f"spacing {spacing:g} m", "the distance between two numbers of a row: &spacing=1mm")
    if facing not in ("-x", "z"):
        raise properties.error(f"facing={facing}", "facing: -x or z")
    vertices, triangles = read_heights(file, unit, spacing)
    if facing == "z":  # a quarter turn about y
        vertices = vertices[:, [2, 1, 0]] * (1.0, 1.0, -1.0)
    return _placed(properties, vertices, triangles)


def _sdf(properties: Properties, file: str) -> Shape:
    if not is_volume(file):
        function = load(f"scene {properties.words}", file, _FUNCTION)
        if not callable(function):
            raise properties.error(file, _FUNCTION)
        return DistanceFunction(function, file, properties.lengths("at", (0.0, 0.0, 0.0)))
    plain = file.lower().endswith(NUMPY)
    unit = _unit(properties, file) if plain else UNITS.get(properties.text("unit") or "mm", 0.0)
    if not unit:
        raise properties.error("unit", f"one of {', '.join(UNITS)}")
    spacing, iso = properties.lengths("spacing", (0.0,))[0] or None, properties.text("iso")
    level = None if iso is None else value_of(iso, None)
    if (iso is None and not plain) or (iso is not None and level is None):
        raise properties.error(iso or file, "iso= and a number: voxels of this value or more are inside, as in iso=300")
    distances, steps = read_volume(file, unit, spacing, level)
    inside = np.argwhere(distances < 0.0)
    deep = -distances[tuple(inside.T)][:, None]  # the solid extends at least this far
    low, high = (inside * steps - deep).min(axis=0), (inside * steps + deep).max(axis=0)
    middle = 0.5 * (low + high)
    return VoxelGrid(distances, steps.tolist(), np.array(_middle(properties, float(high[0] - middle[0]))) - middle)


def _unit(properties: Properties, file: str) -> float:
    """The unit of a file [m], which the file itself does not contain."""
    text = properties.text("unit")
    if text is None or text not in UNITS:
        require_file(file)  # a missing file comes before a missing unit
        given = properties.words if text is None else f"unit={text}"
        raise properties.error(given, f"the file's unit after its name: ?unit=mm (or {', '.join(UNITS)})")
    return UNITS[text]


def _placed(properties: Properties, vertices: Array, triangles: Triangles) -> Mesh:
    """Place a mesh; by default it begins in front of the start."""
    used = vertices[np.unique(triangles)]
    low, high = used.min(axis=0), used.max(axis=0)
    at = properties.text("at")
    if at != "file":
        if at is not None:
            properties.give_back("at", at)
        middle = 0.5 * (low + high)
        vertices = vertices + (np.array(_middle(properties, float(high[0] - middle[0]))) - middle)
    sharp_deg = properties.number("sharp", SHARP_DEG)
    if not 0.0 <= sharp_deg <= 180.0:
        raise properties.error(f"sharp={sharp_deg:g}", "sharp: 0 to 180 degrees")
    return Mesh(vertices, triangles, sharp_deg)


KINDS: dict[str, SolidKind] = {
    "sphere": SolidKind(_sphere, "radius=30mm, at=X,Y,Z (centre)"),
    "cuboid": SolidKind(_cuboid, "size=X,Y,Z, at=X,Y,Z (centre)"),
    "cylinder": SolidKind(_cylinder, "radius=30mm, length=60mm, axis=z, at=X,Y,Z (centre)"),
    "mesh": SolidKind(_mesh, f"unit=mm (needed; {', '.join(UNITS)}), at={_PLACE}, {_SHARP}"),
    "heights": SolidKind(_heights, f"unit=mm and spacing=1mm (needed), facing=-x or z, at={_PLACE}, {_SHARP}"),
    "sdf": SolidKind(
        _sdf, f"(FILE) unit=mm and spacing=1mm, or iso=LEVEL of an image; at={_PLACE}; (module:function) at=X,Y,Z"
    ),
    "hole": SolidKind(_hole, "radius=5.2mm, at=X,Y,Z (its mouth), normal=X,Y,Z (into it), chamfer=1mm"),
    "plane": SolidKind(_plane, "normal=X,Y,Z (into the solid), at=X,Y,Z (a point of it)"),
}
"""The kinds of solids by name."""

FROM_FILES = ("mesh", "heights", "sdf")

FIRST_WORDS = tuple(KINDS)
"""First words of texts that describe such a world."""
OFFERED = tuple((name, kind.words) for name, kind in KINDS.items() if name not in FROM_FILES)
"""The worlds that need no file, each with the help on its properties."""
