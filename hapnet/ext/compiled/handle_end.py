"""A tick of a simulated handle as one compiled call, in real and in virtual time. Its record stays Python's too."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from hapnet.ext.tools import device as handles
from hapnet.ext.tools.device import Handle
from hapnet.mechanics.pose import AXES
from hapnet.records.record import FloatRows, Record, equation


class HandleEnd(Record):
    """The handle, and the hand's reference at a tick's begin and end [m]. work : of the hand in it [J]."""

    handle: Handle
    path: Annotated[FloatRows, (2, AXES)]
    work: float


@equation
def tick(end: HandleEnd) -> None:
    """A tick of the handle."""
    end.work = handles.tick(end.handle, end.path)


def enter(ends: Sequence[HandleEnd]) -> bool:
    """Make a tick. Compiled code is entered by this."""
    tick(ends[0])
    return True
