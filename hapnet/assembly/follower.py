"""The interface of a robot in the virtual mass's place; `Follower` itself stands for a run without a robot."""

from __future__ import annotations

from typing import Any

from hapnet.assembly.choices import Part
from hapnet.checks import Vector
from hapnet.couplings.rendering import largest
from hapnet.couplings.spec import CouplingSpec
from hapnet.loading import extension
from hapnet.mechanics.frame import Frame
from hapnet.mechanics.pose import ARM_M
from hapnet.mechanics.pose_frame import Arms, PoseFrame
from hapnet.params import Params, follows
from hapnet.plant.worlds.protocol import World
from hapnet.side.content import NANO
from hapnet.side.device import Write
from hapnet.side.reindexing import Reindexing
from hapnet.units import POSE


class Follower:
    """No robot follows: the parameters are used as they are, in the device's own units.

    `hapnet.ext.robots.following.RobotFollower` is the follower with a robot.

    seen : chooses the robot's parameters in the leader's units (`hapnet.mechanics.frame`). on_link : the same, with the
    spring of a tool along the coordinates of the link.
    """

    seen: tuple[Part, ...] = ()
    on_link: tuple[Part, ...] = ()

    def warnings(self, params: Params, spec: CouplingSpec[Any], dof: int) -> list[str]:
        """Warnings for the user of a simulated follower, or of follower parameters without a follower."""
        found = [name for name, _ in params.sources if name.startswith("follower.") and params.asked(name)]
        return [f"{name} is set, but nothing follows: --follower" for name in found if name != "follower.robot"]

    def is_held(self, params: Params, spec: CouplingSpec[Any]) -> bool:
        """Whether the robot's force is held from tick to tick."""
        return False

    def is_driven(self, params: Params) -> bool:
        """Whether a driver holds the robot's force, so that the world's side is a robot's side."""
        return False

    def arms(self, params: Params) -> Arms | None:
        """The conversion of a tool's pose from the servo's to the link's coordinates (`hapnet.mechanics.pose_frame`);
        None: they are the same."""
        return None

    def meets_here(self, params: Params) -> bool:
        """Whether the world's side starts at its present position when a leader connects."""
        return True

    def reindexing(self, params: Params, spec: CouplingSpec[Any], scene: World) -> Reindexing | None:
        """The robot's way to meet a leader that returns to this world; None: there is no such robot."""
        if not scene.robot or "world" not in spec.set_positions:
            return None
        arms = self.arms(params)
        length = ARM_M if arms is None else ARM_M * arms.back.times
        frame = PoseFrame(1.0, 1.0, length) if scene.units == POSE else Frame(1.0, 1.0, (0.0,) * scene.dof, scene.jaw)
        return Reindexing(frame, round(params.world.silence_after_s / NANO), meets=self.meets_here(params))

    def leaders_stiffness(self, params: Params, dof: int) -> Vector:
        """The largest of `device.stiffness` along each of the servo's coordinates [N/m]."""
        return (largest(params.device.stiffness),) * dof

    def writes_on_link(self, params: Params, write: Write, moved: Reindexing | None = None) -> Write:
        """Return a writer of a robot's samples in the coordinates of the link, which its leader uses."""
        if moved is None:
            return write
        return lambda sample: write(moved.recorded(sample))


_NONE = Follower()


def follower_of(params: Params) -> Follower:
    """Return the follower in the virtual mass's place with these parameters."""
    if not follows(params):
        return _NONE
    robot: Follower = extension("robots").follower_of(params)
    return robot
