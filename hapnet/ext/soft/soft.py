"""Soft bodies that a ball in the hand presses: ``soft`` (a block), ``soft:organ``, or ``soft:FILE?unit=mm``.

The ball is the proxy, `ball` its radius. By default the body begins 20 mm in front of the ball, and its far side is
held. Solids may stand beside it, as in ``soft?pin=none + plane?normal=0,0,-1&at=0,0,-30mm``
(`hapnet.ext.solids.rigid`): ball and body touch them, and a body without a held side lies on a solid. Every length has
a unit; all properties have defaults. `lump` is a stiffer part: its factor of stiffness, its centre relative to the
body's centre, and its radius.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from math import hypot

import numpy as np

from hapnet.checks import Array, Vector
from hapnet.errors import InvalidParameter
from hapnet.ext.soft import soft_mesh
from hapnet.ext.soft.soft_body import Body, Marks, Material
from hapnet.ext.soft.soft_contacts import Skin, SoftContacts
from hapnet.ext.soft.soft_linear import Indices
from hapnet.ext.soft.soft_picture import SoftPicture
from hapnet.ext.solids.mesh_file import require_file
from hapnet.ext.solids.properties import UNITS, Properties, kind_of
from hapnet.ext.solids.rigid import parts_in, solids_of
from hapnet.ext.solids.rigid_contacts import Solid
from hapnet.installing import require
from hapnet.plant.worlds.protocol import WorldDefaults
from hapnet.plant.worlds.scene import STEP_MAX_S, STEP_MIN_S, Scene, checked_dof
from hapnet.plant.worlds.walls import WALL_DAMPING, WALL_STIFFNESS

WORD = "soft"
FIRST_WORDS = (WORD,)
"""First words of texts that describe such a world."""
WORDS = (
    "unit=mm (of a file), size=60mm,60mm,60mm, nodes=1000 (about), young=20000 (Pa), poisson=0.4, density=1000, "
    "beta=0.01 (damping [s]), lump=TIMES, lump_at=X,Y,Z, lump_radius=10mm, pin=+x (-x, +y, ...; none), "
    "gravity=X,Y,Z (m/s2), ball=10mm (radius), contact=500 (N/m a point; by default "
    "as the material), contact_damping=0.5, friction=0.3"
)
_SIZES = {"": (0.06, 0.06, 0.06), "organ": (0.05, 0.09, 0.06)}
_FRONT_M = 0.02
_PINNED = 0.12
"""The share of a body's extent that is held at its far side."""

_STEP_M = 5e-4
_FALLS_MPS = 0.05
"""A body that still moves this fast after settling has nothing to lie on."""


class SoftWorld(WorldDefaults):
    """A world with a ball and a soft body, for one run."""

    def __init__(self, name: str, contacts: SoftContacts, min_s: float, max_s: float) -> None:
        self.name, self.dof, self.contacts = name, contacts.dof, contacts
        self._steps = Scene(name, contacts.dof, (), min_s, max_s)
        self.start: Vector = self._steps.start
        contacts.require_outside(self.start)

    @property
    def stiffnesses(self) -> tuple[float, ...] | None:
        return tuple([solid.stiffness for solid in self.contacts.solids.solids]) or None

    def next_step_s(self, rng: np.random.Generator) -> float:
        """T_k [s], drawn uniformly. In real time a step lasts longer if its computation does."""
        return self._steps.next_step_s(rng)

    def picture(self) -> SoftPicture:
        return SoftPicture(self.contacts)

    def towards(self, position: Vector) -> Vector:
        """The farthest point on the straight line from `start` to `position` where the ball touches nothing."""
        path = tuple([b - a for a, b in zip(self.start, position, strict=True)])
        count = 1 + int(hypot(*path) / _STEP_M)
        place = self.start
        for share in np.linspace(0.0, 1.0, count + 1)[1:].tolist():
            there = tuple([a + share * b for a, b in zip(self.start, path, strict=True)])
            if self.contacts.penetration(there) > 0.0:
                break
            place = there
        return place


def builder(text: str) -> Callable[..., SoftWorld] | None:
    """A function that makes the world that `text` describes; None: `text` does not describe a soft body."""
    kinds = [kind_of(part)[0] for part in parts_in(text)]
    if WORD in kinds[1:]:
        raise InvalidParameter("scene", text, "the soft body first, as in soft + plane")
    return partial(soft_world, text) if kinds[0] == WORD else None


