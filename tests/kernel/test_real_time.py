"""The compiled ends of real time beside those of plain Python, over the same input: the same bits, in every field."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from hapnet.assembly.build import Setup, prepare, virtual_mass
from hapnet.checks import Vector
from hapnet.control.coupling import Ends, PositionSample, ProxySample, WorldCoupling, counted
from hapnet.control.set_position_servo import SampledServo
from hapnet.control.set_position_steps import SetPositionSteps
from hapnet.couplings.spec import CouplingStart
from hapnet.ext.compiled import names, real_time
from hapnet.ext.compiled.servo_end import CompiledServo
from hapnet.ext.compiled.world_end import CompiledMass, CompiledSteps
from hapnet.mechanics.curvature import Curvature
from hapnet.mechanics.effects import Effects
from hapnet.mechanics.plane import Plane
from hapnet.params import Params
from hapnet.plant.worlds.scene import Scene, along
from hapnet.plant.worlds.walls import Wall
from hapnet.records.record import OfAxes, Record, element, fields
from tests.conftest import mostly_slow

TICKS = 1500
TOOL = "tool:box + plane?normal=0,0,-1&at=0,0,-20mm"
DT = 1e-3


def setup_of(changes: dict[str, Any]) -> Setup:
    return prepare(Params().set({"scene": "wall", **changes}), "sampled")


def compiled_ends(end: str, axes: int) -> Ends:
    """The maker of compiled ends; this one, with room for so many axes, is compiled if it is not yet."""
    real_time.make_ready(names.named(end, axes))
    return real_time.CompiledEnds()


def start_of(setup: Setup, side: Any, position: Vector) -> CouplingStart[Any]:
    return CouplingStart(setup.params, setup.tuning, position, side.ceiling_J, 0.0, setup.harvest)


FEW_AXES = 7
"""The first cases have no more axes than three; those of the others are compiled for themselves."""

ROOM = {"spring", "offset", "wanted", "pull", "error", "c", "damper", "product", "penetration", "bends", "seen"}
"""Fields that only lend room to an equation, and the spring, which nobody writes into else."""


def state(record: Any, n: int) -> Any:
    """All fields of a record, those of the records in it too; of vectors the n numbers that are used."""
    found = {}
    for name, type_ in fields(type(record)).items():
        if name in ROOM:
            continue
        of, shape = element(type_)
        value = getattr(record, name)
        if issubclass(of, Record):
            found[name] = state(value, n) if not shape else [state(one, n) for one in value]
        elif len(shape) == 2:
            found[name] = [tuple(row)[:n] for row in value]
        else:
            found[name] = tuple(value)[: n if type_ is OfAxes else None] if shape else value
    return found


def planes(rng: np.random.Generator, n: int, kind: str) -> tuple[Plane, ...] | None:
    if kind == "none":
        return None
    found = []
    for _ in range(int(rng.integers(0, 3))):
        normal = rng.standard_normal(n)
        normal /= np.linalg.norm(normal)
        bends = (Curvature(tuple(np.eye(n)[0].tolist()), 20.0),) if kind == "bends" and n > 1 else ()
        friction = 0.4 if kind == "rubs" else 0.0
        offset, velocity = float(rng.uniform(-0.005, 0.01)), float(rng.choice([0.0, 0.02]))
        effects = Effects(viscosity=2.0, sticking=0.6) if kind == "acts" else None
        found.append(Plane(tuple(normal.tolist()), offset, 2000.0, 5.0, velocity, bends, friction, effects))
    return tuple(found)


def inputs(seed: int, n: int, kinds: tuple[str, ...]) -> Iterator[tuple[str, Any]]:
    """What happens to a device's end: ticks, samples, energy, late ticks, releases, another peer."""
    rng = np.random.default_rng(seed)
    x, phase = np.zeros(n), rng.uniform(0.0, 6.0, n)
    for k in range(TICKS):
        before = x
        x = 0.01 * np.sin(20.0 * DT * k + phase) - 0.01 * np.sin(phase)
        if rng.uniform() < 0.1:
            told = planes(rng, n, str(rng.choice(kinds)))
            force = rng.normal(size=n) * float(rng.choice([0.0, 1.0]))
            place = x + rng.normal(size=n) * 0.002
            sample = ProxySample(tuple(place.tolist()), k * DT, tuple(force.tolist()), told, 0.02, float(rng.uniform()))
            yield "sample", (sample, k * DT - 0.02, 0.03)
        if rng.uniform() < 0.05:
            yield "credit", float(rng.uniform(0.0, 1e-4))
        if k == 700:
            yield "peer", None
        dt = float(rng.choice([DT, DT, DT, 1.01 * DT])) if k % 400 != 399 else 0.04
        if k % 800 == 799:  # the device moved on while the servo stalled
            yield "follow", (0.5 * dt, tuple((0.5 * (before + x)).tolist()))
        yield "tick", (dt, tuple(x.tolist()), tuple(((x - before) / dt).tolist()), 900 < k < 905)


