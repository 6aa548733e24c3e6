"""The device's side with the continuous servo, as in the paper: a simulated device renders the coupling itself."""

from __future__ import annotations

from collections.abc import Callable

from hapnet.checks import Vector
from hapnet.control.continuous_servo import ContinuousServo
from hapnet.control.coupling import ForceParts
from hapnet.plant.device import SimulatedDevice
from hapnet.plant.tick import TickResult
from hapnet.records.vectors import added
from hapnet.side.device import DeviceSide, Drive, Observe
from hapnet.side.endpoint import NANO, DeviceControl


class ContinuousDeviceSide(DeviceSide):
    """A simulated device whose coupling acts continuously, as in the paper; its account is at the human's port.

    make_servo : makes the law from a position [m], a kinetic energy [J], and whether the reservoir is empty.
    """

    device: SimulatedDevice
    servo: ContinuousServo
    """The servo's law; it exists once control has started."""

    def __init__(
        self,
        endpoint: DeviceControl,
        device: SimulatedDevice,
        make_servo: Callable[[Vector, float, bool], ContinuousServo],
        drive: Drive,
    ) -> None:
        super().__init__(endpoint, device, drive)
        self._make_servo = make_servo
        self._skippable_dt = max(drive.period_ns * NANO, device.period)
        self._ahead: TickResult | None = None  # of the next tick: the device was already advanced to it
        self._work = self._dt = 0.0  # put in by the hand since the last tick [J], and the time since then [s]

    def _start(self, x: Vector) -> None:
        device = self.device
        servo = self.servo = self._make_servo(x, device.kinetic, self.endpoint.restarted)
        self.endpoint.start_continuous(servo)
        spring = servo.coupling.spring
        device.couple(spring.K, servo.damping, x, spring.force_limit)
        device.passage()

    @property
    def skippable_ticks(self) -> int:
        if self.ledger is None or self.endpoint.has_news or self.paused:
            return 0
        return self.servo.skippable_ticks(self._skippable_dt)

    def rest(self, now_ns: int, ticks: int, observe: Observe, *, then_tick: bool) -> None:
        device, servo, ledger, dt = self.device, self.servo, self.ledger, self._skippable_dt
        assert ledger is not None, "control has not started"
        results = device.run(ticks + then_tick)
        if then_tick:
            self._ahead = results.pop()
        rest, kinetic_at = servo.rest, device.kinetic_at
        tick, every = self.ticks, self.drive.record_every
        lowest = ledger.work
        for (work, x, v, hand_force, force), target in zip(
            results, device.references, strict=False
        ):  # the tick that follows too
            rest(dt, x, work, kinetic_at(v))
            if ledger.work < lowest:
                lowest = ledger.work
            tick += 1
            if tick % every == 0:
                at_ns = now_ns + (tick - self.ticks - 1) * self.drive.period_ns
                self._record(at_ns, x, v, force, hand_force, target)
        observe(lowest, lowest)
        observe(ledger.work, ledger.work)
        self.resume(now_ns + (ticks - 1) * self.drive.period_ns, ticks)

    def measure(self, now_ns: int) -> None:
        device = self.device
        periods = self._periods(now_ns)
        if self._ahead is not None:
            self._work, self._ahead = self._ahead[0], None
        elif periods == 1:
            self._work = device.advance()
        else:
            self._work = added([device.advance() for _ in range(periods)])
        self._dt = max((self.drive.clock() - self.last_ns) * NANO, periods * device.period)

    def act(self, now_ns: int) -> bytes | None:
        device = self.device
        return self.endpoint.tick_continuous(
            now_ns, self._dt, device.position, device.passage, self._work, device.kinetic, release=self._releases_spring
        )

    def hold(self) -> None:
        self.device.move_set_position(self.servo.coupling.modulator.set_position)

    def _sample(self, now_ns: int) -> None:
        device = self.device
        self._record(
            now_ns, device.position, device.velocity, device.actuator_force, device.hand_force, device.references[-1]
        )

    def _parts(self, x: Vector, force: Vector) -> ForceParts:
        return self.servo.parts(x, force)
