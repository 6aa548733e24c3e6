"""The picture of an arm: its links are where the arm is, whatever drew it."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hapnet.checks import Array
from hapnet.ext.arms.device import SimulatedArm
from hapnet.ext.arms.picture import ArmPicture, described
from hapnet.ext.arms.table import omni
from hapnet.ext.pictures.scene import scene_figure
from hapnet.params import Params
from hapnet.plant.operator import Impedance, Sine
from hapnet.plant.worlds.picture import RESTS
from hapnet.recording.frames import table
from hapnet.recording.mcap import RecordingWriter, read_recording
from hapnet.simulation.simulation import simulate
from tests.plant.arms.references import in_mujoco, random_arm


def turned(quaternion: Array) -> Array:
    import mujoco

    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)


@pytest.mark.parametrize("slides", [(), (0, 4)])
def test_seven_links_are_where_mujoco_has_them(slides: tuple[int, ...]) -> None:
    """Each capsule goes from its joint to the next one, and the last to the tip; counted from the tip at home. A
    slide's link is away from the end of the capsule before it."""
    import mujoco

    rng = np.random.default_rng(3)
    table = random_arm(rng, 7, slides)
    home = (1.5, 0.0, 0.0, 0.0, -2.0, 0.0, 0.0)
    table = replace(table, home=home) if slides else table
    picture = ArmPicture(json.loads(json.dumps(described(table, True))))
    model, data = in_mujoco(table)
    data.qpos[:] = table.home
    mujoco.mj_forward(model, data)
    origin = data.site_xpos[0].copy()
    base, *links = picture.parts
    assert base.body == RESTS
    for _ in range(20):
        q = rng.uniform(-2.0, 2.0, 7)
        data.qpos[:] = q
        mujoco.mj_forward(model, data)
        poses = picture.poses(q.tolist())
        assert np.abs(poses[:, :3] - (data.xpos[1:] - origin)).max() <= 1e-12
        assert picture.tip((q - table.home).tolist()) == pytest.approx(data.site_xpos[0] - origin, abs=1e-12)
        ends = np.vstack([poses[1:, :3], data.site_xpos[0] - origin])
        for k, (part, pose, end) in enumerate(zip(links, poses, ends, strict=True), 1):
            if k in slides:
                continue
            placed = part.vertices @ turned(pose[3:]).T + pose[:3]
            middle = 0.5 * (placed.min(axis=0) + placed.max(axis=0))
            assert np.abs(middle - 0.5 * (pose[:3] + end)).max() < 1e-6
            size = placed.max(axis=0) - placed.min(axis=0) - np.abs(end - pose[:3])
            assert np.ptp(size) < 2e-3  # the capsule's width, as its sides let it be seen


def test_a_held_tip_has_the_recorded_posture_and_before_it_that_at_home() -> None:
    """Of three joints and of seven, whose posture the tip does not tell; MuJoCo has the same tip there."""
    import mujoco

    for arm_table in (omni(), random_arm(np.random.default_rng(1), 7)):
        arm = SimulatedArm(arm_table, Sine(3, Impedance(), 0.02, 1.0, start_s=0.2))
        picture = ArmPicture(described(arm_table, False))
        assert picture.angles((), ()) == arm_table.home
        model, data = in_mujoco(arm_table)
        data.qpos[:] = arm_table.home
        mujoco.mj_forward(model, data)
        home = data.site_xpos[0].copy()
        for _ in range(150):
            arm.advance()
        data.qpos[:] = arm.posture
        mujoco.mj_forward(model, data)
        poses = picture.poses(picture.angles(arm.position, arm.posture))
        assert np.abs(poses[:, :3] - (data.xpos[1:] - home)).max() <= 1e-12
        assert data.site_xpos[0] - home == pytest.approx(arm.position, abs=1e-12)
        assert np.abs(np.subtract(arm.posture, arm_table.home)).max() > 1e-3


def test_what_describes_no_arm_has_no_picture() -> None:
    for broken in ({}, {"arm": 3}, {"arm": {"joints": "no", "tip": [], "home": []}}, {"arm": None}):
        assert ArmPicture.of(broken) is None


def test_recordings_and_figures_have_the_links(tmp_path: Path) -> None:
    """Frames for viewers, 60 a second; of joints no frame of a handle, whose position is no place."""
    from mcap.reader import make_reader

    topics = {}
    for name, scene in (("omni", "wall"), ("omni?axes=joints", "joints")):
        by_joints = scene == "joints"
        changes = {"hardware": name, "scene": scene, "duration_s": 0.3, "device.substeps": 1}
        recording = simulate(Params().set(changes), 1).recording
        path = tmp_path / f"{scene}.mcap"
        writer = RecordingWriter(path, recording.meta)
        for sample in recording.samples():
            writer.write(sample)
        writer.close()
        with path.open("rb") as file:
            summary = make_reader(file).get_summary()
        counts = summary.statistics.channel_message_counts
        topics[scene] = {channel.topic: counts[number] for number, channel in summary.channels.items()}
        assert scene_figure(recording) is not None
        back = read_recording(path)
        assert back.posture == recording.posture
        assert bool(recording.posture) != by_joints
        assert ("joint_3_rad" in table(recording)) != by_joints
        if not by_joints:
            assert [one.time_ns for one in recording.posture] == recording.device["time_ns"].tolist()
            assert table(recording)["joint_2_rad"][-1] == recording.posture[-1].angles_rad[1]
    for found in topics.values():
        assert 15 <= found["/device/link_1"] == found["/device/link_2"] == found["/device/link_3"] <= 20
        assert found["/device/shapes"] == 1
    assert "/device/frame" in topics["wall"]
    assert not {"/device/frame", "/world/frame"} & topics["joints"].keys()
