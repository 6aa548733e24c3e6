"""The driver with `franka-sim`, a simulator of the FR3 that speaks the maker's protocol and was not written here.

It needs another MuJoCo than hapnet, so it stands in an environment of its own: ``python -m venv .franka-sim`` and
``.franka-sim/bin/pip install franka-sim`` beside pyproject.toml, or HAPNET_FRANKA_SIM names its python.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import ROOT
from tests.support.processes import assert_passive, started

PYTHON = Path(os.environ.get("HAPNET_FRANKA_SIM", ROOT / ".franka-sim" / "bin" / "python"))
pylibfranka = pytest.importorskip("pylibfranka", reason="pylibfranka is not installed: extra franka")
mujoco = pytest.importorskip("mujoco")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not PYTHON.is_file(), reason="franka-sim is not installed: HAPNET_FRANKA_SIM"),
    pytest.mark.xdist_group("franka-sim"),
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


@pytest.fixture(scope="module")
def simulator(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    folder = tmp_path_factory.mktemp("franka")
    path = model(folder)
    argv = [PYTHON, "-m", "franka_sim.run_server", "--no-gripper", "--enforce-motion-limits"]
    with (folder / "log").open("w") as log:
        env = {**os.environ, "FR3_MJCF": str(path)}
        process = subprocess.Popen(argv, env=env, stdout=log, stderr=log, cwd=folder)
        try:
            subprocess.run([PYTHON.with_name("franka-sim-check"), "--timeout", "30"], check=True, capture_output=True)
            yield path
        finally:
            process.kill()
            process.wait()


def test_the_robots_jacobian_is_laid_out_as_the_driver_takes_it(simulator: Path) -> None:
    from hapnet.devices.franka import Franka

    device = Franka(3, "127.0.0.1", realtime=False)
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


def test_it_follows_over_4g_and_meets_a_wall_in_the_air(simulator: Path, tmp_path: Path) -> None:
    given = ("world.stiffness=1000", "world.damping=60", "follower.force_scale=0.05", "follower.fixtures=true")
    sets = [part for one in given for part in ("--set", one)]
    argv = ("run", "--follower", "franka:127.0.0.1,realtime=no,speed=1.7", "--dof", 3, "--scene", "wall", *sets)
    with started(
        *argv, "--operator", "hand-21", "--link", "4g", "--duration", 8, "--json", "-", "--out", tmp_path
    ) as one:
        code, stdout, stderr = one.end()
    assert code == 0, stderr
    summary = json.loads(stdout)
    assert_passive(summary)
    assert "robot has stopped" not in stderr
    assert summary["motion"]["peak_force_N"] > 0.3  # of the wall, at the leader
    assert summary["motion"]["free_rms_m"] < 0.02
