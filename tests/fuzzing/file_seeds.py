"""Files that can be read, of every kind that a user may be handed: what the fuzzer of files breaks."""

import io
import random
import struct
import tempfile
import tomllib
from pathlib import Path

import numpy as np

from hapnet.ext.study.journal import NAME, Journal
from hapnet.ext.study.spec import Spec
from hapnet.ext.study.task import CaseResult
from hapnet.params import Params
from hapnet.recording.mcap import save
from hapnet.simulation.simulation import Simulation

HERE = Path(__file__).parents[1]


def seeds(kind: str) -> list[tuple[str, bytes]]:
    """What is mutated: the endings of files of this kind, and their contents."""
    array = io.BytesIO()
    np.save(array, np.linalg.norm(np.mgrid[-2:3, -2:3, -2:3], axis=0) - 1.5)
    if kind == "recording":
        return [(".mcap", one) for one in _recordings()]
    return {
        "mesh": _meshes(),
        "urdf": [(".urdf", _URDF.encode())],
        "toml": [(".toml", Params().toml().encode()), (".toml", _STUDY.encode())],
        "npy": [(".npy", array.getvalue())],
        "mujoco": [(".xml", _ARM.encode()), (".xml", (HERE.parent / "examples/dominoes.xml").read_bytes())],
        "journal": _journals() if kind == "journal" else [],
    }[kind]


def _journals() -> list[tuple[str, bytes]]:
    spec = Spec.of_tables("a study", tomllib.loads(_STUDY))
    with tempfile.TemporaryDirectory() as room:
        journal = Journal.create_or_resume(Path(room), spec, spec.cases())
        results = [CaseResult(case.number, {"margin_J": 0.1}, wall_s=0.2, worker="x") for case in journal.pending()[:9]]
        journal.record([*results, CaseResult(9, {}, "it failed")])
        journal.close()
        return [(NAME, (Path(room) / NAME).read_bytes())]


def _recordings() -> list[bytes]:
    room = Path("/dev/shm" if Path("/dev/shm").is_dir() else ".")
    recordings = [(HERE / "data" / "recording-0.1.0.mcap").read_bytes()]
    for changes in ({"duration_s": 0.2, "record_hz": 200.0}, {"duration_s": 0.1, "scene": "box", "record_hz": 100.0}):
        file = room / f"seed-{random.getrandbits(64):x}.mcap"
        save(Simulation(Params().set(changes), 1, kernel=False).run().recording, file)
        recordings.append(file.read_bytes())
        file.unlink()
    return recordings


_URDF = """<?xml version="1.0"?>
<robot name="two">
  <link name="base"/>
  <link name="upper"><inertial><origin xyz="0.1 0 0" rpy="0 0 0"/><mass value="0.5"/>
    <inertia ixx="0.001" iyy="0.002" izz="0.002" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="lower"><inertial><origin xyz="0.1 0 0"/><mass value="0.3"/>
    <inertia ixx="0.001" iyy="0.001" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="tip"><inertial><origin xyz="0.02 0 0"/><mass value="0.1"/>
    <inertia ixx="0.0001" iyy="0.0001" izz="0.0001" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="one" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 0 1"/>
    <limit lower="-1.5" upper="1.5" effort="5" velocity="3"/><dynamics damping="0.01"/></joint>
  <joint name="two" type="revolute"><parent link="upper"/><child link="lower"/><origin xyz="0.2 0 0"/>
    <axis xyz="0 1 0"/><limit lower="-1.5" upper="1.5" effort="5" velocity="3"/></joint>
  <joint name="three" type="continuous"><parent link="lower"/><child link="tip"/><origin xyz="0.2 0 0" rpy="0 0.1 0"/>
    <axis xyz="0 1 0"/><limit effort="5" velocity="3"/></joint>
</robot>
"""

_ARM = """<mujoco model="arm">
  <compiler angle="radian"/><option timestep="0.002"/>
  <default><geom size="0.01" mass="0.1"/></default>
  <worldbody>
    <body name="upper" pos="0.2 0 0"><joint name="one" axis="0 0 1" range="-1 1" damping="0.1"/>
      <geom type="capsule" fromto="0 0 0 0.1 0 0"/>
      <body name="lower" pos="0.1 0 0"><joint name="two" type="slide" axis="1 0 0" range="0 0.1"/>
        <geom type="sphere"/><site name="tip" pos="0.1 0 0"/></body></body>
  </worldbody>
  <actuator><position joint="one" kp="10"/><motor joint="two" gear="2"/></actuator>
  <equality><joint joint1="one" joint2="two" polycoef="0 1 0 0 0"/></equality>
  <keyframe><key name="home" qpos="0.1 0.02" ctrl="0 0"/></keyframe>
</mujoco>
"""

_STUDY = """[vary]
coupling = ["pspm", "zoh"]
"link.up" = ["", "delay 40ms 10ms loss 2%"]
"world.wall.stiffness" = { from = 1000, to = 3000, steps = 3 }
[fixed]
duration_s = 2.0
"""


def _meshes() -> list[tuple[str, bytes]]:
    corners = [(x, y, z) for x in (0, 20) for y in (0, 20) for z in (0, 20)]
    faces = [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1), (2, 3, 7), (2, 7, 6), (0, 2, 6),
             (0, 6, 4), (1, 5, 7), (1, 7, 3)]  # fmt: skip
    loops = "".join(
        "facet normal 0 0 0\nouter loop\n" + "".join("vertex {} {} {}\n".format(*corners[k]) for k in face)
        + "endloop\nendfacet\n" for face in faces
    )  # fmt: skip
    binary = bytes(80) + struct.pack("<I", len(faces))
    binary += b"".join(struct.pack("<12fH", 0, 0, 0, *[v for k in face for v in corners[k]], 0) for face in faces)
    obj = "".join(f"v {x} {y} {z}\n" for x, y, z in corners) + "".join(
        f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in faces
    )
    heading = (
        f"ply\nformat {{}} 1.0\nelement vertex {len(corners)}\nproperty float x\nproperty float y\nproperty float z\n"
    )
    heading += f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    rows = "".join(f"{x} {y} {z}\n" for x, y, z in corners) + "".join(f"3 {a} {b} {c}\n" for a, b, c in faces)
    packed = b"".join(struct.pack("<3f", *one) for one in corners)
    packed += b"".join(struct.pack("<B3i", 3, *face) for face in faces)
    ply = heading.format("binary_little_endian").encode() + packed
    return [
        (".stl", f"solid a\n{loops}endsolid a\n".encode()),
        (".stl", binary),
        (".obj", obj.encode()),
        (".ply", (heading.format("ascii") + rows).encode()),
        (".ply", ply),
    ]
