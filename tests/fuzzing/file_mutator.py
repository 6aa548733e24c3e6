"""Files to attack the readers with: recordings, meshes, URDF, TOML and numpy's arrays, each broken somewhere by a seed.

Half of them are broken in their bytes, as a damaged disk would. The others know the format: they change a size that a
header claims, move or drop a record, nest a thing in itself, or put in a number that fits nowhere.
"""

import json
import random
import re
import struct
import zlib
from collections.abc import Callable, Mapping

import lz4.frame
import zstandard

SIZES = (0, 1, 2, 7, 255, 256, 4096, 2**31 - 1, 2**31, 2**32 - 1, 2**40, 2**63 - 1, 2**63, 2**64 - 1)
WORDS = (
    "nan", "inf", "-inf", "1e309", "-1e308", "5e-324", "0", "-1", "1" * 5000, "0x" + "f" * 5000, "9223372036854775808",
    "''", '"', "\\", "[]", "{}", "true", "null", "é", "\u202e", "\0", "a.b.c", "99999999999999999999", "", " ", "\n",
)  # fmt: skip
DEPTHS = (3, 60, 1000, 100_000)

_MAGIC = b"\x89MCAP0\r\n"
Record = tuple[int, bytes]


class FileMutator:
    """An endless stream of broken files of one kind. rng : of everything. seeds : as `seeds` gives them."""

    def __init__(self, rng: random.Random, kind: str, seeds: list[tuple[str, bytes]]) -> None:
        self._rng, self._seeds, self._structural = rng, seeds, _STRUCTURAL[kind]

    def next(self) -> tuple[str, bytes]:
        """The ending of a file, and its content."""
        rng = self._rng
        ending, data = rng.choice(self._seeds)
        for _ in range(rng.choice((1, 1, 1, 2, 3, 6))):
            change = rng.choice(self._structural) if rng.random() < 0.7 else rng.choice(_BYTES)
            data = change(rng, data)
        return ending, data


# -- any bytes ---------------------------------------------------------------------------------------------------------


def _flip(rng: random.Random, data: bytes) -> bytes:
    out = bytearray(data or b"\0")
    for _ in range(rng.choice((1, 1, 3, 20))):
        out[rng.randrange(len(out))] = rng.randrange(256)
    return bytes(out)


def _cut(rng: random.Random, data: bytes) -> bytes:
    return data[: rng.randrange(len(data) + 1)]


def _lose(rng: random.Random, data: bytes) -> bytes:
    start = rng.randrange(len(data) + 1)
    return data[:start] + data[start + rng.choice((1, 2, 8, 100)) :]


def _again(rng: random.Random, data: bytes) -> bytes:
    start = rng.randrange(len(data) + 1)
    part = data[start : start + rng.choice((1, 4, 9, 100, 1000))]
    return data[:start] + part * rng.choice((2, 3, 50)) + data[start:]


def _claim(rng: random.Random, data: bytes) -> bytes:
    at, form = rng.randrange(len(data) + 1), rng.choice(("<B", "<H", "<I", "<Q", ">I"))
    size = rng.choice(SIZES) % (1 << 8 * struct.calcsize(form))
    return data[:at] + struct.pack(form, size) + data[at + struct.calcsize(form) :]


_BYTES: tuple[Callable[[random.Random, bytes], bytes], ...] = (_flip, _cut, _lose, _again, _claim)


# -- text --------------------------------------------------------------------------------------------------------------


def _other_word(rng: random.Random, data: bytes) -> bytes:
    places = list(re.finditer(rb"[-\w.+]+", data))
    if not places:
        return data
    where = rng.choice(places)
    return data[: where.start()] + rng.choice(WORDS).encode() + data[where.end() :]


def _swapped_words(rng: random.Random, data: bytes) -> bytes:
    places = list(re.finditer(rb"[-\w.+]+", data))
    if len(places) < 2:
        return data
    one, two = sorted(rng.sample(places, 2), key=lambda place: place.start())
    return data[: one.start()] + two[0] + data[one.end() : two.start()] + one[0] + data[two.end() :]


def _line_again(rng: random.Random, data: bytes) -> bytes:
    lines = data.split(b"\n")
    at = rng.randrange(len(lines))
    return b"\n".join(lines[:at] + [lines[at]] * rng.choice((0, 2, 100)) + lines[at + 1 :])


def _moved_line(rng: random.Random, data: bytes) -> bytes:
    lines = data.split(b"\n")
    line = lines.pop(rng.randrange(len(lines)))
    lines.insert(rng.randrange(len(lines) + 1), line)
    return b"\n".join(lines)


def _deep_toml(rng: random.Random, data: bytes) -> bytes:
    n = rng.choice(DEPTHS)
    bad = rng.choice(
        (
            b"x = " + b"[" * n,
            b"x = " + b"[" * n + b"]" * n,
            b"x = " + b"{a=" * n + b"1" + b"}" * n,
            b"[" + b"a." * n + b"a]",
            b"a." * n + b"a = 1",
            b"dof = " + b"9" * 5000,
            b"seed = 0x" + b"f" * n,
        )
    )
    at = rng.choice([0, *[place.end() for place in re.finditer(rb"\n", data)]])
    return data[:at] + bad + b"\n" + data[at:]


