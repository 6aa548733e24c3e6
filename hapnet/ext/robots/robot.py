"""The side of a real follower robot: it stops, or is released, when its leader is released."""

from __future__ import annotations

from typing import Any

from hapnet.checks import Vector
from hapnet.control.held_steps import FollowerServo
from hapnet.recording.samples import Event
from hapnet.side.device import Stop
from hapnet.side.real_device import RealDeviceSide
from hapnet.wire.fields import Signal
from hapnet.wire.signals import LEADS


class RobotSide(RealDeviceSide):
    """A driver's robot in the world's place.

    releases : whether its force ends when its leader is released. Else it holds its set-position. Other parameters
        as for `RealDeviceSide`.
    """

    def __init__(self, *given: Any, releases: bool = False, **named: Any) -> None:
        super().__init__(*given, **named)
        self._releases = releases
        self._stands_still = self._released = False

    def stop_force(self, now_ns: int, why: str, *, asked: bool = False) -> None:
        """As for a device. If the stop was requested, the robot stops as `follower.on_stop` sets."""
        if not asked:
            self._stands_still = False
            if self.stopped is not None and self.stopped.asked:
                self.stopped = None
        elif self.stopped is None:
            self._stands_still, self._released = True, self._releases
            self.endpoint.stand_still()
            self._release()
            self.stopped = Stop(now_ns, why, asked=True)
            does = "renders no force" if self._releases else "holds its set-position"
            self._write(Event(now_ns, "stopped", f"the robot {does} from now on: {why}"))
            return
        super().stop_force(now_ns, why, asked=asked)

    @property
    def _renders_none(self) -> bool:
        return super()._renders_none and not self._stands_still

    def _on_signal(self, now_ns: int, name: str, value: Signal) -> None:
        super()._on_signal(now_ns, name, value)
        if name == LEADS and isinstance(value, bool) and not self._stands_still:
            self._released = self._releases and not value
            self._release()
            self.endpoint.lead(value)

    def _start(self, x: Vector) -> None:
        super()._start(x)
        self._release()

    def _release(self) -> None:
        """Pass on to the servo, if it runs, whether it may render a force."""
        if self.endpoint.started and isinstance(self.servo, FollowerServo):
            self.servo.released = self._released

    def _why_not_led(self, now_ns: int) -> str:
        return ""
