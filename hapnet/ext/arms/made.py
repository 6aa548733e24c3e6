"""An arm's record from its table; rules set the stops and brakes."""

from __future__ import annotations

import math

import numpy as np

from hapnet.ext.arms import motion
from hapnet.ext.arms.chain import difference
from hapnet.ext.arms.motion import Arm
from hapnet.ext.arms.table import ArmTable, at_home, chain_of
from hapnet.plant.operator import Impedance

STOP_HZ = 40.0
"""The frequency of a joint on its stop, with the arm at home: stiff compared with a hand, slow compared with a step."""

STOP_LOSS_SPRAD = 0.5
"""Damping of a stop over its stiffness [s/rad]: a joint that arrives at 1 rad/s leaves at two thirds of that."""

SLIP_RADPS = 0.01
"""Below this rate friction acts nearly as a damper."""

LEVER_M = 0.1
"""Stops and friction of a slide are those of a hinge at this lever."""

BRAKES_AT = 0.1
"""The share above the greatest rate at which a drive brakes with its motor's full torque."""


def arm_of(
    table: ArmTable, hand: Impedance, period: float, steps: int, *, compensated: bool = True, by_joints: bool = False
) -> Arm:
    """The arm at rest at home, in a hand.

    period : of a tick [s]; steps : in a tick. compensated : the motors carry the arm's weight.
    by_joints : hand and coupling act on each joint, not at the tip.
    """
    arm = Arm()
    arm.chain = chain_of(table, 0.0 if by_joints else hand.mass)
    arm.n = n = arm.chain.n
    arm.port.axes, arm.port.by_joints = n if by_joints else 3, int(by_joints)
    arm.port.origin[:n] = list(table.home)
    for i in range(n):
        arm.port.columns[i][i] = 1.0  # those of a tip are computed in each step
    arm.period, arm.steps, arm.h = period, steps, period / steps
    arm.compensated = int(compensated)
    arm.hand_mass, arm.hand_stiffness, arm.hand_damping = hand.mass, hand.stiffness, hand.damping
    inertias = np.diagonal(at_home(table)[1]).tolist()
    swing = 2.0 * math.pi * STOP_HZ
    for i, joint in enumerate(table.free):
        lever = LEVER_M if joint.slides else 1.0
        arm.slip[i] = SLIP_RADPS * lever
        arm.damping[i], arm.friction[i] = joint.damping, joint.friction
        arm.lower[i], arm.upper[i], arm.effort[i], arm.speed[i] = joint.lower, joint.upper, joint.effort, joint.speed
        arm.stop_stiffness[i] = inertias[i] * swing * swing
        arm.stop_damping[i] = STOP_LOSS_SPRAD / lever * arm.stop_stiffness[i]
        if joint.speed < math.inf:
            torque = joint.effort if joint.effort < math.inf else joint.speed * inertias[i] * swing
            arm.brake[i] = torque / (BRAKES_AT * joint.speed)
    arm.has_limits = int(any(joint.effort < math.inf for joint in table.free))
    arm.q[:n] = list(table.home)
    difference(arm.chain, arm.chain.tip, arm.q, arm.q)
    for r in range(3):
        arm.chain.tip.arms[0][r] -= arm.chain.tip.begin[r]
    motion.look(arm)
    return arm
