"""What viewers draw without configuration: Foxglove's own schemas, field by field, and what is written in them."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapnet.plant.worlds.picture import SOFT, part
from hapnet.recording.drawing import Drawing, SceneSample, pack
from hapnet.recording.foxglove import MOST_BODIES, MOST_VERTICES, bodies, shapes
from hapnet.recording.mcap import RecordingWriter, read_recording, repair
from hapnet.recording.samples import Event, Sample
from tests.recording.test_samples import META, ORIGIN, device_sample, world_sample
from tests.support.mcap_messages import messages

PUBLISHED = {  # number, name and type of fields, as Foxglove publishes them; of a scene some
    "foxglove.FrameTransform": "1 timestamp google.protobuf.Timestamp, 2 parent_frame_id string, "
    "3 child_frame_id string, 4 translation foxglove.Vector3, 5 rotation foxglove.Quaternion",
    "foxglove.PoseInFrame": "1 timestamp google.protobuf.Timestamp, 2 frame_id string, 3 pose foxglove.Pose",
    "foxglove.Log": "1 timestamp google.protobuf.Timestamp, 2 level foxglove.Log.Level, 3 message string, "
    "4 name string, 5 file string, 6 line fixed32",
    "foxglove.Pose": "1 position foxglove.Vector3, 2 orientation foxglove.Quaternion",
    "foxglove.Vector3": "1 x double, 2 y double, 3 z double",
    "foxglove.Quaternion": "1 x double, 2 y double, 3 z double, 4 w double",
    "foxglove.SceneUpdate": "2 entities foxglove.SceneEntity",
    "foxglove.SceneEntity": "1 timestamp google.protobuf.Timestamp, 2 frame_id string, 3 id string, "
    "5 frame_locked bool, 12 triangles foxglove.TriangleListPrimitive",
    "foxglove.TriangleListPrimitive": "1 pose foxglove.Pose, 2 points foxglove.Point3, 3 color foxglove.Color, "
    "5 indices fixed32",
    "foxglove.Point3": "1 x double, 2 y double, 3 z double",
    "foxglove.Color": "1 r double, 2 g double, 3 b double, 4 a double",
    "google.protobuf.Timestamp": "1 seconds int64, 2 nanos int32",
}
_TYPES = {1: "double", 3: "int64", 5: "int32", 7: "fixed32", 8: "bool", 9: "string"}
SQUARE = part([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]], (255, 0, 51, 102))
PARTS = (SQUARE, SQUARE._replace(body=0), SQUARE._replace(body=SOFT))
POSE = (0.25, 0.5, -1.0, 0.0, 0.0, 1.0, 0.0)
LATER_NS = 10**15
EVENTS = (
    Event(ORIGIN, "paired", "with the world"),
    Event(
        ORIGIN + 1,
        "overrun",
        "the servo stalled for 24.0 ms (machine too busy): no force until it is on time again",
        "warning",
    ),
    Event(ORIGIN + 2, "stopped", "the device renders no force any more: it left its workspace", "error"),
)


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A tenth of a second of a device with two axes, five steps of a world that is drawn, an event of each level."""
    path = tmp_path_factory.mktemp("foxglove") / "a.mcap"
    samples: list[Sample] = [device_sample(i) for i in range(100)] + [world_sample(i) for i in range(5)]
    samples += [Drawing(ORIGIN, pack(PARTS)), SceneSample(ORIGIN, np.array([POSE], "<f4").tobytes(), b"", b"")]
    writer = RecordingWriter(path, META | {"utc_origin_ns": ORIGIN + LATER_NS})
    for sample in [*samples, *EVENTS]:
        writer.write(sample)
    writer.close()
    return path


def kinds(descriptor: Any) -> dict[str, str]:
    """The fields of a message and of those in it, in the words of `PUBLISHED`."""
    found = {}
    for field in descriptor.fields:
        if field.message_type is not None:
            found |= kinds(field.message_type)
    words = [
        f"{field.number} {field.name} "
        + (field.message_type or field.enum_type or type("", (), {"full_name": _TYPES.get(field.type)})).full_name
        for field in descriptor.fields
    ]
    return {descriptor.full_name: ", ".join(words)} | found


def test_the_schemas_are_those_that_foxglove_publishes(file: Path) -> None:
    found = {}
    for topic, read in messages(file).items():
        if not topic.endswith(("/state", "/scene")):
            found |= kinds(read[0][1].DESCRIPTOR)
    assert found == PUBLISHED


