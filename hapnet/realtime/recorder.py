"""A side's recording in real time: samples come from any thread, and the event loop writes them."""

from __future__ import annotations

import secrets
from collections import deque
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from hapnet.assembly import simulated_device
from hapnet.assembly.build import Setup
from hapnet.errors import RecordingError
from hapnet.recording.drawing import Drawing
from hapnet.recording.mcap import RecordingWriter, preload
from hapnet.recording.samples import Sample
from hapnet.wire.messages import Role
from netem import LinkProfile

MOST_SAMPLES = 100_000
"""The most samples that wait to be written; further ones are counted and dropped."""


class Recorder:
    """Writes the recording at `path`, once its description is known.

    If the disk is full or the file cannot be written any more, the recording ends and the run goes on.

    path : the recording's path.
    report : called with a text about what is missing in it.

    Attributes
    ----------
    broken : whether it ended too early.
    missing : the last text passed to `report`; None: nothing is missing.

    Raises RecordingError: it cannot be written.
    """

    def __init__(self, path: Path, report: Callable[[str], None]) -> None:
        require_writable(path)
        preload()
        self.broken: bool = False
        self.missing: str | None = None
        self.path = path
        self._report = report
        self._writer: RecordingWriter | None = None
        self._samples: deque[Sample] = deque()
        self._unrecorded = 0

    def keep(self, sample: Sample) -> None:
        """Keep one more sample, from any thread; returns at once."""
        if self.broken:
            return
        if len(self._samples) < MOST_SAMPLES:
            self._samples.append(sample)
        else:
            self._unrecorded += 1

    def drain(self, now_ns: int, meta: Callable[[], dict[str, Any]]) -> None:
        """Write the samples kept since the last call. meta : returns the description, at the recording's begin."""
        if self.broken:
            return
        try:
            if self._writer is None:
                self.path.parent.mkdir(parents=True, exist_ok=True)
                self._writer = RecordingWriter(self.path, meta())
            while self._samples:
                self._writer.write(self._samples.popleft())
            self._writer.flush(now_ns)
        except OSError as error:
            self._give_up(RecordingError(f"cannot write recording {self.path}: {error.strerror or error}"))
        except RecordingError as error:
            self._give_up(error)

    def close(self, summary: Mapping[str, Any] | None, unrecorded: int) -> None:
        """End the recording with the summary; call it once. `unrecorded` : samples that were lost before."""
        if self._writer is None:
            return
        if unrecorded := unrecorded + self._unrecorded:
            self._report_missing(f"{unrecorded} samples are missing: they came faster than they could be written")
        try:
            self._writer.close(summary)
        except RecordingError as error:
            self.broken = True
            self._report_missing(f"{error}; its end is missing")

    def _give_up(self, error: RecordingError) -> None:
        self.broken = True
        self._writer = None
        self._samples.clear()
        self._report_missing(f"{error}; the run goes on without a recording")

    def _report_missing(self, text: str) -> None:
        self.missing = text
        self._report(text)


class Recordings:
    """The recordings of a side, one after another. Between them, samples are dropped.

    report : called with a text about what is missing in a recording.

    Attributes
    ----------
    missing : texts about what is missing in the ended recordings.
    """

    def __init__(self, report: Callable[[str], None]) -> None:
        self.missing: list[str] = []
        self._report = report
        self._recorder: Recorder | None = None
        self._lost_before = 0
        self._drawing: Drawing | None = None  # it comes once, and is part of each recording

    @property
    def path(self) -> Path | None:
        """The path of the running recording."""
        recorder = self._recorder
        return None if recorder is None or recorder.broken else recorder.path

    def begin(self, path: Path) -> None:
        """Record at `path` from now on. Raises RecordingError if that is not possible."""
        recorder = Recorder(path, self._report)
        if self._drawing is not None:
            recorder.keep(self._drawing)
        self._recorder = recorder

    def keep(self, sample: Sample) -> None:
        """Keep one more sample, from any thread."""
        if isinstance(sample, Drawing):
            self._drawing = sample
        if (recorder := self._recorder) is not None:
            recorder.keep(sample)

    def drain(self, now_ns: int, meta: Callable[[], dict[str, Any]]) -> None:
        """See `Recorder.drain`."""
        if self._recorder is not None:
            self._recorder.drain(now_ns, meta)

    def end(self, summary: Mapping[str, Any] | None, lost: int) -> None:
        """End the running recording, if there is one.

        lost : the number of samples that were lost before `keep`, of all recordings so far.
        """
        recorder, self._recorder = self._recorder, None
        if recorder is not None:
            recorder.close(summary, lost - self._lost_before)
            if recorder.missing is not None:
                self.missing.append(recorder.missing)
        self._lost_before = lost


def measured_utc_less_clock_ns(clock: Callable[[], int], utc: Callable[[], int]) -> int:
    """Measure UTC less the clock's reading [ns]; call it once. The least interrupted of a few tries counts."""
    tries = [(clock(), utc(), clock()) for _ in range(5)]
    before_ns, utc_ns, after_ns = min(tries, key=lambda one: one[2] - one[0])
    return utc_ns - (before_ns + after_ns) // 2


def described(setup: Setup, role: Role, seed: int, link: LinkProfile) -> dict[str, Any]:
    """The description of a side's recording, for its ``meta``."""
    links = {"up" if role == "device" else "down": str(link)}
    return {**simulated_device.described(setup, seed), "role": role, "clock": _boot_id(), "links": links}


def _boot_id() -> str:
    """The name of this machine's monotonic clock: two recordings with the same name can be aligned."""
    try:
        return "boot:" + Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
    except OSError:
        return "process:" + secrets.token_hex(8)


def require_writable(path: Path) -> None:
    """Raise RecordingError if no recording can be written at `path`. Files made for the check are deleted."""
    new = [each for each in path.parents if not each.exists()]
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        existed = path.exists()
        path.open("ab").close()
        if not existed:
            path.unlink()  # no data are written before pairing
        for directory in new:
            directory.rmdir()
    except OSError as error:
        raise RecordingError(f"cannot write recording {path}: {error.strerror or error}") from None
