"""A tick of the device's servo as one compiled call, for real time; its records stay those of `SampledServo`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from hapnet.checks import Vector
from hapnet.control import contact_equations
from hapnet.control import set_position_servo as servos
from hapnet.control.contact_equations import ContactState
from hapnet.control.continuous_servo import sent
from hapnet.control.coupling import Update
from hapnet.control.set_position_coupling import SetPositionCoupling
from hapnet.control.set_position_servo import SampledServo
from hapnet.records.equation import equation
from hapnet.records.record import OfAxes, Record
from hapnet.records.vectors import copy

RESTS, SENDS, ASKS = range(3)
"""What a tick returns: there is nothing to send; there may be; y is to be chosen, and then it goes on."""


class ServoEnd(Record):
    """The device's end of a coupling of set-positions, with the arguments of its next tick.

    asks : does Python choose y? chosen : has it done so, in this tick? interval : since the run of PSPM
    before, if it runs in this tick [s]; else below 0.
    """

    servo: SampledServo
    coupling: SetPositionCoupling
    model: ContactState
    asks: int
    chosen: int
    interval: float
    dt: float
    x: OfAxes
    v: OfAxes


@equation
def tick(end: ServoEnd) -> int:
    """`SampledServo.tick` of a servo that is in time."""
    servo, coupling, result = end.servo, end.coupling, RESTS
    if not end.chosen:
        end.interval = -1.0
    if end.chosen or servos.hold_on(servo, coupling, end.dt, end.x):
        if not end.chosen:
            end.interval = servo.elapsed
            if end.asks:
                return ASKS
            if end.model.in_use:
                contact_equations.step(end.model, servo.n, end.interval, end.x, coupling.y)
            else:
                copy(servo.n, coupling.received, coupling.y)
        servos.update_held(servo, coupling, end.x)
        if servo.sender.sends or coupling.shuffled != 0.0:
            result = SENDS
    end.chosen = 0
    servos.render(servo, coupling, end.x, end.v)
    return result


def entry_of(sources: str) -> Callable[[Sequence[ServoEnd]], int]:
    """The function that compiled code is entered by. sources : their digest."""

    def run(ends: Sequence[ServoEnd]) -> int:
        """Make a tick, or the rest of it; returns what is to be done."""
        return tick(ends[0]) if sources is not None else ASKS

    return run


class CompiledServo(SampledServo):
    """A `SampledServo` whose ticks are compiled. A late one, and a y that only Python can choose, stay Python's."""

    def runs(self, array: Any, end: Any, run: Any) -> None:
        """array, end : the end's memory. run : the compiled tick."""
        self._array, self._end, self._run = array, end, run

    def tick(self, dt: float, x: Vector, v: Vector, *, release: bool = False) -> Update | None:
        if release or self.is_late(dt):
            return super().tick(dt, x, v, release=release)
        end, model = self._end, self.model
        n = self.n
        end.dt, end.x[:n], end.v[:n] = dt, x, v
        if model is not None:
            end.asks = not model.goes_on
        result = self._run(self._array)
        if result == ASKS:
            self.coupling.choose(end.interval, x)
            end.chosen = 1
            result = self._run(self._array)
        elif model is not None and end.interval >= 0.0:
            model.went_on(end.interval, x)
        return sent(self.sender, self.coupling, x) if result == SENDS else None
