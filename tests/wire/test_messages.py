import pickle
import random
import struct
from pathlib import Path
from typing import Any, get_args

import msgpack
import pytest
from hypothesis import given, settings, strategies as st
from msgspec import structs

from hapnet.errors import BadMessage
from hapnet.wire import messages
from hapnet.wire.messages import (
    Account,
    Bye,
    Encrypted,
    Energy,
    Hello,
    Message,
    Motion,
    OtherVersion,
    Port,
    Position,
    Proxy,
    Refuse,
    Signals,
    Wave,
    Welcome,
    decode,
    encode,
)

A, B = 0x1122334455667788, 0xFEDCBA9876543210
PROXY = Proxy(B, 7, 1_000_000_000, (0.01, 0.0), 2_000_000_000, (-1.5, 0.0), (((1.0, 0.0), 0.02, 3000.0, 10.0, 0.0),))
GOLDEN: dict[str, Message] = {
    "position": Position(A, 7, 1_000_000_000, (0.01, -0.25, 0.0), 2_000_000_000, 995_000_000),
    "energy": Energy(A, B, 1_500_000, 20_000),
    "acknowledgement": Energy(B, A, 0, 1_500_000),
    "hello": Hello(A, 1, "device", 3, "pen", {"program": "example", "rate_hz": 1000.0}),
    "welcome": Welcome(B, A, 1, "world", 3, "wall", {}),
    "refuse": Refuse(B, A, "pen has 3 degrees of freedom, wall has 1"),
    "bye": Bye(A, B, 20_000, "duration is over"),
    "motion": Motion(A, 7, 1_000_000_000, (0.01,), (-0.25,)),
    "port": Port(B, 7, 1_000_000_000, (1.5,), 1_500_000),
    "wave": Wave(A, 7, 1_000_000_000, (0.5,), 5_000_000),
    "integral": Wave(A, 7, 1_000_000_000, (0.5,), 5_000_000, more={"integral": ((0.0125,), 40_000_000)}),
    "proxy": PROXY,
    "curvatures": structs.replace(PROXY, more={"curvatures": ((((0.0, 1.0), 25.0),),)}),
    "friction": structs.replace(PROXY, more={"friction": (0.5,)}),
    "effects": structs.replace(
        PROXY, more={"effects": ((2.0, 0.5, 1.0, 0.005, ((0.0, 500.0), 0.0002, b"\0\x7f\0\x81")),)}
    ),
    "signals": Signals(A, B, 3, {"buttons": (True, False), "grip": 0.25, "tool": "pen"}),
    "account": Account(A, B, 4, 2, True, True, {"ledger.margin_J": 0.125, "sent_nJ": 1_500_000}),
    "encrypted": Encrypted(
        A,
        7,
        bytes.fromhex(
            "72dc64e2fdc109a0a32f9d96d4edce76d45e880042b30260935263af58735026a8ef9c00f53d"
            "b6f47d0d5f3fd03854f253d03e4ed4fe206b16d343d458c775393f3ed3915b4f40402f8cf65f2a1cace902979a76278425c4850683c3"
        ),
    ),
    "further": Energy(B, A, 0, 1_500_000, {"example": (1, True)}),
}
FRAMES = dict(
    line.split()
    for line in (Path(__file__).parents[1] / "data" / "frames.txt").read_text().splitlines()
    if not line.startswith("#")
)
KINDS = {"size", "malformed", "version", "kind", "length", "type", "range", "dimension"}


def test_every_kind_has_a_golden_frame() -> None:
    assert {type(message) for message in GOLDEN.values()} == set(get_args(Message))


@pytest.mark.parametrize("name", GOLDEN)
def test_golden_frames_both_ways(name: str) -> None:
    frame = bytes.fromhex(FRAMES[name])
    assert encode(GOLDEN[name]) == frame
    assert decode(frame) == GOLDEN[name]


