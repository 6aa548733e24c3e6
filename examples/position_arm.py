"""A position-controlled arm follows: it takes 50 positions a second. Inverse kinematics by mink.

pip install mujoco mink daqp
hapnet play --follower examples.position_arm:Arm --scene free --dof 3        # the mouse is the hand
python examples/position_arm.py                            # energy taken by damping: the arm's own loop is not passive
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

from numpy import array, zeros

from hapnet import HapnetError, Params, PositionRobot, simulate

Vector = tuple[float, ...]

MODEL = """<mujoco><option gravity="0 0 0" timestep="0.001"/><default>
<joint damping="1" armature="0.01"/><geom solref="0.004 1"/><position kp="60" kv="1"/></default><worldbody>
<body pos="-0.3 0 0"><joint name="a" axis="0 0 1"/><joint name="b" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 0 0 0.2" size="0.015" mass="0.4"/><body pos="0 0 0.2"><joint name="c" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 0.3 0 -0.2" size="0.012" mass="0.3"/>
<body name="tip" pos="0.3 0 -0.2"><geom name="tip" type="sphere" size="0.01" mass="0.05"/></body></body></body>
<geom name="foam" type="box" size="0.02 0.1 0.1" pos="0.06 0 0" solref="-400 -8"/></worldbody>
<actuator><position joint="a"/><position joint="b"/><position joint="c"/></actuator></mujoco>"""


class Arm(PositionRobot):
    """A simulated arm. For a real arm, `read` and `contact_force` return what it measures, and `move` commands it."""

    simulated, rate_hz = True, 50.0  # so it runs in virtual time too; `move` is called so often
    speed_limit, step_limit = 0.5, 0.02  # [m/s], [m]

    def __init__(self, dof: int = 3) -> None:
        self.dof = dof
        try:
            self._mujoco, self._mink = import_module("mujoco"), import_module("mink")
        except ModuleNotFoundError as error:
            raise HapnetError(f"this robot needs {error.name}: pip install mujoco mink daqp") from None
        self._model: Any = self._mujoco.MjModel.from_xml_string(MODEL)
        self._data: Any = self._mujoco.MjData(self._model)
        self._arm: Any = self._mink.Configuration(self._model)
        self._task: Any = self._mink.FrameTask("tip", "body", position_cost=1.0, orientation_cost=0.0, lm_damping=1e-6)
        self._mujoco.mj_forward(self._model, self._data)

    def read(self) -> Vector:
        return tuple(self._data.body("tip").xpos.tolist())

    def move(self, dt: float, position: Vector, velocity: Vector) -> None:
        self._task.set_target(self._mink.SE3.from_translation(array(position)))
        for _ in range(4):  # iterate, because the kinematics are not linear
            self._arm.integrate_inplace(self._mink.solve_ik(self._arm, [self._task], 1.0, "daqp", 1e-9), 1.0)
        self._data.ctrl[:] = self._arm.q
        for _ in range(round(dt / self._model.opt.timestep)):
            self._mujoco.mj_step(self._model, self._data)

    def contact_force(self) -> Vector:
        """Force of the foam on the tip [N], in the world's axes."""
        total, found = zeros(3), zeros(6)
        for k, contact in enumerate(self._data.contact):
            self._mujoco.mj_contactForce(self._model, self._data, k, found)
            away = 1.0 if self._model.geom(contact.geom2).name == "tip" else -1.0
            total += away * (found[:3] @ contact.frame.reshape(3, 3))
        return tuple(total.tolist())


def main() -> None:
    link = {"link.up": "4g", "link.down": "4g"}
    robot = {"follower.robot": f"{__name__}:Arm", "scene": "free", "dof": 3}
    params = Params().set({**robot, "operator": "press", "duration_s": 6.0, **link})
    result = simulate(params, seed=1)
    world, own = result.recording.world, result.summary["environment"]
    assert world is not None
    print(f"the foam pushed with {-world['contact_force_N'].min():.2f} N at most")
    print(f"damping took {1e3 * (own['env_paid_J'] or 0.0):.2f} mJ; slack {1e3 * (own['env_slack_J'] or 0.0):.2f} mJ")
    print(result.summary["verdict"]["reason"])


if __name__ == "__main__":
    main()
