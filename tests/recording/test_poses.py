"""A tool that turns, as recordings, summaries, tables, figures and viewers have it, beside scipy's rotations."""

import csv
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hapnet.assembly.build import device_session, prepare, world_session
from hapnet.checks import Array
from hapnet.ext.pictures.run import figure
from hapnet.ext.pictures.scene import scene_figure
from hapnet.ext.study.case import measure
from hapnet.mechanics import pose
from hapnet.mechanics.pose import ARM_M, AXES
from hapnet.params import Params
from hapnet.recording.export import export
from hapnet.recording.mcap import RecordingWriter, read_recording
from hapnet.recording.poses import of_point, of_turning
from hapnet.recording.samples import DeviceSample, Recording
from hapnet.simulation.result import Result
from hapnet.simulation.simulation import simulate
from hapnet.summary.from_samples import LiveFigures
from hapnet.summary.structure import read
from hapnet.summary.tables import brief, motion
from hapnet.wire.events import Mismatch
from tests.support.mcap_messages import messages
from tests.support.sessions import MS, Network

HERE = "tests.recording.test_poses"
TABLE = "tool:box?size=60mm,40mm,20mm + plane?normal=0,0,-1&at=0,0,-20mm"


def twelve(position: object, velocity: object, time: float) -> list[float]:
    """Twelve axes in metres that are no pose."""
    return [0.0] * AXES


def params(**more: object) -> Params:
    own = {"scene": TABLE, "duration_s": 2.0, "operator_model.turn_rad": 0.4, "operator_model.turn_hz": 1.0}
    return Params().set({**own, **more})


@pytest.fixture(scope="module")
def result() -> Result:
    return simulate(params(), 3)


def rotations(x: Array) -> Rotation:
    """Of the arms, which here are orthogonal."""
    arms = np.eye(3) + x[:, 3:].reshape(-1, 3, 3) / ARM_M
    return Rotation.from_matrix(np.swapaxes(arms, 1, 2))


def torques(x: Array, f: Array) -> Array:
    arms = ARM_M * np.eye(3) + x[:, 3:].reshape(-1, 3, 3)
    return np.asarray(np.cross(arms, f[:, 3:].reshape(-1, 3, 3)).sum(axis=1))


def test_the_world_says_that_it_is_a_pose_and_no_other_is(result: Result) -> None:
    assert result.summary["units"] == result.recording.meta["params"]["units"] == "pose"
    plain = simulate({"scene": f"{HERE}:twelve", "dof": AXES, "duration_s": 0.1, "operator": "rest"})
    assert plain.summary["units"] == "m"
    assert of_turning(plain.recording) is None
    assert of_point(plain.recording) is plain.recording
    assert plain.summary["motion"]["peak_torque_Nm"] is None


def test_a_pose_and_twelve_axes_refuse_each_other() -> None:
    plain = prepare(Params().set({"scene": f"{HERE}:twelve", "dof": AXES, "operator": "rest", "rendering": "paper"}))
    turns = prepare(params(rendering="paper"))
    network = Network(device_session(plain, 1, "pen"), world_session(turns, 2, "table"))
    network.run(1000 * MS)
    told = [e.reason for s in network.sessions for e in network.happened(s, Mismatch) if isinstance(e, Mismatch)]
    assert "table has axes in pose, pen in m: both must have the same" in told


def test_the_summary_has_angles_and_torques(result: Result) -> None:
    device, world = result.recording.device, result.recording.world
    moved = result.summary["motion"]
    torque = np.linalg.norm(torques(device["position_m"], device["force_N"]), axis=1)
    assert moved["peak_torque_Nm"] == pytest.approx(torque.max(), rel=1e-12)
    assert moved["peak_force_N"] == pytest.approx(np.linalg.norm(device["force_N"][:, :3], axis=1).max(), rel=1e-12)
    known = (device["time_s"] >= world["time_s"][0]) & (device["time_s"] <= world["time_s"][-1])
    times = device["time_s"][known]
    proxy = np.column_stack([np.interp(times, world["time_s"], axis) for axis in world["position_m"].T])
    # between two samples the nearest rotation is not on scipy's way to 1e-4
    angles = (rotations(device["position_m"][known]).inv() * rotations(proxy)).magnitude()
    inside = world["penetration_m"][np.searchsorted(world["time_s"], times, side="right") - 1] > 0.0
    assert inside.any()
    assert moved["contact_rms_rad"] == pytest.approx(np.sqrt(np.mean(angles[inside] ** 2)), rel=1e-3)
    assert moved["free_rms_rad"] == pytest.approx(np.sqrt(np.mean(angles[~inside] ** 2)), rel=1e-3)
    live = LiveFigures("pose")
    for sample in result.recording.samples():
        if isinstance(sample, DeviceSample):
            live.see(sample)
    assert live.motion()["peak_torque_Nm"] == pytest.approx(torque.max(), rel=1e-12)


