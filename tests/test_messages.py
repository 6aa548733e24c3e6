from __future__ import annotations

import pickle
import random
import struct
from pathlib import Path
from typing import Any

import msgpack
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hapnet.errors import BadMessage
from hapnet.wire import messages
from hapnet.wire.messages import (
    Bye,
    Energy,
    Hello,
    Message,
    Motion,
    OtherVersion,
    Port,
    Position,
    Refuse,
    Wave,
    Welcome,
    decode,
    encode,
)

A, B = 0x1122334455667788, 0xFEDCBA9876543210
GOLDEN: dict[str, Message] = {
    "position": Position(A, 7, 1_000_000_000, (0.01, -0.25, 0.0)),
    "energy": Energy(A, B, 1_500_000, 20_000),
    "acknowledgement": Energy(B, A, 0, 1_500_000),
    "hello": Hello(A, 1, "device", 3, "pen", {"program": "example", "rate_hz": 1000.0}),
    "welcome": Welcome(B, A, 1, "world", 3, "wall", {}),
    "refuse": Refuse(B, A, "pen has 3 degrees of freedom, wall has 1"),
    "bye": Bye(A, B, 20_000, "duration is over"),
    "motion": Motion(A, 7, 1_000_000_000, (0.01,), (-0.25,)),
    "port": Port(B, 7, 1_000_000_000, (1.5,), 1_500_000),
    "wave": Wave(A, 7, 1_000_000_000, (0.5,), 5_000_000),
}
FRAMES = dict(
    line.split()
    for line in (Path(__file__).parent / "data" / "frames.txt").read_text().splitlines()
    if not line.startswith("#")
)
KINDS = {"size", "malformed", "version", "kind", "length", "type", "range", "dimension"}


@pytest.mark.parametrize("name", GOLDEN)
def test_golden_frames_both_ways(name: str) -> None:
    frame = bytes.fromhex(FRAMES[name])
    assert encode(GOLDEN[name]) == frame
    assert decode(frame) == GOLDEN[name]


def test_golden_frames_are_what_the_msgpack_specification_says() -> None:
    position = b"\x96\x01\x01\xcf" + struct.pack(">Q", A) + b"\x07\xce" + struct.pack(">I", 10**9)
    position += b"\x93" + b"".join(b"\xcb" + struct.pack(">d", x) for x in (0.01, -0.25, 0.0))
    assert position.hex() == FRAMES["position"]
    energy = b"\x96\x01\x02\xcf" + struct.pack(">Q", A) + b"\xcf" + struct.pack(">Q", B)
    energy += b"\xce" + struct.pack(">I", 1_500_000) + b"\xcd" + struct.pack(">H", 20_000)
    assert energy.hex() == FRAMES["energy"]
    bye = b"\x96\x01\x06\xcf" + struct.pack(">Q", A) + b"\xcf" + struct.pack(">Q", B)
    assert (bye + b"\xcd" + struct.pack(">H", 20_000) + b"\xb0duration is over").hex() == FRAMES["bye"]
    numbered = b"\x07\xce" + struct.pack(">I", 10**9) + b"\x91\xcb"
    motion = b"\x97\x01\x07\xcf" + struct.pack(">Q", A) + numbered + struct.pack(">d", 0.01)
    assert (motion + b"\x91\xcb" + struct.pack(">d", -0.25)).hex() == FRAMES["motion"]
    port = b"\x97\x01\x08\xcf" + struct.pack(">Q", B) + numbered + struct.pack(">d", 1.5)
    assert (port + b"\xce" + struct.pack(">I", 1_500_000)).hex() == FRAMES["port"]
    wave = b"\x97\x01\x09\xcf" + struct.pack(">Q", A) + numbered + struct.pack(">d", 0.5)
    assert (wave + b"\xce" + struct.pack(">I", 5_000_000)).hex() == FRAMES["wave"]


def test_the_protocol_page_shows_the_golden_frames() -> None:
    page = (Path(messages.__file__).parent / "README.md").read_text()
    assert set(FRAMES) == set(GOLDEN)
    for name, frame in FRAMES.items():
        assert f"`{frame}`" in page, name


