"""A servo in a process of its own: the part in the process that owns the wire half.

In one interpreter with a network, a recording and an event loop, a servo's thread waits while their threads run. In a
process of its own, under SCHED_FIFO, it does not wait: `--realtime` starts one. The price is that every message passes
one more socket. `control_of` chooses between the two.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np

from hapnet.assembly.build import Setup, device_session, world_session
from hapnet.checks import Vector
from hapnet.control.coupling import CouplingSample
from hapnet.errors import HapnetError, InvalidParameter
from hapnet.loading import LENT, extension
from hapnet.param_sources import RULE
from hapnet.processes.start import (
    LOOK_S,
    LOOKS,
    NOT_ON,
    NOTHING,
    Program,
    TimeoutExpired,
    end,
    how_it_ended,
    standing_still,
    stands_still,
    started,
)
from hapnet.realtime import servo_pipe
from hapnet.realtime.controllers import Control, ControlCallbacks, MakeServo, ThreadedDevice, ThreadedWorld
from hapnet.realtime.servo import MakeStepLoop, Servo, Stepper
from hapnet.realtime.servo_pipe import Pipe, PipeClosed, kind_of, socket_pair
from hapnet.recording.samples import DeviceSample, Event, PostureSample
from hapnet.side.endpoint import WireHalf
from hapnet.summary.run import SidePart, unknown_device
from hapnet.wire.fields import Signal
from hapnet.wire.messages import Role
from hapnet.wire.secret import Secret
from hapnet.wire.session import Session

START_LIMIT_S = 30.0
STOP_LIMIT_S = 5.0
NOT_STARTED = "the servo's process did not start"


class ServoProcess:
    """Starts the servo's process. The wire half uses it like a control half in this process.

    setup, session, callbacks : this side's.

    Raises InvalidParameter: a user's part is defined in the script itself, where another process cannot import it.
    """

    def __init__(self, setup: Setup, session: Session, callbacks: ControlCallbacks) -> None:
        for name in ("hardware", "operator", "scene"):
            if setup.params.get(name).startswith(("__main__:", LENT)):
                allowed = "a class in a module of its own: with --realtime another process imports it"
                raise InvalidParameter(name, setup.params.get(name), allowed)
        self.wire: WireHalf = WireHalf(session, self)
        self.origin_ns: int | None = None
        self.unrecorded: Any = 0
        self._setup, self._callbacks = setup, callbacks
        self._shuffled: deque[float] = deque()
        self._reported: deque[tuple[str, Signal]] = deque()
        self._owed: deque[tuple[Any, ...]] = deque()  # frames that must arrive, while the pipe is full or not open yet
        self._open_for_all = False  # not before the setup, which must be the first frame
        self._sending = threading.Lock()
        self._life = threading.Lock()  # held while the process is started and while it is ended
        self._process: Program | None = None
        self._stopping = self._has_part = False
        self._part: SidePart = unknown_device()
        self._reader = threading.Thread(target=self._read, name="servo-pipe", daemon=True)

    # -- the control half, as the wire half sees it -------------------------------------------------------------------

    def pair(self, restarted: bool, leads_robot: bool = False) -> None:
        self._deliver("pair", restarted, leads_robot)

    def on_sample(self, sample: CouplingSample, sent_ns: int, came_ns: int, took_ns: int) -> None:
        self._send_owed()
        if not self._owed:  # a waiting frame of a new peer must arrive before that peer's data
            self._pipe.offer("arrive", kind_of(sample), sample, sent_ns, came_ns, took_ns)

    def echo(self, sent_ns: int, came_ns: int) -> None:
        if not self._owed:
            self._pipe.offer("echo", sent_ns, came_ns)

    def on_signal(self, name: str, value: Signal) -> None:
        self._deliver("signal", name, value)

    def reported(self) -> tuple[str, Signal] | None:
        return self._reported.popleft() if self._reported else None

    @property
    def has_reported(self) -> bool:
        return bool(self._reported)

    def credit(self, credited_nJ: int) -> None:
        self._deliver("credit", credited_nJ)

    def shuffled(self) -> float:
        return self._shuffled.popleft() if self._shuffled else 0.0

    @property
    def has_shuffled(self) -> bool:
        return bool(self._shuffled)

    def _deliver(self, *frame: Any) -> None:
        self._owed.append(frame)
        self._send_owed()

    def _send_owed(self) -> None:
        with self._sending:  # otherwise two threads could send the same frame twice
            while self._open_for_all and self._owed and self._pipe.offer(*self._owed[0]):
                self._owed.popleft()

    # -- the process ---------------------------------------------------------------------------------------------------

    def start(self) -> str | None:
        """Start the process and wait until its servo runs; call it once. After `stop` it has no effect.

        Raises HapnetError: the device cannot be made, or the process does not start.
        """
        with self._life:
            if self._stopping:
                return None
            self._open()
            try:
                while (frame := self._pipe.wait(START_LIMIT_S)) is not None and frame[0] not in ("ready", "refused"):
                    self._pass_on(frame)  # the device warns while it is made; the servo may be ahead of `ready`
            except PipeClosed:
                frame = None
            if frame is None or frame[0] != "ready":
                assert self._process is not None
                still = stands_still(self._process.pid)
                how = self._end_process()
                raise HapnetError(frame[1] if frame is not None else f"{NOT_STARTED}: it {NOT_ON if still else how}")
            self._reader.start()
        refusal: str | None = frame[1]
        return refusal

    def stop(self) -> None:
        self._stopping = True
        with self._life:
            if self._process is None:
                return
            self._pipe.hang_up()
            if sys.platform != "win32":
                self._process.send_signal(signal.SIGCONT)  # continue a stopped process, so that it can end in order
            if self._reader.ident is not None:
                self._reader.join(STOP_LIMIT_S)
            how = self._end_process()
            self._process = None
            if self._reader.ident is not None and not self._has_part:  # its account is missing
                self._callbacks.fail(HapnetError(f"the servo's process {how}"))

    def pause(self, paused: bool) -> None:
        self._deliver("pause", paused)

    def let_go(self, why: str) -> None:
        self._deliver("let go", why)

    def lead(self, position: Vector) -> None:
        self._deliver("lead", position)

    def place(self, position: Vector) -> None:
        self._deliver("place", position)

    def beat(self) -> None:
        if self._open_for_all:
            self._pipe.offer("beat")

    def part(self) -> SidePart:
        return self._part

    def _open(self) -> None:
        params = self._setup.params.set({"device.servo": self._setup.servo}, RULE)
        ours, theirs = socket_pair()
        self._pipe = Pipe(ours)
        path = os.pathsep.join(str(entry) or os.getcwd() for entry in sys.path)
        with theirs:
            try:
                self._process = started(
                    [sys.executable, "-P", "-m", "hapnet.realtime.servo_child", str(theirs.fileno())],
                    keeps=(theirs.fileno(),),
                    own_group=True,  # a Ctrl-C is for the parent, which ends the servo in order
                    stdin=NOTHING,
                    stdout=2,  # what a driver prints must not mix with the output of --json
                    environment={"PYTHONPATH": path},
                )
            except OSError as error:
                self._pipe.close()
                raise HapnetError(f"{NOT_STARTED}: {error.strerror or error}") from error
        setup = {"params": params.changes(), "sources": dict(params.sources)}
        incarnation = self.wire.session.identity.incarnation
        self._pipe.offer("setup", {**setup, "incarnation": incarnation, "parent": os.getpid()})
        self._open_for_all = True
        self._send_owed()

    def _end_process(self) -> str:
        """End the process if it has not ended yet; returns in words how it ended."""
        process = self._process
        assert process is not None
        self._pipe.hang_up()
        how = end(process, STOP_LIMIT_S)
        self._pipe.close()
        return how

    def _read(self) -> None:
        """Pass on the servo's frames until its process ends; check the process while none come."""
        assert self._process is not None
        looks = 0
        try:
            while True:
                frame = self._pipe.wait(LOOK_S)
                if frame is None:
                    looks = looks + 1 if stands_still(self._process.pid) else 0
                    self._report_stopped(self._process.pid, looks)
                    continue
                looks = 0
                try:
                    self._pass_on(frame)
                except Exception as error:
                    self._callbacks.fail(error)
                if frame[0] == "end":
                    break
        except PipeClosed:
            pass
        if not self._stopping:
            with suppress(TimeoutExpired):
                self._process.wait(STOP_LIMIT_S)
            how = how_it_ended(self._process.returncode)
            self._callbacks.fail(HapnetError(f"the servo's process {how}"))

    def _report_stopped(self, pid: int, looks: int) -> None:
        """Report a stopped servo at the first look; fail at the last one."""
        if looks == 1:
            text = f"the servo's process {standing_still(pid)}"
            self._callbacks.write(Event(time.monotonic_ns(), "stopped", text, "warning"))
        elif looks == LOOKS:
            self._callbacks.fail(HapnetError(f"the servo's process {NOT_ON}"))

    def _pass_on(self, frame: Any) -> None:
        callbacks = self._callbacks
        match frame:
            case ("position", surplus, message):
                if surplus > 0.0:
                    self._shuffled.append(surplus)
                if message is None:
                    callbacks.wake()
                else:
                    callbacks.send(message)
            case ("samples", samples):
                for sample in samples:
                    callbacks.write(DeviceSample(*sample))
            case ("signal", name, value):
                self._reported.append((name, value))
                callbacks.wake()
            case ("posture", sample):
                callbacks.write(PostureSample(*sample))
            case ("note", note):
                callbacks.write(Event(*note))
            case ("began", origin_ns):
                self.origin_ns = origin_ns
            case ("failed", text):
                callbacks.fail(HapnetError(text))
            case ("end", part, unrecorded, surplus):
                self._part, self.unrecorded, self._has_part = part, unrecorded, True
                if surplus > 0.0:
                    self._shuffled.append(surplus)


