"""Which runs the compiled kernel covers, and why not."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import replace

from hapnet.assembly.build import Setup
from hapnet.couplings.registry import known
from hapnet.ext.compiled import sources
from hapnet.ext.compiled.kinds import Kind
from hapnet.ext.solids.rigid import RigidScene, describes
from hapnet.params import Params, follows
from hapnet.plant.worlds.protocol import World
from hapnet.plant.worlds.scene import Scene
from hapnet.plant.worlds.walls import MOST, Contacts
from hapnet.records.machine_code import no_compiler
from hapnet.records.record import AXES
from netem import LinkProfile

_MOST_BURST_J, _MOST_POWER_W = 4.0, 500.0  # in aJ, and over a step of the admission, they must fit 63 bits


OUT_OF_RANGE = "it leaves the range that messages can carry"


_WORTH_TICKS = 200_000
"""The reference takes as long for so many ticks as compiling the kernel takes, once for all processes."""

_WORTH_ARM_TICKS = 5_000
"""The same for an arm."""

_WORTH_END_TICKS = 30_000
"""The same for the ends of such a run, beside the arm."""

_ticks: Counter[str] = Counter()


def kind_of(params: Params, scene: World | None = None) -> Kind | None:
    """The kind of scenario that a run with these parameters is; None: its coupling, or stages before it, are not
    compiled.

    scene : what it is, where only that tells: a user's own may have solids too.
    """
    law = known(params.coupling)
    if law is None or law.compiled is None or (params.rendering == "hapnet" and any(law.compiled)):
        return None
    return Kind(*law.compiled, describes(params.scene) if scene is None else type(scene) is RigidScene)


def unavailable(setup: Setup, kind: Kind) -> str | None:
    """Why the kernel is not there for this run; None: it is.

    As long as it is not compiled, a process first runs some on the reference, which gives the same bits.
    """
    if sources.are_compiled(kind.name):
        return None
    _ticks[kind.name] += round(setup.params.duration_s * setup.params.device.servo_hz)
    return None if _ticks[kind.name] >= _WORTH_TICKS else "compiling it would take longer than this run"


def compile_for(runs: Iterable[tuple[Params, float]]) -> None:
    """Compile now what is about to be run for many ticks, here or in processes that would each compile it.

    runs : their parameters, and how many ticks they have.
    """
    if no_compiler() is not None:
        return
    ticks = Counter[Kind]()
    for params, count in runs:
        if (kind := kind_of(params)) is not None:
            ticks[kind] += count  # type: ignore[assignment]  # half a tick is as good
    for kind, count in ticks.items():
        if count >= _WORTH_TICKS and not sources.are_compiled(kind.name):
            from hapnet.ext.compiled.whole_runs.run import make_ready  # here, since it loads numba

            make_ready(kind)


def with_device(setup: Setup) -> Setup:
    """The setup, with the ticks of an arm or of a tool's handle, and both ends of the coupling, compiled if that pays.
    The rest of such a run is the reference's.
    """
    params = setup.params
    from hapnet.ext.compiled import real_time

    ticks = round(params.duration_s * params.device.servo_hz)
    wanted = real_time.SERVO, real_time.WORLD
    if ticks >= _WORTH_END_TICKS or not real_time.missing(setup.coupling, wanted, setup.dof, params):
        return replace(setup, ends=real_time.CompiledEnds())
    compiles = ticks >= _WORTH_ARM_TICKS or sources.are_compiled(real_time.part_of_device(params))
    return replace(setup, ends=real_time.CompiledDevices()) if compiles else setup


def chosen(setup: Setup, kernel: bool | None) -> str | None:
    """Why the kernel does not run this; None: it does.

    setup : its walls have met the virtual mass. kernel : must it? None: where it is there.
    """
    why, kind = why_not(setup), kind_of(setup.params, setup.scene)
    if why is not None or kind is None:
        return why
    return unavailable(setup, kind) if kernel is None else None


def why_not(setup: Setup) -> str | None:
    """Why the kernel does not cover this run; None: it does."""
    return next(_reasons(setup), None)


def _reasons(setup: Setup) -> Iterator[str]:
    params = setup.params
    if params.hardware != "simulated":
        yield f"the device {params.hardware}"
    if params.device.enable != "auto":
        yield "a switch that enables the device"
    if params.device.clutch:
        yield "a clutch"
    if kind_of(params) is None:
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
    """The walls of a `Scene`, and solids that equations know."""
    scene = setup.scene
    if follows(setup.params):
        yield "a follower"
    elif type(scene) is RigidScene:
        if not 0 < len(scene.contacts.secants) <= MOST:
            yield f"a scene with {len(scene.contacts.secants)} solids"
        elif not scene.contacts.have_formulas:
            yield "a mesh, a field, a layer, or a user's shape or friction"
        elif scene.has_effects:
            yield "effects of a surface"
    elif type(scene) is not Scene or type(scene.contacts) is not Contacts:
        yield f"the scene {setup.params.scene}"
    elif scene.dof > AXES or len(scene.walls) > MOST:
        yield f"a scene with {scene.dof} axes and {len(scene.walls)} walls"
    elif not scene.contacts.separate:
        yield "walls that act on one another"


def _of_link(profile: LinkProfile) -> Iterator[str]:
    if profile.slot is not None:
        yield "slots"
    yield from (one.word() for one in profile.others)
    if profile.trace is not None or profile.csv is not None:
        yield "a recorded link"
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