incarnations = st.integers(1, 2**64 - 1)
naturals = st.integers(0, 2**64 - 1)
totals = st.integers(0, 2**63 - 1)
texts = st.text(st.characters(codec="utf-8"), max_size=20).filter(str.isprintable)
scalars = st.one_of(
    texts, st.integers(-(2**63), 2**64 - 1), st.floats(allow_nan=False, allow_infinity=False), st.none()
)
identity = (
    st.sampled_from(["device", "world"]),
    st.integers(1, 64),
    texts,
    st.dictionaries(texts, scalars | st.booleans(), max_size=8),
)
coordinates = st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=64).map(tuple)
motions = coordinates.flatmap(
    lambda x: st.builds(Motion, incarnations, naturals, naturals, st.just(x), st.permutations(x).map(tuple))
)
any_message = st.one_of(
    motions,
    st.builds(Port, incarnations, naturals, naturals, coordinates, totals),
    st.builds(Wave, incarnations, naturals, naturals, coordinates, st.integers(1, 10**10)),
    st.builds(Position, incarnations, naturals, naturals, coordinates),
    st.builds(Energy, incarnations, naturals, totals, totals),
    st.builds(Hello, incarnations, naturals, *identity),
    st.builds(Welcome, incarnations, naturals, naturals, *identity),
    st.builds(Refuse, incarnations, naturals, texts),
    st.builds(Bye, incarnations, naturals, totals, texts),
)


@settings(deadline=None)
@given(any_message)
def test_decode_inverts_encode(message: Message) -> None:
    again = decode(encode(message))
    assert again == message
    assert type(again) is type(message)  # named tuples of one shape are equal


def rejected(frame: object) -> BadMessage:
    data = frame if isinstance(frame, bytes) else msgpack.packb(frame)
    with pytest.raises(BadMessage) as caught:
        decode(data)
    assert caught.value.kind in KINDS
    return caught.value


nan, inf = float("nan"), float("inf")
HELLO: list[Any] = [1, 3, A, 1, "device", 3, "pen", {}]


@pytest.mark.parametrize(
    ("kind", "frame"),
    [
        ("malformed", b""),
        ("malformed", b"\xc1"),
        ("malformed", b"\x91" * 4000),  # nested too deep
        ("malformed", b"\xdd\xff\xff\xff\xff\x01"),  # four thousand million elements announced
        ("malformed", bytes.fromhex(FRAMES["position"])[:-1]),
        ("malformed", bytes.fromhex(FRAMES["position"]) + b"\x00"),
        ("malformed", {"a": 1}),
        ("malformed", 7),
        ("malformed", []),
        ("malformed", [1, 2]),
        ("malformed", [True, 1, A, 0, 0, [0.0]]),
        ("malformed", [1, 1.0, A, 0, 0, [0.0]]),
        ("malformed", [1, [[[[]]]], A]),
        ("malformed", msgpack.packb([*HELLO[:-1], {1: 2}])),
        ("malformed", b"\x95\x01\x05\x01\x01\xa2\xff\xfe"),  # not UTF-8
        ("size", b"\x00" * 4097),
        ("version", [2, 1, A, 0, 0, [0.0]]),
        ("version", [0, 99, A]),
        ("kind", [1, 10, A]),
        ("length", [1, 7, A]),
        ("length", [1, 7, A, 0, 0, [0.0]]),
        ("length", [1, 8, A, 0, 0, [0.0]]),
        ("length", [1, 9, A, 0, 0, [0.0]]),
        ("length", [1, 9, A, 0, 0, [0.0], 1, 1]),
        ("dimension", [1, 7, A, 0, 0, [0.0, 0.0], [0.0]]),
        ("dimension", [1, 7, A, 0, 0, [0.0], []]),
        ("type", [1, 7, A, 0, 0, [0.0], [0]]),
        ("type", [1, 7, A, 0, 0, [0.0], [True]]),
        ("range", [1, 7, A, 0, 0, [0.0], [nan]]),
        ("range", [1, 7, A, 0, 0, [0.0], [-1e7]]),
        ("range", [1, 7, A, -1, 0, [0.0], [0.0]]),
        ("type", [1, 8, A, 0, 0, [0.0], 1.0]),
        ("type", [1, 8, A, 0, 0, [0.0], True]),
        ("range", [1, 8, A, 0, 0, [0.0], -1]),
        ("range", [1, 8, A, 0, 0, [0.0], 2**63]),
        ("range", [1, 8, A, 0, 0, [inf], 0]),
        ("type", [1, 8, A, 0, 0, [1], 0]),
        ("range", [1, 9, A, 0, 0, [0.0], 0]),
        ("range", [1, 9, A, 0, 0, [0.0], 10**10 + 1]),
        ("type", [1, 9, A, 0, 0, [0.0], 5e6]),
        ("type", [1, 9, A, 0, 0, 0.5, 1]),
        ("dimension", [1, 9, A, 0, 0, [0.0] * 65, 1]),
        ("range", [1, 9, 0, 0, 0, [0.0], 1]),
        ("kind", [1, -1, A]),
        ("length", [1, 1, A, 0, 0]),
        ("length", [1, 2, A, B, 0, 0, 0]),
        ("range", [1, 1, 0, 0, 0, [0.0]]),
        ("range", [1, 1, "x", 0, 0, [0.0]]),
        ("range", [1, 1, True, 0, 0, [0.0]]),
        ("type", [1, 1, A, True, 0, [0.0]]),
        ("type", [1, 1, A, 0, 1.5, [0.0]]),
        ("range", [1, 1, A, -1, 0, [0.0]]),
        ("type", [1, 1, A, 0, 0, 0.5]),
        ("type", [1, 1, A, 0, 0, [0]]),
        ("type", [1, 1, A, 0, 0, [[0.0]]]),
        ("type", [1, 1, A, 0, 0, {"x": 1.0}]),
        ("range", [1, 1, A, 0, 0, [nan]]),
        ("range", [1, 1, A, 0, 0, [0.0, -inf]]),
        ("range", [1, 1, A, 0, 0, [1e300]]),
        ("dimension", [1, 1, A, 0, 0, []]),
        ("dimension", [1, 1, A, 0, 0, [0.0] * 65]),
        ("range", [1, 2, A, B, 2**63, 0]),
        ("range", [1, 2, A, B, 0, -5]),
        ("type", [1, 2, A, B, 1.0, 0]),
        ("type", [1, 2, A, None, 1, 0]),
        ("range", [*HELLO[:4], "witch", *HELLO[5:]]),
        ("type", [*HELLO[:4], 5, *HELLO[5:]]),
        ("dimension", [*HELLO[:5], 0, *HELLO[6:]]),
        ("dimension", [*HELLO[:5], 65, *HELLO[6:]]),
        ("range", [*HELLO[:6], "x" * 257, {}]),
        ("range", [*HELLO[:6], "\x1b[31mred", {}]),
        ("type", [*HELLO[:6], b"pen", {}]),
        ("type", [*HELLO[:7], []]),
        ("type", [*HELLO[:7], {"a": []}]),
        ("type", [*HELLO[:7], {b"a": 1}]),
        ("range", [*HELLO[:7], {"a": nan}]),
        ("range", [*HELLO[:7], {str(k): k for k in range(33)}]),
        ("type", [*HELLO[:7], {"a": msgpack.Timestamp(1, 1)}]),
        ("type", [1, 5, A, B, msgpack.ExtType(5, b"xx")]),
    ],
)
def test_rejected_with_its_kind(kind: str, frame: object) -> None:
    assert rejected(frame).kind == kind