def _deep_xml(rng: random.Random, data: bytes) -> bytes:
    n = rng.choice(DEPTHS)
    laughs = b'<!DOCTYPE r [<!ENTITY a "' + b"h" * 1000 + b'">' + b"".join(
        b'<!ENTITY %s "%s">' % (bytes([98 + k]), b"&%c;" % (97 + k) * 10) for k in range(9)) + b"]>"  # fmt: skip
    at = rng.choice([place.end() for place in re.finditer(rb">", data)] or [0])
    bad = rng.choice(
        (b"<link>" * n, b"<link>" * n + b"</link>" * n, laughs, b"<link name='&j;'/>", b"<!--", b"<![CDATA[")
    )
    return data[:at] + bad + data[at:]


def _deep_json(rng: random.Random, data: bytes) -> bytes:
    """Another value where a JSON value begins, as long as the one that was there."""
    places = list(re.finditer(rb"[{\[][^{}\[\]\0]*[}\]]", data))
    if not places:
        return data
    where = rng.choice(places)
    odd = rng.choice((b"7", b"null", b'"x"', b"[]", b"[" * len(where[0]), b"{}", b'{"seed":{}}', b"9" * len(where[0])))
    return data[: where.start()] + odd[: len(where[0])].ljust(len(where[0])) + data[where.end() :]


def _large_model(rng: random.Random, data: bytes) -> bytes:
    """A model that claims to be large, somewhere among its elements."""
    n = rng.choice((b"7", b"1000", b"60000", b"99999999", b"2000000000"))
    at = rng.choice([place.end() for place in re.finditer(rb">", data)] or [0])
    bad = rng.choice(
        (
            b'<replicate count="%b"><geom size="0.01"/></replicate>' % n,
            b'<replicate count="1000">' * 3 + b'<geom size="0.01"/>' + b"</replicate>" * 3,
            b'<flexcomp name="x" type="grid" count="%b %b 2" spacing="0.01 0.01 0.01" dim="3"/>' % (n, n),
            b'<asset><hfield name="h" nrow="%b" ncol="%b" size="1 1 1 1"/></asset>' % (n, n),
            b'<asset><texture name="t" type="cube" builtin="flat" width="%b"/></asset>' % n,
            b'<asset><texture name="t" type="2d" builtin="checker" width="%b" height="%b"/></asset>' % (n, n),
            b'<size memory="%bM"/>' % n,
            b'<size nuserdata="%b" nkey="%b"/>' % (n, n),
            b'<size nuser_geom="%b"/>' % n,
            b'<include file="/dev/zero"/>',
            b'<asset><mesh name="m" file="/dev/zero"/></asset>',
        )
    )
    data = data[:at] + bad + data[at:]
    return data if rng.random() < 0.5 else re.sub(rb"<worldbody>", b"<worldbody>" + bad, data, count=1)


# -- recordings --------------------------------------------------------------------------------------------------------


def _records(data: bytes) -> list[Record]:
    found, at = [], len(_MAGIC)
    while at + 9 <= len(data):
        length = struct.unpack("<Q", data[at + 1 : at + 9])[0]
        if at + 9 + length > len(data):
            break
        found.append((data[at], data[at + 9 : at + 9 + length]))
        at += 9 + length
    return found


def _file(records: list[Record]) -> bytes:
    return _MAGIC + b"".join(_record(*one) for one in records) + _MAGIC


def _record(code: int, body: bytes) -> bytes:
    return bytes([code]) + struct.pack("<Q", len(body)) + body


def _shuffled(rng: random.Random, data: bytes) -> bytes:
    records = _records(data)
    if not records:
        return data
    at = rng.randrange(len(records))
    match rng.randrange(5):
        case 0:
            del records[at]
        case 1:
            records.insert(rng.randrange(len(records)), records[at])
        case 2:
            records[at] = rng.randrange(256), records[at][1]
        case 3:
            records[at] = records[at][0], rng.choice(_BYTES)(rng, records[at][1])
        case 4:
            records.insert(at, (rng.randrange(20), rng.randbytes(rng.choice((0, 5, 40)))))
    return _file(records)


def _chunk(rng: random.Random, body: bytes, change: Callable[[bytes], bytes]) -> bytes:
    """A chunk with other records in it, or with a claim that is wrong."""
    first, last, size, _, name = struct.unpack_from("<QQQII", body)
    kind, packed = body[32 : 32 + name], body[40 + name :]
    try:
        inside = lz4.frame.decompress(packed) if kind == b"lz4" else packed
    except RuntimeError:
        inside = packed
    inside = change(inside)
    crc = rng.choice((0, zlib.crc32(inside)))
    kind = rng.choice((b"lz4", b"zstd", b"", b"lz4", b"lzma"))
    packed = {b"lz4": lz4.frame.compress, b"zstd": zstandard.compress}.get(kind, bytes)(inside)
    size = rng.choice((len(inside), len(inside), len(inside), rng.choice(SIZES)))
    return struct.pack("<QQQII", first, last, size, crc, len(kind)) + kind + struct.pack("<Q", len(packed)) + packed


