"""A recording as a rosbag2: what a reader finds there, and the bytes of messages by the rules of plain CDR.

The bytes are those of OMG's CDR (little endian, version 1): four bytes of encapsulation, then each number aligned to
its size from there on; a text is its length with the zero that ends it.
"""

import struct
from pathlib import Path

import numpy as np
import pytest

from hapnet import simulate
from hapnet.cli import main
from hapnet.recording.export import export
from hapnet.recording.frames import table
from hapnet.recording.rosbag import FRAME
from hapnet.recording.samples import Recording

highlevel = pytest.importorskip("rosbags.highlevel")


def aligned(data: bytes, size: int) -> bytes:
    return data + bytes(-len(data) % size)


def header(time_ns: int) -> bytes:
    """std_msgs/Header: seconds (int32), nanoseconds (uint32), frame (text)."""
    name = FRAME.encode() + b"\0"
    return struct.pack("<iII", time_ns // 10**9, time_ns % 10**9, len(name)) + name


def numbers(data: bytes, *values: float) -> bytes:
    return aligned(data, 8) + struct.pack(f"<{len(values)}d", *values)


def made(path: Path) -> Path:
    path.mkdir()
    return path


ENCAPSULATED = b"\0\1\0\0"


@pytest.fixture(scope="module")
def run() -> Recording:
    return simulate({"scene": "free", "dof": 2, "operator": "hand-21", "duration_s": 1.5}, 1).recording


def found(path: Path) -> dict[str, list[tuple[int, bytes, str]]]:
    messages: dict[str, list[tuple[int, bytes, str]]] = {}
    with highlevel.AnyReader([path]) as reader:
        for connection, time_ns, raw in reader.messages():
            reader.deserialize(raw, connection.msgtype)
            messages.setdefault(connection.topic, []).append((time_ns, bytes(raw), connection.msgtype))
    return messages


def test_its_bytes_are_those_of_cdr(run: Recording, tmp_path: Path) -> None:
    (path,) = export(run, tmp_path, format="rosbag2")
    bag, columns = found(path), table(run, "device")
    pose, twist, wrench = (bag[f"/device/{name}"] for name in ("pose", "twist", "wrench"))
    for k in (0, 17, len(pose) - 1):
        x, y = columns["position_m_x"][k], columns["position_m_y"][k]
        time_ns = int(columns["time_ns"][k])
        assert pose[k][:2] == (time_ns, ENCAPSULATED + numbers(header(time_ns), x, y, 0.0, 0.0, 0.0, 0.0, 1.0))
        v = columns["velocity_mps_x"][k], columns["velocity_mps_y"][k]
        assert twist[k][1] == ENCAPSULATED + numbers(header(time_ns), *v, 0.0, 0.0, 0.0, 0.0)
        f = columns["force_N_x"][k], columns["force_N_y"][k]
        assert wrench[k][1] == ENCAPSULATED + numbers(header(time_ns), *f, 0.0, 0.0, 0.0, 0.0)
    assert {kind for *_, kind in pose} == {"geometry_msgs/msg/PoseStamped"}
    assert len(bag["/world/contact"]) == len(bag["/world/pose"]) == len(table(run, "world")["time_ns"])


def test_the_account_is_a_diagnosis_once_a_second(run: Recording, tmp_path: Path) -> None:
    (path,) = export(run, tmp_path, format="rosbag2")
    texts = [raw for _, raw, _ in found(path)["/diagnostics"]]
    assert sum(b"hapnet: account of the device" in raw for raw in texts) == 2
    assert all(b"margin_J" in raw for raw in texts if b"hapnet: account" in raw)


def test_joints_and_orientations(tmp_path: Path) -> None:
    link = {"link.up": "lan", "link.down": "lan", "duration_s": 1.0}
    twin = simulate({"scene": "joints", "hardware": "omni?axes=joints", "operator": "sine", **link}).recording
    (path,) = export(twin, made(tmp_path / "joints"), format="rosbag2")
    bag, columns = found(path), table(twin, "device")
    _, raw, kind = bag["/device/joint_states"][5]
    assert kind == "sensor_msgs/msg/JointState"
    angles = [columns[f"position_rad_{axis}"][5] for axis in "xyz"]
    assert struct.pack("<I", 3) in raw
    assert struct.pack("<3d", *angles) in raw
    assert "/device/pose" not in bag
    tool = simulate({"scene": "tool:stick", "operator": "sine", **link}).recording
    (path,) = export(tool, made(tmp_path / "tool"), format="rosbag2")
    raw = found(path)["/device/pose"][9][1]
    w, x, y, z = (table(tool, "device")[f"position_quaternion_{axis}"][9] for axis in "wxyz")
    assert raw.endswith(struct.pack("<4d", x, y, z, w))
    assert np.hypot.reduce([w, x, y, z]) == pytest.approx(1.0)


def test_a_user_exports_once(run: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from hapnet.recording.mcap import save

    save(run, tmp_path / "run.mcap")
    assert main(["export", str(tmp_path / "run.mcap"), "--format", "rosbag2"]) == 0
    assert (tmp_path / "rosbag2" / "metadata.yaml").is_file()
    capsys.readouterr()
    assert main(["export", str(tmp_path / "run.mcap"), "--format", "rosbag2"]) != 0
    assert "already exists" in capsys.readouterr().err
    assert main(["export", str(tmp_path / "run.mcap"), "--format", "bag"]) == 2
    assert "rosbag2" in capsys.readouterr().err
