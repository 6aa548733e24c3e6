"""A stand-in of `pylibfranka` for the driver's own tests: what its classes return and raise, and no more.

After libfranka 0.21 (`include/franka/robot_state.h`, `active_control_base.h`, `src/active_control.cpp`,
`src/robot_impl.cpp`, `pylibfranka/src/pylibfranka.cpp`): arrays with their columns one after the other; a state reports
the torque that was received before it, and an external wrench that is positive where the robot pushes; a command for a
state that is not the newest is lost; `ControlException` when the robot has left its mode Move, for good;
`NetworkException` when no state comes. Kinematics are the maker's table of Denavit-Hartenberg parameters
(frankarobotics.github.io/docs/robot_specifications.html); each joint is a mass by itself.
"""

from __future__ import annotations

import enum
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np

START = np.array([0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785])
INERTIA = np.array([1.2, 1.5, 0.9, 0.9, 0.3, 0.3, 0.2])
_A = (0.0, 0.0, 0.0, 0.0825, -0.0825, 0.0, 0.088, 0.0)
_D = (0.333, 0.0, 0.316, 0.0, 0.384, 0.0, 0.0, 0.107)
_ALPHA = (0.0, -np.pi / 2, np.pi / 2, np.pi / 2, -np.pi / 2, np.pi / 2, np.pi / 2, 0.0)


class RobotMode(enum.Enum):
    Idle = 1
    Move = 2
    Reflex = 4
    UserStopped = 5


class RealtimeConfig(enum.Enum):
    kEnforce = 0
    kIgnore = 1


class FrankaException(Exception): ...


class NetworkException(RuntimeError): ...


class ControlException(RuntimeError): ...


class CommandException(RuntimeError): ...


class RealtimeException(RuntimeError): ...


class InvalidOperationException(RuntimeError): ...


class Torques:
    def __init__(self, tau_J: list[float]) -> None:
        assert len(tau_J) == 7
        assert np.all(np.isfinite(tau_J))
        self.tau_J, self.motion_finished = tau_J, False


def chain(q: Any) -> tuple[Any, Any]:
    """The flange's pose (4, 4) and its Jacobian (6, 7), by the geometry of each joint's axis."""
    pose, axes = np.eye(4), []
    for k in range(8):
        angle = q[k] if k < 7 else 0.0
        ca, sa, ct, st = np.cos(_ALPHA[k]), np.sin(_ALPHA[k]), np.cos(angle), np.sin(angle)
        pose = pose @ np.array([
            [ct, -st, 0.0, _A[k]], [st * ca, ct * ca, -sa, -_D[k] * sa], [st * sa, ct * sa, ca, _D[k] * ca],
            [0.0, 0.0, 0.0, 1.0],
        ])  # fmt: skip
        axes.append((pose[:3, 2], pose[:3, 3]))
    columns = [np.concatenate((np.cross(axis, pose[:3, 3] - at), axis)) for axis, at in axes[:7]]
    return pose, np.column_stack(columns)


class Robot:
    """Also the one that its control and its model are of. before_state : called before each state, to disturb it."""

    made: Robot

    def __init__(self, address: str, config: RealtimeConfig) -> None:
        if address == "nowhere":
            raise NetworkException("libfranka: Connection timeout. Please check your network connection or settings.")
        Robot.made = self
        self.config = config
        self.q, self.dq, self.torque, self.time = START.copy(), np.zeros(7), np.zeros(7), 0
        self.mode, self.errors, self.recovered, self.finished = RobotMode.Idle, "", 0, False
        self.thresholds: tuple[Any, ...] = ()
        self.pushed = np.zeros(6)
        self.sent: list[Any] = []
        self.reported: list[Any] = []
        self.before_state: Callable[[Robot], None] = lambda robot: None
        self.lost = 0
        self._read: int | None = None

    def load_model(self) -> Robot:
        return self

    def zero_jacobian(self, state: Any) -> list[float]:
        return list(chain(state.q)[1].T.ravel())

    def mass(self, state: Any) -> list[float]:
        return list(np.diag(INERTIA).ravel())

    def coriolis(self, state: Any) -> list[float]:
        return [0.0] * 7

    def set_collision_behavior(self, *thresholds: Any) -> None:
        self.thresholds = thresholds

    def automatic_error_recovery(self) -> None:
        self.recovered, self.mode, self.errors = self.recovered + 1, RobotMode.Idle, ""

    def start_torque_control(self) -> Robot:
        self.mode = RobotMode.Move
        return self

    def read_once(self) -> Any:
        self.before_state(self)
        for _ in range(1 + self.lost):
            self.time += 1
            self.dq = self.dq + 1e-3 * self.torque / INERTIA
            self.q = self.q + 1e-3 * self.dq
        self.reported.append(self.torque)
        return SimpleNamespace(
            q=list(self.q), dq=list(self.dq), tau_J_d=list(self.torque), O_T_EE=list(chain(self.q)[0].T.ravel()),
            O_F_ext_hat_K=list(self.pushed), robot_mode=self.mode, current_errors=self.errors,
            control_command_success_rate=0.98,
        )  # fmt: skip

    def readOnce(self) -> tuple[Any, Any]:
        state = self.read_once()
        if self.mode != RobotMode.Move:
            said = f'libfranka: Move command aborted: motion aborted by reflex! ["{self.errors}"]\n'
            raise ControlException(f"{said}control_command_success_rate: 0.98")
        since, self._read = 1e-3 * (self.time - (self._read or self.time)), self.time
        return state, SimpleNamespace(to_sec=lambda: since)

    def writeOnce(self, torques: Torques) -> None:
        if torques.motion_finished:
            self.finished = True
        self.sent.append(np.array(torques.tau_J))
        if not self.lost:
            self.torque = np.array(torques.tau_J)
