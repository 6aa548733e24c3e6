"""The Franka Control Interface through the maker's `pylibfranka`: its objects, its newest state and the pace of states.

Sources: libfranka's headers `robot.h`, `active_torque_control.h` and `robot_state.h` (0.21).
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from typing import Any

import numpy as np

from hapnet.errors import HapnetError
from hapnet.ext.robots.franka_torques import JOINTS, LOST_IN_A_ROW, PERIOD_S, TORQUE_LIMIT, ArmState, Array
from hapnet.processes import start

EARLY_S = 0.3e-3
"""The binding holds Python's lock while it waits for a state. So it is called only so long before the next [s]."""

ANSWER_S = 1.5
"""A robot answers a connection within this time [s]."""

_CONNECT = """
import sys, pylibfranka as lib
print(flush=True)
lib.Robot(sys.argv[1], lib.RealtimeConfig.kIgnore)
"""
_RAMP_TICKS = 200


def require_answer(host: str, within_s: float = ANSWER_S) -> None:
    """Raise HapnetError if `host` accepts a connection and does not answer it `within_s` [s].

    The library waits for an answer without a limit, and holds Python's lock, so that even Ctrl-C does not end the
    program. So another process connects first. What else it finds, the library reports at once.
    """
    with start.started([sys.executable, "-c", _CONNECT, host], stdout=start.PIPE, stderr=start.NOTHING) as program:
        assert program.stdout is not None
        program.stdout.readline()  # the library is loaded
        try:
            program.wait(within_s)
        except start.TimeoutExpired:
            program.kill()
            raise HapnetError(
                f"no robot at {host}: its port is open, but nothing answers within {within_s:g} s; check the address,"
                " and that FCI is active in Desk"
            ) from None


