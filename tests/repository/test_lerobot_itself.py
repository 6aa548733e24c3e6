"""LeRobot's own programs and SO-101 classes, on emulated buses: an environment with LeRobot 0.6 or later is needed.

HAPNET_LEROBOT_PYTHON names its Python, in which both packages of examples/lerobot and hapnet's dependencies are
installed (examples/lerobot/README.md).
"""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapnet.transport.config import free_address
from tests.conftest import ROOT
from tests.support.so101 import JOINTS, calibration

PYTHON = os.environ.get("HAPNET_LEROBOT_PYTHON", "")
LEADER, FOLLOWER = (10.0, -30.0, 40.0, 5.0, -15.0, 40.0), (-20.0, 15.0, 60.0, -40.0, 30.0, 50.0)
EPISODES = 10
PATIENT = "num_read_retries: 20"  # the machine may stop both emulators for longer than LeRobot's 50 ms
FOLDERS = [
    str(ROOT / "examples" / "lerobot" / name) for name in ("lerobot_robot_hapnet", "lerobot_teleoperator_hapnet")
]

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not PYTHON, reason="HAPNET_LEROBOT_PYTHON names no Python with lerobot>=0.6"),
]

READ = """
import json, sys
from lerobot.datasets.lerobot_dataset import LeRobotDataset
found = LeRobotDataset("hapnet/test", root=sys.argv[1])
names = found.meta.features["observation.state"]["names"], found.meta.features["action"]["names"]
rows = found.hf_dataset.with_format("numpy")
episodes = [int(one) for one in rows["episode_index"]]
states, actions = ([list(map(float, one)) for one in rows[key]] for key in ("observation.state", "action"))
json.dump({"names": names, "episodes": episodes, "states": states, "actions": actions}, sys.stdout)
"""


def environment() -> dict[str, str]:
    return os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), *FOLDERS]), "HF_HUB_OFFLINE": "1"}


def lerobot(program: str, *options: str, log: Path) -> subprocess.Popen[bytes]:
    with log.open("wb") as out:
        command = [PYTHON, "-m", f"lerobot.scripts.{program}", *options]
        return subprocess.Popen(command, env=environment(), stdout=out, stderr=subprocess.STDOUT, cwd=log.parent)


@contextmanager
def arm(kind: str, folder: Path, starts: tuple[float, ...]) -> Iterator[str]:
    """An emulated arm; yields LeRobot's options of it, in braces."""
    link = folder / kind
    command = [sys.executable, "-m", "tests.support.so101", kind, str(link), "400", ",".join(map(str, starts))]
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE)
    assert process.stdout is not None
    assert process.stdout.readline() == b"ready\n"
    calibration(folder / "calibration", kind)
    try:
        yield f"{{type: so101_{kind}, port: {os.readlink(link)}, id: {kind}, calibration_dir: {folder}/calibration, {PATIENT}}}"
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(20.0)


def told(folder: Path, kind: str) -> Any:
    return json.loads((folder / f"{kind}.json").read_text("utf-8"))


def test_ten_episodes_with_force_over_4g(tmp_path: Path) -> None:
    """The two commands of the page, with lerobot-record on the robot's host and a leader that feels."""
    address, data = free_address(), tmp_path / "data"
    with arm("leader", tmp_path, LEADER) as led, arm("follower", tmp_path, FOLLOWER) as followed:
        robot = lerobot(
            "lerobot_record",
            "--robot.type=hapnet_arm", f"--robot.arm={followed}",
            "--teleop.type=hapnet", f"--teleop.connect={address}", '--teleop.params={"link.down": "4g"}',
            "--dataset.repo_id=hapnet/test", f"--dataset.root={data}", f"--dataset.num_episodes={EPISODES}",
            "--dataset.episode_time_s=3", "--dataset.reset_time_s=1", "--dataset.fps=60", "--dataset.single_task=follow",
            "--dataset.push_to_hub=false", "--dataset.video=false", "--play_sounds=false",
            log=tmp_path / "robot.log",
        )  # fmt: skip
        time.sleep(15.0)
        assert robot.poll() is None, (tmp_path / "robot.log").read_text("utf-8")
        hand_s = time.monotonic()
        hand = lerobot(
            "lerobot_teleoperate",
            "--teleop.type=hapnet_leader", f"--teleop.leader={led}",
            "--robot.type=hapnet", f"--robot.listen={address}", '--robot.params={"link.up": "4g"}',
            log=tmp_path / "hand.log",
        )  # fmt: skip
        try:
            ended = robot.wait(240.0)
        finally:
            hand.send_signal(signal.SIGINT)
            hand.wait(30.0)
            robot.kill()
    logs = [(tmp_path / f"{side}.log").read_text("utf-8") for side in ("robot", "hand")]
    log = "\n".join(one[-4000:] for one in logs)
    assert ended == 0, log
    verdicts = [line for one in logs for line in one.splitlines() if "account" in line or "passive" in line]
    follower, leader = told(tmp_path, "follower"), told(tmp_path, "leader")

    # no action without a peer, and the first is the arm's place
    assert follower["goals"][0][0] > hand_s
    first = np.subtract(follower["goals"][0][1], FOLLOWER)
    assert np.max(np.abs(first)) < 1.0

    read = subprocess.run([PYTHON, "-c", READ, str(data)], env=environment(), capture_output=True, cwd=tmp_path)
    found = json.loads(read.stdout)
    observed, acted = found["names"]
    assert sorted(observed) == sorted([f"{joint}.{kind}" for joint in JOINTS for kind in ("pos", "force")])
    assert acted == [f"{joint}.pos" for joint in JOINTS]
    assert sorted(set(found["episodes"])) == list(range(EPISODES))
    states, actions = np.array(found["states"]), np.array(found["actions"])
    forces = states[:, [observed.index(f"{joint}.force") for joint in JOINTS]]
    places = states[:, [observed.index(f"{joint}.pos") for joint in JOINTS]]
    has_force = np.any(forces != 0.0, axis=1)
    moves = int(np.argmax(has_force))
    without = int(np.sum(~has_force[moves:]))
    assert moves < 60, "the hand moves within a second"
    assert without <= EPISODES, "after a pause of LeRobot's, as it saves an episode, the arm is where the mass is"
    assert np.max(np.abs(forces)) > 0.02
    assert np.ptp(places, axis=0).min() > 5.0, "each joint follows the hand"

    times = np.array([one[0] for one in follower["goals"]])
    gaps = np.diff(times)
    fps = 1.0 / np.median(gaps)
    limits = [one for one in leader["limits"] if max(one[1]) > 0.0]
    steps = max(np.max(np.abs(np.subtract(b[1], a[1]))) for a, b in pairwise(follower["goals"]))
    print(
        f"\nfirst action {np.max(np.abs(first)):.2f} units from the arm; {len(states)} frames in {EPISODES} episodes, "
        f"{without} without force since the hand moves; {fps:.1f} fps (median), "
        f"{len(gaps) / (times[-1] - times[0]):.1f} (mean with saving); largest step of a goal {steps:.1f} units; "
        f"arm behind goal {np.sqrt(np.mean((actions - places) ** 2)):.2f} units rms; "
        f"forces up to {np.max(np.abs(forces)):.3f} Nm; {len(limits)} limits of {len(leader['goals'])} at the leader, "
        f"up to {max(max(one[1]) for one in limits):.2f} Nm; the leader's motors gave at most {sum(leader['most_J']):.3f} J"
    )
    assert fps >= 57.0
    assert len(limits) > 0.9 * len(leader["goals"])
