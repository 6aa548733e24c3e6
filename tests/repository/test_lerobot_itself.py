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
EPISODES, EPISODE_S = 10, 3
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
def arm(kind: str, folder: Path, starts: tuple[float, ...], *more: str) -> Iterator[str]:
    """An emulated arm; yields LeRobot's options of it, in braces."""
    link = folder / kind
    command = [sys.executable, "-m", "tests.support.so101", kind, str(link), "400", ",".join(map(str, starts)), *more]
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE)
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == b"ready\n"
        calibration(folder / "calibration", kind)
        place = f"port: {os.readlink(link)}, calibration_dir: {folder}/calibration"
        yield f"{{type: so101_{kind}, id: {kind}, {place}, {PATIENT}}}"
    finally:
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=20.0)


def told(folder: Path, kind: str) -> Any:
    return json.loads((folder / f"{kind}.json").read_text("utf-8"))


HAND = ("lerobot_teleoperate", "--teleop.type=hapnet_leader", "--robot.type=hapnet", '--robot.params={"link.up": "4g"}')
ROBOT = ("--robot.type=hapnet_arm", "--teleop.type=hapnet", '--teleop.params={"link.down": "4g"}')


def texts(folder: Path) -> str:
    return "\n".join((folder / f"{side}.log").read_text("utf-8")[-4000:] for side in ("robot", "hand"))


def test_ten_episodes_with_force_over_4g(tmp_path: Path) -> None:
    """The two commands of the page, with lerobot-record on the robot's host and a leader that feels."""
    address, data = free_address(), tmp_path / "data"
    with arm("leader", tmp_path, LEADER) as led, arm("follower", tmp_path, FOLLOWER) as followed:
        robot = lerobot(
            "lerobot_record", *ROBOT, f"--robot.arm={followed}", f"--teleop.connect={address}",
            "--dataset.repo_id=hapnet/test", f"--dataset.root={data}", f"--dataset.num_episodes={EPISODES}",
            f"--dataset.episode_time_s={EPISODE_S}", "--dataset.reset_time_s=1", "--dataset.fps=60",
            "--dataset.single_task=follow", "--dataset.push_to_hub=false", "--dataset.video=false",
            "--play_sounds=false", log=tmp_path / "robot.log",
        )  # fmt: skip
        time.sleep(15.0)
        assert robot.poll() is None, (tmp_path / "robot.log").read_text("utf-8")
        hand_s = time.monotonic()
        hand = lerobot(*HAND, f"--teleop.leader={led}", f"--robot.listen={address}", log=tmp_path / "hand.log")
        try:
            until = time.monotonic() + 240.0
            while robot.poll() is None and hand.poll() is None and time.monotonic() < until:
                time.sleep(0.2)
            ended = robot.poll()
        finally:
            hand.send_signal(signal.SIGINT)
            hand.wait(30.0)
            robot.kill()
    assert ended == 0, texts(tmp_path)
    follower, leader = told(tmp_path, "follower"), told(tmp_path, "leader")

    assert follower["goals"][0][0] > hand_s, "no action without a peer"
    first = float(np.max(np.abs(np.subtract(follower["goals"][0][1], FOLLOWER))))
    assert first < 1.0, "the first action is the arm's place"

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
    assert without == 0
    assert np.ptp(places, axis=0).min() > 5.0, "each joint follows the hand"

    rate = len(states) / (EPISODES * EPISODE_S)
    limits = [one for one in leader["limits"] if max(one[1]) > 0.0]
    steps = max(np.max(np.abs(np.subtract(b[1], a[1]))) for a, b in pairwise(follower["goals"]))
    behind = np.sqrt(np.mean((actions - places) ** 2))
    print(
        f"\nfirst action {first:.2f} units from the arm; {len(states)} frames in {EPISODES} episodes, all with force "
        f"since the hand moves; {rate:.1f} frames a second; largest step {steps:.1f} units; arm behind its goal "
        f"{behind:.2f} units rms; forces up to {np.max(np.abs(forces)):.3f} Nm; {len(limits)} forces in "
        f"{len(leader['goals'])} frames at the leader, up to {max(max(one[1]) for one in limits):.2f} Nm; its motors "
        f"gave at most {1e3 * sum(leader['most_J']):.1f} mJ and took {-sum(leader['work_J']):.1f} J"
    )
    assert rate / 60.0 >= 0.95, "LeRobot's loop keeps its rate"
    assert len(limits) > 0.9 * len(leader["goals"])
    assert sum(leader["most_J"]) < 0.25, "the theorem's bound: both ceilings, 0.2 J and 0.05 J"


def test_a_leader_of_position_servos_feels_where_the_arm_is_blocked(tmp_path: Path) -> None:
    """Statics: the hand's spring (3 Nm/rad, 20 degrees away) against the coupling's two in series (each 2 Nm/rad),
    which end at the blocked joint, 5 degrees away. The gripper is blocked too, as by an object."""
    stops = "5,90,90,90,90,5"
    both = np.array([0, 5])
    address = free_address()
    with (
        arm("leader", tmp_path, LEADER, "push") as led,
        arm("follower", tmp_path, FOLLOWER, "sine", stops) as followed,
    ):
        more = ("--teleop_time_s=25",)
        robot = lerobot(
            "lerobot_teleoperate", *ROBOT, f"--robot.arm={followed}", f"--teleop.connect={address}", *more,
            log=tmp_path / "robot.log",
        )  # fmt: skip
        hand = lerobot(*HAND, f"--teleop.leader={led}", f"--robot.listen={address}", *more, log=tmp_path / "hand.log")
        assert (hand.wait(120.0), robot.wait(120.0)) == (0, 0), texts(tmp_path)
    leader, follower = told(tmp_path, "leader"), told(tmp_path, "follower")
    began_s = leader["goals"][0][0]
    steady = [one for one in leader["goals"] if 12.0 < one[0] - began_s < 20.0]
    place = np.subtract([one[2] for one in steady], LEADER).mean(axis=0)
    force = np.mean([one[1] for one in leader["limits"] if 12.0 < one[0] - began_s < 20.0], axis=0)
    arm_at = np.subtract([one[2] for one in follower["goals"]][-200], FOLLOWER)
    print(f"\nhand at {place.round(1)} degrees, force {force.round(3)} Nm, arm at {arm_at.round(1)}")
    assert arm_at[both] == pytest.approx(5.0, abs=0.3)
    at = (3.0 * 20.0 + 1.0 * 5.0) / 4.0
    assert place[both] == pytest.approx(at, abs=1.0)
    assert force[both] == pytest.approx(3.0 * np.radians(20.0 - at), rel=0.15)
    free = np.setdiff1d(np.arange(6), both)
    assert place[free] == pytest.approx(20.0, abs=1.0)
    assert np.max(force[free]) < 0.25 * np.min(force[both])
