"""``--teleop.type=hapnet_leader``: a leader of Feetech's position servos that renders hapnet's force.

An STS3215 has no command for a torque. It has a goal position, a torque limit (a share of its stall torque) and a
measured current. So each joint gets the place at which the coupling's spring would be relaxed as its goal, and the size
of the force as its limit: the servo's own loop pulls towards the goal, and no harder. If LeRobot stops, the servos hold
a limited spring. The force that hapnet's energy account counts is the measured current's, not the command's.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

from lerobot.teleoperators import Teleoperator, TeleoperatorConfig, make_teleoperator_from_config

from .choice import config_of

CURRENT_A = 6.5e-3
"""Of a count of the register Present_Current (Feetech's memory table of the STS series)."""

SIGN_BIT = 15
WHOLE = 1000
"""The register Torque_Limit counts in thousandths of the stall torque."""

GEAR = 345.0
GEARS = {"shoulder_pan": 191.0, "elbow_flex": 191.0, "wrist_flex": 147.0, "wrist_roll": 147.0, "gripper": 147.0}
"""The gear ratios of SO-101's leader (its bill of materials); 345 for other joints."""


@TeleoperatorConfig.register_subclass("hapnet_leader")
@dataclass(kw_only=True)
class HapnetLeaderConfig(TeleoperatorConfig):
    """leader : as in ``--teleop.leader='{type: so101_leader, port: /dev/ttyACM0}'``.

    stall_torque, torque_constant : of a servo with the gear ratio 345 at its supply [Nm], [Nm/A]; those of the others
    are smaller by their ratios. The defaults are the maker's for 12 V: 30 kg cm and 2.7 A at stall. gears : each
    joint's ratio, where it is not 345.
    """

    leader: dict[str, Any]  # a TeleoperatorConfig in one would have no end in LeRobot's parser
    stall_torque: float = 2.94
    torque_constant: float = 1.09
    gears: dict[str, float] = field(default_factory=lambda: dict(GEARS))


class HapnetLeader(Teleoperator):
    """The leader. Raises ValueError: its bus has no torque limits.

    Attributes
    ----------
    opened : the connected leaders; `HapnetRobot` renders its force at them.
    """

    config_class = HapnetLeaderConfig
    name = "hapnet_leader"
    opened: ClassVar[list[HapnetLeader]] = []

    def __init__(self, config: HapnetLeaderConfig) -> None:
        super().__init__(config)
        self.config = config
        self.leader: Any = make_teleoperator_from_config(config_of(TeleoperatorConfig, "teleop.leader", config.leader))
        bus = getattr(self.leader, "bus", None)
        tables = [bus.model_ctrl_table[motor.model] for motor in bus.motors.values()] if bus is not None else [{}]
        if not all({"Torque_Limit", "Present_Current", "Goal_Position"} <= table.keys() for table in tables):
            allowed = (
                "so100_leader, so101_leader, or another with STS servos; lead with any other without hapnet_leader"
            )
            raise ValueError(f"teleop.leader: {config.leader['type']} has no torque limits; allowed: {allowed}")
        self.measured: dict[str, float] = {}
        """The motors' mean torques between the last two readings [Nm]."""
        self._newest = dict.fromkeys(bus.motors, 0.0)

    @property
    def action_features(self) -> dict[str, Any]:
        return dict(self.leader.action_features)

    @property
    def feedback_features(self) -> dict[str, Any]:
        return {name.replace(".pos", ".force"): kind for name, kind in self.action_features.items()}

    @property
    def is_connected(self) -> bool:
        return bool(self.leader.is_connected)

    @property
    def is_calibrated(self) -> bool:
        return bool(self.leader.is_calibrated)

    def calibrate(self) -> None:
        self.leader.calibrate()

    def configure(self) -> None:
        self.leader.configure()

    def connect(self, calibrate: bool = True) -> None:
        """Connect the leader, without force. Then its motors are on."""
        self.leader.connect(calibrate)
        bus = self.leader.bus
        self._limit(dict.fromkeys(bus.motors, 0.0))
        bus.sync_write("Goal_Position", bus.sync_read("Present_Position"))
        bus.enable_torque()
        self._limit(dict.fromkeys(bus.motors, 0.0))  # switching on resets it in some versions of the firmware
        self.opened.append(self)

    def get_action(self) -> dict[str, float]:
        """The leader's position; its motors' torques are measured with it."""
        self._drop_late()
        action: dict[str, float] = self.leader.get_action()
        self._drop_late()
        tries = getattr(self.leader.config, "num_read_retries", 2)
        currents = self.leader.bus.sync_read("Present_Current", normalize=False, num_retry=tries)
        counts = {joint: _signed(int(count)) for joint, count in currents.items()}
        before = self._newest
        most = self.config.stall_torque / self.config.torque_constant / CURRENT_A
        if max(map(abs, counts.values())) <= most:  # a larger one is the late answer to another request
            constant = self.config.torque_constant * CURRENT_A
            self._newest = {joint: constant * self._ratio(joint) * count for joint, count in counts.items()}
        self.measured = {joint: 0.5 * (before[joint] + one) for joint, one in self._newest.items()}
        return action

    def send_feedback(self, feedback: Mapping[str, float]) -> None:
        """Render a force: ``x.force``, its size [Nm], and ``x.pos``, the place towards which it pulls."""
        bus = self.leader.bus
        goals = {joint: feedback[f"{joint}.pos"] for joint in bus.motors}
        self._limit({joint: abs(feedback[f"{joint}.force"]) for joint in bus.motors})
        bus.sync_write("Goal_Position", goals)

    def disconnect(self) -> None:
        if self in self.opened:
            self.opened.remove(self)
            self._limit(dict.fromkeys(self.leader.bus.motors, 0.0))
        self.leader.disconnect()

    def _ratio(self, joint: str) -> float:
        return self.config.gears.get(joint, GEAR) / GEAR

    def _drop_late(self) -> None:
        """Drop late answers: Feetech's SDK would take one for the answer to the next request, of another register."""
        self.leader.bus.port_handler.ser.reset_input_buffer()

    def _limit(self, torques: Mapping[str, float]) -> None:
        counts = {
            joint: min(WHOLE, round(WHOLE * torque / (self.config.stall_torque * self._ratio(joint))))
            for joint, torque in torques.items()
        }
        self.leader.bus.sync_write("Torque_Limit", counts, normalize=False)


def _signed(count: int) -> int:
    """Decode a count whose highest bit is its sign."""
    size = count & (1 << SIGN_BIT) - 1
    return -size if count >> SIGN_BIT & 1 else size
