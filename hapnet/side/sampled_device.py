"""The device's side with the sampled servo: the torque is held from tick to tick, as on hardware."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from hapnet.checks import Vector
from hapnet.control.coupling import DeviceCoupling, ForceParts, vector_of
from hapnet.control.ledger import Ledger
from hapnet.errors import HapnetError
from hapnet.mechanics.frame import Frame
from hapnet.plant.device import Device, SimulatedDevice
from hapnet.plant.operating_range import OperatingRange, RangeWatch
from hapnet.recording.samples import Event
from hapnet.side import held_device
from hapnet.side.clutch import Clutch
from hapnet.side.device import DeviceSide, Drive, Observe, S
from hapnet.side.endpoint import NANO, DeviceControl
from hapnet.side.held_device import HeldDevice
from hapnet.wire.signals import LEADS


class SampledDeviceSide(DeviceSide):
    """Any device with its torque held from tick to tick; its account is at the actuator's port.

    make_servo : makes the law from a measured position [m], and whether the reservoir is empty.
    declared : the device's operating range. A reading outside of it stops the force for good. This and all later
        readings are ignored: for the coupling the device stays where it was. None: all readings count.
    """

    def __init__(
        self,
        endpoint: DeviceControl,
        device: Device,
        make_servo: Callable[[Vector, bool], DeviceCoupling],
        drive: Drive,
        declared: OperatingRange | None = None,
    ) -> None:
        super().__init__(endpoint, device, drive)
        self._declared = declared
        self._watch: RangeWatch | None = None
        self.clutch: Clutch | None = None
        """Converts between the device's own axes and the coupling's; None: they are the same so far."""
        self.leads_while_held = False
        """True: the device leads any world only while it is held. False: this holds for robots only."""
        self._leads = True
        self._dt = 0.0  # between the last two readings [s]
        self.same: Frame = Frame(1.0, 1.0, (0.0,) * device.dof)
        """The coupling's axes until the device stops leading for the first time: the device's own axes."""
        self.is_held: Callable[[float], bool] = lambda t: True
        """Returns whether a hand holds the device at a time after control began [s]."""
        self._simulated = device if isinstance(device, SimulatedDevice) else None
        self._make_servo = make_servo
        self.held: HeldDevice | None = None
        """The simulated device with its true accounts, once control has started."""
        self.hand = Ledger(0.0, 0.0)
        self._skippable_ticks: Callable[[float], int] | None = None
        self._follow: Callable[[float, Vector], None] | None = None

    @property
    def hand_work(self) -> float:
        return self.hand.work

    @property
    def true_slack(self) -> float | None:
        # the true account has the device's own axes
        return None if self.held is None or self.clutch is not None else self.held.true_ledger.slack_min

    @property
    def _frame(self) -> Frame:
        """The frame that relates the device's own axes to the coupling's."""
        return self.same if self.clutch is None else self.clutch.frame

    @property
    def quantisation(self) -> float | None:
        return self.servo.quantisation if self.origin_ns is not None else None

    def held_forces(self) -> dict[str, Any]:
        if self.origin_ns is None:
            return {}
        cut = {} if self.held is None else {"cut_ticks": self.held.cut_ticks}
        return {**self.servo.figures(), **cut}

    def stop(self) -> None:
        super().stop()
        if self.origin_ns is not None:
            self.servo.stop()

    def _require_inside(self, x: Vector) -> None:
        """Raise HapnetError if the device is outside its workspace."""
        if self._declared is not None and (where := self._declared.outside(x)) is not None:
            raise HapnetError(f"the device cannot begin: {where}")

    @property
    def _can_start(self) -> bool:
        return self.clutch is None or not self.clutch.meets or self.endpoint.arrived is not None

    def _start(self, x: Vector) -> None:
        self._require_inside(x)
        if self._declared is not None:
            self._watch = RangeWatch(self._declared, self.device.resolution, x)
        if (clutch := self.clutch) is not None:
            if clutch.meets and (first := self.endpoint.arrived) is not None:
                clutch.frame.meet(x, vector_of(first))
            x = clutch.frame.coupled(x)
        servo = self.servo = self._make_servo(x, self.endpoint.restarted)
        self.endpoint.start(servo)
        self.x, self._v = x, (0.0,) * len(x)
        if self._simulated is not None:
            self.held = HeldDevice(self._simulated, servo, self.hand)
            self._skippable_dt = max(self.drive.period_ns * NANO, self._simulated.period)
            self._skippable_ticks = servo.skippable_ticks if self._simulated.may_wait else None
            if self._watch is None:
                self._follow = getattr(servo, "follow", None)

    def measure(self, now_ns: int) -> None:
        held = self.held
        elapsed_s = followed_s = 0.0
        if held is not None:
            period, shared = held.plant.period, held.plant.shared_periods(now_ns)
            periods = self._periods(now_ns) if shared is None else shared
            elapsed_s = periods * period
            if self._follow is not None and periods > 1 and shared is None:
                followed_s = (periods - 1) * period
                for _ in range(periods - 1):
                    self._live_through(held, self._follow)
                periods = 1
            held_device.live(held, None, periods)
            self.write_waiting()
        x, v = self._read()
        self._dt = max(self._elapsed(), elapsed_s)
        if self._watch is None or self._watch.passes(self._dt, x, v):
            why = self._why_not_led(now_ns) if self.leads_while_held or self.endpoint.leads_robot else ""
            if bool(why) is self._leads:
                self._let_go(now_ns, why)
            if self.clutch is not None:
                x, v = self._through(self.clutch, now_ns, x, v)
                self._releases_spring = self._releases_spring or self.clutch.open
            self.x = x
        else:
            self.stop_force(now_ns, self._watch.why or "")
            v, self._releases_spring = (0.0,) * len(v), True
        self._v = v
        if held is not None:
            held_device.count(held, self._dt - followed_s)

    def act(self, now_ns: int) -> bytes | None:
        return self.endpoint.tick_sampled(now_ns, self._dt, self.x, self._v, release=self._releases_spring)

    def hold(self) -> None:
        if self.held is not None:
            held_device.apply(self.held)
        elif (applied := self._apply(self._dt, self._frame.own_force(self.servo.force))) is None:
            self.applied = False
        else:
            self.servo.force = self._frame.coupled_force(applied)

    def _why_not_led(self, now_ns: int) -> str:
        """The reason why the device leads nothing now; empty: it leads."""
        if self.stopped is not None:
            return self.stopped.why
        return self.withheld or self.let_go or ("" if self.is_held(self._since_s(now_ns)) else "it is not held")

    def _since_s(self, now_ns: int) -> float:
        """The time since control began [s]."""
        return 0.0 if self.origin_ns is None else (now_ns - self.origin_ns) * NANO

    def _let_go(self, now_ns: int, why: str) -> None:
        """Stop leading for the reason `why`; empty: lead again, from the device's present position."""
        self._leads = not why
        self.endpoint.report(LEADS, self._leads)
        text = f"the device no longer leads: {why}" if why else "the device leads again, from where it is"
        self._write(Event(now_ns, "leads", text, "warning" if why else "info"))
        if self.clutch is None:
            self.clutch = Clutch(self.same)

    def _through(self, clutch: Clutch, now_ns: int, x: Vector, v: Vector) -> tuple[Vector, Vector]:
        """Return position and velocity in the coupling's axes."""
        was = clutch.disengaged
        moved = clutch.move(self._since_s(now_ns), x, v, self.servo.force, lets_go=not self._leads)
        if clutch.disengaged != was:
            state = "open: no force" if clutch.disengaged else "closed: the device is coupled again"
            self._write(Event(now_ns, "clutch", f"the clutch is {state}"))
        return moved

    def _live_through(self, held: HeldDevice, follow: Callable[[float, Vector], None]) -> None:
        """Advance the device by a period in which the servo stalled: the force is held, and both accounts count its
        true work."""
        held_device.live(held, None, 1)
        x = held.plant.read()[0]
        follow(held.plant.period, x if self.clutch is None else self.clutch.place(x, self.servo.force))
        held_device.count(held, held.plant.period)
        held_device.observe(held)

    def _elapsed(self) -> float:
        """The time since the last tick's reading [s]."""
        return (self.drive.clock() - self.last_ns) * NANO

    def _apply(self, dt: float, force: Vector) -> Vector | None:
        """Hold this force from now on, `dt` seconds after the last; returns the applied force, if it is known."""
        return self.device.apply(force)

    @property
    def skippable_ticks(self) -> int:
        if self._skippable_ticks is None or self.endpoint.has_news or self.paused or self.clutch is not None:
            return 0
        return self._skippable_ticks(self._skippable_dt)

    def rest(self, now_ns: int, ticks: int, observe: Observe, *, then_tick: bool) -> None:
        held, servo, hand, ledger, dt = self.held, self.servo, self.hand, self.ledger, self._skippable_dt
        assert held is not None, "only simulated ticks may wait"
        assert ledger is not None, "control has not started"
        tick, lowest, hand_lowest = self.ticks, ledger.work, hand.work
        for at_ns in range(now_ns, now_ns + ticks * self.drive.period_ns, self.drive.period_ns):
            held_device.live(held, None, 1)
            self.write_waiting()
            self.x, self._v = held.plant.read()
            held_device.count(held, dt)
            update = servo.tick(dt, self.x, self._v)
            assert update is None, "a tick that sends something may not wait"
            held_device.apply(held)
            if ledger.work < lowest:
                lowest = ledger.work
            if hand.work < hand_lowest:
                hand_lowest = hand.work
            tick += 1
            if tick % self.drive.record_every == 0:
                self._sample(at_ns)
        observe(lowest, hand_lowest)
        observe(ledger.work, hand.work)
        self.resume(now_ns + (ticks - 1) * self.drive.period_ns, ticks)

    def _sample(self, now_ns: int) -> None:
        simulated = self._simulated
        if simulated is None:
            self._record(now_ns, self.x, self._v, self.servo.force, None, None)
        else:
            hand, target = simulated.hand_force, self._frame.coupled(simulated.references[-1])
            self._record(now_ns, self.x, self._v, self.servo.force, hand, target)

    def _emit(self, write: Callable[[S], None], sample: S) -> None:
        if self._simulated is None or not self._simulated.cuts_force:
            write(sample)
        else:
            self.write_later(lambda: write(sample._replace(force_N=self.servo.force)))

    def _parts(self, x: Vector, force: Vector) -> ForceParts | None:
        return self.servo.parts
