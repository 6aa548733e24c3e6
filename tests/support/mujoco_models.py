"""MuJoCo models for tests, and the world that is made of one."""

from pathlib import Path

from hapnet.ext.engines.engine_world import EngineMass, EngineWorld
from hapnet.ext.engines.mujoco_engine import MujocoEngine, mujoco_world
from hapnet.ext.engines.mujoco_model import MujocoModel

FLOOR = '<geom name="floor" type="plane" size="1 1 .1"/>'
BLOCK = '<geom name="block" type="box" pos="0.05 0 0.03" size="0.02 0.1 0.03"/>'
BOX = '<body name="box" pos="0.03 0 0.02"><freejoint/><geom type="box" size=".02 .02 .02" mass="0.05"/></body>'
DOOR = (
    '<body name="door" pos="0.02 0.1 0.05"><joint type="hinge" axis="0 0 1" damping="0.002" stiffness="0.05"/>'
    '<geom type="box" size="0.005 0.1 0.04" pos="0 -0.1 0" mass="0.1"/><site name="handle" pos="0 -0.18 0"/></body>'
)
BALL = '<body name="ball" pos="-0.2 0 0.1"><freejoint/><geom type="sphere" size=".02" mass="0.1"/></body>'
FLEX = (
    '<flexcomp name="soft" type="grid" count="4 4 4" spacing=".012 .012 .012" pos="0.05 0 0.025" radius=".002" dim="3"'
    ' mass="0.05"><contact selfcollide="none"/><edge equality="true" damping="1"/></flexcomp>'
)


def model(path: Path, content: str, *, solref: str = "0.02 1", option: str = 'timestep="0.004"', more: str = "") -> str:
    """The scene's name for a model with this content."""
    default = f'<default><geom solref="{solref}"/></default>'
    path.write_text(f"<mujoco><option {option}/>{default}<worldbody>{FLOOR}{content}</worldbody>{more}</mujoco>")
    return f"mujoco:{path}"


def made(scene: str, dof: int = 3) -> tuple[EngineWorld, EngineMass]:
    world = mujoco_world(scene, dof=dof)
    return world, world.proxy(0.02, 14.0, 500.0)


def engine_of(world: EngineWorld) -> MujocoEngine:
    return world.engine


def found_of(world: EngineWorld) -> MujocoModel:
    """The model that runs in this world."""
    return engine_of(world).found
