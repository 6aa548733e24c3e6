"""The hand that a parameter names: simulated, recorded, or led by the user."""

from __future__ import annotations

from pathlib import Path

from hapnet.assembly.user_device import declared_range
from hapnet.assembly.user_operator import UserOperator
from hapnet.params import Params
from hapnet.plant.live_hand import LiveHand
from hapnet.plant.operator import Impedance, Operator, Press, Rest, Sine
from hapnet.plant.worlds.protocol import World
from hapnet.recording.hand import is_recording, recorded_hand
from hapnet.recording.motion import read_motion

LIVE = "mouse"
"""The operator that the user leads during the run; in real time only."""


def operator(params: Params, scene: World) -> Operator:
    """The hand in this scene. Raises InvalidParameter."""
    name, hand, dof = params.operator, params.operator_hand, scene.dof
    impedance = Impedance(hand.mass, hand.damping, hand.stiffness)
    reach = declared_range(params.device, dof).reach
    walls = scene.walls
    normal = walls[0].normal if walls else (1.0, *(0.0,) * (dof - 1))
    start = tuple([hand.start_m * component for component in normal])
    if name == LIVE:
        return LiveHand(start, impedance)
    if name == "rest":
        return Rest(dof, impedance, start)
    if name == "sine":
        return Sine(dof, impedance, hand.amplitude_m, hand.frequency_hz)
    if name == "press":
        goal = tuple([hand.goal_m * component for component in normal])
        return Press(start, goal, impedance, reach=hand.reach_s, hold=hand.hold_s, wait=hand.wait_s)
    if is_recording(name):
        return recorded_hand(name, dof, impedance, reach)
    if name.endswith(".csv") or Path(name).exists():
        depths = {"press_depth": hand.press_depth_m, "hover": hand.hover_m}
        return read_motion(Path(name), dof, impedance, **depths, reach=reach)
    return UserOperator(name, dof, impedance, reach)
