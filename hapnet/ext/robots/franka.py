"""Franka Research 3, by the maker's own binding `pylibfranka`: torques at 1 kHz through the Franka Control Interface.

The tool's force F becomes joint torques. To these are added torques that hold the axes that the scene does not have:

    tau = J' F + tau_h        tau_h : of the wrist's spring, of dampers, against Coriolis' forces

The robot itself compensates gravity and the motors' friction. `franka_torques.py` has the arithmetic and the account:
the work of the reported torques, less the work of tau_h, is the work of the force that `acted` returns.
`franka_interface.py` has the maker's objects.

Sources: libfranka's headers `robot.h`, `robot_state.h`, `rate_limiting.h` (0.21), and the maker's page of limits
(frankarobotics.github.io/docs/robot_specifications.html). Its page is franka.md.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from typing import Any

import numpy as np

from hapnet.checks import Vector
from hapnet.devices.driver import Axes, Driver
from hapnet.errors import DeviceSilent, HapnetError, InvalidParameter
from hapnet.ext.robots.franka_interface import ControlInterface, StatePace
from hapnet.ext.robots.franka_torques import JOINTS, LOST_IN_A_ROW, PERIOD_S, ArmState, Array, TorqueBalance, Torques
from hapnet.installing import install_command
from hapnet.mechanics.pose import quaternion

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

    host : of the robot's Control. axes : which of the tool's axes the scene has, as in `Axes`; the others are held.
    force : the largest at the tool [N]. contact : the external force above which the robot's own reflex ends the motion
    [N]. reach : how far the tool may move from its start along each axis [m], and speed : how fast [m/s]; beyond these
    the force stops. wrist : stiffness of the spring that holds the tool's orientation in a scene
    without a tool [Nm/rad]; the wrist's damper is 0.08 s of it in every scene.
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
        self._contact, self._recover = contact, recover
        self._acted: Array | None = None
        if why := self.missing():
            raise HapnetError(f"the robot needs {why}")
        self._pace = StatePace(clock)
        self._robot = ControlInterface(host, realtime=realtime)
        held = [0.0 if any(self._axes.take(tuple(row))) else 1.0 for row in np.eye(3)]
        self._make_torques = partial(Torques, held=_OURS.T @ np.diag(held) @ _OURS, wrist=wrist, elbow=elbow)
        self.arm: ArmState = self._robot.arm
        self._torques = self._make_torques(self.arm)
        self._origin = self.arm.position
        self._turned_at_start = self.arm.rotation
        mass = self._robot.mass.reshape(JOINTS, JOINTS)
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
        self._robot.make_ready(self._contact, recover=self._recover)

    def begin(self) -> None:
        """Start the torque control, with no torque. The wrist and the axes that the scene lacks are held from here."""
        self._robot.begin()
        self.arm = self.arm._replace(torque=np.zeros(JOINTS))
        self._torques = self._make_torques(self.arm)
        self._pace.restart()

    def read(self) -> tuple[Vector, Vector]:
        """Position [m] and velocity [m/s] of the tool in the robot's newest state; waits for it.

        Raises HapnetError: the robot has ended the motion (with its reason), or no state has come for a second.
        """
        robot = self._robot
        if robot.failed:
            raise HapnetError(robot.failed)
        self._pace.wait()
        since_s = robot.read()
        self.missed = robot.missed
        self._pace.count(since_s)
        self.arm = robot.arm
        self._acted = self._torques.acted(self.arm) if robot.controlled else None
        x, v = self._taken(self.arm.position - self._origin), self._taken(self.arm.linear @ self.arm.dq)
        return x, v

    def apply(self, force: Vector) -> Vector:
        """Hold this force; returns it after the limits of torques and of their rate.

        Raises DeviceSilent: the robot cannot be reached.
        """
        self._hold(force, None)
        return self._taken(self._torques.wrench[:3]) if self._is_driven else (0.0,) * self.dof

    def apply_wrench(self, force: Vector, torque: Vector) -> tuple[Vector, Vector]:
        """Hold this force [N] and this torque [Nm], of a scene with a tool; returns them after all limits.

        Raises DeviceSilent: the robot cannot be reached.
        """
        self._hold(force, _OURS.T @ np.array(torque))
        if not self._is_driven:
            return (0.0,) * self.dof, (0.0,) * 3
        return self._both(self._torques.wrench)

    @property
    def _is_driven(self) -> bool:
        return self._robot.controlled and not self._robot.stopped

    def _hold(self, force: Vector, torque: Any) -> None:
        robot = self._robot
        if not self._is_driven:
            return
        if robot.failed:
            raise DeviceSilent(robot.failed)
        wanted = _OURS.T @ np.array(self._axes.spread(force))
        robot.write(self._torques.of(self.arm, wanted, robot.coriolis, robot.mass, torque))

    @property
    def account_J(self) -> TorqueBalance:
        """The net energy that the holding torques took in, and the work not yet assigned to a force."""
        return self._torques.account

    def acted(self) -> Vector | None:
        """The force that did the work of the torques that the robot reports."""
        return None if self._acted is None else self._taken(self._acted[:3])

    def acted_wrench(self) -> tuple[Vector, Vector] | None:
        """The force [N] and the torque [Nm] that did the work of the torques that the robot reports."""
        return None if self._acted is None else self._both(self._acted)

    def orientation(self) -> Vector:
        """How far the tool has turned since its start, a unit quaternion w, x, y, z."""
        turned = _OURS @ self.arm.rotation @ self._turned_at_start.T @ _OURS.T
        return quaternion(turned.tolist())

    def interval(self) -> float | None:
        """The time by the robot's clock, so that delayed states are not mistaken for fast motion."""
        return self._pace.interval_s

    def contact_force(self) -> Vector | None:
        """The robot's own estimate of the external force, filtered; zeros near a singularity, according to its maker.

        `O_F_ext_hat_K` is positive where the robot pushes its surroundings (`robot_state.h`); here they push the robot.
        None: more than `contact` along each axis, where its reflex ends the motion (`robot.h`).
        """
        force = -np.array(self._robot.state.O_F_ext_hat_K[:3])
        return self._taken(force) if np.linalg.norm(force) <= np.sqrt(3.0) * self._contact else None

    def close(self) -> None:
        """Reduce the torques to zero at the permitted rate, and finish the motion; the robot then holds its posture."""
        self._robot.end(self._torques.fading)

    def _both(self, wrench: Any) -> tuple[Vector, Vector]:
        return self._taken(wrench[:3]), tuple((_OURS @ wrench[3:]).tolist())

    def _taken(self, theirs: Any) -> Vector:
        return self._axes.take(tuple((_OURS @ theirs).tolist()))