def soft_world(
    text: str, /, *, dof: int = 3, step_min_s: float = STEP_MIN_S, step_max_s: float = STEP_MAX_S
) -> SoftWorld:
    """The world that `text` describes (see above).

    Raises InvalidParameter, MissingLibrary.
    """
    first, *others = parts_in(text)
    _, file, words = kind_of(first)
    properties = Properties(text, words)
    require("soft", "a soft body")
    try:
        body, skin = _body(properties, file)
        contacts = SoftContacts(body, skin, checked_dof(dof), solids=_solids(others))
        if contacts.settle() > _FALLS_MPS:
            raise properties.error(text, "a body that is pinned, or lies on a solid, or gravity=0,0,0")
        return SoftWorld(text, contacts, step_min_s, step_max_s)
    except InvalidParameter as error:
        if error.name.startswith(("scene ", "step_", "dof")):
            raise
        raise error.renamed(f"scene {text}: {error.name}") from error


def _body(properties: Properties, file: str) -> tuple[Body, Skin]:
    nodes = int(properties.number("nodes", 1000.0))
    if not 8 <= nodes <= 20_000:
        raise properties.error(f"nodes={nodes}", "nodes: 8 to 20000")
    if file in _SIZES:
        size = properties.lengths("size", _SIZES[file])
        if not min(size) > 0.0:
            raise properties.error("size", "three lengths above 0")
        places, tets = (soft_mesh.organ if file else soft_mesh.block)(size, nodes)
    else:
        unit = properties.text("unit")
        if unit not in UNITS:
            require_file(file)
            raise properties.error(unit or properties.words, f"the file's unit: ?unit=mm (or {', '.join(UNITS)})")
        places, tets = soft_mesh.read(file, UNITS[unit], nodes)
    places = places - 0.5 * (places.min(axis=0) + places.max(axis=0))
    skin = Skin(
        stiffness=_contact(properties), friction=_least(properties, "friction", 0.3),
        radius=properties.length("ball", 0.01), damping=_least(properties, "contact_damping", 0.5),
    )  # fmt: skip
    material = Material(
        young=_above(properties, "young", 20e3) * _lump(properties, places, tets),
        poisson=properties.number("poisson", 0.4), density=_above(properties, "density", 1000.0),
        beta_s=_least(properties, "beta", 0.01), gravity=_triple(properties.numbers("gravity", (0.0, 0.0, -9.81))),
    )  # fmt: skip
    if not 0.0 <= material.poisson <= 0.49 or not skin.radius > 0.0:
        raise properties.error("poisson or ball", "poisson: 0 to 0.49; ball: a radius above 0")
    pinned = _pinned(properties, places)
    properties.finish(WORDS)
    places[:, 0] += _FRONT_M + skin.radius - places[:, 0].min()
    return Body(places, tets, pinned, material), skin


def _solids(parts: list[str]) -> list[Solid]:
    given = {"stiffness": WALL_STIFFNESS, "damping": WALL_DAMPING}
    return [solid for part in parts for solid in solids_of(part, given)[0]]


def _lump(properties: Properties, places: Array, tets: Indices) -> Array:
    """The factor of each tetrahedron's stiffness."""
    times, at = _above(properties, "lump", 1.0), properties.lengths("lump_at", (0.0, 0.0, 0.0))
    radius = properties.length("lump_radius", 0.01)
    apart = np.linalg.norm(places[tets].mean(axis=1) - at, axis=1)
    return np.where(apart < radius, times, 1.0)


def _pinned(properties: Properties, places: Array) -> Marks:
    side = properties.text("pin") or "+x"
    if side == "none":
        return np.zeros(len(places), dtype=bool)
    if len(side) != 2 or side[0] not in "+-" or side[1] not in "xyz":
        raise properties.error(f"pin={side}", "pin: the side that is held, +x, -x, +y, -y, +z or -z, or none")
    along = places[:, "xyz".index(side[1])] * (1.0 if side[0] == "+" else -1.0)
    found: Marks = along >= along.max() - _PINNED * np.ptp(along)
    return found


def _above(properties: Properties, key: str, default: float) -> float:
    value = properties.number(key, default)
    if not value > 0.0:
        raise properties.error(f"{key}={value:g}", f"{key}: above 0")
    return value


def _contact(properties: Properties) -> float | None:
    """The stiffness of each point [N/m], if it is given."""
    if (text := properties.text("contact")) is None:
        return None
    properties.give_back("contact", text)
    return _above(properties, "contact", 1.0)


def _least(properties: Properties, key: str, default: float) -> float:
    value = properties.number(key, default)
    if not value >= 0.0:
        raise properties.error(f"{key}={value:g}", f"{key}: 0 or above")
    return value


def _triple(values: Vector) -> tuple[float, float, float]:
    x, y, z = values
    return x, y, z