def test_an_event_has_foxgloves_level(file: Path) -> None:
    lines = [line for _, line in messages(file)["/events"]]
    level = lines[0].DESCRIPTOR.enum_types_by_name["Level"]
    assert [name.name for name in level.values] == ["UNKNOWN", "DEBUG", "INFO", "WARNING", "ERROR", "FATAL"]
    assert [level.values_by_number[line.level].name for line in lines] == ["INFO", "WARNING", "ERROR"]
    assert tuple(read_recording(file).events) == EVENTS


def test_handle_and_proxy_are_frames_and_set_positions_are_poses_in_the_scene(file: Path) -> None:
    read = messages(file)
    utc_ns, handle = read["/device/frame"][2]
    sample = device_sample((utc_ns - ORIGIN - LATER_NS) // 1_000_000)
    assert (handle.parent_frame_id, handle.child_frame_id) == ("scene", "device")
    assert (handle.translation.x, handle.translation.y, handle.translation.z) == (*sample.position_m, 0.0)
    assert (handle.rotation.x, handle.rotation.y, handle.rotation.z, handle.rotation.w) == (0.0, 0.0, 0.0, 1.0)
    pose = read["/device/set_position"][2][1]
    assert pose.frame_id == "scene"
    assert (pose.pose.position.x, pose.pose.position.y) == sample.set_position_m
    assert pose.pose.orientation.w == 1.0
    assert read["/world/frame"][0][1].child_frame_id == "proxy"
    assert read["/world/set_position"][1][1].pose.position.x == world_sample(1).set_position_m[0]


def test_a_world_and_what_moves_in_it_are_entities_in_their_frames(file: Path) -> None:
    read = messages(file)
    [(utc_ns, update)] = read["/world/shapes"]
    rests, moves = update.entities
    assert (rests.frame_id, moves.frame_id) == ("scene", "body_1")  # what is soft has no frame
    assert rests.id != moves.id
    for entity in update.entities:
        assert entity.frame_locked
        assert entity.timestamp.ToNanoseconds() == utc_ns
        (surface,) = entity.triangles
        assert [(point.x, point.y, point.z) for point in surface.points] == [tuple(p) for p in SQUARE.vertices.tolist()]
        assert list(surface.indices) == [0, 1, 2, 0, 2, 3]
        assert (surface.color.r, surface.color.g, surface.color.b, surface.color.a) == (1.0, 0.0, 0.2, 0.4)
        assert surface.pose.orientation.w == 1.0
    [(_, frame)] = read["/world/body_1"]
    assert (frame.parent_frame_id, frame.child_frame_id) == ("scene", "body_1")
    assert (frame.translation.x, frame.translation.y, frame.translation.z) == POSE[:3]
    assert (frame.rotation.w, frame.rotation.y) == (0.0, 1.0)


def test_large_surfaces_and_further_bodies_are_left_out() -> None:
    large = part(np.zeros((MOST_VERTICES, 3)), np.zeros((0, 3)))
    found = shapes("/world/body", 1, (SQUARE._replace(body=MOST_BODIES), SQUARE, large, SQUARE._replace(body=1)))
    assert [frame for frame, _ in found.parts] == ["scene", "body_2"]
    assert len(list(bodies("/world/body", 1, [POSE] * 20))) == MOST_BODIES


def test_stamps_are_log_times_some_60_a_second(file: Path) -> None:
    read = messages(file)
    for topic, found in read.items():
        if not topic.endswith(("/state", "/scene", "/shapes")):
            assert [stamped.timestamp.ToNanoseconds() for _, stamped in found] == [at_ns for at_ns, _ in found]
    assert len(read["/device/frame"]) == len(read["/device/set_position"]) == 7  # 0, 16, ... 96 ms
    assert len(read["/world/frame"]) == 5


@pytest.mark.parametrize("change", [{"position_m": (float("nan"), 0.0)}, {"set_position_m": (float("inf"), 0.0)}])
def test_what_is_no_place_in_space_is_not_drawn(tmp_path: Path, change: dict[str, Any]) -> None:
    for name, sample in (("a", device_sample(0)._replace(**change)), ("b", device_sample(0, 4))):
        writer = RecordingWriter(tmp_path / f"{name}.mcap", META)
        writer.write(sample)
        writer.close()
        assert list(messages(tmp_path / f"{name}.mcap")) == ["/device/state"]


def test_readers_pass_over_them_and_a_repaired_copy_keeps_them(file: Path, tmp_path: Path) -> None:
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(file.read_bytes()[:-200])
    assert read_recording(file).device is not None
    assert len(messages(repair(torn))["/device/frame"]) == 7
