"""A MuJoCo model with a proxy: loading, the part of the model that the hand moves, and warnings.

``mujoco:FILE.xml`` loads any model as it is. A sphere is added that only the virtual coupling moves: on slide joints,
without weight. It touches every body that has contacts, and uses none of the model's defaults. ``?proxy=NAME`` makes a
body of the model the proxy, at its centre of mass, or a site, at its place; ``?proxy=A,B`` names the proxies of several
hands, and one hand holds the first. ``?at=X,Y,Z`` [m] is the start of the added sphere, ``?radius=`` [m] its radius,
``?planes=`` the choice of contact planes to send (`hapnet.ext.engines.mujoco_planes`), ``?key=`` the keyframe at the
start, by name or number, ``?ctrl=A,B`` the commands of its actuators; join several options by &.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib import import_module
from math import isfinite
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import parse_qsl

import numpy as np

from hapnet.errors import InvalidParameter, MissingLibrary
from hapnet.ext.engines.mujoco_sizes import check_sizes
from hapnet.loading import cause
from hapnet.plant.worlds.walls import check_number

PREFIX = "mujoco:"
PLANES = ("auto", "all", "none")
"""The bodies sent as planes: those that planes describe well, all that the sphere touches, none."""
SHORTEST_S, MAX_S = 1e-5, 1.0
"""The range of a model's timestep [s]; with a shorter one a run makes hardly any progress."""

MOST_LIFTS = 2000
"""The greatest number of times that a proxy is lifted to a free place."""

_PREFIX, _PROXY = "hapnet_", "proxy"
_NAME = _PREFIX + _PROXY
_RADIUS = 0.005
_ALL = 2**31 - 1
"""The sphere's contact bits: all, so that it touches every geom that has any."""
_OVERLAP_M = 5e-4
"""The depth above which bodies that overlap at the start are reported: soft contacts at rest overlap a little."""
_FORM = (
    "mujoco:FILE.xml, perhaps with ?proxy=NAME of a body or site, or ?at=X,Y,Z&radius=R in metres, or ?planes=all, "
    "or ?key=NAME of a keyframe, or ?ctrl=A,B,... for the actuators"
)


class Asked(NamedTuple):
    """The options in a scene's name."""

    file: str
    proxies: tuple[str, ...]
    at: tuple[float, ...]
    radius: float
    planes: str
    key: str
    ctrl: tuple[float, ...]


class HandProxy(NamedTuple):
    """A hand's proxy: the body or site of this name; or, without a name, a sphere that begins `at` a place [m], or at a
    free place above the origin."""

    name: str = ""
    at: tuple[float, ...] = ()


class MujocoModel(NamedTuple):
    """A compiled model, with one of its proxies. `body`, `site`: the proxy's, -1: none; `dofs`: the sphere's slide
    joints, empty without it.
    `key`: the keyframe at the start, -1: none. `overlaps`: pairs of bodies that overlap at the start."""

    engine: Any
    model: Any
    data: Any
    body: int
    site: int
    dofs: tuple[int, ...]
    geoms: frozenset[int]
    key: int
    overlaps: tuple[str, ...]

    def names(self) -> list[str]:
        """The names of the model's own bodies and sites."""
        model = self.model
        found = [model.body(i).name for i in range(1, model.nbody)] + [model.site(i).name for i in range(model.nsite)]
        return [name for name in found if name and not name.startswith(_PREFIX)]


