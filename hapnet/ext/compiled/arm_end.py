"""A tick of a simulated arm as one compiled call, in real time and in virtual time; Python uses the same record."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from hapnet.ext.arms import motion
from hapnet.ext.arms.chain import JOINTS
from hapnet.ext.arms.motion import Arm
from hapnet.records.record import FloatRows, Record, equation


class ArmEnd(Record):
    """The arm, and the hand's reference at a tick's begin and end [m] or [rad]. work : the hand's, in the tick [J]."""

    arm: Arm
    path: Annotated[FloatRows, (2, JOINTS)]
    work: float


@equation
def tick(end: ArmEnd) -> None:
    """Make a tick of the arm."""
    end.work = motion.tick(end.arm, end.path, 0)


def enter(ends: Sequence[ArmEnd]) -> bool:
    """Make a tick. This is the entry to the compiled code."""
    tick(ends[0])
    return True
