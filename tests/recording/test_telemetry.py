import math
from contextlib import suppress

import msgpack
import pytest
from hypothesis import given, strategies as st

from hapnet.errors import BadMessage
from hapnet.mechanics.curvature import Curvature
from hapnet.mechanics.plane import Plane
from hapnet.realtime.telemetry_publisher import TelemetryPublisher
from hapnet.recording.samples import DeviceSample, Event, PostureSample, WorldSample
from hapnet.recording.telemetry import MAX_LENGTH, VERSION, KnownPlanes, Status, Telemetry, decode, encode

WHOLE = st.integers(-(2**63), 2**63 - 1)
LEVELS = st.sampled_from(("info", "warning", "error"))
NUMBER = st.floats(allow_nan=False)
STATUS = Status(
    role="device", time_ns=5, incarnation=2**62, paired=True, paused=False, recording="a.mcap",
    about={"params": {"dof": 1}, "surfaces": ({"axis": 0, "position_m": 0.02, "solid": 1},)},
    link={"profile": "", "delay_now_ms": None}, path={"round_trip_p50_ms": 81.5, "up": None, "down": {"loss": 0.02}},
)  # fmt: skip


@st.composite
def samples(draw: st.DrawFn) -> DeviceSample | WorldSample:
    vector = st.tuples(*[NUMBER] * draw(st.integers(1, 8)))
    kind = draw(st.sampled_from((DeviceSample, WorldSample)))
    values = {}
    for name, words in kind.__annotations__.items():
        text = str(words)
        values[name] = draw(WHOLE if "int" in text else NUMBER if "float" in text else vector)
        if "None" in text and draw(st.booleans()):
            values[name] = None
    return kind(**values)


POSTURE = PostureSample(5, (0.25, -2.5, 0.0))
WALL = Plane((0.6, 0.8), -0.01, 3000.0, 10.0, 0.0)
BENT = WALL._replace(curvatures=(Curvature((-0.8, 0.6), 30.0),))
PLANES = tuple(map(KnownPlanes, (None, (), (WALL, BENT), (WALL, WALL._replace(normal=(1.0, 0.0))))))


@given(
    message=st.one_of(
        samples(), st.builds(Event, WHOLE, st.text(), st.text(), LEVELS), st.sampled_from((STATUS, POSTURE, *PLANES))
    )
)
def test_what_is_published_is_what_is_read(message: Telemetry) -> None:
    assert decode(encode(message)) == message


def test_what_json_cannot_hold_is_unknown_in_a_status() -> None:
    status = decode(encode(Status(**{**vars(STATUS), "link": {"loss_now": math.nan}})))
    assert isinstance(status, Status)
    assert status.link == {"loss_now": None}


@given(data=st.binary(max_size=200))
def test_any_bytes_are_a_message_or_are_refused(data: bytes) -> None:
    with suppress(BadMessage):
        decode(data)


@given(
    message=st.one_of(samples(), st.sampled_from((STATUS, *PLANES))),
    at=st.integers(0, 10**6),
    value=st.integers(0, 255),
)
def test_a_flipped_byte_never_raises_anything_else(message: Telemetry, at: int, value: int) -> None:
    data = bytearray(encode(message))
    data[at % len(data)] = value
    with suppress(BadMessage):
        decode(bytes(data))


DEVICE = DeviceSample(1, (0.0,), (0.0,), (0.0,), (0.0,), None, *[0.0] * 7, None)


@pytest.mark.parametrize(
    ("frame", "why"),
    [
        ([VERSION + 1, "device"], "version"),
        ([VERSION, "weather", 1], "neither"),
        ([VERSION], "neither"),
        ("text", "neither"),
        ([VERSION, "device", *DEVICE[:-1]], "fields"),
        ([VERSION, "device", 1.0, *DEVICE[1:]], "time_ns"),
        ([VERSION, "device", True, *DEVICE[1:]], "time_ns"),
        ([VERSION, "device", 2**63, *DEVICE[1:]], "time_ns"),
        ([VERSION, "device", *DEVICE._replace(position_m=())], "position_m"),
        ([VERSION, "device", *DEVICE._replace(position_m=None)], "position_m"),
        ([VERSION, "device", *DEVICE._replace(position_m=("0",))], "position_m"),
        ([VERSION, "device", *DEVICE._replace(position_m=(0.0, 0.0))], "numbers of axes"),
        ([VERSION, "device", *DEVICE._replace(margin_J=1)], "margin_J"),
        ([VERSION, "event", 1, "kind"], "neither"),
        ([VERSION, "posture", 1, [0.5, math.nan]], "neither"),
        ([VERSION, "posture", 1, [0.5, "up"]], "neither"),
        ([VERSION, "posture", 1, [0.5] * 65], "neither"),
        ([VERSION, "planes"], "neither"),
        ([VERSION, "planes", 3], "planes is 3; allowed: array"),
        ([VERSION, "planes", [WALL._replace(normal=(1.0, 1.0))[:5]]], "normal"),
        ([VERSION, "planes", [WALL[:5]] * 9], "planes is of length 9; allowed: array of length <= 8"),
        ([VERSION, "planes", [WALL[:5]], [[[[1.0, 0.0], 30.0]]]], "perpendicular to the others"),
        ([VERSION, "planes", [WALL[:5]], []], "one element for each plane"),
        ([VERSION, "status", {"role": "device"}], "other fields"),
        ([VERSION, "status", {**vars(STATUS), "role": "mouse"}], "role"),
        ([VERSION, "status", {**vars(STATUS), "about": []}], "about"),
        *(
            ([VERSION, "status", {**vars(STATUS), **odd}], "parameters, surfaces, link or path")
            for odd in (
                {"about": {"params": 3}},
                {"about": {"params": {"device": 3}}},
                {"about": {"params": {"device": {"smoothing_s": "long"}}}},
                {"about": {"surfaces": 3}},
                {"about": {"surfaces": [{"axis": 0, "solid": 1}]}},
                {"about": {"surfaces": [{"axis": -1, "position_m": 0.0, "solid": 1}]}},
                {"about": {"surfaces": [{"axis": 0, "position_m": 0.0, "solid": 2}]}},
                {"about": {"surfaces": [{"axis": 0, "position_m": math.inf, "solid": 1}]}},
                {"link": {"delay_now_ms": "long"}},
                {"link": {"loss_now": [0.1]}},
                {"path": {"round_trip_p50_ms": "long"}},
                {"path": {"up": 0.1}},
                {"path": {"down": {"lost": 3}}},
            )
        ),
    ],
)
def test_what_is_refused_is_named(frame: object, why: str) -> None:
    with pytest.raises(BadMessage, match=why):
        decode(msgpack.packb(frame))


def test_planes_are_published_when_they_change_and_with_each_status() -> None:
    """Without a loop: `publish` is a turn of it."""
    put: list[Telemetry] = []
    known: list[tuple[Plane, ...] | None] = [None]
    publisher = TelemetryPublisher(60.0, lambda data: put.append(decode(data)), lambda: STATUS, lambda: known[0])
    for planes in (None, None, (WALL,), (WALL,), ()):
        known[0] = planes
        publisher.publish()
    assert put == [KnownPlanes(None), KnownPlanes((WALL,)), KnownPlanes(())]
    publisher.report_status()
    publisher.publish()
    assert put[3:] == [STATUS, KnownPlanes(())]


def test_what_is_too_long_is_not_looked_at() -> None:
    with pytest.raises(BadMessage, match="allowed: up to"):
        decode(bytes(MAX_LENGTH + 1))