def drive(servo: SampledServo, happened: Iterator[tuple[str, Any]]) -> Iterator[Any]:
    for what, value in happened:
        if what == "sample":
            servo.coupling.receive(*value)
        elif what == "credit":
            servo.coupling.credit(value)
        elif what == "peer":
            yield servo.coupling.on_peer_changed()
        elif what == "follow":
            servo.follow(*value)
        else:
            dt, x, v, release = value
            update = servo.tick(dt, x, v, release=release)
            yield update, servo.force, servo.account, servo.coupling.potential(x), servo.parts


CASES: dict[str, tuple[dict[str, Any], int, tuple[str, ...]]] = {
    "one axis": ({}, 1, ("flat",)),
    "three axes": ({"dof": 3}, 3, ("flat",)),
    "whatever a world may send": ({"dof": 3}, 3, ("flat", "bends", "rubs", "acts", "none")),
    "as in the paper": ({"rendering": "paper", "dof": 2}, 2, ("none",)),
    "zoh, smoothed and predicted": (
        {"coupling": "zoh", "dof": 2, "device.smoothing_s": 0.005, "device.predict_s": 0.01}, 2, ("flat",),
    ),
    "by range, with encoders": (
        {"rendering": "paper", "device.harvest": "range", "device.resolution_m": 5e-5}, 1, ("none",),
    ),
    "encoders, limits and needed energy": (
        {"dof": 3, "device.resolution_m": 5e-5, "device.force_limit_N": 1.0, "device.shuffle": "needed",
         "device.on_silence": "release", "device.silence_after_s": 0.05}, 3, ("flat",),
    ),
    "seven axes": ({"device.force_limit_N": 1.0}, 7, ("flat", "none")),
    "a tool": ({"scene": TOOL}, 12, ("flat", "rubs")),
    "a tool with two stiffnesses": ({"scene": TOOL, "device.stiffness": [200, 0.3]}, 12, ("flat",)),
}  # fmt: skip


@pytest.mark.parametrize("case", mostly_slow(CASES, FEW_AXES))
def test_a_compiled_servo_gives_the_same_bits(case: str) -> None:
    changes, n, kinds = CASES[case]
    setup = setup_of(changes)
    plain, fast = (
        ends.servo(setup.coupling.device(start_of(setup, setup.params.device, (0.0,) * n)))
        for ends in (Ends(), compiled_ends(names.SERVO, n))
    )
    assert isinstance(fast, CompiledServo)
    assert isinstance(plain, SampledServo)
    assert not isinstance(plain, CompiledServo)
    for one, other in zip(drive(plain, inputs(7, n, kinds)), drive(fast, inputs(7, n, kinds)), strict=True):
        assert one == other
    assert state(plain, n) == state(fast, n)
    assert state(plain.coupling, n) == state(fast.coupling, n)
    assert plain.figures() == fast.figures()
    if plain.model is not None:
        assert fast.model is not None
        assert state(plain.model.rubbing, n) == state(fast.model.rubbing, n)
        for one, other in zip(plain.model.planes, fast.model.planes, strict=True):
            assert (state(one, n), one.bends.curvatures) == (state(other, n), other.bends.curvatures)