def asked(scene: str) -> Asked:
    """Read the name ``mujoco:FILE?OPTIONS``. Raises InvalidParameter."""
    file, _, query = scene.removeprefix(PREFIX).partition("?")
    try:
        options = dict(parse_qsl(query, strict_parsing=True)) if query else {}
        unknown = set(options) - {"proxy", "at", "radius", "planes", "key", "ctrl"}
        at, ctrl = (_numbers(options.get(name, "")) for name in ("at", "ctrl"))
        radius = float(options.get("radius", _RADIUS))
    except ValueError as error:
        raise InvalidParameter("scene", scene, f"{_FORM} ({error})") from None
    if not file or unknown or len(at) not in (0, 3) or not all(map(isfinite, at + ctrl)):
        raise InvalidParameter("scene", scene, _FORM)
    check_number("scene's radius", radius, "a positive number [m], at most 1", lambda r: 0.0 < r <= 1.0)
    if "proxy" in options and ("at" in options or "radius" in options):
        raise InvalidParameter("scene", scene, "either proxy=NAME, or at= and radius= for an added sphere")
    if (planes := options.get("planes", "auto")) not in PLANES:
        raise InvalidParameter("scene", scene, f"planes= one of {', '.join(PLANES)}")
    proxies = tuple(options["proxy"].split(",")) if "proxy" in options else ()
    if not all(proxies) or len({*proxies}) < len(proxies):
        raise InvalidParameter("scene", scene, "proxy= different names of bodies and sites, with commas")
    return Asked(file, proxies, at, radius, planes, options.get("key", ""), ctrl)


def held_first(scene: str) -> HandProxy:
    """The proxy of a single hand in the model that `scene` names."""
    want = asked(scene)
    return HandProxy(want.proxies[0]) if want.proxies else HandProxy(at=want.at)


def _numbers(text: str) -> tuple[float, ...]:
    return tuple(float(part) for part in text.split(",") if part.strip())


def load(
    scene: str, dof: int, mass: float, hands: Sequence[HandProxy], add: Callable[[Any, Any], None] | None = None
) -> tuple[MujocoModel, ...]:
    """The model that `scene` names, once with each hand's proxy; the spheres weigh `mass` [kg], and move on `dof` axes.

    add : a function of engine and model that adds a free body instead of one hand's sphere; the caller places it.

    Raises MissingLibrary; InvalidParameter: there is no such file, it is not a model, or it has no such body.
    """
    want = asked(scene)
    try:
        engine: Any = import_module("mujoco")
    except ImportError:
        raise MissingLibrary("a MuJoCo scene", "mujoco", "mujoco") from None
    if not Path(want.file).is_file():
        raise InvalidParameter("scene", scene, f"an existing file: there is no file {want.file}")
    engine.set_mju_user_warning(_quiet)
    try:
        check_sizes(Path(want.file))
        spec = engine.MjSpec.from_file(want.file)
        total = float(spec.compiler.settotalmass)
        spec.compiler.settotalmass = -1.0  # the spheres do not count in the model's mass
        if add is not None:
            add(engine, spec)
        else:
            for number, held in enumerate(hands):
                if not held.name:
                    _add_sphere(engine, spec, _prefix(number), held.at, want.radius, dof, mass)
        model = spec.compile()
        data = engine.MjData(model)
        if total > 0.0:
            _weigh(engine, model, total, len(hands))
        if not SHORTEST_S <= (timestep := float(model.opt.timestep)) <= MAX_S:
            allowed = f"a model with a timestep of {SHORTEST_S:g} to {MAX_S:g} s; that of {want.file} is {timestep:g} s"
            raise InvalidParameter("scene", scene, allowed)
        model.opt.enableflags |= int(engine.mjtEnableBit.mjENBL_ENERGY)
        model.opt.disableflags |= int(engine.mjtDisableBit.mjDSBL_AUTORESET)  # a reset would make energy
        return _with_proxies(engine, model, data, scene, hands, dof, lifts=add is None)
    except InvalidParameter:
        raise
    except Exception as error:
        raise InvalidParameter("scene", scene, f"a model that MuJoCo can load ({cause(error)})") from error


def _quiet(warning: str) -> None:
    """Drop a warning, which MuJoCo would write to a file in the working directory. Invalid energy ends the run."""


def _prefix(number: int) -> str:
    """The prefix of the names of this hand's sphere."""
    return f"{_PREFIX}{number + 1}_" if number else _PREFIX


def _add_sphere(engine: Any, spec: Any, prefix: str, at: Sequence[float], radius: float, dof: int, mass: float) -> None:
    """Add a sphere, on slide joints."""

    def slide(body: Any) -> None:
        for axis in range(dof):
            along = [float(i == axis) for i in range(3)]
            body.add_joint(name=f"{_PROXY}_{'xyz'[axis]}", type=engine.mjtJoint.mjJNT_SLIDE, axis=along)

    geom = {"type": engine.mjtGeom.mjGEOM_SPHERE, "size": [radius, 0.0, 0.0], "mass": mass}
    _add_proxy(engine, spec, prefix, at, slide, geom)


