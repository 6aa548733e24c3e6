"""The joint torques of an FR3 for a force at its tool, and the work that they do. No I/O, no clock.

    tau   = J' F + W' T + tau_h                J : of the tool's position, 3 x 7; W : of its rotation
    tau_h = J' (k (x0 - x) - b v)_held + W' (K_w e - B_w w) + (k_e n' (q0 - q) - d a) M n / (n' M n) + c

* along axes that the scene does not have, the tool is held where it began (_held);
* in a scene with a tool the torque T is the scene's, and K_w is 0; in others T is 0, and the wrist's spring holds the
  tool; its damper B_w acts in both;
* the wrist's spring has the potential K_w (1 - cos angle), with e = 1/2 sum of r_i x r_i0 over the columns r_i of the
  tool's rotation; w = W dq;
* the elbow is damped, and pulled back to where it began: n, of length 1, spans the null space of J and W, and
  a = n' M dq / n' M n is the speed along it. Torques along M n do not accelerate the tool; the damper puts in -d a^2;
* c compensates Coriolis' and centrifugal torques.

The account. Between two readings the joints move by dq and the tool by dx. The robot reports the acting torque as
tau_J_d; of the reports before and after the motion, the one that gave out more energy counts. Its work is that of the
wrench that `acted` returns plus that of tau_h. Dampers and springs with a potential give out no more than they took in;
c and the elbow's spring may. So tau_h has its own account: near -`LENT_J` springs and c are left out, and a deficit is
charged to the force. If the tool moves too little to assign all the work to a force, the rest is owed and counted in
the next readings.
"""

from __future__ import annotations

from collections import deque
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapnet.ext.robots.joint_torques import paid, share
from hapnet.mechanics.pose import ARM_M, turned

Array = NDArray[np.float64]

JOINTS = 7
PERIOD_S = 1e-3
TORQUE_LIMIT: Array = np.array([87.0] * 4 + [12.0] * 3)
"""The torque limit of each joint [Nm]."""

LOST_IN_A_ROW = 20
"""The number of cycles without a command after which the robot stops."""

RATE = 990.0
"""Its torques change by at most 1000 Nm/s; states are floats of 32 bits, so a hundredth less."""

LENT_J = 0.01
"""The energy that the holding torques may give out before they took it in [J]."""

HELD_STIFFNESS, HELD_DAMPING = 600.0, 60.0
MOST_OWED_N = 2.0
"""The greatest correction of the force by owed work [N]."""

ELBOW_PER_S = 5.0
"""The ratio of the elbow's spring k_e [Nm/rad] to its damper [Nms/rad]."""

_PER_NM = 1.0 / (2.0**0.5 * ARM_M)
"""A torque counts as the force that makes it along a pose's coordinates [1/m]."""

_WRIST_DAMPING_S = 0.08
_SAME_NM = 1e-3
_HOLDING = 0.6
"""The share of each joint's limit that the holding torque may use."""


class ArmState(NamedTuple):
    """A state: q [rad], dq [rad/s], the torque that the robot reports [Nm], the tool's position [m] and rotation, the
    Jacobians of its position and of its rotation."""

    q: Array
    dq: Array
    torque: Array
    position: Array
    rotation: Array
    linear: Array
    angular: Array

    @classmethod
    def of(cls, state: Any, jacobian: Any) -> ArmState:
        """Make a state from libfranka's RobotState and its 6 x 7 Jacobian, both stored column by column."""
        pose = np.array(state.O_T_EE).reshape(4, 4).T
        both = np.array(jacobian).reshape(JOINTS, 6).T
        q, dq, torque = (np.array(one) for one in (state.q, state.dq, state.tau_J_d))
        return cls(q, dq, torque, pose[:3, 3], pose[:3, :3], both[:3], both[3:])

    @property
    def jacobian(self) -> Array:
        """Both Jacobians (6, 7)."""
        return np.vstack((self.linear, self.angular))


class _Command(NamedTuple):
    """A command: the torques that were sent [Nm], their wrench (6,) [N and Nm] and the holding torques [Nm]."""

    torque: Array
    wrench: Array
    hold: Array


class TorqueBalance(NamedTuple):
    """held : the net energy that the holding torques took in [J]. owed : work of the torques not yet assigned to a
    force [J]."""

    held: float
    owed: float


