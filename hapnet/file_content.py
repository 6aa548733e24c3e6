"""Reads files that may be anybody's: plain files of a bounded size, and tables and trees of a bounded depth.

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
"""No TOML, URDF or CSV file is larger [bytes]."""

DEEPEST = 50
"""Tables and lists in a file contain one another at most this deep."""

MOST_DOTS = 10_000
"""A line of a TOML file has at most so many: the time for a dotted name grows with the square of its parts."""


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

    most : its largest size [bytes]; None: any. Raises OSError.
    """
    name = os.fspath(path)
    try:
        found = os.stat(name)
    except ValueError:  # a null byte
        raise OSError(errno.EINVAL, "this is no file's name") from None
    if stat.S_ISDIR(found.st_mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), name)
    if not stat.S_ISREG(found.st_mode):
        raise OSError(errno.EINVAL, "it is a pipe or a device, not a plain file", name)
    if most is not None and found.st_size > most:
        raise OSError(errno.EFBIG, f"it has {found.st_size / 1e6:.1f} MB, {most / 1e6:.1f} MB are allowed", name)
    return Path(path).open("rb")


def read_bytes(path: str | PathLike[str], most: int) -> bytes:
    """The content of a plain file. Raises OSError: it cannot be read, or has more than `most` bytes."""
    with open_plain(path, most) as file:
        return file.read(most)


def read_text(path: str | PathLike[str], most: int = LARGEST_TEXT) -> str:
    """The same as text; the lines end as in `Path.read_text`. Raises OSError, UnicodeDecodeError."""
    return read_bytes(path, most).decode("utf-8").replace("\r\n", "\n").replace("\r", "\n")


def read_toml(path: str | PathLike[str]) -> dict[str, Any]:
    """The table in a TOML file, with integers of 64 bits as TOML has them. Raises OSError, ValueError."""
    text = read_text(path)
    if max(map(_dots, text.split("\n"))) > MOST_DOTS:
        raise ValueError(f"a line with more than {MOST_DOTS} dots")
    try:
        table: dict[str, Any] = bounded(tomllib.loads(text))
        return table
    except RecursionError:
        raise ValueError(f"nested more than {DEEPEST} deep") from None
    except tomllib.TOMLDecodeError as error:  # it may quote a name of thousands of parts; its end says where
        message = str(error)
        raise ValueError(message if len(message) <= 200 else f"{message[:100]} ... {message[-80:]}") from None


def read_json(text: str | bytes) -> Any:
    """Decode a text in JSON. Raises ValueError."""
    try:
        return bounded(json.loads(text))
    except RecursionError:
        raise ValueError(f"nested more than {DEEPEST} deep") from None


def bounded(tree: Any) -> Any:
    """The tree itself. Raises ValueError: it is too deep, or has an integer that 64 bits do not hold."""
    level = [tree]
    for _ in range(DEEPEST):
        inside: list[Any] = []
        for one in level:
            if isinstance(one, dict):
                inside += one.values()
            elif isinstance(one, list):
                inside += one
            elif isinstance(one, int) and not -(1 << 63) <= one < 1 << 63:
                raise ValueError(f"{_named(one, tree)}an integer of more than 64 bits")
        if not inside:
            return tree
        level = inside
    raise ValueError(f"nested more than {DEEPEST} deep")


def _named(value: int, tree: Any) -> str:
    """The beginning of a sentence about a value, with the key under which it is in `tree`; empty: there is none."""
    left: list[tuple[str, Any]] = [("", tree)]
    while left:
        name, one = left.pop()
        if one is value:
            return name
        if isinstance(one, dict):
            left += [(f"{key!r:.60} has ", inner) for key, inner in one.items()]
        elif isinstance(one, list):
            left += [(name, inner) for inner in one]
    return ""


def _dots(line: str) -> int:
    return line.count(".")
