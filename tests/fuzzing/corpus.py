"""Seed frames: golden ones, oddities, a real conversation, and what atheris found, which is in `corpus/`."""

import struct
from functools import cache
from pathlib import Path

import msgpack

from hapnet.wire.session import Session

FOLDER = Path(__file__).parent / "corpus"
GOLDEN = Path(__file__).parents[1] / "data" / "frames.txt"
DEVICE, WORLD = 0x1122334455667788, 0xFEDCBA9876543210
"""The incarnations in the golden frames: of the device, "pen", and the world, "wall"."""

MS = 1_000_000
NAN, INF = float("nan"), float("inf")


def golden() -> dict[str, bytes]:
    lines = [line.split() for line in GOLDEN.read_text().splitlines() if not line.startswith("#")]
    return {name: bytes.fromhex(frame) for name, frame in lines}


def oddities() -> dict[str, bytes]:
    """Frames that are wrong in one way, or only just right."""

    def position(*coordinates: object, sequence: object = 7, sent_ns: object = 10**9) -> list[object]:
        return [2, 1, WORLD, sequence, sent_ns, list(coordinates), 0, 0]

    def hello(**changes: object) -> list[object]:
        fields: dict[str, object] = {"number": 1, "role": "world", "dof": 1, "name": "wall", "about": {}}
        return [2, 3, WORLD, *(fields | changes).values()]

    def wave(further: dict[str, object]) -> list[object]:
        return [2, 9, WORLD, 7, 10**9, [0.5], 1, 0, 0, further]

    def proxy(**further: object) -> list[object]:
        return [2, 10, WORLD, 7, 10**9, [0.0], 0, [0.0], [[[1.0], 0.02, 3000.0, 10.0, 0.0]], 0, 0, further]

    frames: dict[str, object] = {
        "position-nan": position(NAN),
        "position-infinite": position(INF, -INF),
        "position-subnormal": position(5e-324, -5e-324, 2.2e-308),
        "position-edge": position(1e6, -1e6),
        "position-outside": position(1000000.0000000001),
        "position-integer": position(1),
        "position-64": position(*[0.5] * 64),
        "position-65": position(*[0.5] * 65),
        "position-none": position(),
        "position-bytes": [2, 1, WORLD, 7, 10**9, struct.pack(">ddd", 1.0, 2.0, 3.0), 0, 0],
        "position-map": [2, 1, WORLD, 7, 10**9, {"x": 1.0}, 0, 0],
        "position-leap": position(0.0, sequence=2**64 - 1, sent_ns=2**64 - 1),
        "position-negative": position(0.0, sequence=-1),
        "position-own": [2, 1, DEVICE, 7, 10**9, [0.0], 0, 0],
        "position-nobody": [2, 1, 0, 7, 10**9, [0.0], 0, 0],
        "position-boolean": [True, 1, WORLD, 7, 10**9, [0.0], 0, 0],
        "signals-nan": [2, 11, WORLD, DEVICE, 1, {"grip": NAN}],
        "signals-nested": [2, 11, WORLD, DEVICE, 1, {"grip": [[1.0]]}],
        "signals-33": [2, 11, WORLD, DEVICE, 1, {f"signal {i}": i for i in range(33)}],
        "signals-65": [2, 11, WORLD, DEVICE, 1, {"grip": [0.5] * 65}],
        "signals-bytes": [2, 11, WORLD, DEVICE, 1, {"grip": b"x"}],
        "signals-none": [2, 11, WORLD, DEVICE, 0, {}],
        "account-65": [2, 12, WORLD, DEVICE, 1, 0, False, False, {f"value {i}": i for i in range(65)}],
        "account-64": [2, 12, WORLD, DEVICE, 1, 0, False, True, {f"value {i}": 0.5 for i in range(64)}],
        "account-nan": [2, 12, WORLD, DEVICE, 1, 0, False, False, {"ledger.margin_J": NAN}],
        "account-flags": [2, 12, WORLD, DEVICE, 1, 0, 1, 0, {}],
        "account-unheard": [2, 12, WORLD, DEVICE, 1, 2**64 - 1, True, True, {}],
        "account-none": [2, 12, WORLD, DEVICE, 0, 0, False, False, {}],
        "account-short": [2, 12, WORLD, DEVICE, 1],
        "encrypted-empty": [2, 13, WORLD, 7, bytes(16)],
        "encrypted-least": [2, 13, WORLD, 7, bytes(17)],
        "encrypted-last": [2, 13, WORLD, 2**64 - 1, bytes(100)],
        "encrypted-text": [2, 13, WORLD, 7, "x" * 40],
        "encrypted-nobody": [2, 13, 0, 7, bytes(40)],
        "hello-encrypts": [*hello(), {"encrypts": True}],
        "hello-encrypts-once": [*hello(), {"encrypts": 1}],
        "energy-most": [2, 2, WORLD, DEVICE, 2**63 - 1, 0],
        "energy-too-much": [2, 2, WORLD, DEVICE, 2**63, 0],
        "energy-unannounced": [2, 2, WORLD, DEVICE, 1, 2**63 - 1],
        "energy-negative": [2, 2, WORLD, DEVICE, -1, 0],
        "energy-other": [2, 2, WORLD, 3, 1000, 0],
        "energy-2-53": [2, 2, WORLD, DEVICE, 2**53 + 1, 0],
        "energy-float": [2, 2, WORLD, DEVICE, 1000.0, 0],
        "hello-foreign": [2, 3, 99, 1, "world", 1, "wall", {}],
        "hello-same-role": hello(role="device"),
        "hello-no-role": hello(role="observer"),
        "hello-dof": hello(dof=3),
        "hello-dof-65": hello(dof=65),
        "hello-binary-name": hello(name=b"wall"),
        "hello-line-end": hello(name="wall\nERROR all is lost"),
        "hello-long-name": hello(name="w" * 257),
        "hello-about-32": hello(about={f"key{i}": i for i in range(32)}),
        "hello-about-33": hello(about={f"key{i}": i for i in range(33)}),
        "hello-about-nested": hello(about={"a": [1]}),
        "hello-about-nan": hello(about={"a": NAN}),
        "hello-about-values": hello(about={"coupling": "pspm", "a": None, "b": True, "c": -(2**63), "d": 2**64 - 1}),
        "hello-coupling": hello(about={"coupling": "zoh"}),
        "hello-earlier": hello(about={"earlier": 3}),
        "welcome-number": [2, 4, WORLD, DEVICE, 2**64 - 1, "world", 1, "wall", {}],
        "welcome-foreign": [2, 4, 99, DEVICE, 1, "world", 1, "wall", {}],
        "refuse-version-9": [9, 5, WORLD, DEVICE, "too old"],
        "hello-version-1": [1, 3, WORLD, 1, "world", 1, "wall", {}],
        "hello-version-3": [3, 3, WORLD, "whatever", [2], {"version": 3}],
        "position-version-1": [1, 1, WORLD, 7, 10**9, [0.0]],
        "energy-version-3": [3, 2, WORLD, DEVICE, 1000, 0],
        "bye-nobody": [2, 6, WORLD, 0, 0, ""],
        "bye-unannounced": [2, 6, WORLD, DEVICE, 2**62, "gone"],
        "motion-short": [2, 7, WORLD],
        "motion-foreign": [2, 7, WORLD, 7, 10**9, [0.5], [0.5], 0, 0],
        "motion-uneven": [2, 7, WORLD, 7, 10**9, [0.5], [0.5, 0.5], 0, 0],
        "motion-fast": [2, 7, WORLD, 7, 10**9, [0.5], [1000000.0000000001], 0, 0],
        "port-foreign": [2, 8, WORLD, 7, 10**9, [0.5], 0, 0, 0],
        "port-most": [2, 8, WORLD, 7, 10**9, [0.5], 2**63 - 1, 0, 0],
        "port-too-much": [2, 8, WORLD, 7, 10**9, [0.5], 2**63, 0, 0],
        "port-in-debt": [2, 8, WORLD, 7, 10**9, [0.5], -1, 0, 0],
        "wave-longest": [2, 9, WORLD, 7, 10**9, [0.5], 10**10, 0, 0],
        "wave-too-long": [2, 9, WORLD, 7, 10**9, [0.5], 10**10 + 1, 0, 0],
        "wave-of-no-time": [2, 9, WORLD, 7, 10**9, [0.5], 0, 0, 0],
        "wave-leap": [2, 9, WORLD, 2**64 - 1, 10**9, [0.5], 1, 0, 0],
        "wave-integral": wave({"integral": [[1e12], 2**64 - 1]}),
        "wave-integral-too-large": wave({"integral": [[1e12 + 1.0], 7]}),
        "wave-integral-nan": wave({"integral": [[NAN], 7]}),
        "wave-integral-uneven": wave({"integral": [[0.5, 0.5], 7]}),
        "wave-integral-of-integers": wave({"integral": [[1], 7]}),
        "wave-integral-before": wave({"integral": [[0.5], -1]}),
        "wave-integral-short": wave({"integral": [[0.5]]}),
        "wave-integral-bare": wave({"integral": 0.5}),
        "wave-integral-text": wave({"integral": ["1", 7]}),
        "kind-unknown": [2, 99, WORLD, 7, 10**9, [0.5]],
        "position-echo": [2, 1, WORLD, 7, 10**9, [0.0], 2**64 - 1, 2**64 - 1],
        "position-echo-negative": [2, 1, WORLD, 7, 10**9, [0.0], -1, 0],
        "position-further": [2, 1, WORLD, 7, 10**9, [0.0], 5, 6, {"contacts": [[1, 0.5]], "orientation": [1.0, 0.0]}],
        "position-level": [*position(0.0), {"level": 0.5}],
        "position-level-full": [*position(0.0), {"level": 1.0, "b": 1}],
        "position-level-above": [*position(0.0), {"level": 1.0000000000000002}],
        "position-level-below": [*position(0.0), {"level": -5e-324}],
        "position-level-nan": [*position(0.0), {"level": NAN}],
        "position-level-integer": [*position(0.0), {"level": 1}],
        "position-reach": [*position(0.0), {"reach": "of a proxy only"}],
        "proxy-level-none": proxy(level=None),
        "proxy-reach": proxy(level=0.25, reach=1e6),
        "proxy-reach-too-far": proxy(reach=1000000.0000000001),
        "proxy-reach-below": proxy(reach=-0.1),
        "proxy-reach-nan": proxy(reach=NAN),
        "proxy-reach-integer": proxy(reach=1),
        "position-further-none": [2, 1, WORLD, 7, 10**9, [0.0], 5, 6, None],
        "energy-further-33": [2, 2, WORLD, DEVICE, 1000, 0, {f"key{i}": i for i in range(33)}],
        "hello-further": [*hello(), {"roles": ["operator"]}],
        "hello-shared": hello(about={"shared.impedance_Ns_m": 2.5}),
        "extension": [2, 1, WORLD, 7, msgpack.ExtType(5, b"time"), [0.0], 0, 0],
        "timestamp": [2, 1, WORLD, 7, msgpack.Timestamp(1, 2), [0.0], 0, 0],
        "map": {"version": 1},
        "number": 7,
    }
    raw = {
        "empty": b"",
        "reserved": b"\xc1",
        "nested-maps": b"\x81\xa1a" * 1300,
        "nested": b"\x91" * 600,
        "nested-wide": b"\xdc\x0f\xff" * 1365,
        "announced": b"\xdd\xff\xff\xff\xff\x01",
        "announced-text": b"\x95\x02\x05\x01\x01\xdb\xff\xff\xff\xff",
        "not-utf8": b"\x95\x02\x05\x01\x01\xa2\xff\xfe",
        "two-frames": golden()["energy"] * 2,
        "cut": golden()["position"][:-1],
        "size": b"\x00" * 4097,
        "map-twice": b"\x98\x02\x03\x05\x01\xa6device\x01\xa1n\x82\xa1a\x01\xa1a\x02",
        "map-integer-key": b"\x98\x02\x03\x05\x01\xa6device\x01\xa1n\x81\x01\x02",
        "float32": b"\x98\x02\x01\x05\x07\x08\x91\xca" + struct.pack(">f", 0.1) + b"\x00\x00",
        "long-integers": b"\x98\x02\x01\xcf" + struct.pack(">Q", 5) + b"\xd3" + struct.pack(">q", 7) +
                         b"\x00\x91\xcb" + bytes(8) + b"\xcc\x01\xcd\x00\x01",
    }  # fmt: skip
    return {name: msgpack.packb(frame) for name, frame in frames.items()} | raw