class ControlInterface:
    """The robot at `host`. realtime : refuse a kernel without PREEMPT_RT, as the library does.

    Attributes
    ----------
    state : the maker's newest state. missed : the number of states that this program missed because it was late.
    failed : the reason why the motion has ended; empty: it has not. stopped : whether the robot itself ended it.

    Raises HapnetError: the robot does not answer.
    """

    def __init__(self, host: str, *, realtime: bool) -> None:
        self.missed, self.failed, self.stopped = 0, "", False
        self._control: Any = None
        require_answer(host)
        self._lib: Any = import_module("pylibfranka")
        lib = self._lib
        self._errors: tuple[type[Exception], ...] = (
            lib.NetworkException, lib.ControlException, lib.CommandException, lib.RealtimeException,
            lib.InvalidOperationException, lib.FrankaException,
        )  # fmt: skip
        try:
            with _scheduled_as_before():
                self._robot = lib.Robot(host, lib.RealtimeConfig.kEnforce if realtime else lib.RealtimeConfig.kIgnore)
            self._model = self._robot.load_model()
            self.state: Any = self._robot.read_once()
        except self._errors as error:
            raise HapnetError(f"no robot at {host}: {_line(error)}") from error

    @property
    def controlled(self) -> bool:
        """Whether the torque control runs."""
        return self._control is not None

    @property
    def arm(self) -> ArmState:
        """The arm in the newest state."""
        return ArmState.of(self.state, self._model.zero_jacobian(self.state))

    @property
    def coriolis(self) -> Array:
        """The Coriolis torques in the newest state (7,) [Nm]."""
        return np.array(self._model.coriolis(self.state))

    @property
    def mass(self) -> Array:
        """The mass matrix in the newest state (49,), row by row."""
        return np.array(self._model.mass(self.state))

    def make_ready(self, contact: float, *, recover: bool) -> None:
        """Set the external force above which the robot's own reflex ends the motion [N].

        recover : clear the errors of the last motion first.

        Raises HapnetError: the robot has an error, or its user stop is pressed; a person must clear that first.
        """
        try:
            if recover:
                self._robot.automatic_error_recovery()
                self.state = self._robot.read_once()
            joints = np.minimum(TORQUE_LIMIT, 0.9 * contact).tolist()  # 0.9 m: its reach
            self._robot.set_collision_behavior(joints, joints, [contact] * 6, [contact] * 6)
        except self._errors as error:
            raise HapnetError(_line(error)) from error
        if self.state.robot_mode != self._lib.RobotMode.Idle or self.state.current_errors:
            mode, errors = self.state.robot_mode.name, str(self.state.current_errors)
            raise HapnetError(f"the robot is in mode {mode} {errors}: make it ready in Desk, or start with recover=yes")

    def begin(self) -> None:
        """Start the torque control. Raises HapnetError."""
        with self._failing(), _scheduled_as_before():
            self._control = self._robot.start_torque_control()

    def read(self) -> float:
        """Wait for the next state; returns its time since the last one of the motion [s]; 0 for the first, and without
        torque control. Raises HapnetError."""
        with self._failing():
            if self._control is None:
                self.state = self._robot.read_once()
                return 0.0
            self.state, since = self._control.readOnce()
            since_s: float = since.to_sec()
            self.missed += max(0, round(since_s / PERIOD_S) - 1)
        return since_s

    def write(self, torques: Array) -> None:
        """Send the joints' torques (7,) [Nm]. Raises HapnetError."""
        with self._failing():
            self._control.writeOnce(self._lib.Torques(torques.tolist()))

    def end(self, fading: Callable[[ArmState], Array]) -> None:
        """End the torque control, by the torques that `fading` returns for each state until they are zero."""
        control, self._control = self._control, None
        if control is None or self.failed:
            return
        with suppress(*self._errors):
            for _ in range(_RAMP_TICKS):
                self.state, _ = control.readOnce()
                torques = fading(self.arm)
                control.writeOnce(self._lib.Torques(torques.tolist()))
                if not torques.any():
                    break
            last = self._lib.Torques([0.0] * JOINTS)
            last.motion_finished = True
            control.writeOnce(last)

    @contextmanager
    def _failing(self) -> Iterator[None]:
        """Raise HapnetError: the robot has ended the motion, or is not connected. Only a person may restart it."""
        try:
            yield
        except self._errors as error:
            self.stopped = isinstance(error, self._lib.ControlException)  # then the robot itself has ended its torques
            what = "the robot has stopped" if self.stopped else "no answer of the robot"
            rate = self.state.control_command_success_rate
            self.failed = (
                f"{what}: {_line(error)} ({self.missed} states missed, last success rate {rate:.2f}); check the robot,"
                " make it ready in Desk, then start again"
            )
            raise HapnetError(self.failed) from error


class StatePace:
    """The times of the robot's states. clock : monotonic [s].

    Attributes
    ----------
    interval_s : the time between the last two states by the robot's clock; None: there was none.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._due_s = self._counted_s = 0.0
        self.interval_s: float | None = None

    def restart(self) -> None:
        """Do not wait for the next state."""
        self._due_s = 0.0

    def wait(self) -> None:
        """Sleep until shortly before the next state."""
        if (wait_s := self._due_s - self._clock()) > 0.0:
            time.sleep(wait_s)

    def count(self, since_s: float) -> None:
        """Count a state that has arrived, so long after the last one by the robot's clock; 0: it is the first."""
        now_s = self._clock()
        self._due_s = now_s + PERIOD_S - EARLY_S
        if since_s > 0.0:
            # the clock counts states: a slow simulator makes fewer, so each counts as longer, up to the watchdog's time
            behind_s = now_s - self._counted_s - since_s
            self.interval_s = since_s + min(max(0.0, behind_s), LOST_IN_A_ROW * PERIOD_S)
            self._counted_s += self.interval_s
        else:
            self.interval_s, self._counted_s = None, now_s


def _line(error: Exception) -> str:
    return " ".join(str(error).replace("libfranka:", "").split())


@contextmanager
def _scheduled_as_before() -> Iterator[None]:
    """Restore the thread's scheduling: the maker's library always sets the highest real-time priority, if permitted.

    All threads and processes started from here would inherit it. `--realtime` is the option for it.
    """
    if sys.platform != "linux":
        yield
    else:
        policy, priority = os.sched_getscheduler(0), os.sched_getparam(0)
        try:
            yield
        finally:
            os.sched_setscheduler(0, policy, priority)
