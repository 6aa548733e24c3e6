"""Reads untrusted files: plain files of a bounded size, and tables and trees of a bounded depth.

All errors are OSError or ValueError, with a reason in one line.
"""

from __future__ import annotations

import errno
import json
import os
import stat
import tomllib
from os import PathLike
from pathlib import Path
from typing import IO, Any

LARGEST_TEXT = 4 << 20
"""The largest TOML, URDF or CSV file that is read [bytes]."""

DEEPEST = 50
"""The deepest nesting of tables and lists in a file."""

MOST_DOTS = 10_000
"""The most dots in a line of a TOML file: the time to parse a dotted name grows with the square of its parts."""


MCAP = b"\x89MCAP0\r\n"
"""The first bytes of a recording."""


def begins_with(path: str | PathLike[str], magic: bytes) -> bool:
    """Whether the file exists and begins with these bytes."""
    try:
        with open_plain(path) as file:
            return file.read(len(magic)) == magic
    except (OSError, ValueError):
        return False


def open_plain(path: str | PathLike[str], most: int | None = None) -> IO[bytes]:
    """Open a file for reading. A pipe or a device is refused, as reading it may never end.

    most : the largest size that is allowed [bytes]; None: any. Raises OSError.
    """
    name = os.fspath(path)
    try:
        found = os.stat(name)
    except ValueError:  # a null byte
        raise OSError(errno.EINVAL, "this is not a file name") from None
    if stat.S_ISDIR(found.st_mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), name)
    if not stat.S_ISREG(found.st_mode):
        raise OSError(errno.EINVAL, "it is a pipe or a device, not a plain file", name)
    if most is not None and found.st_size > most:
        raise OSError(errno.EFBIG, f"it has {found.st_size / 1e6:.1f} MB, {most / 1e6:.1f} MB are allowed", name)
    return Path(path).open("rb")


def read_bytes(path: str | PathLike[str], most: int) -> bytes:
    """The content of a plain file. Raises OSError: the file cannot be read, or has more than `most` bytes."""
    with open_plain(path, most) as file:
        return file.read(most)


def read_text(path: str | PathLike[str], most: int = LARGEST_TEXT) -> str:
    """The content of a plain file as text; lines end as in `Path.read_text`. Raises OSError, UnicodeDecodeError."""
    return read_bytes(path, most).decode("utf-8").replace("\r\n", "\n").replace("\r", "\n")


def read_toml(path: str | PathLike[str]) -> dict[str, Any]:
    """The table in a TOML file; integers must fit 64 bits, as in TOML. Raises OSError, ValueError."""
    text = read_text(path)
    if max(map(_dots, text.split("\n"))) > MOST_DOTS:
        raise ValueError(f"a line with more than {MOST_DOTS} dots")
    try:
        table: dict[str, Any] = bounded(tomllib.loads(text))
        return table
    except RecursionError:
        raise ValueError(f"nested more than {DEEPEST} deep") from None
    except tomllib.TOMLDecodeError as error:  # it may quote a name of thousands of parts; its end has the line number
        message = str(error)
        raise ValueError(message if len(message) <= 200 else f"{message[:100]} ... {message[-80:]}") from None


def read_json(text: str | bytes) -> Any:
    """Decode JSON. Raises ValueError."""
    try:
        return bounded(json.loads(text))
    except RecursionError:
        raise ValueError(f"nested more than {DEEPEST} deep") from None


def bounded(tree: Any) -> Any:
    """Return the tree unchanged. Raises ValueError: it is too deep, or has an integer of more than 64 bits."""
    level = [tree]
    for _ in range(DEEPEST):
        inside: list[Any] = []
        for value in level:
            if isinstance(value, dict):
                inside += value.values()
            elif isinstance(value, list):
                inside += value
            elif isinstance(value, int) and not -(1 << 63) <= value < 1 << 63:
                raise ValueError(f"{_named(value, tree)}an integer of more than 64 bits")
        if not inside:
            return tree
        level = inside
    raise ValueError(f"nested more than {DEEPEST} deep")


def _named(value: int, tree: Any) -> str:
    """The beginning of a sentence about `value`, with its key in `tree`; empty: the value has no key."""
    left: list[tuple[str, Any]] = [("", tree)]
    while left:
        name, node = left.pop()
        if node is value:
            return name
        if isinstance(node, dict):
            left += [(f"{key!r:.60} has ", inner) for key, inner in node.items()]
        elif isinstance(node, list):
            left += [(name, inner) for inner in node]
    return ""


def _dots(line: str) -> int:
    return line.count(".")
