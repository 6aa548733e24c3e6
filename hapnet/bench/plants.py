"""What a tick of a simulated device costs that is more than a mass: an arm, and a handle that turns."""

from __future__ import annotations

from collections.abc import Callable

from hapnet.bench.cost import Call, cost
from hapnet.bench.row import Options, Row, row
from hapnet.kernel import real_time
from hapnet.plant.arms.device import SimulatedArm
from hapnet.plant.arms.omni import omni
from hapnet.plant.device import SimulatedDevice
from hapnet.plant.operator import Impedance, Rest, Sine
from hapnet.plant.poses.device import SimulatedHandle
from hapnet.plant.poses.hand import TurningHand


def arm_tick(options: Options) -> Row:
    """An arm of three joints in a hand that moves."""
    what = "tick of a simulated arm of three joints, four steps"
    return _beside_python("arm_tick", what, lambda: SimulatedArm(omni(), Sine(3, Impedance())), options)


def handle_tick(options: Options) -> Row:
    """A handle of six degrees of freedom in a hand that turns it."""
    what = "tick of a simulated handle that turns, 12 coordinates, four steps"
    return _beside_python(
        "handle_tick", what, lambda: SimulatedHandle(TurningHand(Rest(3, Impedance()), 0.3, 0.25)), options
    )


def _beside_python(name: str, what: str, make: Callable[[], SimulatedDevice], options: Options) -> Row:
    ours, plain = real_time.ends().simulated(make()), make()
    for device in (ours, plain):
        device.apply((0.1,) * device.dof)
    subject, bare = cost(Call(ours.advance), Call(plain.advance), options)
    return row(name, "us", what, subject, "the same in plain Python", bare, panel=False)
