"""Runners of a side's control half: a thread of this process, or a process of its own (servo_process.py)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from hapnet.assembly.build import Setup, compiled_ends, device_side, world_side
from hapnet.assembly.device_class import is_blocking
from hapnet.checks import Vector
from hapnet.control.coupling import Ends
from hapnet.loading import extension
from hapnet.processes.system import ThreadTime
from hapnet.realtime.servo import MakeStepLoop, Servo, ServoStats, StepLoop, Stepper
from hapnet.recording.samples import Event, Sample
from hapnet.side.device import Clock, DeviceSide
from hapnet.side.endpoint import DeviceEndpoint, WireHalf, WorldEndpoint
from hapnet.side.real_device import RealDeviceSide
from hapnet.side.world import WorldSide
from hapnet.summary.run import SidePart, device_summary, robot_summary, world_summary
from hapnet.wire.session import Session

UNPAIRED_STEP_NS = 1_000_000
"""A world without a peer waits for this time before it checks again [ns]."""


@dataclass(frozen=True)
class ControlCallbacks:
    """The functions that control calls with its results, each on control's own thread; each returns at once.

    send : takes a position message for the link. write : takes a sample to record. fail : takes the error that ended
    control. wake : called when there is surplus energy to collect but no message to send.
    """

    send: Callable[[bytes], None]
    write: Callable[[Sample], None]
    fail: Callable[[BaseException], None]
    wake: Callable[[], None]


class Control(Protocol):
    """A side's control, with its wire half."""

    wire: WireHalf
    unrecorded: int
    """Samples that were lost before `ControlCallbacks.write`, because there was no room."""

    @property
    def origin_ns(self) -> int | None:
        """The time at which control started, on this machine's monotonic clock; None before."""

    def start(self) -> str | None:
        """Begin to tick or step; returns one line on why real-time scheduling was refused, or None."""

    def stop(self) -> None:
        """Stop rendering force and end; returns when that is done. May be called again."""

    def pause(self, paused: bool) -> None:
        """Halt the simulated device or world, or let it continue."""

    def let_go(self, why: str) -> None:
        """Stop the device leading, for the reason `why`; if it is empty, let the device lead again."""

    def lead(self, position: Vector) -> None:
        """Lead a live hand to `position` [m], shape (n,)."""

    def place(self, position: Vector) -> None:
        """Begin at `position` [m], shape (n,): a device with a live hand, or a world; before `start`."""

    def beat(self) -> None:
        """Enter that the event loop still runs, so that this side can be ended."""

    def part(self) -> SidePart:
        """This side's part of the summary so far, without the wire half's; complete once it has stopped."""


class ServoLoop(Protocol):
    """The ticks of a device in real time; see `Servo`."""

    unsafe: str | None

    def start(self) -> str | None: ...
    def stop(self) -> None: ...
    def count_anew(self) -> None: ...
    def stats(self) -> ServoStats: ...


class MakeServo(Protocol):
    """Makes the ticks of a device from the arguments of `Servo`."""

    def __call__(
        self,
        period_ns: int,
        tick: Callable[[int], None],
        *,
        safe: Callable[[], None],
        on_error: Callable[[BaseException], None],
        paced: bool,
        realtime: bool,
        clock: Clock,
    ) -> ServoLoop: ...


