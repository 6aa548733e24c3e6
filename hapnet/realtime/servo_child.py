"""A servo's process, with only the device and its control half. Started by servo_process.py.

No network, recording or display runs here, so nothing holds the interpreter's lock when a tick is due. If the parent
has ended, for any reason, the next tick detects it, and the servo stops rendering force. While the parent is stopped
or hangs the servo renders none either (parent_watch.py).
"""

from __future__ import annotations

import os
import signal
import socket
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from hapnet.assembly.build import compiled_ends, device_side, prepare
from hapnet.assembly.device_class import is_blocking
from hapnet.assembly.own_parts import named_failure
from hapnet.errors import HapnetError
from hapnet.params import Params
from hapnet.processes.system import ThreadTime
from hapnet.realtime.controllers import servo_timing, unsafe
from hapnet.realtime.parent_watch import ParentWatch
from hapnet.realtime.servo import Servo, tuned_interpreter
from hapnet.realtime.servo_pipe import Pipe, PipeClosed, sample_of
from hapnet.recording.samples import DeviceSample, PostureSample, Sample
from hapnet.side.device import DeviceSide
from hapnet.side.endpoint import DeviceControl, backlog
from hapnet.side.real_device import RealDeviceSide
from hapnet.summary.run import device_summary
from hapnet.wire.session import PositionStream

FINAL_SEND_S = 2.0
"""The longest time for which the last frames wait for a parent that does not read [s]."""

_COLLECT_EVERY_S = 1.0
_MOST_SAMPLES = 20  # a frame


class ServoChild:
    """The side's control half and its end of the pipe. All but the constructor and `end` run on the servo's thread."""

    def __init__(self, pipe: Pipe, setup: dict[str, Any]) -> None:
        params = Params().set(setup["params"], setup["sources"])
        self._pipe = pipe
        self._params, self._coupling = params, params.coupling
        prepared = replace(prepare(params, "sampled"), ends=compiled_ends())
        waiting = backlog(prepared.coupling.sends("world", params))
        self._control = DeviceControl(PositionStream(setup["incarnation"]), waiting)
        self.side: DeviceSide = device_side(prepared, self._control, time.monotonic_ns, self._write)
        if isinstance(self.side, RealDeviceSide):
            self.side.waited = ThreadTime()
        self.servo: Servo = Servo(
            round(1e9 / prepared.params.device.servo_hz),
            self._tick,
            safe=self.side.stop,
            on_error=self._fail,
            paced=not is_blocking(params.hardware),
            realtime=True,
        )
        self.collect: Callable[[], int] = lambda: 0
        self._collect_every = round(_COLLECT_EVERY_S * prepared.params.device.servo_hz)
        self._parent: int = setup["parent"]
        self._watch = ParentWatch(self._parent)
        self._samples: list[DeviceSample] = []
        self._a_frame = max(1, min(_MOST_SAMPLES, round(params.record_hz / (params.telemetry_hz or 1.0))))
        self._unrecorded = 0
        self._unsent = 0
        self._shuffled = 0.0  # energy that did not fit into the full pipe; it is sent with the next message
        self._began = False

    def end(self) -> None:
        """Send the last frames, after the servo has ended."""
        self._watch.close()
        self._flush_samples()
        if self.servo.unsafe is not None:
            self._pipe.send(FINAL_SEND_S, "note", tuple(unsafe(time.monotonic_ns(), self.servo)))
        part = device_summary(self.side, self._coupling, servo_timing(self.servo, self.side))
        part["servo"]["unsent"] = self._unsent
        self._pipe.send(FINAL_SEND_S, "end", part, self._unrecorded, self._shuffled + self._control.shuffled())

    def _tick(self, now_ns: int) -> None:
        self._take()
        side = self.side
        side.withhold(now_ns, self._watch.look(now_ns))
        message = side.tick(now_ns)
        if message is not None or self._control.has_shuffled:
            surplus = self._shuffled + self._control.shuffled()
            # a parent that was stopped would later send all at once, long out of date: the room is for samples
            if not side.withheld and self._pipe.offer("position", surplus, message):
                self._shuffled = 0.0
            else:
                self._shuffled = surplus
                self._unsent += message is not None
        while (signal := self._control.reported()) is not None:
            self._pipe.offer("signal", *signal)
        if not self._began and side.origin_ns is not None:
            self._began = self._pipe.offer("began", side.origin_ns)
            self.servo.count_anew()
        if side.ticks % self._collect_every == 0:
            self.collect()  # right after a tick, when most time is left

    def _take(self) -> None:
        """Pass frames from the parent's wire half to the control half."""
        control = self._control
        if os.getppid() != self._parent:  # a copy of the parent, made by a fork, may hold the pipe open
            self.servo.stop()
        try:
            while (frame := self._pipe.look()) is not None:
                match frame:
                    case ("arrive", kind, values, sent_ns, came_ns, took_ns):
                        control.on_sample(sample_of(kind, values), sent_ns, came_ns, took_ns)
                    case ("echo", sent_ns, came_ns):
                        control.echo(sent_ns, came_ns)
                    case ("signal", name, value):
                        control.on_signal(name, value)
                    case ("credit", credited_nJ):
                        control.credit(credited_nJ)
                    case ("beat",):
                        self._watch.beat()
                    case ("pair", restarted, leads_robot):
                        control.pair(restarted, leads_robot)
                    case ("pause", paused):
                        self.side.paused = paused
                    case ("let go", why):
                        self.side.let_go = why
                    case ("place", position):
                        self.side.place(position)
                    case ("lead", position) if self.side.live_hand is not None:
                        self.side.live_hand.lead(position)
        except PipeClosed:
            self.servo.stop()

    def _write(self, sample: Sample) -> None:
        if not isinstance(sample, DeviceSample):
            self._pipe.offer("posture" if isinstance(sample, PostureSample) else "note", sample)
        else:
            self._samples.append(sample)
            if len(self._samples) >= self._a_frame:
                self._flush_samples()

    def _flush_samples(self) -> None:
        if self._samples and not self._pipe.offer("samples", self._samples):
            self._unrecorded += len(self._samples)
        self._samples = []

    def _fail(self, error: BaseException) -> None:
        error = named_failure(self._params, error)
        known = isinstance(error, HapnetError)
        self._pipe.send(FINAL_SEND_S, "failed", str(error) if known else f"{type(error).__name__}: {error}")


def main(descriptor: int) -> int:
    """Run the servo until the parent, at the other end of `descriptor`, hangs up or ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent handles it
    if sys.platform != "win32":
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
    pipe = Pipe(socket.socket(fileno=descriptor))
    try:
        frame = pipe.wait()
    except PipeClosed:
        return 0
    assert frame is not None
    assert frame[0] == "setup", frame[0]
    try:
        child = ServoChild(pipe, frame[1])
    except HapnetError as error:
        pipe.offer("refused", str(error))
        return 2
    asked: list[int] = []

    def on_signal(number: int, stack: object) -> None:
        asked.append(number)
        child.servo.stop()

    signal.signal(signal.SIGTERM, on_signal)
    with tuned_interpreter() as collect:
        child.collect = collect
        pipe.offer("ready", child.servo.start())
        child.servo.join()
    child.end()
    return 128 + asked[0] if asked else 0


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1])))