def add_free_body(engine: Any, spec: Any, geom: Mapping[str, Any], margin_m: float) -> None:
    """Add a free body as the proxy: one `geom`, type, size and mass. Contacts within `margin_m` are listed."""
    _add_proxy(engine, spec, _PREFIX, (), lambda body: body.add_freejoint(name=_PROXY), {**geom, "gap": margin_m})


def _add_proxy(
    engine: Any, spec: Any, prefix: str, at: Sequence[float], join: Callable[[Any], None], geom: Mapping[str, Any]
) -> None:
    """Add a body without weight as a model of its own, which has MuJoCo's defaults and not those of `spec`."""
    own = engine.MjSpec()
    body = own.worldbody.add_body(name=_PROXY, pos=list(at or (0.0, 0.0, 0.0)))
    body.gravcomp = 1.0
    join(body)
    # the bodies that it touches have the friction
    body.add_geom(
        name=_PROXY, contype=_ALL, conaffinity=_ALL, priority=-1, rgba=[0.9, 0.5, 0.1, 1.0], margin=0.0, **geom
    )
    spec.attach(own, frame=spec.worldbody.add_frame(), prefix=prefix)


def _weigh(engine: Any, model: Any, total: float, hands: int) -> None:
    """Scale all bodies but the spheres to the total mass [kg] that the model sets."""
    spheres = [engine.mj_name2id(model, engine.mjtObj.mjOBJ_BODY, _prefix(k) + _PROXY) for k in range(hands)]
    own = ~np.isin(np.arange(model.nbody), [0, *spheres])
    share = total / float(model.body_mass[own].sum())
    model.body_mass[own] *= share
    model.body_inertia[own] *= share
    engine.mj_setConst(model, engine.MjData(model))  # mj_setConst changes the data passed to it


def _with_proxies(
    engine: Any, model: Any, data: Any, scene: str, hands: Sequence[HandProxy], dof: int, *, lifts: bool
) -> tuple[MujocoModel, ...]:
    want, parts = asked(scene), [_parts(engine, model, scene, held, k, dof) for k, held in enumerate(hands)]
    key = _begin(engine, model, data, scene, want, [joint for _, _, dofs in parts for joint in dofs])
    for held, (body, _, dofs) in zip(hands, parts, strict=True):
        if dofs and lifts and not held.at:

            def lift(body: int = body) -> None:
                model.body_pos[body][2] += want.radius

            raised(engine, model, data, body, lift, MOST_LIFTS)
    engine.mj_forward(model, data)
    overlaps = tuple(_overlaps(engine, model, data, {body for body, _, dofs in parts if dofs}))
    geoms = [frozenset(np.flatnonzero(model.geom_bodyid == body).tolist()) for body, _, _ in parts]
    return tuple(
        MujocoModel(engine, model, data, body, site, dofs, own, key, overlaps)
        for (body, site, dofs), own in zip(parts, geoms, strict=True)
    )


def _parts(
    engine: Any, model: Any, scene: str, held: HandProxy, number: int, dof: int
) -> tuple[int, int, tuple[int, ...]]:
    """Body, site and slide joints of a hand's proxy, as in `MujocoModel`."""
    kinds, site = engine.mjtObj, -1
    if not held.name:
        body = int(engine.mj_name2id(model, kinds.mjOBJ_BODY, _prefix(number) + _PROXY))
        first = int(model.body_dofadr[body])
        return body, site, tuple(range(first, first + dof))
    body = int(engine.mj_name2id(model, kinds.mjOBJ_BODY, held.name))
    if body < 0:
        site = int(engine.mj_name2id(model, kinds.mjOBJ_SITE, held.name))
        if site < 0:
            bodies = ", ".join(model.body(i).name for i in range(1, model.nbody) if model.body(i).name) or "none"
            sites = ", ".join(model.site(i).name for i in range(model.nsite) if model.site(i).name) or "none"
            allowed = f"the name of a body or site of the model, not {held.name} (bodies: {bodies}; sites: {sites})"
            raise InvalidParameter("scene", scene, allowed)
        body = int(model.site_bodyid[site])
    if model.body_weldid[body] == 0:
        raise InvalidParameter("scene", scene, f"a body that can move: {held.name} is fixed to the world")
    return body, site, ()


