"""A world's picture in recordings and telemetry: its parts once (`Drawing`), their motion as `SceneSample`.

Numbers are 32 bit, little-endian. A drawing is zlib-compressed msgpack: an array of parts, each an array of its
vertices' bytes, its triangles' bytes, four colour numbers, its body's number, and whether it is smooth (`Part`).
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from typing import Any, NamedTuple

import msgpack
import numpy as np
from numpy.typing import NDArray

from hapnet.checks import Array, Vector
from hapnet.errors import BadMessage
from hapnet.plant.worlds.picture import SOFT, Part, Picture, Touch

PERIOD_NS = 16_000_000
"""The minimum time between two scene samples [ns]: some 60 a second."""

LARGEST = 4 * 1024 * 1024
"""Largest drawing [bytes]. A larger drawing is not sent; a viewer that has the scene's files can still draw it."""

_UNPACKED = 32 * 1024 * 1024
_MARKS = 1024 * 1024  # largest overhead of msgpack [bytes]
_POSE, _TOUCH, _VERTEX = 7, 10, 3  # numbers in each


class Drawing(NamedTuple):
    """A world's parts, packed; empty if they are too large."""

    time_ns: int
    data: bytes


class SceneSample(NamedTuple):
    """The moving parts of a world's picture, as float32.

    `poses` : of each body that moves, 7 numbers: place [m] and quaternion w, x, y, z. `touches` : of each contact of
    the proxy, 10 numbers: point [m], normal, mu, force [N]. `soft` : of each vertex of the soft parts, 3 numbers [m].
    """

    time_ns: int
    poses: bytes
    touches: bytes
    soft: bytes

    def bodies(self) -> Array:
        """(B, 7)."""
        return _numbers(self.poses, _POSE)

    def contacts(self) -> list[Touch]:
        return [
            Touch(tuple(row[:3]), tuple(row[3:6]), row[6], tuple(row[7:]))
            for row in _numbers(self.touches, _TOUCH).tolist()
        ]

    def vertices(self) -> Array:
        """(V, 3)."""
        return _numbers(self.soft, _VERTEX)

    def problem(self) -> str | None:
        """The reason why this cannot be drawn; None: it can."""
        for data, count in ((self.poses, _POSE), (self.touches, _TOUCH), (self.soft, _VERTEX)):
            if len(data) % (4 * count) or not np.isfinite(np.frombuffer(data, "<f4")).all():
                return "a scene with incomplete or infinite numbers"
        return None


def observe(picture: Picture, now_ns: int, position: Vector, force: Vector) -> SceneSample:
    """Sample the picture now, with the proxy at `position` (n,) [m] and the force `force` (n,) [N] on it."""
    touches = [(*touch.point, *touch.normal, touch.friction, *touch.force_N) for touch in
               picture.touches(position, force)]  # fmt: skip
    return SceneSample(now_ns, _bytes(picture.poses()), _bytes(touches), _bytes(picture.soft()))


class SceneWriter:
    """Writes a world's drawing at once, and then scene samples, some 60 a second at most.

    picture : of the world. write : records and sends its argument. now_ns : when control starts.
    """

    def __init__(self, picture: Picture, write: Callable[[Drawing | SceneSample], None], now_ns: int) -> None:
        self._picture, self._write, self._due_ns = picture, write, now_ns
        write(Drawing(now_ns, pack(picture.parts)))

    def step(self, now_ns: int, position: Vector, force: Vector) -> None:
        """Call this after each step of the world; arguments as in `observe`."""
        if now_ns >= self._due_ns:
            self._due_ns = max(now_ns, self._due_ns + PERIOD_NS)
            self._write(observe(self._picture, now_ns, position, force))


def pack(parts: tuple[Part, ...]) -> bytes:
    """Pack the parts as bytes; no bytes if they are too large."""
    numbers = [
        (_bytes(one.vertices), np.asarray(one.triangles, "<u4").tobytes(), one.color, one.body, one.smooth)
        for one in parts
    ]
    if sum(len(vertices) + len(triangles) for vertices, triangles, *_ in numbers) > _UNPACKED:
        return b""
    packed = zlib.compress(msgpack.packb(numbers), 6)
    return packed if len(packed) <= LARGEST else b""


def unpack(data: bytes) -> tuple[Part, ...]:
    """Unpack the parts from these bytes; no parts if there are no bytes, as the drawing was too large.

    Raises BadMessage: the bytes are not a drawing.
    """
    if not data:
        return ()
    try:
        opened = zlib.decompressobj()
        unpacker = msgpack.Unpacker(use_list=False, max_array_len=4, max_map_len=0, max_ext_len=0, max_buffer_size=0)
        unpacker.feed(opened.decompress(data, _UNPACKED + _MARKS))
        parts = tuple([_next_part(unpacker) for _ in range(unpacker.read_array_header())])
    except (TypeError, ValueError, OverflowError, zlib.error, msgpack.UnpackException) as error:
        raise BadMessage("drawing", f"no parts ({error})") from None
    return parts


def _next_part(unpacker: msgpack.Unpacker) -> Part:
    if unpacker.read_array_header() != len(Part._fields):
        raise ValueError("an array that is not a part")
    return _part(*[unpacker.unpack() for _ in Part._fields])


def _part(vertices: bytes, triangles: bytes, color: Any, body: int, smooth: bool) -> Part:
    places = _numbers(vertices, _VERTEX).astype(np.float32)
    corners: NDArray[Any] = np.frombuffer(triangles, "<u4").reshape(-1, 3).astype(np.uint32)
    red, green, blue, opacity = (int(value) for value in color)
    whole = all(0 <= value <= 255 for value in (red, green, blue, opacity)) and type(body) is int and body >= SOFT
    if not whole or not np.isfinite(places).all() or (corners.size and corners.max() >= len(places)):
        raise ValueError("a part that cannot be drawn")
    return Part(places, corners, (red, green, blue, opacity), body, bool(smooth))


def _bytes(values: Any) -> bytes:
    return np.asarray(values, "<f4").tobytes()


def _numbers(data: bytes, each: int) -> Array:
    return np.frombuffer(data, "<f4").reshape(-1, each).astype(float)