class Torques:
    """Torques for a wrench, with their account.

    start : where the tool begins. held : projection on the axes that the scene does not have (3, 3). wrist [Nm/rad] and
    elbow [Nms/rad] : see above.

    Attributes
    ----------
    wrench : the force [N] and the torque [Nm] that were sent last, after all limits (6,).
    """

    def __init__(self, start: ArmState, held: Array, wrist: float, elbow: float) -> None:
        self._start, self._held, self._wrist, self._elbow = start, held, wrist, elbow
        self._before = start
        self.wrench: Array = np.zeros(6)
        self._turns = False
        nothing = _Command(np.zeros(JOINTS), np.zeros(6), np.zeros(JOINTS))
        self._open = deque([nothing], LOST_IN_A_ROW)  # the command that the robot reported, and later ones
        self._held_J = self._owed_J = 0.0

    @property
    def account(self) -> TorqueBalance:
        return TorqueBalance(self._held_J, self._owed_J)

    def of(self, arm: ArmState, force: Array, coriolis: Array, mass: Array, torque: Array | None = None) -> Array:
        """The torques (7,) to send in the state `arm` for `force` (3,) [N]; mass : M, 7 x 7 row by row.

        torque : the scene's at the tool (3,) [Nm]; None: the wrist's spring holds the tool.
        """
        self._turns = torque is not None
        wrench = np.concatenate((force, np.zeros(3) if torque is None else torque))
        across = arm.jacobian.T
        push = across @ wrench
        hold = _limited(self._holding(arm, coriolis, mass.reshape(JOINTS, JOINTS)))
        most = share(push.tolist(), hold.tolist(), TORQUE_LIMIT.tolist())
        sent, part = self._towards(hold + most * push, arm.torque)
        self.wrench = self.wrench + part * (most * wrench - self.wrench)
        self._open.append(_Command(sent, self.wrench, sent - across @ self.wrench))
        return sent

    def fading(self, arm: ArmState) -> Array:
        """The torques to send in the state `arm` while all torques are reduced to zero."""
        self.acted(arm)
        torque, _ = self._towards(np.zeros(JOINTS), arm.torque)
        self._open.append(_Command(torque, np.zeros(6), torque))
        return torque

    def _towards(self, wanted: Array, reported: Array) -> tuple[Array, float]:
        """The torque towards `wanted`, within the step limit from each command that may be active, and its share."""
        sent, may = self._open[-1].torque, np.array([reported, *(one.torque for one in self._open)])
        step, most = wanted - sent, RATE * PERIOD_S
        room = np.where(step > 0.0, may.min(axis=0) + most - sent, sent - may.max(axis=0) + most)
        part = float(np.clip(np.min(room / np.maximum(np.abs(step), 1e-12)), 0.0, 1.0))
        return sent + part * step, part

    def acted(self, arm: ArmState) -> Array:
        """The wrench (6,) [N and Nm] that acted since the last state, on the tool's motion and its turn.

        The turn is that of `hapnet.mechanics.pose.turned`; the torque is 0 where the wrist's spring holds the tool.
        """
        before, self._before = self._before, arm
        joints, moved = arm.q - before.q, arm.position - before.position
        moved = np.concatenate((moved, turned(before.rotation, arm.rotation) if self._turns else np.zeros(3)))
        torque, (_, wrench, hold) = before.torque, self._open[0]
        same = [bool(np.max(np.abs(arm.torque - one.torque)) < _SAME_NM) for one in self._open]
        for _ in range(len(same) - 1 - same[::-1].index(True) if any(same) else 0):
            self._open.popleft()
        if arm.torque @ joints > torque @ joints:
            torque, (_, wrench, hold) = arm.torque, self._open[0]
        self._held_J -= float(hold @ joints)
        self._owed_J += float(torque @ joints - hold @ joints - wrench @ moved)
        if self._held_J < -LENT_J:
            self._owed_J -= self._held_J + LENT_J
            self._held_J = -LENT_J
        moved[:3] -= self._held @ moved[:3]  # no force is rendered along the held axes
        scale = np.array([1.0] * 3 + [_PER_NM] * 3)
        force, way = tuple((wrench * scale).tolist()), tuple((moved / scale).tolist())
        acted, self._owed_J = paid(self._owed_J, force, way, MOST_OWED_N)
        found: Array = np.array(acted) / scale
        return found

    def _holding(self, arm: ArmState, coriolis: Array, mass: Array) -> Array:
        velocity, turning = arm.linear @ arm.dq, arm.angular @ arm.dq
        null = np.linalg.svd(arm.jacobian)[2][-1]
        along = mass @ null
        inertia = float(null @ along)
        torque: Array = -self._elbow * float(along @ arm.dq) / inertia**2 * along
        back = ELBOW_PER_S * self._elbow * float(null @ (self._start.q - arm.q)) / inertia
        torque = torque - arm.linear.T @ (HELD_DAMPING * self._held @ velocity)
        torque = torque - arm.angular.T @ (_WRIST_DAMPING_S * self._wrist * turning)
        if self._held_J <= -0.5 * LENT_J:
            return torque
        away = self._held @ (self._start.position - arm.position)
        wrist = 0.0 if self._turns else self._wrist
        off = 0.5 * np.sum(np.cross(arm.rotation.T, self._start.rotation.T), axis=0)
        pull: Array = arm.linear.T @ (HELD_STIFFNESS * away) + arm.angular.T @ (wrist * off) + back * along
        return torque + pull + coriolis


def _limited(torque: Array) -> Array:
    """A holding torque, scaled to the share of each joint's limit that it may use."""
    return torque * min(1.0, float(np.min(_HOLDING * TORQUE_LIMIT / np.maximum(np.abs(torque), 1e-12))))