def world_of(setup: Setup, ends: Ends) -> tuple[WorldCoupling, Any]:
    mass = virtual_mass(setup)
    made = setup.coupling.world(start_of(setup, setup.params.world, mass.position))
    steps = ends.steps(made, mass, setup.scene.contacts)
    return steps, ends.mass(steps, mass)


class Stops(Scene):
    """A stop on each of seven joints."""

    def __init__(self) -> None:
        walls = [Wall(along(7, k, 1.0), 0.01, 3000.0, 10.0) for k in range(7)]
        super().__init__("stops", 7, tuple(walls), 0.001, 0.03)


WORLDS: dict[str, dict[str, Any]] = {
    "one axis": {},
    "three axes in a box": {"scene": "box", "dof": 3},
    "as in the paper": {"rendering": "paper", "scene": "box", "dof": 2},
    "zoh": {"coupling": "zoh"},
    "smoothed, predicted, released": {
        "rendering": "paper", "dof": 2, "world.smoothing_s": 0.01, "world.predict_s": 0.02,
        "world.on_silence": "release", "world.silence_after_s": 0.1, "world.step_limit_N": 0.5,
    },
    "with matrices": {"dof": 2, "world.shuffle": "needed"},
    "seven axes": {"scene": "tests.kernel.test_real_time:Stops"},
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("case", WORLDS)
def test_a_compiled_world_gives_the_same_bits(case: str) -> None:
    setup = setup_of(WORLDS[case])
    n = setup.dof
    made = [world_of(setup, ends) for ends in (Ends(), compiled_ends(names.WORLD, n))]
    assert [isinstance(steps, CompiledSteps) for steps, _ in made] == [False, True]
    rng = np.random.default_rng(3)
    sent_s = 0.0
    for k in range(600):
        dt = float(rng.uniform(0.001, 0.03))
        x = tuple((0.02 * np.sin(0.05 * k + np.arange(n))).tolist())
        sent_s += dt
        sample = PositionSample(x, 0.3) if k % 3 else x
        energy = float(rng.uniform(0.0, 1e-4)) if k % 5 == 0 else 0.0
        results = []
        for steps, mass in made:
            coupling = steps.coupling
            if k % 7:
                coupling.receive(sample, sent_s, 0.02)
            if energy:
                coupling.credit(energy)
            if k == 300:
                results.append(coupling.on_peer_changed())
            done = steps.advance(mass, dt, setup.scene.contacts)
            count = steps.counted if isinstance(steps, SetPositionSteps) else None
            update = (count or (lambda *given, own=steps: counted(own, *given)))(
                dt, done.position, mass.kinetic_J, done.work_J, done.dissipated_J
            )
            results.append((done, update, mass.velocity, mass.kinetic_J, coupling.set_position, coupling.account))
        half = len(results) // 2
        assert results[:half] == results[half:], k
    (plain, mass), (fast, moved) = made
    assert state(plain.coupling, n) == state(fast.coupling, n)
    assert isinstance(moved, CompiledMass)
    assert state(mass, n) == state(moved, n)


def test_an_end_that_is_not_covered_stays_as_it_is() -> None:
    setup = setup_of({"coupling": "wave"})
    servo = setup.coupling.device(start_of(setup, setup.params.device, (0.0,)))
    assert real_time.CompiledEnds().servo(servo) is servo


@pytest.mark.parametrize("changes", [{"scene": "sphere"}, {"scene": TOOL}, {"scene": "shared:block?mass=0.2"}])
def test_the_steps_of_a_world_without_walls_stay_as_they_are(changes: dict[str, Any]) -> None:
    """Python makes them, and would take a third longer on compiled memory."""
    setup = setup_of(changes)
    steps, mass = world_of(setup, real_time.CompiledEnds())
    assert (type(steps), isinstance(mass, CompiledMass)) == (SetPositionSteps, False)


def test_nothing_is_compiled_while_a_servo_runs() -> None:
    """Other arguments are an error, not seconds without a tick."""
    run = real_time.make_ready(names.SERVO)
    with pytest.raises(TypeError, match="No matching definition"):
        run(1.0)
