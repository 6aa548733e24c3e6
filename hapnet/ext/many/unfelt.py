"""The device's end of an edge that its leader does not feel (``force = false``): a damper without a spring.

The damper stays, so that the edge harvests energy for the follower. The set-position is always the device's own
position. That is as passive as any other: PSPM allows every y.
"""

from __future__ import annotations

from typing import Any

from hapnet.checks import Vector
from hapnet.control.continuous_servo import sent
from hapnet.control.coupling import DeviceCoupling, Update
from hapnet.control.harvest import take
from hapnet.control.set_position_servo import SampledServo, end_held, hold_on, render
from hapnet.couplings.pspm import modulator
from hapnet.couplings.set_position import held_servo
from hapnet.couplings.spec import CouplingStart


class DamperServo(SampledServo):
    """A servo whose spring stays released, and whose damper acts."""

    def tick(self, dt: float, x: Vector, v: Vector, *, release: bool = False) -> Update | None:
        if release:
            return super().tick(dt, x, v, release=True)
        coupling = self.coupling
        hold_on(self, coupling, dt, x)
        coupling.release(x, take(self.measured, coupling.potential(x) - self.potential))
        end_held(self, coupling, x)
        render(self, coupling, x, v)
        return sent(self.sender, coupling, x)

    def skippable_ticks(self, dt: float) -> int:
        """None: PSPM runs at each tick."""
        return 0


def unfelt(start: CouplingStart[Any]) -> DeviceCoupling:
    """The device's end of PSPM, without its spring."""
    return held_servo(start, modulator, None, None, DamperServo)