def test_the_text_says_degrees_and_newton_metres(result: Result) -> None:
    lines = brief(read(result.summary))
    assert "° free" in lines[0]
    assert lines[1].split(",")[0].endswith(" Nm")
    assert lines[2].endswith("through springs of 600 and 500 N/m, 1.92 and 1.6 Nm/rad")  # 2 K l^2
    labels = {label for label, *_ in motion(read(result.summary)).rows}
    assert {"angle between, free (rms) [°]", "torque, largest [Nm]"} <= labels


def test_what_turns_is_rotation_vectors_and_torques(result: Result) -> None:
    turning, whole = of_turning(result.recording), result.recording.device
    x = whole["position_m"]
    assert turning.device["position_m"] == pytest.approx(rotations(x).as_rotvec(), abs=1e-9)
    assert turning.device["force_N"] == pytest.approx(torques(x, whole["force_N"]), abs=1e-12)
    v = turning.device["velocity_mps"]
    arms = (ARM_M * np.eye(3) + x[:, 3:].reshape(-1, 3, 3), whole["velocity_mps"][:, 3:].reshape(-1, 3, 3))
    assert np.cross(v[:, None], arms[0]) == pytest.approx(arms[1], abs=1e-9)  # P' = w x P
    assert np.isnan(pose.rotation([np.nan] * AXES)).all()


def test_tables_and_viewers_have_positions_quaternions_forces_and_torques(result: Result, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    writer = RecordingWriter(path, result.recording.meta)
    for sample in result.recording.samples():
        writer.write(sample)
    writer.close(result.summary)
    whole: Recording = read_recording(path)
    expected = rotations(whole.device["position_m"]).as_quat(canonical=True, scalar_first=True)
    with export(whole, tmp_path, format="csv")[0].open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    for name in ("position_m_z", "force_N_x", "torque_Nm_x", "spring_torque_Nm_y", "velocity_radps_z"):
        assert name in rows[0]
    assert not [name for name in rows[0] if name.endswith(("_3", "_11"))]
    table = [[float(row[f"position_quaternion_{axis}"]) for axis in "wxyz"] for row in rows]
    assert np.array(table) == pytest.approx(expected, abs=1e-9)
    frames = messages(path)["/device/frame"]
    assert len(frames) > 100
    for utc_ns, frame in frames:
        at = int(np.searchsorted(whole.device["time_ns"], utc_ns))
        turn, moved = frame.rotation, frame.translation
        assert (turn.w, turn.x, turn.y, turn.z) == pytest.approx(expected[at], abs=1e-9)
        assert (moved.x, moved.y, moved.z) == tuple(whole.device["position_m"][at, :3])
    shown = messages(path)["/world/set_position"]
    assert max(abs(1.0 - one.pose.orientation.w) for _, one in shown) > 1e-3


def test_the_figure_has_rotation_and_torque(result: Result) -> None:
    labels = [panel.get_ylabel() for panel in figure(result.recording).axes]
    assert [label.partition(" ")[0] for label in labels[:4]] == ["position", "force", "rotation", "torque"]
    assert labels[2].endswith("[°]")
    assert labels[3].endswith("[Nm]")


def test_the_scene_is_drawn_and_a_free_tool_feels_no_wall(result: Result) -> None:
    drawn = scene_figure(result.recording)
    assert drawn.axes[0].get_zlabel() == "z [mm]"
    assert prepare(params(scene="tool:stick")).felt["stiffness_N_m"] is None
    assert prepare(params(scene="tool:stick + plane?at=0,0,-60mm&stiffness=2000")).felt["stiffness_N_m"] == 2000.0


@pytest.mark.slow
def test_a_case_has_angles_and_the_errors_of_the_torque() -> None:
    found = measure(params(**{"link.up": "4g", "link.down": "4g"}), 3)
    for name in ("free_rms_mm", "free_rms_deg", "true_force_error_percent", "true_torque_error_percent",
                 "torque_step_Nm", "peak_torque_Nm"):  # fmt: skip
        value = found[name]
        assert value > 0.0
    flat = measure(Params().set({"scene": "wall", "duration_s": 0.5}), 3)
    assert flat["free_rms_deg"] is flat["torque_step_Nm"] is flat["true_torque_error_percent"] is None
