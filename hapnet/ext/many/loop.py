"""One control thread for all pairs of a node in real time: the steps of its worlds, and the ticks of its devices.

The sides are those of `hapnet world` and `hapnet device` (`hapnet.realtime.runner`). Each has its part of the loop in
place of a thread of its own. A pair that fails or ends leaves the loop, and the others go on.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from hapnet.ext.many.hands import JointSteps
from hapnet.ext.many.reservoirs import Reservoirs
from hapnet.realtime.controllers import UNPAIRED_STEP_NS, ThreadedWorld
from hapnet.realtime.servo import Servo, ServoStats, Stepper

Step = Callable[[int], int]
Fail = Callable[[BaseException], None]


class JointLoop:
    """The control thread of a node.

    reservoirs : of the seats of a world; None: there is one hand. period_ns : of the node's servo [ns]; None: it is a
    world, whose steps have the lengths that its scene chooses. realtime : as in `Servo`.

    A follower's robot makes its step first, and then come the ticks of the pairs that it leads, all at one time.
    """

    def __init__(
        self, reservoirs: Reservoirs | None = None, period_ns: int | None = None, *, realtime: bool = False
    ) -> None:
        self._reservoirs = reservoirs
        self._lock = threading.Lock()
        clock = time.monotonic_ns
        self._stepper = Stepper(self._step, self._fail, clock)
        self._servo: Servo | None = None
        if period_ns is not None:
            self._servo = Servo(
                period_ns, self._tick, safe=self._release, on_error=self._fail, realtime=realtime, clock=clock
            )
        self._made = 0
        self._running: list[_PairLoop] = []
        self._joint = JointSteps(())
        self._began = self._counted = False

    def for_world(self, step: Step, on_error: Fail, clock: Callable[[], int]) -> WorldLoop:
        """The steps of one hand; a `hapnet.realtime.servo.MakeStepLoop`."""
        self._made += 1
        return WorldLoop(self, self._made, step, on_error)

    def for_device(
        self,
        period_ns: int,
        tick: Callable[[int], None],
        *,
        safe: Callable[[], None],
        on_error: Fail,
        paced: bool,
        realtime: bool,
        clock: Callable[[], int],
    ) -> DeviceLoop:
        """The ticks of one pair; a `hapnet.realtime.controllers.MakeServo`."""
        self._made += 1
        return DeviceLoop(self, self._made, tick, safe, on_error)

    def begin(self, part: _PairLoop) -> str | None:
        """Let a pair take part; returns one line on why real-time scheduling was refused, or None."""
        with self._lock:
            self._running.append(part)
            self._running.sort(key=lambda one: one.number)
            self._change()
            first, self._began = not self._began, True
        if not first:
            return None
        if self._servo is not None:
            return self._servo.start()
        self._stepper.start()
        return None

    def end(self, part: _PairLoop) -> None:
        """Let a pair take part no more, without force; with the last one the thread ends."""
        with self._lock:
            if part in self._running:
                self._running.remove(part)
                self._change()
                part.release()
            last = self._began and not self._running
        if last:
            (self._servo or self._stepper).stop()

    def count_anew(self) -> None:
        """Count the servo's lateness from now on, once: from the start of the first pair."""
        if self._servo is not None and not self._counted:
            self._counted = True
            self._servo.count_anew()

    def stats(self) -> ServoStats:
        """The lateness of the node's servo."""
        assert self._servo is not None, "only a servo has ticks"
        return self._servo.stats()

    def _change(self) -> None:
        worlds = [part.world for part in self._running if part.world is not None]
        self._joint = JointSteps([(world.side, world.wire.session) for world in worlds], self._reservoirs)

    def _tick(self, now_ns: int) -> None:
        self._step(now_ns)

    def _step(self, now_ns: int) -> int:
        with self._lock:
            self._joint.begin(now_ns)
            lengths = [UNPAIRED_STEP_NS]
            for part in list(self._running):
                try:
                    length_ns = part.step(now_ns)
                except BaseException as error:
                    self._running.remove(part)
                    self._change()
                    part.release()
                    part.on_error(error)
                    continue
                if part.world is not None and part.world.side.origin_ns is not None:
                    lengths.append(length_ns)
            self._joint.end(now_ns)
        return lengths[1] if len(lengths) > 1 else lengths[0]

    def _release(self) -> None:
        with self._lock:
            for part in self._running:
                part.release()

    def _fail(self, error: BaseException) -> None:
        for part in self._running:
            part.on_error(error)


class _PairLoop:
    """The part of one pair in a `JointLoop`; they come in the order of their numbers."""

    world: ThreadedWorld | None = None
    """The control of a world's side, once it is made; None: it is a device's."""

    def __init__(self, loop: JointLoop, number: int, step: Step, on_error: Fail) -> None:
        self.loop, self.number, self.step, self.on_error = loop, number, step, on_error

    def stop(self) -> None:
        """Make no more steps."""
        self.loop.end(self)

    def release(self) -> None:
        """Hold no force any more."""


class WorldLoop(_PairLoop):
    """The steps of a world's side; a `hapnet.realtime.servo.StepLoop`."""

    def start(self) -> None:
        """Begin to step."""
        self.loop.begin(self)


class DeviceLoop(_PairLoop):
    """The ticks of a device's side; a `hapnet.realtime.controllers.ServoLoop`."""

    def __init__(
        self, loop: JointLoop, number: int, tick: Callable[[int], None], safe: Callable[[], None], on_error: Fail
    ) -> None:
        def step(now_ns: int) -> int:
            tick(now_ns)
            return 0

        super().__init__(loop, number, step, on_error)
        self._safe: Callable[[], None] | None = safe
        self.unsafe: str | None = None

    def start(self) -> str | None:
        """Begin to tick."""
        return self.loop.begin(self)

    def release(self) -> None:
        safe, self._safe = self._safe, None
        if safe is not None:
            try:
                safe()
            except BaseException as error:
                self.unsafe = f"{type(error).__name__}: {error}"

    def count_anew(self) -> None:
        """See `JointLoop.count_anew`."""
        self.loop.count_anew()

    def stats(self) -> ServoStats:
        """The lateness of the node's servo."""
        return self.loop.stats()
