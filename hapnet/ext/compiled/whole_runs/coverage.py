"""Finds whether the compiled kernel covers a run, and the reason if it does not."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, nullcontext
from typing import NamedTuple

from hapnet.assembly.build import Setup
from hapnet.control.coupling import Ends
from hapnet.control.law import DeviceEnd, WorldEnd
from hapnet.couplings.registry import known
from hapnet.ext.compiled import sources
from hapnet.ext.compiled.background import Background
from hapnet.ext.compiled.names import Kind, are_ready, missing, part_of_device
from hapnet.params import Params, follows
from hapnet.plant.worlds.coupled import MOST
from hapnet.plant.worlds.protocol import World
from hapnet.plant.worlds.scene import Scene
from hapnet.plant.worlds.walls import Contacts
from hapnet.records.machine_code import no_compiler
from hapnet.records.record import AXES
from netem import LinkProfile

_MOST_BURST_J, _MOST_POWER_W = 4.0, 500.0  # in aJ (the power: over a step of the admission) they must fit in 63 bits


OUT_OF_RANGE = "it leaves the range that messages can carry"


_WORTH_TICKS = 1_000_000
"""Plain Python takes about a minute for this number of ticks, longer than compiling a kind takes, once for all."""

_WORTH_ARM_TICKS = 5_000
"""Plain Python takes as long for this number of ticks of an arm as compiling the arm takes."""


class ChosenCode(NamedTuple):
    """The code that runs a simulation.

    why_not : the reason against compiled code; None: it runs. awaits_code : it can run once its machine code is made.
    """

    why_not: str | None
    awaits_code: bool = False


NOT_YET = "it is not compiled yet: hapnet compile does that, once"


def kind_of(params: Params, scene: World | None = None) -> Kind | None:
    """The kind of scenario of a run with these parameters; None: its coupling, or stages before it, are not compiled.

    scene : the built scene, if there is one: a user's own scene may have solids too, which only it shows.
    """
    ends = _ends(params)
    if ends is None:
        return None
    if type(scene) is Scene:
        return Kind(*ends)
    from hapnet.ext.solids.rigid import RigidScene, describes  # here: a run among walls does not load solids

    return Kind(*ends, describes(params.scene) if scene is None else type(scene) is RigidScene)


def _ends(params: Params) -> tuple[type[DeviceEnd] | None, type[WorldEnd] | None] | None:
    """The ends of the coupling, as in a `Kind`; None: the coupling, or stages before it, are not compiled."""
    law = known(params.coupling)
    if law is None or law.compiled is None or (params.rendering == "hapnet" and any(law.compiled)):
        return None
    return law.compiled


def background(runs: Iterable[tuple[Params, float]]) -> AbstractContextManager[Background | None]:
    """Compile the kinds of runs with many ticks in another process, before they run here or in other processes.

    runs : their parameters and numbers of ticks. The context gives None if there is nothing to compile.
    """
    ticks = Counter[str]()
    if no_compiler() is None:
        for params, count in runs:
            if (kind := kind_of(params)) is not None:
                ticks[kind.name] += count  # type: ignore[assignment]  # half a tick is as good
    return _compile(ticks)


def beside(setup: Setup) -> AbstractContextManager[Background | None]:
    """Compile the kind of a run in another process, for the rest of the run, if the run is long enough."""
    kind, params = kind_of(setup.params, setup.scene), setup.params
    return _compile({} if kind is None else {kind.name: params.duration_s * params.device.servo_hz})


def _compile(ticks: Mapping[str, float]) -> AbstractContextManager[Background | None]:
    """Compile in the background the kinds that run for many ticks and are not compiled yet."""
    names = [name for name, count in ticks.items() if count >= _WORTH_TICKS and not sources.are_compiled(name)]
    return Background(*names) if names else nullcontext()


def device_ends(setup: Setup) -> Ends:
    """Compile the ticks of an arm or of a tool's handle if that saves time, and both ends of the coupling if there is
    machine code for them. Plain Python runs the rest.
    """
    params = setup.params
    ticks = round(params.duration_s * params.device.servo_hz)
    all_ready = are_ready(setup.coupling, setup.dof, params)
    compiles = part_of_device(params) and (ticks >= _WORTH_ARM_TICKS or not missing(params))
    if not all_ready and not compiles:
        return setup.ends
    from hapnet.ext.compiled.real_time import CompiledDevices, CompiledEnds  # here, since it loads what it compiles

    return CompiledEnds() if all_ready else CompiledDevices()


def chosen(setup: Setup, kernel: bool | None) -> ChosenCode:
    """Choose the code for a run. `kernel` : True: compile if necessary; None: use machine code that exists.

    setup : the virtual mass was placed among its walls.
    """
    why, kind = why_not(setup), kind_of(setup.params, setup.scene)
    if why is not None or kind is None:
        return ChosenCode(why)
    if kernel or sources.are_compiled(kind.name):
        return ChosenCode(None)
    return ChosenCode(NOT_YET, awaits_code=True)


def why_not(setup: Setup) -> str | None:
    """The reason why the kernel does not cover this run; None: it covers it."""
    return next(_reasons(setup), None)


def _reasons(setup: Setup) -> Iterator[str]:
    params = setup.params
    if params.hardware != "simulated":
        yield f"the device {params.hardware}"
    if params.device.enable != "auto":
        yield "a switch that enables the device"
    if params.device.clutch:
        yield "a clutch"
    if _ends(params) is None:
        before = "the stages before " if known(params.coupling) and params.rendering == "hapnet" else ""
        yield f"{before}the coupling {params.coupling}"
    if setup.servo == "sampled" and setup.harvest != "measured":
        yield f"the harvest {setup.harvest} of a sampled servo"
    yield from _of_scene(setup)
    for name, profile, timeline in (
        ("uplink", setup.up, setup.up_timeline), ("downlink", setup.down, setup.down_timeline)
    ):  # fmt: skip
        if timeline is not None:
            yield f"a timeline of the {name}"
        yield from (f"{what} in the {name}" for what in _of_link(profile))
    yield from _of_wire(params)


def _of_scene(setup: Setup) -> Iterator[str]:
    """Yield the reasons in the scene: only walls of a `Scene`, and solids with equations, are covered."""
    scene = setup.scene
    if follows(setup.params):
        yield "a follower"
    elif type(scene) is not Scene:
        yield from _of_solids(setup)
    elif type(scene.contacts) is not Contacts:
        yield f"the scene {setup.params.scene}"
    elif scene.dof > AXES or len(scene.walls) > MOST:
        yield f"a scene with {scene.dof} axes and {len(scene.walls)} walls"
    elif not scene.contacts.separate:
        yield "walls that act on one another"


def _of_solids(setup: Setup) -> Iterator[str]:
    from hapnet.ext.solids.rigid import RigidScene  # here: a run among walls does not load solids

    scene = setup.scene
    if type(scene) is not RigidScene:
        yield f"the scene {setup.params.scene}"
    elif not 0 < len(scene.contacts.secants) <= MOST:
        yield f"a scene with {len(scene.contacts.secants)} solids"
    elif not scene.contacts.have_formulas:
        yield "a mesh, a field, a layer, or a user's shape or friction"
    elif scene.has_effects:
        yield "effects of a surface"


def _of_link(profile: LinkProfile) -> Iterator[str]:
    if profile.slot is not None:
        yield "slots"
    yield from (one.word() for one in profile.others)
    if profile.trace is not None or profile.csv is not None:
        yield "a recorded link"
    if profile.limit_bytes:
        yield "a limit in bytes"
    if profile.resend is not None and not profile.resend.ordered and profile.rate_bit_s:
        yield "unordered resends before a rate"


def _of_wire(params: Params) -> Iterator[str]:
    wire = params.wire
    if wire.deadband:
        yield "a deadband"
    if wire.admission_burst_J > _MOST_BURST_J:
        yield f"wire.admission_burst_J above {_MOST_BURST_J:g}"
    if wire.admission_W > _MOST_POWER_W:
        yield f"wire.admission_W above {_MOST_POWER_W:g}"
