"""A MuJoCo model with a proxy in it: loading, the part of the model that the hand moves, and what to warn of.

``mujoco:FILE.xml`` loads any model as it is. A sphere is added that only the virtual coupling moves: on slide joints,
without weight. ``?proxy=NAME`` makes a body of the model the proxy, at its centre of mass, or a site, at its place.
``?at=X,Y,Z`` [m] is where the added sphere begins, ``?radius=`` [m] how large it is, ``?planes=`` which contact planes
are sent (`hapnet.plant.worlds.mujoco_planes`); several with &.
"""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module
from math import isfinite
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import parse_qsl

import numpy as np

from hapnet.errors import InvalidParameter, MissingLibrary
from hapnet.loading import cause
from hapnet.plant.worlds.walls import check_number

PREFIX = "mujoco:"
PLANES = ("auto", "all", "none")
"""What is sent as planes: what they describe well, all that the sphere meets, nothing."""
SHORTEST_S, MAX_S = 1e-5, 1.0
"""Of a model's timestep. Shorter ones take so many substeps that a run makes no progress."""

_NAME = "hapnet_proxy"
_RADIUS = 0.005
_FORM = "mujoco:FILE.xml, perhaps with ?proxy=NAME of a body or site, or ?at=X,Y,Z&radius=R in metres, or ?planes=all"


class Asked(NamedTuple):
    """What a scene's name asks for."""

    file: str
    proxy: str
    at: tuple[float, ...]
    radius: float
    planes: str


class Model(NamedTuple):
    """A compiled model. `body`, `site`: the proxy's, -1: none; `dofs`: the sphere's slide joints, empty without it."""

    engine: Any
    model: Any
    data: Any
    body: int
    site: int
    dofs: tuple[int, ...]
    geoms: frozenset[int]


def asked(scene: str) -> Asked:
    """Read the name ``mujoco:FILE?OPTIONS``. Raises InvalidParameter."""
    file, _, query = scene.removeprefix(PREFIX).partition("?")
    try:
        options = dict(parse_qsl(query, strict_parsing=True)) if query else {}
        unknown = set(options) - {"proxy", "at", "radius", "planes"}
        at = tuple(float(part) for part in options.get("at", "").split(",") if part.strip())
        radius = float(options.get("radius", _RADIUS))
    except ValueError as error:
        raise InvalidParameter("scene", scene, f"{_FORM} ({error})") from None
    if not file or unknown or len(at) not in (0, 3) or not all(map(isfinite, at)):
        raise InvalidParameter("scene", scene, _FORM)
    check_number("scene's radius", radius, "a positive number [m], at most 1", lambda r: 0.0 < r <= 1.0)
    if "proxy" in options and ("at" in options or "radius" in options):
        raise InvalidParameter("scene", scene, "either proxy=NAME, or at= and radius= for a sphere that is added")
    if (planes := options.get("planes", "auto")) not in PLANES:
        raise InvalidParameter("scene", scene, f"planes= one of {', '.join(PLANES)}")
    return Asked(file, options.get("proxy", ""), at, radius, planes)


def load(scene: str, dof: int, mass: float) -> Model:
    """The model that `scene` names, with a proxy of `mass` [kg] if a sphere is added, which moves on `dof` axes.

    Raises MissingLibrary; InvalidParameter: there is no such file, it is no model, or it has no such body.
    """
    want = asked(scene)
    try:
        engine: Any = import_module("mujoco")
    except ImportError:
        raise MissingLibrary("a MuJoCo scene", "mujoco", "mujoco") from None
    if not Path(want.file).is_file():
        raise InvalidParameter("scene", scene, f"a file that is there: there is no file {want.file}")
    engine.set_mju_user_warning(_quiet)
    try:
        spec = engine.MjSpec.from_file(want.file)
        if not want.proxy:
            _add_sphere(engine, spec, want, dof, mass)
        model = spec.compile()
        data = engine.MjData(model)
    except Exception as error:
        raise InvalidParameter("scene", scene, f"a model that MuJoCo can load ({cause(error)})") from error
    if not SHORTEST_S <= (timestep := float(model.opt.timestep)) <= MAX_S:
        allowed = f"a model with a timestep of {SHORTEST_S:g} to {MAX_S:g} s; that of {want.file} is {timestep:g} s"
        raise InvalidParameter("scene", scene, allowed)
    model.opt.enableflags |= int(engine.mjtEnableBit.mjENBL_ENERGY)
    model.opt.disableflags |= int(engine.mjtDisableBit.mjDSBL_AUTORESET)  # a jump back would be energy from nowhere
    return _with_proxy(engine, model, data, scene, want, dof)


