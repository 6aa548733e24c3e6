"""The driver with `franka-sim`, a simulator of the FR3 that speaks the maker's protocol and was not written here.

It needs another MuJoCo than hapnet, so it stands in an environment of its own, `.franka-sim` beside pyproject.toml, or
where HAPNET_FRANKA_SIM names its python; the tests' page has the line. Whether the robot stops when commands are late
is off, as it would measure the machine.
"""

from __future__ import annotations

import json
import math
import os
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from hapnet.recording.mcap import read_recording
from tests.conftest import ROOT, mostly_slow
from tests.support.processes import assert_passive, started

Array = NDArray[np.float64]
PYTHON = Path(os.environ.get("HAPNET_FRANKA_SIM", ROOT / ".franka-sim" / "bin" / "python"))
CHECK = PYTHON.with_name("franka-sim-check")
pylibfranka = pytest.importorskip("pylibfranka", reason="pylibfranka is not installed: extra franka")
mujoco = pytest.importorskip("mujoco")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not CHECK.is_file(), reason="franka-sim is not installed: HAPNET_FRANKA_SIM"),
    pytest.mark.realtime,
]
MODEL = """
import sys, franka_sim, pathlib; print((pathlib.Path(franka_sim.__file__).parent / "models/fr3.urdf").read_text())
"""


def model(folder: Path) -> Path:
    """The URDF that it serves to its clients, without shapes, as MuJoCo's XML.

    The simulator takes ``link7`` for the tool, its clients the flange: so the flange has that name. Without the motors'
    inertia, which the URDF does not have, its own position servo swings.
    """
    urdf = subprocess.run([PYTHON, "-c", MODEL], capture_output=True, text=True, check=True).stdout
    urdf = re.sub(r"<(visual|collision)\b.*?</\1>", "", urdf, flags=re.DOTALL)
    urdf = re.sub("(<robot[^>]*>)", r'\1<mujoco><compiler fusestatic="false"/></mujoco>', urdf, count=1)
    path = folder / "fr3.xml"
    mujoco.mj_saveLastXML(str(path), mujoco.MjModel.from_xml_string(urdf))
    text = path.read_text("utf-8").replace('name="link7"', 'name="wrist"').replace('name="link8"', 'name="link7"')
    path.write_text(text.replace("<joint ", '<joint armature="0.1" '), "utf-8")
    return path


@pytest.fixture
def simulator(tmp_path: Path) -> Iterator[Path]:
    path = model(tmp_path)
    argv = [PYTHON, "-m", "franka_sim.run_server", "--no-gripper", "--enforce-motion-limits"]
    with (tmp_path / "log").open("w") as log:
        env = {**os.environ, "FR3_MJCF": str(path)}
        process = subprocess.Popen(argv, env=env, stdout=log, stderr=log, cwd=tmp_path)
        try:
            subprocess.run([CHECK, "--timeout", "30"], check=True, capture_output=True)
            assert process.poll() is None, "another one is answering"
            yield path
        finally:
            process.kill()
            process.wait()


def test_the_robots_jacobian_is_laid_out_as_the_driver_takes_it(simulator: Path) -> None:
    from hapnet.ext.robots.franka import Franka

    scheduling = os.sched_getscheduler(0)
    device = Franka(3, "127.0.0.1", realtime=False)
    device.begin()
    assert os.sched_getscheduler(0) == scheduling, "the maker's library takes the highest priority that it may have"
    device.close()
    state = device.arm
    theirs = mujoco.MjModel.from_xml_path(str(simulator))
    data = mujoco.MjData(theirs)
    data.qpos[:] = state.q
    mujoco.mj_kinematics(theirs, data)
    mujoco.mj_comPos(theirs, data)
    tool = theirs.body("link7").id
    linear, angular = np.zeros((3, 7)), np.zeros((3, 7))
    mujoco.mj_jac(theirs, data, linear, angular, data.xpos[tool], tool)
    assert state.linear == pytest.approx(linear, abs=1e-5)
    assert state.angular == pytest.approx(angular, abs=1e-5)
    assert state.position == pytest.approx(data.xpos[tool], abs=1e-5)
    assert state.rotation == pytest.approx(data.xmat[tool].reshape(3, 3), abs=1e-5)


