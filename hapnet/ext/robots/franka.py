"""Franka Research 3, by the maker's own binding `pylibfranka`: torques at 1 kHz through the Franka Control Interface.

The tool's force F becomes joint torques. To these are added torques that hold the axes that the scene does not have:

    tau = J' F + tau_h        tau_h : of the wrist's spring, of dampers, against Coriolis' forces

The robot itself compensates gravity and the motors' friction. `franka_torques.py` has the arithmetic and the account:
the work of the reported torques, less the work of tau_h, is the work of the force that `acted` returns.

Sources: libfranka's headers `robot.h`, `active_torque_control.h`, `robot_state.h`, `rate_limiting.h` (0.21), and the
maker's page of limits (frankarobotics.github.io/docs/robot_specifications.html). Its page is franka.md.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np

from hapnet.checks import Vector
from hapnet.devices.driver import Axes, Driver
from hapnet.errors import DeviceSilent, HapnetError, InvalidParameter
from hapnet.ext.robots.franka_torques import (
    JOINTS,
    LOST_IN_A_ROW,
    PERIOD_S,
    TORQUE_LIMIT,
    ArmState,
    TorqueBalance,
    Torques,
)
from hapnet.installing import install_command

EARLY_S = 0.3e-3
"""The binding holds Python's lock while it waits for a state. So it is called only so long before the next [s]."""

_RAMP_TICKS = 200
_MASS_SHARE = 0.5
"""The smallest mass to declare, as a share of the apparent mass in the lightest direction at the start."""