def test_a_frame_of_another_version_says_so_and_names_its_sender() -> None:
    error = rejected([2, Hello.KIND, A, "anything", {"may": "follow"}])
    assert isinstance(error, OtherVersion)
    assert str(error) == "version: peer speaks protocol 2, this side speaks 1"
    assert (error.message_kind, error.incarnation) == (Hello.KIND, A)
    assert str(pickle.loads(pickle.dumps(error))) == str(error)


def test_a_refusal_is_readable_in_every_version() -> None:
    assert decode(msgpack.packb([9, Refuse.KIND, B, A, "this side speaks 9"])) == Refuse(B, A, "this side speaks 9")


def survives(data: bytes) -> None:
    """Decoding gives a message that means the same when sent on, or one of the known errors."""
    kind = None
    try:
        message = decode(data)
    except BadMessage as error:
        kind = error.kind
    assert kind == kind_when_examined(data)  # the short way takes a position exactly where the long one does
    if kind is None:
        assert decode(encode(message)) == message
    else:
        assert kind in KINDS


def kind_when_examined(data: bytes) -> str | None:
    """What is wrong with a frame, element by element; None: nothing."""
    try:
        frame = msgpack.unpackb(data, use_list=False)
    except (ValueError, msgpack.UnpackException):
        return "malformed"
    try:
        messages._examined(frame)
    except BadMessage as error:
        return error.kind
    return None


@settings(max_examples=300, deadline=None)
@given(st.binary(max_size=200))
def test_noise_never_raises_anything_else(data: bytes) -> None:
    survives(data)


trees = st.recursive(
    scalars | st.booleans() | st.floats() | st.binary(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(texts, inner, max_size=3),
    max_leaves=8,
)


@settings(max_examples=300, deadline=None)
@given(st.integers(0, 10), st.lists(trees, max_size=7))
def test_well_formed_nonsense_never_raises_anything_else(kind: int, fields: list[object]) -> None:
    survives(msgpack.packb([1, kind, A, *fields]))


def test_mutated_frames_give_a_message_or_a_counted_error() -> None:
    rng = random.Random(1)
    frames = [bytes.fromhex(f) for f in FRAMES.values()]
    for _ in range(20_000):
        data = bytearray(rng.choice(frames))
        for _ in range(rng.randrange(1, 4)):
            data[rng.randrange(len(data))] = rng.randrange(256)
        survives(bytes(data))