def beyond_the_motion(to: Array, at: Array) -> Array:
    """How far each set-position of `to` (k, n) is from the line that leads from the one before it by the step of `at`
    (k, n) between them [m]: the change of the spring's stretch that the own motion did not cause."""
    change, moved = np.diff(to, axis=0), np.diff(at, axis=0)
    square = np.maximum((moved**2).sum(1), 1e-300)
    share = np.clip((change * moved).sum(1) / square, 0.0, 1.0)
    return np.linalg.norm(change - share[:, None] * moved, axis=1)


@pytest.mark.parametrize("feedback", mostly_slow(["force", "position"], 0, 1))
def test_it_follows_over_4g_and_meets_a_wall_in_the_air(feedback: str, simulator: Path, tmp_path: Path) -> None:
    """The network is pulled for a second. What is asserted does not depend on how busy the machine is."""
    given = ("world.stiffness=1000", "world.damping=60", "follower.force_scale=0.05", "follower.fixtures=true")
    sets = [part for one in (*given, f"follower.feedback={feedback}", "record_hz=1000") for part in ("--set", one)]
    argv = ("run", "--follower", "franka:127.0.0.1,realtime=no,speed=1.7", "--dof", 3, "--scene", "wall", *sets)
    pulled = [part for way in ("up", "down") for part in (f"--{way}-timeline", "at 3s: down; at 4s: up")]
    with started(
        *argv, "--operator", "hand-21", "--link", "4g", *pulled, "--duration", 6, "--json", "-", "--out", tmp_path
    ) as one:
        code, stdout, stderr = one.end()
    assert code == 0, stderr
    summary = json.loads(stdout)
    assert_passive(summary)
    assert "robot has stopped" not in stderr
    leader, robot = (read_recording(tmp_path / f"{role}.mcap") for role in ("device", "world"))
    for side, most_m in ((leader.device, 0.5 / 200.0), (robot.world, 0.5 / 1000.0)):
        to, at = side["set_position_m"], side["position_m"]
        # Where the robot goes on after the silence, its recording, which is in the leader's coordinates, jumps with its
        # set-position; the spring's stretch does not.
        steps = beyond_the_motion(to, at)
        released = np.all(to == at, axis=1)[1:]  # a servo that stalled renders no force
        assert steps[~released].max() <= most_m * (1.0 + 1e-6)
    assert np.abs(leader.device["force_N"]).max() > 0.03  # newtons of wall and arm, 0.05 of them at the leader
    assert np.any(robot.world["contact_force_N"]) == (feedback == "force")  # the plane's: the simulator has none


def test_in_a_scene_with_a_tool_it_is_turned(simulator: Path, tmp_path: Path) -> None:
    """Six axes, over 4g: the account has the work of force and torque; what is asserted holds on a busy machine."""
    sets = [part for one in ("follower.feedback=position", "record_hz=1000") for part in ("--set", one)]
    argv = ("run", "--follower", "franka:127.0.0.1,realtime=no,speed=1.7", "--scene", "tool:box", *sets)
    given = ("--operator", "hand-21", "--link", "4g", "--duration", 6, "--json", "-", "--out", tmp_path)
    with started(*argv, *given) as one:
        code, stdout, stderr = one.end()
    assert code == 0, stderr
    summary = json.loads(stdout)
    assert_passive(summary)
    assert abs(summary["world"]["ledger"]["slack_J"]) < 1e-12
    assert summary["world"]["force"] == "applied"
    assert "robot has stopped" not in stderr
    robot = read_recording(tmp_path / "world.mcap").world
    places = robot["position_m"]
    assert np.ptp(places[:, :3], axis=0).max() > 0.005
    assert np.ptp(places[:, 3:], axis=0).max() > 0.04 * math.radians(2.0)  # ends of arms of 40 mm
