"""The compiled ends of a side in real time: replaces a side's Python ends by compiled ends when control starts."""

from __future__ import annotations

from functools import cache
from typing import Any

from hapnet.checks import Vector
from hapnet.control.contact_model import ContactModel
from hapnet.control.contact_surfaces import IN_ANY_WORLD
from hapnet.control.coupling import DeviceCoupling, Ends, Made, WorldCoupling
from hapnet.control.predicted_device import PredictedDevice
from hapnet.control.pspm import SetPositionModulator
from hapnet.control.set_position_coupling import SetPositionCoupling
from hapnet.control.set_position_servo import SampledServo
from hapnet.control.set_position_steps import SetPositionSteps
from hapnet.control.smoothing import SmoothingFilter, VelocityPredictor
from hapnet.control.zoh import ZeroOrderHold
from hapnet.ext.arms.device import SimulatedArm
from hapnet.ext.compiled import arm_end, bound, handle_end, servo_end, sources, world_end
from hapnet.ext.compiled.arm_end import ArmEnd
from hapnet.ext.compiled.handle_end import HandleEnd
from hapnet.ext.compiled.kinds import OF_SET_POSITIONS
from hapnet.ext.compiled.names import ARM, HANDLE, SERVO, WORLD, named
from hapnet.ext.compiled.servo_end import CompiledServo, ServoEnd
from hapnet.ext.compiled.world_end import CompiledCoupling, CompiledMass, CompiledSteps, WorldEndRecord
from hapnet.ext.tools.device import SimulatedHandle
from hapnet.mechanics.contacts import Mass, Surroundings
from hapnet.mechanics.spring import Spring
from hapnet.plant.integrator import PassiveIntegrator, kinetic
from hapnet.plant.worlds.coupled import MOST
from hapnet.plant.worlds.walls import Contacts
from hapnet.records.record import AXES, Record, room_for

_COMPILED: dict[str, tuple[Any, type[Record]]] = {
    SERVO: (servo_end, ServoEnd), WORLD: (world_end, WorldEndRecord),
    ARM: (arm_end, ArmEnd), HANDLE: (handle_end, HandleEnd),
}  # fmt: skip

_STAGES: tuple[list[type], ...] = ([], [VelocityPredictor], [SmoothingFilter], [VelocityPredictor, SmoothingFilter])


@cache
def make_ready(name: str) -> Any:
    """The compiled function of the end or device `name`; loads or makes the machine code, once in a process."""
    part, _, axes = name.partition("-")
    module, kind = _COMPILED[part]
    from hapnet.ext.compiled.twins import ready  # here, since it loads numba

    array, _ = bound.memory(kind, int(axes or AXES))  # a device has no suffix for axes
    run = ready(module.enter, name, OF_SET_POSITIONS | IN_ANY_WORLD, array)
    run.disable_compile()  # a call with other argument types must fail, not compile for half a minute
    return run


_DEVICES: dict[type, str] = {SimulatedArm: ARM, SimulatedHandle: HANDLE}
"""The simulated devices with compiled ticks; the name is that of the record in the device and in its end."""


class CompiledDevices(Ends):
    """Compiles the ticks of an arm or a handle, and leaves everything else as it is."""

    def simulated(self, device: Made) -> Made:
        """Return the same device; if it is an arm or a handle, its ticks are compiled from now on."""
        if (name := _DEVICES.get(type(device))) is not None:
            simulated: Any = device
            array, end = bound.memory(_COMPILED[name][1])
            setattr(simulated, name, bound.Move().to(getattr(end, name), getattr(simulated, name)))
            simulated.compiled = CompiledTicks(array, end, make_ready(name))
        return device


