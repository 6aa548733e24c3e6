"""Recordings as files: what was written is read, by viewers and by other versions too."""

import dataclasses
import json
import math
import re
import struct
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from google.protobuf import descriptor_pb2
from mcap.reader import make_reader
from mcap.records import Chunk, Metadata
from mcap.stream_reader import StreamReader
from mcap.writer import Writer

from hapnet.errors import RecordingError
from hapnet.recording.mcap import CHUNK_BYTES, RecordingWriter, read_recording, save
from hapnet.recording.samples import DeviceSample, Event, Sample, WorldSample, join
from tests.recording.test_samples import META, ORIGIN, device_sample, halves, memory, run, same
from tests.support.mcap_messages import messages


def write(path: Path, samples: list[Sample]) -> None:
    writer = RecordingWriter(path, META)
    for sample in samples:
        writer.write(sample)
        writer.flush(sample.time_ns)
    writer.close({"seed": 7})


@pytest.mark.parametrize("n", [1, 2, 3])
def test_what_is_read_is_what_was_written(tmp_path: Path, n: int) -> None:
    write(tmp_path / "a.mcap", run(n))
    recording = read_recording(tmp_path / "a.mcap")
    assert not recording.torn
    assert recording.device["position_m"].shape == (300, n)
    assert recording.device["position_m"][7].tolist() == list(device_sample(7, n).position_m)
    assert recording.device["time_ns"][1] == ORIGIN + 1_000_000
    assert recording.device["time_s"][7] == 0.007
    assert np.isnan(recording.device["operator_force_N"][1]).all()
    assert recording.events[0] == Event(ORIGIN, "paired", "session ‘a’")
    assert recording.meta == META
    assert recording.summary == {"seed": 7}
    assert same(recording, memory(run(n)))
    save(recording, tmp_path / "b.mcap")
    assert same(recording, read_recording(tmp_path / "b.mcap"))
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.mcap", "b.mcap"]


def test_numbers_that_are_not_finite(tmp_path: Path) -> None:
    """A message's stay as they are; JSON has none, so in settings and summary they become null."""
    sample = device_sample(1)._replace(margin_J=math.inf, target_m=(math.nan, 1.0))
    writer = RecordingWriter(tmp_path / "a.mcap", {**META, "limit": math.inf, "K": np.eye(2)})
    writer.write(sample)
    writer.close({"min": -math.inf, "x": np.float64(2.0), "path": tmp_path})
    recording = read_recording(tmp_path / "a.mcap")
    assert recording.device["margin_J"][0] == math.inf
    np.testing.assert_array_equal(recording.device["target_m"][0], [math.nan, 1.0])
    assert recording.meta["limit"] is None
    assert recording.meta["K"] == [[1.0, 0.0], [0.0, 1.0]]
    assert recording.summary == {"min": None, "x": 2.0, "path": str(tmp_path)}


TEXTS = {  # what viewers must find: the fields of a two-axis device and world, with their units
    "/device/state": "position_x_m position_y_m set_position_x_m set_position_y_m target_x_m target_y_m force_x_N "
    "force_y_N operator_force_x_N operator_force_y_N reservoir_J deficit_J potential_J sent_J credited_J margin_J "
    "slack_J operator_target_x_m operator_target_y_m spring_force_x_N spring_force_y_N damper_force_x_N "
    "damper_force_y_N model_force_x_N model_force_y_N added_damping_force_x_N added_damping_force_y_N "
    "velocity_x_mps velocity_y_mps age_s transit_s bound_J work_J stored_J account_J operator_work_J",
    "/world/state": "step_s position_x_m position_y_m velocity_x_mps velocity_y_mps set_position_x_m set_position_y_m "
    "target_x_m target_y_m coupling_force_x_N coupling_force_y_N contact_force_x_N contact_force_y_N penetration_m "
    "reservoir_J potential_J sent_J credited_J margin_J slack_J age_s transit_s bound_J work_J stored_J account_J",
}
UNITS = ("_m", "_mps", "_s", "_N", "_J")
FOR_VIEWERS = {  # further topics that only viewers read, at most every 16 ms (tests/recording/test_foxglove.py)
    f"/{side}/{name}" for side in ("device", "world") for name in ("frame", "set_position")
}


def decoded(descriptor: bytes, data: bytes) -> dict[str, float]:
    """A message of doubles by its descriptor, read without hapnet: texts of the one, tags and doubles of the other."""
    names = [text.decode() for text in re.findall(rb"\x0a[\x01-\x7f]([a-zA-Z_]+)\x18", descriptor)]
    values, at = {}, 0
    while at < len(data):
        tag = data[at]
        at += 1
        if tag > 0x7F:
            tag, at = tag & 0x7F | data[at] << 7, at + 1
        assert tag & 7 == 1, "a double"
        [values[names[(tag >> 3) - 1]]] = struct.unpack_from("<d", data, at)
        at += 8
    assert list(values) == names
    return values