def test_golden_frames_are_what_the_msgpack_specification_says() -> None:
    def u64(value: int) -> bytes:
        return b"\xcf" + struct.pack(">Q", value)

    def f64(*values: float) -> bytes:
        return bytes((0x90 + len(values),)) + b"".join(b"\xcb" + struct.pack(">d", value) for value in values)

    position = (
        b"\x98\x02\x01" + u64(A) + u64(7) + u64(10**9) + f64(0.01, -0.25, 0.0) + u64(2 * 10**9) + u64(995 * 10**6)
    )
    assert position.hex() == FRAMES["position"]
    energy = b"\x96\x02\x02" + u64(A) + u64(B) + b"\xce" + struct.pack(">I", 1_500_000) + b"\xcd\x4e\x20"
    assert energy.hex() == FRAMES["energy"]
    further = b"\x97\x02\x02" + u64(B) + u64(A) + b"\x00\xce" + struct.pack(">I", 1_500_000)
    assert (further + b"\x81\xa7example\x92\x01\xc3").hex() == FRAMES["further"]
    bye = b"\x96\x02\x06" + u64(A) + u64(B)
    assert (bye + b"\xcd\x4e\x20\xb0duration is over").hex() == FRAMES["bye"]
    none = u64(0) + u64(0)
    motion = b"\x99\x02\x07" + u64(A) + u64(7) + u64(10**9) + f64(0.01) + f64(-0.25)
    assert (motion + none).hex() == FRAMES["motion"]
    port = b"\x99\x02\x08" + u64(B) + u64(7) + u64(10**9) + f64(1.5) + b"\xce" + struct.pack(">I", 1_500_000)
    assert (port + none).hex() == FRAMES["port"]
    wave = b"\x99\x02\x09" + u64(A) + u64(7) + u64(10**9) + f64(0.5) + b"\xce" + struct.pack(">I", 5_000_000)
    assert (wave + none).hex() == FRAMES["wave"]
    integral = b"\x81\xa8integral\x92" + f64(0.0125) + b"\xce" + struct.pack(">I", 40_000_000)
    assert (b"\x9a" + wave[1:] + none + integral).hex() == FRAMES["integral"]
    signals = b"\x96\x02\x0b" + u64(A) + u64(B) + b"\x03\x83\xa7buttons\x92\xc3\xc2"
    assert (signals + b"\xa4grip" + f64(0.25)[1:] + b"\xa4tool\xa3pen").hex() == FRAMES["signals"]
    account = b"\x99\x02\x0c" + u64(A) + u64(B) + b"\x04\x02\xc3\xc3\x82\xafledger.margin_J" + f64(0.125)[1:]
    assert (account + b"\xa7sent_nJ\xce" + struct.pack(">I", 1_500_000)).hex() == FRAMES["account"]
    proxy = b"\x9b\x02\x0a" + u64(B) + u64(7) + u64(10**9) + f64(0.01, 0.0) + b"\xce" + struct.pack(">I", 2 * 10**9)
    plane = b"\x91\x95" + f64(1.0, 0.0) + b"".join(f64(value)[1:] for value in (0.02, 3000.0, 10.0, 0.0))
    assert (proxy + f64(-1.5, 0.0) + plane + none).hex() == FRAMES["proxy"]
    bends = b"\x81\xaacurvatures\x91\x91\x92" + f64(0.0, 1.0) + f64(25.0)[1:]
    assert (b"\x9c" + proxy[1:] + f64(-1.5, 0.0) + plane + none + bends).hex() == FRAMES["curvatures"]
    rubs = b"\x81\xa8friction\x91" + f64(0.5)[1:]
    assert (b"\x9c" + proxy[1:] + f64(-1.5, 0.0) + plane + none + rubs).hex() == FRAMES["friction"]
    grain = b"\x93" + f64(0.0, 500.0) + f64(2e-4)[1:] + b"\xc4\x04\0\x7f\0\x81"
    acts = b"\x81\xa7effects\x91\x95" + f64(2.0, 0.5, 1.0, 0.005)[1:] + grain
    assert (b"\x9c" + proxy[1:] + f64(-1.5, 0.0) + plane + none + acts).hex() == FRAMES["effects"]


def test_integers_may_be_as_short_as_msgpack_makes_them() -> None:
    """This side's streams have long ones, so that the length of a position depends on its dimension only."""
    position = GOLDEN["position"]
    assert isinstance(position, Position)
    short = msgpack.packb((2, 1, *structs.astuple(position)[:-1]))
    assert len(short) < len(bytes.fromhex(FRAMES["position"]))
    assert decode(short) == position
    early, late = (encode(Position(A, n, n, (0.5,), n, n)) for n in (0, 2**64 - 1))
    assert len(early) == len(late)


