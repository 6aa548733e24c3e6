"""A robot that takes positions as the follower: its derived parameters, and its world."""

from __future__ import annotations

from contextlib import suppress
from functools import partial
from typing import Any

from hapnet.assembly.choices import Refusal, refuse
from hapnet.assembly.device_class import FOLLOWER, declared, is_position_robot, load_class
from hapnet.assembly.follower import Follower
from hapnet.couplings.spec import CouplingSpec
from hapnet.errors import HapnetError, InvalidParameter
from hapnet.ext.robots.position_world import PositionWorld
from hapnet.loading import failure
from hapnet.mechanics.frame import Frame
from hapnet.params import FollowerParams, Params, is_real_robot
from hapnet.plant.worlds.protocol import World
from hapnet.side.reindexing import Reindexing
from hapnet.units import POSE

_USED = ("robot", "motion_scale", "force_scale", "start", "feedback", "on_stop")


class PositionFollower(Follower):
    """A robot that takes positions, in its own world."""

    def warnings(self, params: Params, spec: CouplingSpec[Any], dof: int) -> list[str]:
        return []

    def meets_here(self, params: Params) -> bool:
        return params.follower.start == "here"

    def reindexing(self, params: Params, spec: CouplingSpec[Any], scene: World) -> Reindexing | None:
        found = super().reindexing(params, spec, scene)
        if found is not None:
            found.due = self.meets_here(params)  # the robot is anywhere, also when its first leader comes
        return found


POSITIONS = PositionFollower()


def takes_positions(params: Params) -> bool:
    """Whether the robot that follows takes positions; also False if there is no such robot on this host."""
    with suppress(InvalidParameter):
        return is_real_robot(params) and is_position_robot(load_class(params.follower.robot, FOLLOWER))
    return False


def is_simulated(params: Params) -> bool:
    """Whether the robot that follows takes positions and is simulated."""
    return takes_positions(params) and bool(declared(load_class(params.follower.robot, FOLLOWER), "simulated"))


def check(params: Params, spec: CouplingSpec[Any], scene: World) -> None:
    """Raise InvalidParameter for a parameter that does not fit a robot that takes positions."""
    robot, name = params.follower, params.follower.robot
    unused = [field for field in FollowerParams.__dataclass_fields__ if field not in _USED]
    steps = ("world.step_min_s", "world.step_max_s")
    refuse((
        *(Refusal(params.asked(f"follower.{field}"), f"follower.{field}", getattr(robot, field),
                  f"left out: the robot {name} takes positions") for field in unused),
        *(Refusal(params.asked(step), step, params.get(step), f"left out: the robot {name} sets the rate")
          for step in steps),
        Refusal(robot.feedback == "planes", "follower.feedback", "planes", "position or force with a real robot"),
        Refusal("world" not in spec.set_positions, "coupling", params.coupling,
                "one whose virtual mass has a spring with a robot that takes positions, such as pspm or zoh"),
        Refusal(scene.units == POSE, "scene", params.scene, "one without a tool: this robot takes positions only"),
        Refusal(scene.jaw, "scene", params.scene, "one without a jaw: a robot that takes positions has none"),
    ))  # fmt: skip


def place(params: Params, scene: World) -> PositionWorld:
    """The robot's world, with the axes of the scene; the robot is opened later."""
    robot = params.follower
    make = load_class(robot.robot, FOLLOWER)
    frame = Frame(robot.motion_scale, robot.force_scale, (0.0,) * scene.dof)
    return PositionWorld(
        partial(_opened, make, robot.robot, scene.dof), robot.robot, frame, needs_force=robot.feedback == "force",
        dof=scene.dof, units=scene.units,
    )  # fmt: skip


def _opened(make: Any, name: str, dof: int) -> Any:
    try:
        return make(dof=dof)
    except InvalidParameter as error:
        raise error.renamed(f"{FOLLOWER} {name}: {error.name}") from error
    except HapnetError:
        raise
    except BaseException as error:  # see `loading.failure`
        raise HapnetError(f"the robot {name} cannot be opened: {failure(error)}") from error