def _inside(rng: random.Random, data: bytes) -> bytes:
    records = _records(data)
    chunks = [k for k, (code, body) in enumerate(records) if code == 6 and len(body) > 40]
    if not chunks:
        return data

    def change(inside: bytes) -> bytes:
        return (
            _shuffled(rng, _MAGIC + inside)[len(_MAGIC) : -len(_MAGIC)] if rng.random() < 0.7 else _claim(rng, inside)
        )

    at = rng.choice(chunks)
    try:
        records[at] = 6, _chunk(rng, records[at][1], change)
    except struct.error:
        return data
    return _file(records)


def _bomb(rng: random.Random, data: bytes) -> bytes:
    """A chunk that unpacks to much, with or without saying so."""
    n = rng.choice((1 << 20, 40 << 20, 40 << 20))
    packed, kind = _BOMBS.setdefault(n, (zstandard.compress(bytes(n)), b"zstd"))
    said = rng.choice((n, n, 1000, 2**33))
    body = struct.pack("<QQQII", 0, 1, said, 0, len(kind)) + kind + struct.pack("<Q", len(packed)) + packed
    records = _records(data)
    return _file([*records[: min(2, len(records))], (6, body), *records[2:]])


_BOMBS: dict[int, tuple[bytes, bytes]] = {}


def _settings(rng: random.Random, data: bytes) -> bytes:
    """Other settings, or another summary."""
    records = _records(data)
    texts = [k for k, (code, body) in enumerate(records) if code == 12 and b"json" in body]
    if not texts:
        return data
    at = rng.choice(texts)
    body = records[at][1]
    start = body.find(b"{")
    try:
        tree = json.loads(body[start:])
    except (ValueError, RecursionError):
        return data
    text = json.dumps(_other_tree(rng, tree)).encode()
    if rng.random() < 0.1:
        text = text.replace(b"{", b'{"a":' + b"[" * rng.choice(DEPTHS), 1)
    name = body[: struct.unpack_from("<I", body)[0] + 4]
    inner = struct.pack("<I", 4) + b"json" + struct.pack("<I", len(text)) + text
    records[at] = 12, name + struct.pack("<I", len(inner)) + inner
    return _file(records)


def _other_tree(rng: random.Random, tree: object) -> object:
    """The same tree with one value that is other, gone or new."""
    if isinstance(tree, dict) and tree and rng.random() < 0.9:
        key = rng.choice(list(tree))
        if rng.random() < 0.15:
            return {name: value for name, value in tree.items() if name != key}
        return {**tree, key: _other_tree(rng, tree[key])}
    if isinstance(tree, list) and tree and rng.random() < 0.7:
        at = rng.randrange(len(tree))
        return [*tree[:at], _other_tree(rng, tree[at]), *tree[at + 1 :]]
    odd = (
        None,
        True,
        -1,
        0,
        10**30,
        1e308,
        -1e308,
        5e-324,
        "",
        "x",
        "evilmod:x",
        "subprocess:run?args=false",
        "arm:/dev/zero?tip=a",
        "mesh:/dev/zero",
        [],
        {},
        [[]],
        "1" * 5000,
    )
    return rng.choice(odd)


# -- numpy -------------------------------------------------------------------------------------------------------------


def _heading(rng: random.Random, data: bytes) -> bytes:
    """Another header: of other axes, or another kind of number."""
    kind = rng.choice(("<f8", "<f4", "<i2", ">f8", "|O", "<U7", "<c16", "|V8", "<f2", "nonsense", "<M8[ns]"))
    axes = rng.choice(
        ((5, 5, 5), (10**13,), (2**62, 4, 4), (-5, 5, 5), (0,), (), (5, 5, 5.0), (125,), (1, 1, 125), ("a",))
    )
    text = f"{{'descr': {kind!r}, 'fortran_order': {rng.choice((True, False, 7))}, 'shape': {axes}, }}"
    text = rng.choice((text, text, text, "(" * 900, "[" * 50_000, "{}", "1 + 1", text[:-4]))
    version = rng.choice((1, 1, 1, 2, 3, 9))
    form = "<H" if version == 1 else "<I"
    packed = text.encode()[: 65_000 if version == 1 else None]
    return b"\x93NUMPY" + bytes([version, 0]) + struct.pack(form, len(packed)) + packed + data[128:]


_TEXT = (_other_word, _swapped_words, _line_again, _moved_line)
_STRUCTURAL: Mapping[str, tuple[Callable[[random.Random, bytes], bytes], ...]] = {
    "recording": (_shuffled, _inside, _inside, _settings, _settings, _bomb, _claim),
    "mesh": (*_TEXT, _claim),
    "urdf": (*_TEXT, *_TEXT, _deep_xml),
    "toml": (*_TEXT, *_TEXT, _deep_toml),
    "npy": (_heading, _heading, _claim),
    "mujoco": (*_TEXT, *_TEXT, _deep_xml, _large_model, _large_model),
    "journal": (*_TEXT, _deep_json, _deep_json, _claim),
}
