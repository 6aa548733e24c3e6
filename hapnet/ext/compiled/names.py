"""The names of all that can be compiled: kinds of whole runs, ends of a side, and simulated devices.

A plain run imports only this module, so that it does not load the code that is compiled.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from hapnet.control.law import DeviceEnd, WorldEnd
from hapnet.couplings.spec import CouplingSpec
from hapnet.ext.compiled import sources
from hapnet.params import Params, is_arm
from hapnet.records import machine_code
from hapnet.records.record import AXES, room_for
from hapnet.units import POSE

SERVO, WORLD, ARM, HANDLE = "servo", "world", "arm", "handle"
"""The ends, a simulated arm, and a handle that turns. `named` adds the room of ends with more axes to the name."""


class Kind(NamedTuple):
    """The ends of a coupling; None: an end of set-positions. solid : the mass is among rigid solids, not walls."""

    device: type[DeviceEnd] | None = None
    world: type[WorldEnd] | None = None
    solid: bool = False

    @property
    def name(self) -> str:
        """The name of the kind, different for each kind."""
        ends = ["SetPosition" if end is None else end.__name__ for end in self[:2]]
        return "-".join([*ends, "Solids"] if self.solid else ends)


def named(end: str, axes: int) -> str:
    """Return the name of an end, `SERVO` or `WORLD`, with room for this number of axes."""
    room = room_for(axes)
    return end if room == AXES else f"{end}-{room}"


def part_of_device(params: Params) -> str:
    """Return the name of the simulated device's part that is compiled separately: an arm, a tool's handle, or "".

    params : with the units of the world.
    """
    if is_arm(params.hardware):
        return ARM
    return HANDLE if params.hardware == "simulated" and params.units == POSE else ""


def missing(params: Params) -> list[str]:
    """Return the parts that are not compiled yet and too slow in Python at 1 kHz: ticks of a simulated arm or handle.

    params : with the units of the world.
    """
    part = part_of_device(params)
    return [part] if part and machine_code.no_compiler() is None and not sources.are_compiled(part) else []


def are_ready(spec: CouplingSpec[Any], axes: int, params: Params) -> bool:
    """Whether both ends of this coupling, as far as they are set-positions, and the device's part are compiled."""
    laws = zip((SERVO, WORLD), spec.compiled or (), strict=False)
    names = [named(end, axes) for end, law in laws if law is None] + [part_of_device(params)]
    return all(sources.are_compiled(name) for name in names if name)
