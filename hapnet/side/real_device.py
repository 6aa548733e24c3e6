"""The side of a real device: the device may be silent, its readings may block, and its force is limited.

While the device gives no reading the coupling stands still, as if the servo had stalled: nothing is sent to the other
side, and the force is zero as soon as the device takes commands again, or its own watchdog acts. The actuators' work
meanwhile is unknown. So of the forces that may have been held, the account counts the one that put least energy in.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from operator import sub
from typing import Any

from hapnet.checks import Vector
from hapnet.control.coupling import DeviceCoupling
from hapnet.control.held_steps import FollowerServo
from hapnet.control.set_position_servo import SampledServo
from hapnet.errors import DeviceSilent, HapnetError
from hapnet.plant.actuator_check import ActuatorCheck
from hapnet.plant.force_probe import ForceChecks
from hapnet.plant.operating_range import OperatingRange
from hapnet.recording.samples import Event, Level
from hapnet.side.contact_force import ContactForce
from hapnet.side.device import Drive
from hapnet.side.driver_times import Clocks, DriverTimes, RepeatedReadings
from hapnet.side.endpoint import NANO, DeviceControl
from hapnet.side.force_limiter import ForceLimiter
from hapnet.side.real_device_protocol import RealDevice
from hapnet.side.real_device_state import ActuatorForce, Changes, DeviceSilence, HandleReports
from hapnet.side.sampled_device import SampledDeviceSide
from hapnet.wire.fields import Signal


class RealDeviceSide(SampledDeviceSide):
    """A real device, its servo and its endpoint.

    limiter : limits the force that goes to the actuators. check : pushes the handle before control begins; None: there
    is no check. contact : reads a robot's contact force; None: it is not read. Other parameters as for
    `SampledDeviceSide`.
    """

    device: RealDevice

    def __init__(
        self,
        endpoint: DeviceControl,
        device: RealDevice,
        make_servo: Callable[[Vector, bool], DeviceCoupling],
        drive: Drive,
        declared: OperatingRange | None,
        limiter: ForceLimiter,
        check: ActuatorCheck | None = None,
        contact: ContactForce | None = None,
    ) -> None:
        super().__init__(endpoint, device, make_servo, drive, declared)
        self.limiter = limiter
        self._contact = contact
        period_s, axes = drive.period_ns * NANO, device.dof - 1 if device.jaw else None
        self._checks = ForceChecks(check, period_s, device.smallest_mass, device.resolution, axes)
        self._begun = self._closed = False
        patience_ns = drive.watchdog_ns or 0
        if device.watchdog_s is not None:
            patience_ns = min(patience_ns, round(device.watchdog_s / NANO))
        self._silence = DeviceSilence(device.name, patience_ns)
        self._actuators = ActuatorForce(device.dof)
        self._changes = Changes(braked="", released=False, waits_for_switch=False)
        self._reading: tuple[Vector, Vector] = (), ()
        self._handle = HandleReports()
        self._clocks = Clocks()
        self._times = DriverTimes(
            device.name, drive.period_ns, drive.watchdog_ns or 10 * drive.period_ns, paced=not device.blocks
        )
        self._repeats = RepeatedReadings()
        self.waited: Callable[[], int] = lambda: 0
        """The time for which the calling thread ran or waited for a processor so far [ns]."""

    def tick(self, now_ns: int) -> bytes | None:
        begun_ns, self._waited_ns = self.drive.clock(), self.waited()
        self._times.between(begun_ns)
        try:
            self._reading = self.device.read()
        except DeviceSilent as error:
            self._called("read", begun_ns)
            self._keep_still(self.drive.clock(), error)
            return None
        now_ns = self._called("read", begun_ns)  # the call may have waited for a reading
        self._repeats.see(*self._reading)
        if (event := self._silence.hear(now_ns)) is not None:
            self._excused = True  # the servo did not stall, so this is no overrun
            self.limiter.restart()
            self._write(event)
        self._handle.send(now_ns, self.device, self.endpoint, self._write)
        if self.origin_ns is None:
            if self.endpoint.paired and self._checks.start is not None:
                self._push(self._checks.start, now_ns)
                return None
            self._send((0.0,) * self.device.dof)  # a device's watchdog may need regular commands
        return super().tick(now_ns)

    def _called(self, call: str, begun_ns: int) -> int:
        """Count a call of the driver that has just ended; returns the time of its end."""
        ended_ns = self.drive.clock()
        if (event := self._times.called(call, begun_ns, ended_ns, self.waited, self._waited_ns)) is not None:
            self._write(event)
        return ended_ns

    def _push(self, check: ActuatorCheck, now_ns: int) -> None:
        """Push the handle before control begins, once the dead-man switch is held. The last push has no force and
        ends the check."""
        none = (0.0,) * self.device.dof
        if not self.limiter.is_held(self.device.buttons()):
            if self._changes.see("waits_for_switch", True):
                text = f"hold the dead-man switch of {self.device.name}: its force and motion are checked first"
                self._write(Event(now_ns, "dead-man", text))
            check.restart()
            self.last_ns = now_ns
            self._send(none)
            return
        if not self._begun:
            self._require_inside(self._reading[0])
        acted = self.device.acted() if self._begun else none
        dt = (now_ns - self.last_ns) * NANO if self._begun else 0.0
        self._begin()
        self.last_ns = now_ns
        if why := self.withheld or self.device.braked():
            self._write(Event(now_ns, "device", f"force and motion of {self.device.name} are not checked: {why}"))
            self._checks.start = None
            self._send(none)
            return
        acted = self._actuators.sent if acted is None else acted
        force = check.step(self.device.interval() or dt, acted, *self._reading)
        self._send(force)
        if not check.done:
            return
        self._checks.start = None
        if check.wrong_way:
            raise HapnetError(f"the device {self.device.name} failed: {check.wrong_way}")
        self._checks.take(check)
        for doubt in check.doubts:
            self._write(Event(now_ns, "device", f"the device {self.device.name}: {doubt}", "warning"))

    def withhold(self, now_ns: int, why: str) -> None:
        if self.withheld and not why:
            self.limiter.restart()
        super().withhold(now_ns, why)

    def stop(self) -> None:
        if self._closed:
            return
        self._closed = True
        held_N = math.hypot(*self._actuators.sent)
        if self._silence.lasts and self.origin_ns is not None:
            self.stop_force(self.drive.clock(), "the device is silent at the end: its force since then is unknown")
        try:
            super().stop()
        except HapnetError as error:
            ends = "until its own watchdog acts" if self.device.watchdog_s else "as long as it has power"
            remains = f"; up to {held_N:.2g} N may remain {ends}" if held_N else ""
            text = f"the device {self.device.name} did not end its force: {error}{remains}"
            if held_N and self.origin_ns is not None:
                self.stop_force(self.drive.clock(), "it did not end its force: its force since then is unknown")
            self._write(Event(self.drive.clock(), "device", text, "error"))
            if not isinstance(error, DeviceSilent):
                raise
        finally:
            self.device.close()

    def held_forces(self) -> dict[str, Any]:
        figures = super().held_forces()
        if "overrun_risk_J" in figures:
            figures["overrun_risk_J"] = max(figures["overrun_risk_J"], self._actuators.risk_J)
        return figures

    def driver_figures(self) -> dict[str, Any]:
        """The driver's entries in the summary."""
        return {
            "name": self.device.name,
            "missed": self._silence.missed + self.device.missed,
            "silences": self._silence.count,
            "silent_s": self._silence.total_ns * NANO,
            "hot_s": self.limiter.limited_s,
            "mass_kg": list(self._checks.masses) or None,
            "blocked": self._times.blocked or None,
            "reads_hz": self._times.rate_hz or self._repeats.new_hz(self._kept_hz()),
            "contact_missed": None if self._contact is None else self._contact.missed,
        }

    def _kept_hz(self) -> float:
        """The mean number of readings in a second since control started."""
        lasted_ns = 0 if self.origin_ns is None else self.last_ns - self.origin_ns
        return 1.0 / (self.drive.period_ns * NANO) if lasted_ns <= 0 else self.ticks * 1e9 / lasted_ns

    def _on_signal(self, now_ns: int, name: str, value: Signal) -> None:
        super()._on_signal(now_ns, name, value)
        self.device.signal(name, value)

    def _why_not_led(self, now_ns: int) -> str:
        held = self.limiter.is_held(self._handle.buttons)
        return super()._why_not_led(now_ns) or ("" if held else "the dead-man switch is not held")

    def _start(self, x: Vector) -> None:
        super()._start(x)
        if self.device.watchdog_s is not None and isinstance(self.servo, SampledServo):
            self.servo.force_ends_s = self.device.watchdog_s
        self._begin()
        if self._checks.impossible:
            self.stop_force(self.drive.clock(), self._checks.impossible)

    def _begin(self) -> None:
        if not self._begun:
            self._begun = True
            self.device.begin()

    def _read(self) -> tuple[Vector, Vector]:
        return self._reading

    def _elapsed(self) -> float:
        assert self._silence.heard_ns is not None, "a reading comes first"
        ours = (self._silence.heard_ns - self.last_ns) * NANO  # time after the reading belongs to the next tick
        reported = self.device.interval()
        if reported is None:
            return ours
        if (apart := self._clocks.apart(reported, ours, late=self._late)) is not None:
            raise HapnetError(f"the device {self.device.name} failed: the sum of its interval() is {apart}")
        return reported

    def _apply(self, dt: float, force: Vector) -> Vector | None:
        braked = self.device.braked()
        if self._changes.see("braked", braked):
            state = f"renders no force: {braked}" if braked else "renders force again: it grows"
            level: Level = "warning" if braked else "info"
            self._write(Event(self.drive.clock(), "device", f"the device {self.device.name} {state}", level))
        if braked:
            self.limiter.restart()
        permitted = self.limiter.permit(dt, (0.0,) * len(force) if braked else force, self._handle.buttons)
        if self._changes.see("released", released := self.limiter.released):
            state = "not held: no force" if released else "held: the force grows"
            level = "warning" if released else "info"
            self._write(Event(self.drive.clock(), "dead-man", f"the dead-man switch is {state}", level))
        if (share := self._checks.share) < 1.0:
            permitted = tuple([share * component for component in permitted])
        applied = self._send(permitted)
        if isinstance(self.servo, SampledServo) and (model := self.servo.model) is not None:
            grain = model.grain_force(self.servo.coupling.spring)
            self.device.vibrate(grain if any(permitted) else (0.0,) * len(grain))
        if applied is None and (self._actuators.is_reported or permitted is not force):
            self.applied &= self._actuators.is_reported and self.device.knows_force
            return permitted
        return applied

    def _send(self, force: Vector) -> Vector | None:
        begun_ns = self.drive.clock()
        try:
            applied = self.device.apply(force)
            self._called("apply", begun_ns)
        except DeviceSilent as error:
            self._called("apply", begun_ns)
            self._actuators.doubt()
            self._keep_still(self.drive.clock(), error)
            return force
        self._actuators.sent = force if applied is None else applied
        return applied

    def measure(self, now_ns: int) -> None:
        if self._contact is not None and isinstance(self.servo, FollowerServo):
            self.servo.sensed = self._frame.coupled_force(self._contact.sense())
        if (acted := self.device.acted()) is not None:
            self.servo.force = self._frame.coupled_force(acted)
            self._actuators.before, self._actuators.is_reported = None, True
        elif self._releases_spring or self._actuators.before is not None or self._actuators.is_reported:
            x = self._frame.coupled(self._reading[0])
            self._doubt((now_ns - self.last_ns) * NANO, tuple(map(sub, x, self.x)))
        if not self._renders_none:
            dt = (now_ns - self.last_ns) * NANO
            acted = self._frame.own_force(self.servo.force)
            if wrong := self._checks.wrong(dt, acted, self._reading[0]):
                self.stop_force(now_ns, wrong)
                self._releases_spring = True
        super().measure(now_ns)

    def _doubt(self, dt: float, moved: Vector) -> None:
        """Choose the force that the account counts for `dt` seconds in which the device `moved` [m].

        It can have been held until the device's own watchdog acted.
        """
        servo, coupling, before = self.servo, self.coupling, self._actuators.before
        possible = [servo.force] if before is None else [servo.force, self._frame.coupled_force(before)]
        self._actuators.before = None
        speed = super().held_forces().get("speed_limit_mps", math.inf)
        most_m = speed * min(dt, self.device.watchdog_s or dt)  # as far as the device can go while a force is held
        stored_J = max(0.0, coupling.account + coupling.potential(self.x))
        servo.force = self._actuators.worst(possible, moved, most_m, stored_J)

    def _keep_still(self, now_ns: int, error: DeviceSilent) -> None:
        """Handle a missed reading or command. Once the watchdog acts, command zero force, if the device takes commands.

        Raises HapnetError: the device has given no reading for long since its start, or since it began to render force.
        """
        starts = self._begun and self.origin_ns is None
        if (event := self._silence.miss(now_ns, error, starts=starts)) is not None:
            self._actuators.doubt()
            self._write(event)
        if self._silence.lasts:
            with suppress(DeviceSilent):
                self.device.apply((0.0,) * self.device.dof)
