"""What a decoder must say of any bytes, written from hapnet/wire/README.md, not from the code."""

import math
from typing import Any

import msgpack
from msgspec import structs

from hapnet.errors import BadMessage
from hapnet.wire.messages import Message, decode, encode
from tests.fuzzing.mutator import ENERGY, HELLO, POSITION, PROXY, REFUSE, WAVE, WELCOME

LENGTHS = dict(enumerate((8, 6, 8, 9, 5, 6, 9, 9, 9, 11, 6, 9, 5), 1))
"""How many elements a frame has, by its kind: position is 1, encrypted 13."""

BAD_FRAMES = {"size", "malformed", "version", "kind", "length", "type", "range", "dimension"}


class Broken(AssertionError):
    """Something that must hold does not."""


def hold(truth: bool, *words: object) -> None:
    """Raise Broken, with these words, unless it is true."""
    if not truth:
        raise Broken(" ".join(map(str, words)))


def allowed(data: bytes) -> list[Any] | None:
    """The elements of the frame in `data` if the protocol's page allows it, else None."""
    if len(data) > 4096:
        return None
    try:
        frame = msgpack.unpackb(data, strict_map_key=True, max_array_len=65)  # no array may be longer
    except (ValueError, TypeError, msgpack.UnpackException):
        return None
    if not isinstance(frame, list) or len(frame) < 3:
        return None
    version, kind = frame[:2]
    if not (_integer(version, -(2**63)) and _integer(kind, 1, max(LENGTHS)) and _integer(frame[2], 1)):
        return None
    length = LENGTHS[kind]
    if (version != 2 and kind != REFUSE) or len(frame) not in (length, length + 1):
        return None
    if not (_fields(kind, frame[3:length]) and all(map(_further, frame[length:]))):
        return None
    more = frame[length] if len(frame) > length else {}
    if kind == WAVE and "integral" in more and not _integral(more["integral"], len(frame[5])):
        return None
    if kind == ENERGY and "sums" in more and not _sums(more["sums"]):
        return None
    if kind in (HELLO, WELCOME) and "key" in more and not (isinstance(more["key"], bytes) and len(more["key"]) == 32):
        return None
    if kind in (HELLO, WELCOME) and "encrypts" in more and not isinstance(more["encrypts"], bool):
        return None
    if kind in (POSITION, PROXY) and "level" in more and not _within(more["level"], 1.0):
        return None
    if kind == PROXY and "reach" in more and not _within(more["reach"], 1e6):
        return None
    if kind == PROXY and "curvatures" in more and not _curvatures(more["curvatures"], frame[8], frame[5]):
        return None
    if kind == PROXY and "friction" in more and not _friction(more["friction"], frame[8]):
        return None
    if kind == PROXY and "effects" in more and not _effects(more["effects"], frame[8], len(frame[5])):
        return None
    return frame


def _fields(kind: int, fields: list[Any]) -> bool:
    match kind, fields:
        case 1 | 7 | 8 | 9 | 10, [sequence, sent_ns, *values, echo_ns, came_ns]:
            return all(map(_integer, (sequence, sent_ns, echo_ns, came_ns))) and _values(kind, values)
        case 2, [addressee, total_nJ, acked_nJ]:
            return _integer(addressee) and _integer(total_nJ, 0, 2**63 - 1) and _integer(acked_nJ, 0, 2**63 - 1)
        case 3, [number, *identity]:
            return _integer(number) and _identity(*identity)
        case 4, [addressee, number, *identity]:
            return _integer(addressee) and _integer(number) and _identity(*identity)
        case 5, [addressee, reason]:
            return _integer(addressee) and _text(reason)
        case 11, [addressee, sequence, values]:
            return _integer(addressee) and _integer(sequence) and _signals(values)
        case 12, [addressee, number, heard, asks, final, values]:
            flags = isinstance(asks, bool) and isinstance(final, bool)
            return all(map(_integer, (addressee, number, heard))) and flags and _signals(values, 64)
        case 13, [number, content]:
            return _integer(number) and isinstance(content, bytes) and len(content) > 16
        case 6, [addressee, acked_nJ, reason]:
            return _integer(addressee) and _integer(acked_nJ, 0, 2**63 - 1) and _text(reason)
    return False


