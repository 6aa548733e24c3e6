"""A servo's process: the device, its control half and nothing else. Started by servo_process.py.

No network, recording or display runs here, so nothing holds the interpreter's lock when a tick is due. If the parent
goes away, in whatever way, the next tick sees its end of the pipe closed and renders no force any more.
"""

from __future__ import annotations

import signal
import socket
import sys
import time
from collections.abc import Callable
from typing import Any

from hapnet.endpoint import DeviceControl
from hapnet.errors import HapnetError
from hapnet.params import Params
from hapnet.record import DeviceSample, Sample
from hapnet.runtime.build import device_side, prepare
from hapnet.runtime.control import servo_timing
from hapnet.runtime.servo import Servo, tuned_interpreter
from hapnet.runtime.servo_pipe import Pipe, PipeClosed
from hapnet.runtime.summary import device_summary
from hapnet.wire.session import PositionStream

_COLLECT_EVERY_S = 1.0


class ServoChild:
    """The side's control half and its end of the pipe; all but the constructor and `summary` on the servo's thread."""

    def __init__(self, pipe: Pipe, setup: dict[str, Any]) -> None:
        params = Params().set(setup["params"])
        self._pipe = pipe
        self._coupling = params.coupling
        self._control = DeviceControl(PositionStream(setup["incarnation"]))
        self.side = device_side(prepare(params, "sampled"), self._control, time.monotonic_ns, self._write)
        self.servo = Servo(
            round(1e9 / params.device.servo_hz),
            self._tick,
            safe=self.side.stop,
            on_error=self._fail,
            realtime=setup["realtime"],
        )
        self.collect: Callable[[], int] = lambda: 0
        self._collect_every = round(_COLLECT_EVERY_S * params.device.servo_hz)
        self._recording: bool = setup["recording"]
        self._unsent = 0.0  # surplus that found the pipe full
        self.unrecorded = 0
        self._began = False

    def summary(self) -> dict[str, Any]:
        """This side's part of the summary, as control knows it."""
        return device_summary(self.side, self._coupling, servo_timing(self.servo, self.side))

    def _tick(self, now_ns: int) -> None:
        self._take()
        side = self.side
        message = side.tick(now_ns)
        if message is not None:
            surplus = self._unsent + self._control.surplus()
            self._unsent = 0.0 if self._pipe.offer("position", surplus, message) else surplus
        if not self._began and side.origin_ns is not None:
            self._began = self._pipe.offer("began", side.origin_ns)
        if side.ticks % self._collect_every == 0:
            self.collect()  # between two ticks, where there is most time for it

    def _take(self) -> None:
        """Hand over what has come from the wire half."""
        control = self._control
        try:
            while (frame := self._pipe.look()) is not None:
                match frame:
                    case ("arrive", y, sent_s):
                        control.arrive(y, sent_s)
                    case ("credit", credited_nJ):
                        control.credit(credited_nJ)
                    case ("pair", restarted):
                        control.pair(restarted)
                    case _:  # stop
                        self.servo.stop()
        except PipeClosed:
            self.servo.stop()

    def _write(self, sample: Sample) -> None:
        if isinstance(sample, DeviceSample):
            if self._recording and not self._pipe.offer("sample", sample):
                self.unrecorded += 1
        else:
            self._pipe.offer("note", sample)

    def _fail(self, error: BaseException) -> None:
        known = isinstance(error, HapnetError)
        self._pipe.offer("failed", str(error) if known else f"{type(error).__name__}: {error}")


def main(descriptor: int) -> int:
    """Run the servo whose parent is at the other end of `descriptor`, until it says so or is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal tells the whole group; the parent decides
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    pipe = Pipe(socket.socket(fileno=descriptor))
    try:
        frame = pipe.wait()
    except PipeClosed:
        return 0
    assert frame is not None
    setup: dict[str, Any] = frame[1]
    sys.path[:] = setup["path"]
    try:
        child = ServoChild(pipe, setup)
    except HapnetError as error:
        pipe.offer("refused", str(error))
        return 2
    signal.signal(signal.SIGTERM, lambda number, stack: child.servo.stop())
    with tuned_interpreter() as collect:
        child.collect = collect
        pipe.offer("ready", child.servo.start())
        child.servo.join()
    pipe.offer("end", child.summary(), child.unrecorded)
    return 0


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1])))