def control_of(
    setup: Setup,
    role: Role,
    incarnation: int,
    secret: Secret,
    callbacks: ControlCallbacks,
    clock: Callable[[], int],
    steps: np.random.SeedSequence,
    *,
    realtime: bool,
    make_steps: MakeStepLoop = Stepper,
    make_servo: MakeServo = Servo,
) -> Control:
    """The side's control, not started yet. `steps` seeds the random lengths of a world's steps; `make_steps` makes its
    loop. `make_servo` makes a device's servo; another one than `Servo` runs in this process.
    """
    if role == "world":
        session = world_session(setup, incarnation, secret=secret)
        if setup.follower.is_driven(setup.params):
            return ThreadedDevice(setup, session, callbacks, clock, realtime=realtime, follows=True)
        return ThreadedWorld(setup, session, callbacks, clock, rng=np.random.default_rng(steps), steps=make_steps)
    session = device_session(setup, incarnation, secret=secret)
    if realtime and make_servo is Servo and servo_pipe.available():
        for part in extension("compiled names").missing(setup.params):
            extension("compiled ends").make_ready(part)  # the servo's process only loads it
        return ServoProcess(setup, session, callbacks)
    return ThreadedDevice(setup, session, callbacks, clock, realtime=realtime, make_servo=make_servo)