def _values(kind: int, values: list[Any]) -> bool:
    match kind, values:
        case 1, [position]:
            return _floats(position)
        case 7, [position, velocity]:
            return _floats(position) and _floats(velocity) and len(position) == len(velocity)
        case 8, [value, energy_nJ]:
            return _floats(value) and _integer(energy_nJ, 0, 2**63 - 1)
        case 9, [wave, span_ns]:
            return _floats(wave) and _integer(span_ns, 1, 10**10)
        case 10, [position, aimed_ns, force, planes]:
            alike = _floats(position) and _floats(force) and len(force) == len(position)
            return alike and _integer(aimed_ns) and _planes(planes, len(position))
    return False


def _sums(sums: object) -> bool:
    if not (isinstance(sums, list) and len(sums) == 3):
        return False
    number, sent_nJ, seen = sums
    return _integer(number, 1, 2**63) and _integer(sent_nJ, 0, 2**63 - 1) and _integer(seen, 0, 2**63)


def _signals(values: object, most: int = 32) -> bool:
    if not (isinstance(values, dict) and len(values) <= most and all(map(_text, values))):
        return False
    for value in values.values():
        if isinstance(value, list):
            if len(value) > 64 or not all(
                isinstance(part, int) or (isinstance(part, float) and math.isfinite(part)) for part in value
            ):
                return False
        elif isinstance(value, float):
            if not math.isfinite(value):
                return False
        elif not (value is None or isinstance(value, int) or _text(value)):
            return False
    return True


def _planes(planes: object, dof: int) -> bool:
    if planes is None:
        return True
    if not (isinstance(planes, list) and len(planes) <= 8):
        return False
    return all(isinstance(plane, list) and len(plane) == 5 and _plane(plane, dof) for plane in planes)


def _plane(plane: list[Any], dof: int) -> bool:
    normal, *numbers = plane
    if not (_floats(normal) and len(normal) == dof and _floats(numbers)):
        return False
    return abs(math.fsum(n * n for n in normal) - 1.0) <= 1e-6 and numbers[1] > 0.0 and numbers[2] >= 0.0


def _curvatures(value: object, planes: Any, position: list[float]) -> bool:
    if planes is None or not (isinstance(value, list) and len(value) == len(planes)):
        return False
    for (normal, offset, *_), bends in zip(planes, value, strict=True):
        if not (isinstance(bends, list) and len(bends) <= 2):
            return False
        depth, before = sum(n * x for n, x in zip(normal, position, strict=True)) - offset, [normal]
        for bend in bends:
            match bend:
                case [list() as way, float(per_m)] if _floats(way) and len(way) == len(normal):
                    leans = [abs(sum(a * b for a, b in zip(way, other, strict=True))) for other in before]
                    if not (max(leans) <= 1e-6 and abs(sum(a * a for a in way) - 1.0) <= 1e-6):
                        return False
                    if not (abs(per_m) <= 1e4 and per_m * depth < 1.0):
                        return False
                    before.append(way)
                case _:
                    return False
    return True


def _friction(value: object, planes: Any) -> bool:
    if planes is None or not (isinstance(value, list) and len(value) == len(planes)):
        return False
    return all(isinstance(mu, float) and 0.0 <= mu <= 10.0 for mu in value)


def _effects(value: object, planes: Any, dof: int) -> bool:
    if planes is None or not (isinstance(value, list) and len(value) == len(planes)):
        return False
    return all(one is None or _effect(one, dof) for one in value)