_RANGES = {
    "force": (0.1, 100.0), "contact": (1.0, 200.0), "reach": (0.01, 0.855), "speed": (0.05, 1.7), "wrist": (0.0, 100.0),
    "elbow": (0.0, 10.0),
}  # fmt: skip
_OURS = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""The robot's x points away from the base, y to the left, z up; hapnet's to the right, away from the user, up."""


class Franka(Driver):
    """``franka:HOST``: an FR3 whose user looks along its base's x axis. Positions count from where the tool begins.

    More than twenty attributes: a driver's declarations, the maker's objects, and the newest state.

    host : of the robot's Control. axes : which of the tool's axes the scene has, as in `Axes`; the others are held.
    force : the largest at the tool [N]. contact : the external force above which the robot's own reflex ends the motion
    [N]. reach : how far the tool may move from its start along each axis [m], and speed : how fast [m/s]; beyond these
    the force stops. wrist : stiffness of the spring that holds the tool's orientation [Nm/rad].
    elbow : damping of the elbow's motion [Nms/rad]. realtime : refuse a kernel without PREEMPT_RT, as the library does.
    recover : clear the errors of the last motion first. clock : monotonic [s].

    Raises InvalidParameter: a value is not allowed. HapnetError: no library, no robot, or one that is not ready.
    """

    about = "Franka Research 3 (pylibfranka, server version 10)"
    tested = "tested with the simulator franka-sim, not on a robot"
    rate_hz: float = 1.0 / PERIOD_S
    blocking = True
    watchdog_s: float | None = LOST_IN_A_ROW * PERIOD_S

    def __init__(
        self,
        dof: int,
        host: str = "",
        axes: str = "",
        force: float = 20.0,
        contact: float = 40.0,
        reach: float = 0.3,
        speed: float = 0.5,
        wrist: float = 20.0,
        elbow: float = 2.0,
        realtime: bool = True,
        recover: bool = False,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.dof = dof
        self._axes = Axes(axes, dof)
        if not host:
            raise InvalidParameter("host", host, "the address of the robot's Control, such as franka:172.16.0.2")
        given = {"force": force, "contact": contact, "reach": reach, "speed": speed, "wrist": wrist, "elbow": elbow}
        for name, value in given.items():
            least, most = _RANGES[name]
            if not least <= value <= most:
                raise InvalidParameter(name, value, f"{least:g} to {most:g}")
        self.force_limit: float = force
        self.workspace: float = reach
        self.greatest_speed: float | None = speed
        self.missed: int = 0
        """The number of states of the robot that this program missed because it was late."""
        self._clock = clock
        self._contact, self._recover = contact, recover
        self._control: Any = None
        self._failed, self._stopped = "", False
        self._due_s = self._counted_s = 0.0
        self._interval_s: float | None = None
        self._acted: Vector | None = None
        if why := self.missing():
            raise HapnetError(f"the robot needs {why}")
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
            self._state = self._robot.read_once()
        except self._errors as error:
            raise HapnetError(f"no robot at {host}: {_line(error)}") from error
        held = [0.0 if any(self._axes.take(tuple(row))) else 1.0 for row in np.eye(3)]
        self._make_torques = partial(Torques, held=_OURS.T @ np.diag(held) @ _OURS, wrist=wrist, elbow=elbow)
        self.arm: ArmState = self._newest_state()
        self._torques = self._make_torques(self.arm)
        self._origin = self.arm.position
        mass = np.array(self._model.mass(self._state)).reshape(JOINTS, JOINTS)
        mobility = self.arm.linear @ np.linalg.solve(mass, self.arm.linear.T)
        self.smallest_mass: float | None = _MASS_SHARE / float(np.linalg.eigvalsh(mobility)[-1])

    @classmethod
    def missing(cls) -> str:
        if find_spec("pylibfranka") is not None:
            return ""
        return f"pylibfranka (Linux, Python 3.11 or 3.12): {install_command('pylibfranka')}"

    def home(self) -> None:
        """Set the thresholds of the robot's reflexes. Nothing moves.

        Raises HapnetError: the robot has an error, or its user stop is pressed; a person must clear that first.
        """
        modes = self._lib.RobotMode
        try:
            if self._recover:
                self._robot.automatic_error_recovery()
                self._state = self._robot.read_once()
            joints = np.minimum(TORQUE_LIMIT, 0.9 * self._contact).tolist()  # 0.9 m: its reach
            self._robot.set_collision_behavior(joints, joints, [self._contact] * 6, [self._contact] * 6)
        except self._errors as error:
            raise HapnetError(_line(error)) from error
        if self._state.robot_mode != modes.Idle or self._state.current_errors:
            mode, errors = self._state.robot_mode.name, str(self._state.current_errors)
            raise HapnetError(f"the robot is in mode {mode} {errors}: make it ready in Desk, or start with recover=yes")

    def begin(self) -> None:
        """Start the torque control, with no torque. The wrist and the axes that the scene lacks are held from here."""
        try:
            with _scheduled_as_before():
                self._control = self._robot.start_torque_control()
        except self._errors as error:
            raise self._fail(error) from error
        self.arm = self.arm._replace(torque=np.zeros(JOINTS))
        self._torques = self._make_torques(self.arm)
        self._due_s = 0.0

    def read(self) -> tuple[Vector, Vector]:
        """Position [m] and velocity [m/s] of the tool in the robot's newest state; waits for it.

        Raises HapnetError: the robot has ended the motion (with its reason), or no state has come for a second.
        """
        if self._failed:
            raise HapnetError(self._failed)
        if (wait_s := self._due_s - self._clock()) > 0.0:
            time.sleep(wait_s)
        since_s = 0.0  # as in the first state of a motion
        try:
            if self._control is None:
                self._state = self._robot.read_once()
            else:
                self._state, since = self._control.readOnce()
                since_s = since.to_sec()
                self.missed += max(0, round(since_s / PERIOD_S) - 1)
        except self._errors as error:
            raise self._fail(error) from error
        now_s = self._clock()
        self._due_s = now_s + PERIOD_S - EARLY_S
        if since_s > 0.0:
            # the clock counts states: a slow simulator makes fewer, so each counts as longer, up to the watchdog's time
            behind_s = now_s - self._counted_s - since_s
            self._interval_s = since_s + min(max(0.0, behind_s), LOST_IN_A_ROW * PERIOD_S)
            self._counted_s += self._interval_s
        else:
            self._interval_s, self._counted_s = None, now_s
        self.arm = self._newest_state()
        self._acted = None if self._control is None else self._taken(self._torques.acted(self.arm))
        x, v = self._taken(self.arm.position - self._origin), self._taken(self.arm.linear @ self.arm.dq)
        return x, v

    def apply(self, force: Vector) -> Vector:
        """Hold this force; returns it after the limits of torques and of their rate.

        Raises DeviceSilent: the robot cannot be reached.
        """
        if self._control is None or self._stopped:
            return (0.0,) * self.dof
        if self._failed:
            raise DeviceSilent(self._failed)
        wanted = _OURS.T @ np.array(self._axes.spread(force))
        coriolis = np.array(self._model.coriolis(self._state))
        torques = self._torques.of(self.arm, wanted, coriolis, np.array(self._model.mass(self._state)))
        try:
            self._control.writeOnce(self._lib.Torques(torques.tolist()))
        except self._errors as error:
            raise self._fail(error) from error
        return self._taken(self._torques.force)

    @property
    def account_J(self) -> TorqueBalance:
        """The net energy that the holding torques took in, and the work not yet assigned to a force."""
        return self._torques.account

    def acted(self) -> Vector | None:
        """The force that did the work of the torques that the robot reports."""
        return self._acted

    def interval(self) -> float | None:
        """The time by the robot's clock, so that delayed states are not mistaken for fast motion."""
        return self._interval_s

    def contact_force(self) -> Vector | None:
        """The robot's own estimate of the external force, filtered; zeros near a singularity, according to its maker.

        `O_F_ext_hat_K` is positive where the robot pushes its surroundings (`robot_state.h`); here they push the robot.
        None: more than `contact` along each axis, where its reflex ends the motion (`robot.h`).
        """
        force = -np.array(self._state.O_F_ext_hat_K[:3])
        return self._taken(force) if np.linalg.norm(force) <= np.sqrt(3.0) * self._contact else None

    def close(self) -> None:
        """Reduce the torques to zero at the permitted rate, and finish the motion; the robot then holds its posture."""
        control, self._control = self._control, None
        if control is None or self._failed:
            return
        with suppress(*self._errors):
            for _ in range(_RAMP_TICKS):
                self._state, _ = control.readOnce()
                torques = self._torques.fading(self._newest_state())
                control.writeOnce(self._lib.Torques(torques.tolist()))
                if not torques.any():
                    break
            last = self._lib.Torques([0.0] * JOINTS)
            last.motion_finished = True
            control.writeOnce(last)

    def _newest_state(self) -> ArmState:
        return ArmState.of(self._state, self._model.zero_jacobian(self._state))

    def _taken(self, theirs: Any) -> Vector:
        return self._axes.take(tuple((_OURS @ theirs).tolist()))

    def _fail(self, error: Exception) -> HapnetError:
        """Raise HapnetError: the robot has ended the motion, or is not connected. Only a person may restart it."""
        self._stopped = isinstance(error, self._lib.ControlException)  # then the robot itself has ended its torques
        what = "the robot has stopped" if self._stopped else "no answer of the robot"
        rate = self._state.control_command_success_rate
        self._failed = (
            f"{what}: {_line(error)} ({self.missed} states missed, last success rate {rate:.2f}); check the robot,"
            " make it ready in Desk, then start again"
        )
        return HapnetError(self._failed)


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
