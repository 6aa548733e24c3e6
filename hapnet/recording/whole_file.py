"""Files that are written in one go: each appears when it is complete and on the disk, or not at all."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from hapnet.errors import HapnetError, RecordingError

_FULL = (errno.ENOSPC, errno.EDQUOT)


@contextmanager
def complete_or_absent(
    target: Path, what: str = "recording", failure: type[HapnetError] = RecordingError
) -> Iterator[Path]:
    """Yield a path to write to, in the same folder. The file becomes `target` if the body succeeds, and is removed if
    not; then an existing `target` stays unchanged.

    A target that is not a regular file, such as a pipe, is written directly.

    Raises `failure`: the file cannot be written; the message calls it `what`, and names a disk that is full.
    """
    name = f"{what} {target}" if what else str(target)
    part = target.with_name(target.name + ".part")
    try:
        if target.exists() and not target.is_file():
            yield target
            return
        target = target.resolve()  # replace the file behind a link, not the link
        part = target.with_name(target.name + ".part")
        yield part
        _to_disk(part)
        part.replace(target)
    except OSError as error:
        raise failure(f"cannot write {name}: {_why(error, target)}") from error
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)


def _why(error: OSError, target: Path) -> str:
    """The reason why a file could not be written, as text."""
    if error.errno in _FULL:
        return f"{error.strerror}: the disk of {_mounted(target)} is full"
    return error.strerror or str(error)


def _to_disk(file: Path) -> None:
    """Wait until the file is on the disk; some systems allocate its space only then."""
    with file.open("rb") as written:
        os.fsync(written.fileno())


def _mounted(target: Path) -> Path:
    """The mount point of the disk for this file."""
    place = target.absolute().parent
    while not os.path.ismount(place) and place != place.parent:
        place = place.parent
    return place