def _effect(one: object, dof: int) -> bool:
    match one:
        case [float(drag), float(stick), float(snap), float(reach), grain]:
            if not (0.0 <= drag <= 1e3 and 0.0 <= stick <= 10.0 and 0.0 <= snap <= 100.0 and 0.0 <= reach <= 0.1):
                return False
            match grain:
                case None:
                    return True
                case [list(wave), float(height), bytes(shape)]:
                    good = all(isinstance(part, float) and abs(part) <= 1e5 for part in wave)
                    return good and len(wave) == dof and 0.0 <= height <= 0.1 and 2 <= len(shape) <= 256
    return False


def _further(value: object) -> bool:
    return isinstance(value, dict) and len(value) <= 32 and all(map(_text, value))


def _integral(value: object, dof: int) -> bool:
    match value:
        case [list() as total, total_ns] if len(total) == dof:
            return _integer(total_ns) and all(isinstance(part, float) and abs(part) <= 1e12 for part in total)
    return False


def _floats(value: object) -> bool:
    if not (isinstance(value, list) and 1 <= len(value) <= 64):
        return False
    return all(isinstance(x, float) and math.isfinite(x) and abs(x) <= 1e6 for x in value)


def _within(value: object, most: float) -> bool:
    return isinstance(value, float) and 0.0 <= value <= most


def _identity(role: object, dof: object, name: object, about: object) -> bool:
    if not (isinstance(about, dict) and len(about) <= 32 and role in ("device", "world") and _text(role)):
        return False
    return _integer(dof, 1, 64) and _text(name) and all(_text(key) and _scalar(about[key]) for key in about)


def _scalar(value: object) -> bool:
    if isinstance(value, float):
        return math.isfinite(value)
    return value is None or isinstance(value, int) or _text(value)


def _integer(value: object, minimum: int = 0, most: int = 2**64 - 1) -> bool:
    if value is True or value is False or not isinstance(value, int):
        return False
    return minimum <= value <= most


def _text(value: object) -> bool:
    return isinstance(value, str) and len(value) <= 256 and value.isprintable()


def decoded(data: bytes) -> Message | None:
    """Decode `data`, see that this went as it must, and return the message, or None if it is a bad one."""
    frame = allowed(data)
    try:
        message = decode(data)
    except BadMessage as error:
        hold(frame is None, "a frame that is allowed was refused:", error)
        hold(error.kind in BAD_FRAMES, "a kind that nobody counts:", error.kind)
        hold(len(str(error)) < 1000, "an error of", len(str(error)), "characters")
        return None
    if frame is None:
        raise Broken(f"a frame that is not allowed was taken: {message}")
    fields = structs.astuple(message)
    fields, further = fields[:-1], fields[-1]
    hold(repr(further or {}) == repr(_tupled(frame[len(fields) + 2 :] or [{}])[0]), "further", further, frame)
    frame = frame[: len(fields) + 2]
    hold(frame[1] == message.KIND, "kind", frame[1], "became", message)
    hold(_same(list(fields), frame[2:]), "fields", frame[2:], "became", message)
    again = decode(encode(message))
    hold(type(again) is type(message) and repr(again) == repr(message), message, "encoded is", again)
    return message


def _tupled(value: object) -> Any:
    """With tuples in place of arrays, wherever they are."""
    if isinstance(value, list):
        return tuple(map(_tupled, value))
    return {key: _tupled(inner) for key, inner in value.items()} if isinstance(value, dict) else value


def _same(fields: object, elements: object) -> bool:
    """Equal in value and in type, a tuple being as good as a list; zeros have signs."""
    if isinstance(fields, list | tuple) and isinstance(elements, list):
        return len(fields) == len(elements) and all(map(_same, fields, elements))
    if isinstance(fields, dict) and isinstance(elements, dict):
        return list(fields) == list(elements) and all(map(_same, fields.values(), elements.values()))
    return type(fields) is type(elements) and repr(fields) == repr(elements)