def test_the_protocol_page_shows_the_golden_frames() -> None:
    page = (Path(messages.__file__).parent / "README.md").read_text()
    assert set(FRAMES) == set(GOLDEN)
    for name, frame in FRAMES.items():
        assert f"`{frame}`" in page, name


incarnations = st.integers(1, 2**64 - 1)
naturals = st.integers(0, 2**64 - 1)
stamps = (naturals, naturals)
totals = st.integers(0, 2**63 - 1)
texts = st.text(st.characters(codec="utf-8"), max_size=20).filter(str.isprintable)


def vectors(n: int) -> st.SearchStrategy[tuple[float, ...]]:
    return st.tuples(*[st.floats(-1e6, 1e6)] * n)


def planes(n: int) -> st.SearchStrategy[Any]:
    unit = tuple([1.0] + [0.0] * (n - 1))
    numbers = st.tuples(
        st.just(unit), st.floats(-1e6, 1e6), st.floats(1e-3, 1e6), st.floats(0.0, 1e6), st.floats(-9, 9)
    )
    return st.lists(numbers, max_size=4).map(tuple)


scalars = st.one_of(
    texts, st.integers(-(2**63), 2**64 - 1), st.floats(allow_nan=False, allow_infinity=False), st.none()
)
further = st.none() | st.dictionaries(texts, scalars | st.lists(scalars, max_size=3).map(tuple), min_size=1, max_size=4)
identity = (
    st.sampled_from(["device", "world"]),
    st.integers(1, 64),
    texts,
    st.dictionaries(texts, scalars | st.booleans(), max_size=8),
)
numbers = st.integers(-(2**63), 2**64 - 1) | st.floats(allow_nan=False, allow_infinity=False) | st.booleans()
signals = st.dictionaries(texts, scalars | st.booleans() | st.lists(numbers, max_size=8).map(tuple), max_size=8)
coordinates = st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=64).map(tuple)
motions = coordinates.flatmap(
    lambda x: st.builds(Motion, incarnations, *stamps, st.just(x), st.permutations(x).map(tuple), *stamps, further)
)
any_message = st.one_of(
    motions,
    st.builds(Port, incarnations, *stamps, coordinates, totals, *stamps, further),
    st.builds(Wave, incarnations, *stamps, coordinates, st.integers(1, 10**10), *stamps, further),
    st.integers(1, 4).flatmap(
        lambda n: st.builds(
            Proxy, incarnations, *stamps, vectors(n), naturals, vectors(n), st.none() | planes(n), *stamps, further
        )
    ),
    st.builds(Position, incarnations, *stamps, coordinates, *stamps, further),
    st.builds(Energy, incarnations, naturals, totals, totals, further),
    st.builds(Hello, incarnations, naturals, *identity, further),
    st.builds(Welcome, incarnations, naturals, naturals, *identity, further),
    st.builds(Refuse, incarnations, naturals, texts),
    st.builds(Signals, incarnations, naturals, naturals, signals, further),
    st.builds(Account, incarnations, *[naturals] * 3, st.booleans(), st.booleans(), signals, further),
    st.builds(Encrypted, incarnations, naturals, st.binary(min_size=17, max_size=300), further),
    st.builds(Bye, incarnations, naturals, totals, texts, further),
)


@settings(deadline=None)
@given(any_message)
@pytest.mark.long
def test_decode_inverts_encode(message: Message) -> None:
    again = decode(encode(message))
    assert again == message
    assert type(again) is type(message)


def rejected(frame: object) -> BadMessage:
    data = frame if isinstance(frame, bytes) else msgpack.packb(frame)
    with pytest.raises(BadMessage) as caught:
        decode(data)
    assert caught.value.kind in KINDS
    return caught.value