def _quiet(warning: str) -> None:
    """MuJoCo would write a file into the working directory. What matters, energy that is no number, ends the run."""


def _add_sphere(engine: Any, spec: Any, want: Asked, dof: int, mass: float) -> None:
    body = spec.worldbody.add_body(name=_NAME, pos=list(want.at or (0.0, 0.0, 0.0)))
    body.gravcomp = 1.0
    for axis in range(dof):
        along = [float(i == axis) for i in range(3)]
        body.add_joint(name=f"{_NAME}_{'xyz'[axis]}", type=engine.mjtJoint.mjJNT_SLIDE, axis=along)
    sphere = engine.mjtGeom.mjGEOM_SPHERE
    body.add_geom(name=_NAME, type=sphere, size=[want.radius, 0.0, 0.0], mass=mass, rgba=[0.9, 0.5, 0.1, 1.0])


def _with_proxy(engine: Any, model: Any, data: Any, scene: str, want: Asked, dof: int) -> Model:
    kinds, site = engine.mjtObj, -1
    if want.proxy:
        body = int(engine.mj_name2id(model, kinds.mjOBJ_BODY, want.proxy))
        if body < 0:
            site = int(engine.mj_name2id(model, kinds.mjOBJ_SITE, want.proxy))
            if site < 0:
                bodies = ", ".join(model.body(i).name for i in range(1, model.nbody) if model.body(i).name) or "none"
                raise InvalidParameter("scene", scene, f"the name of a body or site of the model (bodies: {bodies})")
            body = int(model.site_bodyid[site])
        if model.body_weldid[body] == 0:
            raise InvalidParameter("scene", scene, f"a body that can move: {want.proxy} is fixed to the world")
        dofs: tuple[int, ...] = ()
    else:
        body = int(engine.mj_name2id(model, kinds.mjOBJ_BODY, _NAME))
        first = int(model.body_dofadr[body])
        dofs = tuple(range(first, first + dof))
        if not want.at:
            _raise(engine, model, data, body, want.radius)
    engine.mj_forward(model, data)
    geoms = frozenset(np.flatnonzero(model.geom_bodyid == body).tolist())
    return Model(engine, model, data, body, site, dofs, geoms)


def _raise(engine: Any, model: Any, data: Any, body: int, radius: float) -> None:
    """Put the sphere over the origin, as high as needed to be free."""
    own = int(model.body_geomadr[body])
    for _ in range(2000):
        engine.mj_forward(model, data)
        if not any(own in pair for pair in data.contact.geom[: data.ncon].tolist()):
            return
        model.body_pos[body][2] += radius


def warnings(found: Model) -> Iterator[str]:
    """What of this model is not passive by itself."""
    engine, model = found.engine, found.model
    integrator = engine.mjtIntegrator(model.opt.integrator).name.removeprefix("mjINT_")
    direct = [f"{kind} {_named(engine, model, kind, i)}" for kind, i in _direct(model)]
    if direct and integrator != "DISCRETE":
        more = f" and {len(direct) - 1} more" if len(direct) > 1 else ""
        yield (
            f"{direct[0]}{more}: a direct solref (negative numbers) gives out energy with the integrator {integrator}; "
            "an observer sees it, and damping takes it back"
        )
    if integrator in ("RK4", "IMPLICIT"):
        other = "Euler is used in its place" if integrator == "RK4" else "an observer watches it"
        yield f"the integrator {integrator} is not passive by itself: {other}"


def _direct(model: Any) -> Iterator[tuple[str, int]]:
    kinds = {"geom": (model.geom_solref, None), "pair": (model.pair_solref, None), "joint": (model.jnt_solref, None),
             "equality": (model.eq_solref, None)}  # fmt: skip
    for kind, (solref, _) in kinds.items():
        for i in np.flatnonzero((solref < 0.0).any(axis=1)).tolist() if len(solref) else ():
            yield kind, i


def _named(engine: Any, model: Any, kind: str, index: int) -> str:
    objects = engine.mjtObj
    of = {"geom": objects.mjOBJ_GEOM, "pair": objects.mjOBJ_PAIR, "joint": objects.mjOBJ_JOINT}
    name = engine.mj_id2name(model, of.get(kind, objects.mjOBJ_EQUALITY), index)
    return name or str(index)
