"""A tick of the device's servo as one compiled call, for real time; its records remain those of `SampledServo`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from hapnet.checks import Vector
from hapnet.control import set_position_servo as servos
from hapnet.control.contact_equations import ContactState
from hapnet.control.contact_plane import ContactPlane
from hapnet.control.continuous_servo import sent
from hapnet.control.coupling import Update
from hapnet.control.set_position_coupling import SetPositionCoupling
from hapnet.control.set_position_servo import ASKING, ASKS, CHOSEN, ITSELF, RESTS, SENDS, SampledServo
from hapnet.ext.compiled import bound
from hapnet.records.record import OfAxes, Record, equation


class ServoEnd(Record):
    """The device's end of a coupling of set-positions, with the arguments of its next tick.

    who : the part that chooses y. interval : time since the last run of PSPM [s]. takes : 1 if the tick takes an answer
    of the world.
    """

    servo: SampledServo
    coupling: SetPositionCoupling
    model: ContactState
    who: int
    interval: float
    takes: int
    dt: float
    x: OfAxes
    v: OfAxes


@equation
def tick(end: ServoEnd) -> int:
    """Make a tick of the sampled servo: `SampledServo.tick`."""
    end.interval, end.takes = end.servo.elapsed + end.dt, end.model.answer.pending
    return servos.tick(end.servo, end.coupling, end.model, end.dt, end.x, end.v, end.who)


def enter(ends: Sequence[ServoEnd]) -> int:
    """Make a tick, or the rest of it; returns the next action. This is the entry to the compiled code."""
    return tick(ends[0])


class CompiledServo(SampledServo):
    """A `SampledServo` with compiled ticks. Python makes any choice of y that only Python can make."""

    def runs(self, array: Any, end: Any, run: Any) -> None:
        """Set the compiled tick.

        array, end : the end's memory. run : the compiled tick.
        """
        self._array, self._end, self._run = array, end, run
        self.limit_gifts()

    def tick(self, dt: float, x: Vector, v: Vector, *, release: bool = False) -> Update | None:
        if release:
            return super().tick(dt, x, v, release=True)
        self.expect(dt)
        end, model, n = self._end, self.model, self.n
        end.dt, end.x[:n], end.v[:n] = dt, x, v
        end.who = ITSELF if model is None or model.goes_on else ASKING
        result = self._run(self._array)
        if result == ASKS:
            self.coupling.choose(self.elapsed, x)
            end.who = CHOSEN
            result = self._run(self._array)
        elif model is not None and result != RESTS:
            model.went_on(end.interval, x)
            if end.takes:
                model.planes = [_plane(place, n) for place in end.model.planes[: model.count]]
        return sent(self.sender, self.coupling, x) if result == SENDS else None


def _plane(place: Any, n: int) -> ContactPlane:
    """A plane that compiled code has received, as a Python record."""
    plane: ContactPlane = bound.read(ContactPlane, place, n)
    plane.effects = None
    return plane
