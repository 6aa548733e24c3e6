"""The recording of a run, given as a recording, a file, the files of both sides, or a directory."""

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
    """Turn errors from invalid settings of a recording into a RecordingError: a file may contain any values.

    Raises RecordingError: the settings of `what` have wrong types.
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

    whole : with both sides if both exist. parts : the recordings of the single files. files : the paths of the files;
    empty if no file was read.
    """

    whole: Recording
    parts: tuple[Recording, ...]
    files: tuple[Path, ...] = ()


Recorded: TypeAlias = Recording | HasRecording | Opened | File | Sequence[File]


def opened(what: Recorded) -> Opened:
    """Read and join the recording of a run: a recording, a file, both sides' files, or a run's directory.

    Raises InvalidParameter: there are more than two files, or a directory has no recording. RecordingError: a file
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
    """The recordings in a run's directory. A recording without samples counts only if there is no other."""
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
