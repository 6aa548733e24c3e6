"""The recording of a run, however it is given: one that is there, a file, the files of both sides, or a directory."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import Protocol, TypeAlias

from hapnet.errors import HapnetError, InvalidParameter, RecordingError
from hapnet.loading import cause
from hapnet.recording.mcap import read_recording
from hapnet.recording.samples import Recording, join

ROLES = ("device", "world")
WHOLE = "run.mcap"
"""The recording of both sides, as a simulation writes it."""


@contextmanager
def fitting(what: object) -> Iterator[None]:
    """Whoever wrote a recording may have put anything in the place of a number or a table of its settings.

    Raises RecordingError: the content of `what` is of other types than a recording's.
    """
    try:
        yield
    except HapnetError:
        raise
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        raise RecordingError(f"{what} cannot be used: its settings do not fit ({cause(error)})") from error


class HasRecording(Protocol):
    """The interface of a run with a recording, such as `hapnet.Result`."""

    @property
    def recording(self) -> Recording: ...
    @property
    def summary(self) -> Mapping[str, object]: ...


File: TypeAlias = str | PathLike[str]


@dataclass(frozen=True)
class Opened:
    """A run's recording.

    whole : with both sides where both are there. parts : as they were recorded, each in its file. files : the paths of
    these; none where no file was read.
    """

    whole: Recording
    parts: tuple[Recording, ...]
    files: tuple[Path, ...] = ()


Recorded: TypeAlias = Recording | HasRecording | Opened | File | Sequence[File]


def opened(what: Recorded) -> Opened:
    """Read and join what was recorded of a run: a recording, a file, both sides' files, or a run's directory.

    Raises InvalidParameter: these are more than two files, or a directory without a recording. RecordingError: one
    cannot be read, or the two are not of one run.
    """
    if isinstance(what, Opened):
        return what
    if isinstance(what, Recording):
        return Opened(what, (what,))
    if isinstance(what, str | PathLike):
        return opened([what])
    if not isinstance(what, Sequence):
        return opened(replace(what.recording, summary=what.summary))
    named = [Path(one) for one in what]
    files = [file for one in named for file in (_recordings_in(one) if one.is_dir() else [one])]
    if not 1 <= len(files) <= 2:
        raise InvalidParameter("FILE", [str(file) for file in files], "one recording, or the device's and the world's")
    parts = [read_recording(file) for file in files]
    with fitting(" and ".join(map(str, files))):
        return Opened(parts[0] if len(parts) == 1 else join(*parts), tuple(parts), tuple(files))


def _recordings_in(directory: Path) -> list[Path]:
    """The recordings in a run's directory. One that was cut off before its first samples counts if it is alone."""
    there = [file for role in ROLES if (file := directory / f"{role}.mcap").exists()]
    if not there and (whole := directory / WHOLE).exists():
        return [whole]
    found = []
    for file in there:
        with suppress(RecordingError):
            recording = read_recording(file)
            if recording.device is not None or recording.world is not None:
                found.append(file)
    if not there:
        allowed = f"a recording, or a directory with {WHOLE}, device.mcap or world.mcap"
        raise InvalidParameter("FILE", str(directory), allowed)
    return found or there[:1]