nan, inf = float("nan"), float("inf")
HELLO: list[Any] = [2, 3, A, 1, "device", 3, "pen", {}]


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
        ("malformed", [2, [[[[]]]], A]),
        ("malformed", msgpack.packb([*HELLO[:-1], {1: 2}])),
        ("malformed", b"\x95\x02\x05\x01\x01\xa2\xff\xfe"),  # not UTF-8
        ("size", b"\x00" * 4097),
        ("version", [1, 1, A, 0, 0, [0.0]]),
        ("version", [0, 99, A]),
        ("kind", [2, 99, A]),
        ("length", [2, 7, A, 0, 0]),
        ("length", [2, 7, A, 0, 0, [0.0], 0, 0]),
        ("length", [2, 8, A, 0, 0, [0.0], 0, 0]),
        ("length", [2, 9, A, 0, 0, [0.0], 0, 0]),
        ("length", [2, 9, A, 0, 0, [0.0], 1, 0, 0, {}, 0]),
        ("dimension", [2, 7, A, 0, 0, [0.0, 0.0], [0.0], 0, 0]),
        ("dimension", [2, 7, A, 0, 0, [0.0], [], 0, 0]),
        ("type", [2, 7, A, 0, 0, [0.0], [0], 0, 0]),
        ("type", [2, 7, A, 0, 0, [0.0], [True], 0, 0]),
        ("range", [2, 7, A, 0, 0, [0.0], [nan], 0, 0]),
        ("range", [2, 7, A, 0, 0, [0.0], [-1e7], 0, 0]),
        ("range", [2, 7, A, -1, 0, [0.0], [0.0], 0, 0]),
        ("type", [2, 8, A, 0, 0, [0.0], 1.0, 0, 0]),
        ("type", [2, 8, A, 0, 0, [0.0], True, 0, 0]),
        ("range", [2, 8, A, 0, 0, [0.0], -1, 0, 0]),
        ("range", [2, 8, A, 0, 0, [0.0], 2**63, 0, 0]),
        ("range", [2, 8, A, 0, 0, [inf], 0, 0, 0]),
        ("type", [2, 8, A, 0, 0, [1], 0, 0, 0]),
        ("range", [2, 9, A, 0, 0, [0.0], 0, 0, 0]),
        ("range", [2, 9, A, 0, 0, [0.0], 10**10 + 1, 0, 0]),
        ("type", [2, 9, A, 0, 0, [0.0], 5e6, 0, 0]),
        ("type", [2, 9, A, 0, 0, 0.5, 1, 0, 0]),
        ("dimension", [2, 9, A, 0, 0, [0.0] * 65, 1, 0, 0]),
        ("range", [2, 9, 0, 0, 0, [0.0], 1, 0, 0]),
        ("kind", [2, -1, A]),
        ("length", [2, 1, A, 0, 0, 0, 0]),
        ("length", [2, 1, A, 0, 0, [0.0], 0, 0, {}, {}]),
        ("length", [2, 2, A, B, 0, 0, {}, {}]),
        ("length", [2, 5, A, B, "no", {}, {}]),
        ("type", [2, 1, A, 0, 0, [0.0], 0, 0, 0]),
        ("type", [2, 2, A, B, 0, 0, []]),
        ("type", [*HELLO, None]),
        ("type", [2, 6, A, B, 0, "end", {b"a": 1}]),
        ("range", [2, 2, A, B, 0, 0, {str(k): k for k in range(33)}]),
        ("range", [2, 2, A, B, 0, 0, {"x" * 257: 0}]),
        ("range", [2, 2, A, B, 0, 0, {"line\nend": 0}]),
        ("malformed", [2, 2, A, B, 0, 0, {1: 2}]),
        ("range", [2, 1, A, 0, 0, [0.0], -1, 0]),
        ("range", [2, 1, A, 0, 0, [0.0], 0, -1]),
        ("type", [2, 1, A, 0, 0, [0.0], 1.0, 0]),
        ("type", [2, 1, A, 0, 0, [0.0], 0, True]),
        ("type", [2, 9, A, 0, 0, [0.0], 1, 0, None]),
        ("range", [2, 1, 0, 0, 0, [0.0], 0, 0]),
        ("range", [2, 1, "x", 0, 0, [0.0], 0, 0]),
        ("range", [2, 1, True, 0, 0, [0.0], 0, 0]),
        ("type", [2, 1, A, True, 0, [0.0], 0, 0]),
        ("type", [2, 1, A, 0, 1.5, [0.0], 0, 0]),
        ("range", [2, 1, A, -1, 0, [0.0], 0, 0]),
        ("type", [2, 1, A, 0, 0, 0.5, 0, 0]),
        ("type", [2, 1, A, 0, 0, [0], 0, 0]),
        ("type", [2, 1, A, 0, 0, [[0.0]], 0, 0]),
        ("type", [2, 1, A, 0, 0, {"x": 1.0}, 0, 0]),
        ("range", [2, 1, A, 0, 0, [nan], 0, 0]),
        ("range", [2, 1, A, 0, 0, [0.0, -inf], 0, 0]),
        ("range", [2, 1, A, 0, 0, [1e300], 0, 0]),
        ("dimension", [2, 1, A, 0, 0, [], 0, 0]),
        ("dimension", [2, 1, A, 0, 0, [0.0] * 65, 0, 0]),
        ("range", [2, 2, A, B, 2**63, 0]),
        ("range", [2, 2, A, B, 0, -5]),
        ("type", [2, 2, A, B, 1.0, 0]),
        ("type", [2, 2, A, None, 1, 0]),
        ("range", [*HELLO[:4], "witch", *HELLO[5:]]),
        ("range", [*HELLO[:4], "world, got `int` - at `$[99]`", *HELLO[5:]]),
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
        ("type", [2, 5, A, B, msgpack.ExtType(5, b"xx")]),
        ("type", [2, 13, A, 7, "QUJD" * 9]),  # no bytes, though they could be in base 64
        *[("type", [*HELLO, {"key": key}]) for key in (b"k" * 31, b"k" * 33, "k" * 32, "QUJD" * 11)],
    ],
)
def test_rejected_with_its_kind(kind: str, frame: object) -> None:
    assert rejected(frame).kind == kind