def _begin(engine: Any, model: Any, data: Any, scene: str, want: Asked, dofs: Sequence[int]) -> int:
    """Set the scene's start: the keyframe, whose number it returns (-1: none), and the actuators' commands."""
    key = -1
    if want.key:
        names = [model.key(i).name for i in range(model.nkey)]
        numbers = [str(i) for i in range(model.nkey)]
        if want.key not in names and want.key not in numbers:
            known = ", ".join(name or number for name, number in zip(names, numbers, strict=True)) or "none"
            raise InvalidParameter("scene", scene, f"key= a keyframe of the model ({known})")
        key = names.index(want.key) if want.key in names else int(want.key)
        engine.mj_resetDataKeyframe(model, data, key)
        for dof in dofs:  # a keyframe does not move the sphere
            data.qpos[model.jnt_qposadr[model.dof_jntid[dof]]] = data.qvel[dof] = 0.0
    if want.ctrl:
        if len(want.ctrl) != model.nu:
            names = [model.actuator(i).name or str(i) for i in range(model.nu)]
            few = f"ctrl= {model.nu} numbers with commas, one for each actuator ({', '.join(names) or 'it has none'})"
            raise InvalidParameter("scene", scene, few)
        data.ctrl[:] = want.ctrl
    return key


def _overlaps(engine: Any, model: Any, data: Any, spheres: set[int]) -> Iterator[str]:
    """The pairs of bodies that overlap at the start, with their depth, the deepest first."""
    deepest: dict[tuple[int, int], float] = {}
    for i in range(data.ncon):
        contact = data.contact[i]
        first, second = (int(model.geom_bodyid[geom]) if geom >= 0 else -1 for geom in contact.geom.tolist())
        if spheres.isdisjoint((first, second)) and -contact.dist > deepest.get((first, second), _OVERLAP_M):
            deepest[first, second] = -float(contact.dist)
    for (first, second), depth in sorted(deepest.items(), key=lambda item: -item[1]):
        names = [model.body(i).name or f"body {i}" if i >= 0 else "a flex" for i in (first, second)]
        yield f"{names[0]} and {names[1]} by {depth * 1e3:.2g} mm"


def raised(engine: Any, model: Any, data: Any, body: int, lift: Callable[[], None], tries: int) -> bool:
    """Lift the proxy until it is free. Returns false if it is not free after `tries` lifts."""
    own = int(model.body_geomadr[body])
    for _ in range(tries):
        engine.mj_forward(model, data)
        contacts, count = data.contact, data.ncon
        acts = contacts.dist[:count] <= contacts.includemargin[:count]
        if own not in contacts.geom[:count][acts]:
            return True
        lift()
    return False


def warnings(found: MujocoModel) -> Iterator[str]:
    """The warnings of parts of this model that are not passive by themselves, or jump at the start."""
    engine, model = found.engine, found.model
    if found.overlaps:
        more = f", and {len(found.overlaps) - 3} more pairs" if len(found.overlaps) > 3 else ""
        yield f"bodies begin inside one another: {'; '.join(found.overlaps[:3])}{more}"
    integrator = engine.mjtIntegrator(model.opt.integrator).name.removeprefix("mjINT_")
    direct = [f"{kind} {_named(engine, model, kind, i)}" for kind, i in _direct(model)]
    if direct and integrator != "DISCRETE":
        more = f" and {len(direct) - 1} more" if len(direct) > 1 else ""
        yield (
            f"{direct[0]}{more}: a direct solref (negative numbers) gives out energy with the integrator {integrator}; "
            "an observer detects it, and damping takes it back"
        )
    if integrator in ("RK4", "IMPLICIT"):
        other = "Euler is used instead" if integrator == "RK4" else "an observer keeps it passive"
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
