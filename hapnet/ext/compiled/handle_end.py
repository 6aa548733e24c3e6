"""A tick of a simulated handle as one compiled call, in real and in virtual time; Python uses the same record."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from hapnet.ext.tools import device as handles
from hapnet.ext.tools.device import Handle
from hapnet.mechanics.pose import AXES
from hapnet.records.record import FloatRows, Record, equation


class HandleEnd(Record):
    """The handle, and the hand's reference at a tick's begin and end [m]. work : the hand's, in the tick [J]."""

    handle: Handle
    path: Annotated[FloatRows, (2, AXES)]
    work: float


@equation
def tick(end: HandleEnd) -> None:
    """Make a tick of the handle."""
    end.work = handles.tick(end.handle, end.path)


def enter(ends: Sequence[HandleEnd]) -> bool:
    """Make a tick. This is the entry to the compiled code."""
    tick(ends[0])
    return True