def test_a_frame_of_another_version_says_so_and_names_its_sender() -> None:
    error = rejected([3, Hello.KIND, A, "anything", {"may": "follow"}])
    assert isinstance(error, OtherVersion)
    assert str(error) == "version: peer speaks protocol 3, this side speaks 2"
    assert (error.message_kind, error.incarnation) == (Hello.KIND, A)
    assert str(pickle.loads(pickle.dumps(error))) == str(error)


def test_what_nobody_here_knows_at_a_frames_end_is_ignored() -> None:
    """A later program's entries, whatever they are: the message is the same but for them."""
    odd = {
        "contacts": [[1, 0.5, [0.0, 1.0]], None],
        "when": msgpack.Timestamp(1, 2),
        "é": b"x",
        "deep": {"a": {"b": 1}},
    }
    for name, message in GOLDEN.items():
        elements = msgpack.unpackb(encode(message))
        plain = elements[:-1] if message.more else elements
        extended = decode(msgpack.packb([*plain, odd]))
        assert extended.more is not None, name
        assert extended.more.keys() == odd.keys()
        bare = decode(msgpack.packb(plain))
        assert decode(msgpack.packb([*plain, {}])) == bare
        assert type(extended) is type(bare)
        assert structs.astuple(extended)[:-1] == structs.astuple(bare)[:-1]


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
        messages.examined(frame)
    except BadMessage as error:
        return error.kind
    return None


@settings(max_examples=300, deadline=None)
@given(st.binary(max_size=200))
@pytest.mark.long
def test_noise_never_raises_anything_else(data: bytes) -> None:
    survives(data)


trees = st.recursive(
    scalars | st.booleans() | st.floats() | st.binary(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(texts, inner, max_size=3),
    max_leaves=8,
)


@settings(max_examples=300, deadline=None)
@given(st.integers(0, 10), st.lists(trees, max_size=9))
@pytest.mark.long
def test_well_formed_nonsense_never_raises_anything_else(kind: int, fields: list[object]) -> None:
    survives(msgpack.packb([2, kind, A, *fields]))


@pytest.mark.long
def test_mutated_frames_give_a_message_or_a_counted_error() -> None:
    rng = random.Random(1)
    frames = [bytes.fromhex(f) for f in FRAMES.values()]
    for _ in range(20_000):
        data = bytearray(rng.choice(frames))
        for _ in range(rng.randrange(1, 4)):
            data[rng.randrange(len(data))] = rng.randrange(256)
        survives(bytes(data))