def conversation() -> dict[str, bytes]:
    """What a device and a world say to each other in their first second, one of each kind and the last of each."""
    device = Session(role="device", dof=1, name="pen", incarnation=DEVICE, about={"coupling": "pspm"})
    world = Session(role="world", dof=1, name="wall", incarnation=WORLD, about={"coupling": "pspm"})
    frames: dict[str, bytes] = {}

    def say(speaker: Session, listener: Session, now_ns: int, kind: str, data: bytes) -> None:
        name = f"session-{speaker.identity.role}-{kind}"
        frames[name if name not in frames else f"{name}-last"] = data
        listener.receive(now_ns, data)

    for now_ns in range(0, 1000 * MS, MS):
        if now_ns == 900 * MS:
            device.close(now_ns, "duration is over")
        for speaker, listener in ((device, world), (world, device)):
            if now_ns % (100 * MS) == 50 * MS:
                speaker.shuffle(now_ns * 1e-12)
                say(speaker, listener, now_ns, "position", speaker.position(now_ns, (now_ns * 1e-11,)))
            for kind, data in speaker.poll(now_ns)[0]:
                say(speaker, listener, now_ns, f"{kind}-{data[2]}", data)
    return frames


@cache
def seeds() -> dict[str, bytes]:
    """Every seed by name, those that atheris found among them."""
    made = {f"golden-{name}": data for name, data in golden().items()} | oddities() | conversation()
    found = {path.stem: path.read_bytes() for path in FOLDER.glob("*.bin")}
    return dict(sorted((made | found).items(), key=lambda seed: f"{seed[0]}.bin"))


def found_lives() -> list[bytes]:
    """What atheris found for a whole session: inputs of `lives.one_life`."""
    return [path.read_bytes() for path in sorted(FOLDER.glob("*.life"))]