class CompiledEnds(CompiledDevices):
    """Compiles ends of set-positions too, as far as there is machine code for them.

    Ends of other laws stay in Python.
    """

    def servo(self, servo: DeviceCoupling) -> DeviceCoupling:
        """Return a servo with compiled ticks if possible, else `servo`. Do not use `servo` after it was replaced."""
        if type(servo) is not SampledServo or not _is_covered(servo.coupling):
            return servo
        if not sources.are_compiled(named(SERVO, servo.n)):
            return servo
        model = servo.coupling.source
        if model is not servo.model or type(model) not in (ContactModel, type(None)):
            return servo
        array, end = bound.memory(ServoEnd, room_for(servo.n))
        move = bound.Move(copied=(Spring,))
        if servo.model is not None:
            move.to(end.model, servo.model)
        move.to(end.coupling, servo.coupling)
        made: CompiledServo = move.to(end.servo, servo, CompiledServo)
        made.runs(array, end, make_ready(named(SERVO, servo.n)))
        return made

    def steps(self, steps: WorldCoupling, mass: Mass, contacts: Surroundings) -> WorldCoupling:
        """Return an end with compiled steps among walls if possible, else `steps`. `mass` is the mass that it moves. Do
        not use replaced arguments afterwards, except a mass that such an end has moved before.

        Elsewhere Python makes the step, and compiled memory would only slow it down.
        """
        if type(steps) is not SetPositionSteps or not _is_covered(steps.coupling) or not _are_walls(contacts):
            return steps
        if not (type(mass) is PassiveIntegrator or isinstance(mass, CompiledMass)):
            return steps
        source, n = steps.coupling.source, len(steps.coupling.y)
        if not (source is None or type(source) is PredictedDevice) or not sources.are_compiled(named(WORLD, n)):
            return steps
        array, end = bound.memory(WorldEndRecord, room_for(n))
        run, end.n = make_ready(named(WORLD, n)), n
        move = bound.Move(copied=(Spring,))
        if source is not None:
            source.predictor.make_room(n)
            predicted = move.to(end.predicted, source)
            if steps.reporter is not None:
                steps.reporter.predicted = predicted
        coupling = move.to(end.coupling, steps.coupling, CompiledCoupling)
        coupling.runs(array, end, run)
        assert isinstance(contacts, Contacts)
        bound.copy(end.contacts, contacts)
        made = CompiledSteps(coupling, steps.reporter, _moved(mass, end), contacts, array, end, run)
        made.in_contact = steps.in_contact
        return made

    def mass(self, steps: WorldCoupling, mass: Mass) -> Mass:
        """The mass that `steps` moves by compiled calls; `mass` itself if there is none."""
        return steps.mass if isinstance(steps, CompiledSteps) else mass


def _moved(mass: PassiveIntegrator, end: Any) -> CompiledMass:
    """Move the mass into this end's memory, from another end's memory or, the first time, from plain Python."""
    end.kinetic = kinetic(mass)
    if isinstance(mass, CompiledMass):
        moved = mass
        bound.move_on(end.mass, moved)
    else:
        moved = bound.Move().to(end.mass, mass, CompiledMass)
    moved.belongs(end)
    return moved


def _is_covered(coupling: SetPositionCoupling) -> bool:
    stages = [type(stage) for stage in coupling.stages.stages]
    return type(coupling.modulator) in (SetPositionModulator, ZeroOrderHold) and stages in _STAGES


def _are_walls(contacts: Surroundings) -> bool:
    return type(contacts) is Contacts and contacts.separate and len(contacts.walls) <= MOST


class CompiledTicks:
    """Makes a tick by a compiled call: the attribute `compiled` of a `SimulatedArm` or a `SimulatedHandle`.

    array, end : the end's memory, with `path` (two rows) and `work`. run : the compiled tick.
    """

    def __init__(self, array: Any, end: Any, run: Any) -> None:
        self._array, self._end, self._run = array, end, run

    def __call__(self, begin: Vector, end: Vector) -> float:
        path, n = self._end.path, len(begin)
        path[0][:n], path[1][:n] = begin, end
        self._run(self._array)
        work: float = self._end.work
        return work