def test_viewers_find_topics_schemas_units_and_times_in_order(tmp_path: Path) -> None:
    """With the plain MCAP reader: what Foxglove, PlotJuggler and Rerun go by."""
    samples = [*run(2), device_sample(400)]
    write(tmp_path / "a.mcap", samples)
    times: dict[str, list[int]] = {}
    with (tmp_path / "a.mcap").open("rb") as file:
        for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            assert (schema.encoding, channel.message_encoding) == ("protobuf", "protobuf")
            times.setdefault(channel.topic, []).append(message.log_time)
            if channel.topic in FOR_VIEWERS:
                continue
            if channel.topic == "/events":
                assert schema.name == "foxglove.Log"
                assert b".google.protobuf.Timestamp" in schema.data
                continue
            assert (
                schema.name
                == {"/device/state": "hapnet.DeviceSample", "/world/state": "hapnet.WorldSample"}[channel.topic]
            )
            values = decoded(schema.data, message.data)
            assert list(values) == TEXTS[channel.topic].split()
            assert all(name.endswith(UNITS) for name in values)
            if channel.topic == "/device/state":
                sample = device_sample((message.log_time - ORIGIN) // 1_000_000)
                assert (values["position_y_m"], values["potential_J"]) == (sample.position_m[1], sample.potential_J)
                assert math.isnan(values["operator_force_x_N"]) == (sample.operator_force_N is None)
    assert times.keys() == {"/device/state", "/world/state", "/events"} | FOR_VIEWERS
    assert all(at == sorted(at) for at in times.values())
    assert sum(len(at) for topic, at in times.items() if topic not in FOR_VIEWERS) == len(samples)


def test_googles_implementation_decodes_every_message(tmp_path: Path) -> None:
    write(tmp_path / "a.mcap", run(3))
    read = {topic: [message for _, message in came] for topic, came in messages(tmp_path / "a.mcap").items()}
    assert {topic: len(came) for topic, came in read.items()} == {
        "/device/state": 300,
        "/world/state": 10,
        "/events": 2,
        **{topic: 19 if "device" in topic else 10 for topic in FOR_VIEWERS},
    }
    assert read["/device/state"][7].position_z_m == device_sample(7, 3).position_m[2]
    assert read["/events"][0].message == "session ‘a’"
    assert read["/events"][0].name == "paired"
    stamp = read["/events"][0].timestamp
    assert stamp.seconds * 10**9 + stamp.nanos == ORIGIN


def test_viewers_find_indexes_and_small_chunks(tmp_path: Path) -> None:
    samples = run(3)
    samples.append(Event(ORIGIN + 10**9, "long", "x" * 100_000))
    samples += [device_sample(i, 3) for i in range(1001, 1100)]
    write(tmp_path / "a.mcap", samples)
    with (tmp_path / "a.mcap").open("rb") as file:
        summary = make_reader(file).get_summary()
        shown = {channel.id for channel in summary.channels.values() if channel.topic in FOR_VIEWERS}
        counts = summary.statistics.channel_message_counts
        assert sum(count for channel, count in counts.items() if channel not in shown) == len(samples)
        file.seek(0)
        records = list(StreamReader(file, emit_chunks=True, validate_crcs=True).records)
    chunks = [record for record in records if isinstance(record, Chunk)]
    assert max(chunk.uncompressed_size for chunk in chunks) <= CHUNK_BYTES
    first = next(i for i, record in enumerate(records) if isinstance(record, Metadata))
    assert first < records.index(chunks[0])


def test_recordings_in_json_can_still_be_read(tmp_path: Path) -> None:
    """As they were written before protobuf: vectors as lists, null where unknown, no target, no parts of the force."""
    later = ("operator_target_m", *(name for name in DeviceSample._fields if name.endswith("_force_N")))
    later = tuple(name for name in later if name != "operator_force_N")
    samples = run(2)
    with (tmp_path / "old.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        writer.add_metadata("hapnet", {"json": json.dumps(META)})
        channels = {}
        for kind, topic in ((DeviceSample, "/device/state"), (WorldSample, "/world/state"), (Event, "/events")):
            schema = writer.register_schema(topic, "jsonschema", b'{"type": "object"}')
            channels[kind] = writer.register_channel(topic, "json", schema)
        for sample in samples:
            fields = {"name": sample.kind, "message": sample.text} if isinstance(sample, Event) else sample._asdict()
            fields = {name: value for name, value in fields.items() if name not in later}
            writer.add_message(channels[type(sample)], sample.time_ns, json.dumps(fields).encode(), sample.time_ns)
        writer.finish()
    recording = read_recording(tmp_path / "old.mcap")
    unknown = dict.fromkeys(later)
    expected = memory([s._replace(**unknown) if isinstance(s, DeviceSample) else s for s in samples])
    assert same(recording, dataclasses.replace(expected, summary=None))


def described(names: list[str]) -> bytes:
    """The descriptor set of a DeviceSample with these doubles, in proto3, as earlier versions wrote it."""
    fields = [{"name": name, "number": i, "type": 1, "label": 1} for i, name in enumerate(names, 1)]
    file = descriptor_pb2.FileDescriptorProto(name="hapnet/DeviceSample.proto", package="hapnet", syntax="proto3")
    file.message_type.add(name="DeviceSample", field=fields)
    return bytes(descriptor_pb2.FileDescriptorSet(file=[file]).SerializeToString())


def packed(values: list[float]) -> bytes:
    """A message of doubles numbered from 1, up to 15, as the wire format has it."""
    return b"".join(bytes([number << 3 | 1]) + struct.pack("<d", value) for number, value in enumerate(values, 1))


def test_what_a_newer_version_adds_is_passed_over_and_what_is_missing_is_unknown(tmp_path: Path) -> None:
    names = ["new_J", "position_x_m", "position_y_m", "force_x_N", "force_y_N", "margin_J", "newer_x_m"]
    values = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]
    with (tmp_path / "new.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        writer.add_metadata("hapnet", {"json": json.dumps(META)})
        schema = writer.register_schema("hapnet.DeviceSample", "protobuf", described(names))
        channel = writer.register_channel("/device/state", "protobuf", schema)
        writer.add_message(channel, ORIGIN, packed(values), ORIGIN)
        writer.finish()
    columns = read_recording(tmp_path / "new.mcap").device
    assert columns["position_m"].tolist() == [[2.0, 3.0]]
    assert columns["force_N"].tolist() == [[4.0, 5.0]]
    assert columns["margin_J"].tolist() == [6.0]
    assert np.isnan(columns["target_m"]).all()
    assert np.isnan(columns["reservoir_J"]).all()


@pytest.mark.parametrize(
    ("encoding", "descriptor", "data"),
    [
        ("cdr", b"", b""),
        ("protobuf", b"", b""),
        ("protobuf", b"\xff\xff", b""),
        ("protobuf", described(["position_x_m"]), b"\x09\x00"),
        ("protobuf", described(["force_x_N"]), packed([1.0])),
        ("json", b"{}", b"[1"),
        ("json", b"{}", b"[" * 200_000),
    ],
)
def test_messages_that_do_not_fit_are_told_in_one_line(
    tmp_path: Path, encoding: str, descriptor: bytes, data: bytes
) -> None:
    def add(writer: Writer) -> None:
        schema = writer.register_schema("hapnet.DeviceSample", encoding, descriptor)
        writer.add_message(writer.register_channel("/device/state", encoding, schema), 1, data, 1)

    assert_refused(tmp_path / "x.mcap", add)


@pytest.mark.parametrize("name", ["hapnet", "hapnet.summary"])
def test_settings_nested_without_end_are_told_in_one_line(tmp_path: Path, name: str) -> None:
    nested = {"json": "[" * 200_000}
    assert_refused(tmp_path / "x.mcap", lambda writer: writer.add_metadata(name, nested), settings=name != "hapnet")


def assert_refused(path: Path, add: Callable[[Writer], object], *, settings: bool = True) -> None:
    """A file with settings as they should be, unless they are left out, and with what `add` adds."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        if settings:
            writer.add_metadata("hapnet", {"json": json.dumps(META)})
        add(writer)
        writer.finish()
    with pytest.raises(RecordingError, match=r"x\.mcap is not a recording: its content does not fit") as info:
        read_recording(path)
    assert "\n" not in str(info.value)


def test_a_zero_is_written_and_nothing_is_loaded_before_it_is_needed(tmp_path: Path) -> None:
    write(tmp_path / "a.mcap", [device_sample(0)._replace(margin_J=0.0, position_m=(0.0, -0.0))])
    with (tmp_path / "a.mcap").open("rb") as file:
        [(schema, _, message)] = make_reader(file).iter_messages(topics="/device/state")
    values = decoded(schema.data, message.data)
    assert values["margin_J"] == 0.0
    assert math.copysign(1.0, values["position_y_m"]) == -1.0
    modules = "hapnet.cli, hapnet.realtime.servo_child, hapnet.recording.mcap"
    code = f"import sys, {modules}; print('google' in str(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"


def test_samples_of_different_dimension_are_refused(tmp_path: Path) -> None:
    writer = RecordingWriter(tmp_path / "x.mcap", META)
    writer.write(device_sample(0, 1))
    with pytest.raises(RecordingError, match="DeviceSample does not fit"):
        writer.write(device_sample(1, 2))
    writer.close()
    assert read_recording(tmp_path / "x.mcap").device is not None


def test_a_joined_recording_can_be_saved(tmp_path: Path) -> None:
    joined = join(*halves({"clock": "boot-2", "origin_ns": 5_000}, 6_000))
    save(joined, tmp_path / "joined.mcap")
    assert same(read_recording(tmp_path / "joined.mcap"), joined)