class ThreadedDevice:
    """The device with its servo in a thread; with `follows`, a real robot in the world's place.

    make_servo : makes the servo; several pairs of one device share theirs.
    """

    unrecorded = 0

    def __init__(
        self,
        setup: Setup,
        session: Session,
        callbacks: ControlCallbacks,
        clock: Clock,
        *,
        realtime: bool,
        follows: bool = False,
        make_servo: MakeServo = Servo,
    ) -> None:
        endpoint, params = DeviceEndpoint(session), setup.params
        self.wire: WireHalf = endpoint
        self.side: DeviceSide
        self._thread_time = ThreadTime()
        if follows:
            self.side = extension("driven robots").robot_side(setup, endpoint, clock, callbacks.write)
            driver, rate_hz = params.follower.robot, params.follower.servo_hz
        else:
            if type(setup.ends) is Ends:
                setup = replace(setup, ends=compiled_ends())
            self.side = device_side(setup, endpoint, clock, callbacks.write)
            driver, rate_hz = params.hardware, params.device.servo_hz
        if isinstance(self.side, RealDeviceSide):
            self.side.waited = self._thread_time
        self._follows = follows
        self._coupling = setup.params.coupling
        self._send, self._wake, self._write = callbacks.send, callbacks.wake, callbacks.write
        self._clock = clock
        self._began = self._started = False
        self._servo: ServoLoop = make_servo(
            round(1e9 / rate_hz),
            self._tick,
            safe=self._end,
            on_error=callbacks.fail,
            paced=not is_blocking(driver),
            realtime=realtime,
            clock=clock,
        )

    @property
    def origin_ns(self) -> int | None:
        return self.side.origin_ns

    def start(self) -> str | None:
        self._started = True
        return self._servo.start()

    def stop(self) -> None:
        if not self._started:  # the device was opened all the same
            self.side.stop()
        self._servo.stop()
        if self._servo.unsafe is not None:
            self._write(unsafe(self._clock(), self._servo))
            self._servo.unsafe = None

    def pause(self, paused: bool) -> None:
        self.side.paused = paused

    def let_go(self, why: str) -> None:
        self.side.let_go = why

    def lead(self, position: Vector) -> None:
        assert self.side.live_hand is not None
        self.side.live_hand.lead(position)

    def place(self, position: Vector) -> None:
        self.side.place(position)

    def beat(self) -> None:
        """Do nothing: only a servo in a process of its own needs it."""

    def part(self) -> SidePart:
        part = device_summary(self.side, self._coupling, servo_timing(self._servo, self.side))
        return robot_summary(part, self.side) if self._follows else part

    def _end(self) -> None:
        try:
            self.side.stop()
        finally:
            self._thread_time.close()  # its file would stay open as long as this process lives

    def _tick(self, now_ns: int) -> None:
        message = self.side.tick(now_ns)
        if message is not None:
            self._send(message)
        elif self.wire.uncollected:
            self._wake()
        if not self._began and self.side.origin_ns is not None:
            self._began = True
            self._servo.count_anew()


class ThreadedWorld:
    """The virtual world with its loop in a thread.

    steps : makes the loop; several hands of one world share theirs.
    """

    unrecorded = 0

    def __init__(
        self,
        setup: Setup,
        session: Session,
        callbacks: ControlCallbacks,
        clock: Clock,
        *,
        rng: np.random.Generator,
        steps: MakeStepLoop = Stepper,
    ) -> None:
        endpoint = WorldEndpoint(session)
        self.wire: WireHalf = endpoint
        self.side: WorldSide = world_side(replace(setup, ends=compiled_ends()), endpoint, rng, callbacks.write)
        self._coupling = setup.params.coupling
        self._send, self._wake = callbacks.send, callbacks.wake
        self._stepper: StepLoop = steps(self._step, callbacks.fail, clock)
        self.side.scene.open()

    @property
    def origin_ns(self) -> int | None:
        return self.side.origin_ns

    def start(self) -> str | None:
        self._stepper.start()
        return None

    def stop(self) -> None:
        self._stepper.stop()
        self.side.scene.close()

    def pause(self, paused: bool) -> None:
        self.side.paused = paused

    def let_go(self, why: str) -> None:
        raise AssertionError("a world leads nothing")

    def lead(self, position: Vector) -> None:
        raise AssertionError("a world has no hand")

    def place(self, position: Vector) -> None:
        self.side.place(position)

    def beat(self) -> None:
        """Do nothing: a world has no force to end."""

    def part(self) -> SidePart:
        return world_summary(self.side, self._coupling)

    def _step(self, now_ns: int) -> int:
        message = self.side.step(now_ns)
        if self.side.origin_ns is None:
            return UNPAIRED_STEP_NS
        if message is not None:
            self._send(message)
        elif self.wire.uncollected:
            self._wake()
        return self.side.next_step_ns()


def unsafe(now_ns: int, servo: ServoLoop) -> Event:
    """The event to record for a servo whose force could not be stopped."""
    return Event(now_ns, "servo", f"the force could not be set to zero at the end: {servo.unsafe}", "error")


def servo_timing(servo: ServoLoop, side: DeviceSide) -> dict[str, Any]:
    """The servo's timing figures, for the summary."""
    timing = servo.stats()
    return {
        "late_p50_us": timing.late_p50_us,
        "late_p99_us": timing.late_p99_us,
        "late_max_us": timing.late_max_us,
        "late_period": timing.late_period,
        "skipped": timing.skipped,
        "overruns": side.overruns,
        "longest_ms": side.max_ns * 1e-6,
        "without_force_s": side.punctuality.without_force_ns * 1e-9,
        "withheld_s": side.withheld_ns * 1e-9,
        "late_histogram_us": [[edge / 1e3, count] for edge, count in timing.late_histogram_ns],
    }
