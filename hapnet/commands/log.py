"""Writes a side's notices: as text on the console, and as one JSON object per line for programs.

A notice that repeats is shown on the console a few times, and then only counted; a log for programs has all notices.
"""

from __future__ import annotations

import json
import os
import sys
import time
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

from hapnet.commands.output import write_line
from hapnet.errors import HapnetError, InvalidParameter, OutputError
from hapnet.side.notices import Notice

if TYPE_CHECKING:
    from rich.console import Console

STYLES = {"info": "", "warning": "yellow", "error": "red"}

REPORTED = 3
"""A kind of notice is shown this often within `EVERY_NS`."""

EVERY_NS = 10_000_000_000

REPEATING = frozenset({"silent", "heard", "overrun", "link", "rate"})
"""Kinds of notices that a bad network or a busy machine causes again and again."""


@dataclass
class _Kind:
    begin_ns: int
    shown: int = 0
    not_shown: int = 0
    text: str = ""


class Repeats:
    """Decides which notices are shown on the console; `who` is the name of the side that sends them.

    shown : how many notices of a kind are shown within `EVERY_NS`.
    """

    def __init__(self, shown: int = REPORTED) -> None:
        self._shown = shown
        self._kinds: dict[tuple[str, str], _Kind] = {}

    def line(self, who: str, kind: str, text: str, now_ns: int) -> str | None:
        """The line to show for a notice, with the number of hidden notices before it; None: do not show it."""
        if kind not in REPEATING:
            return text
        found = self._kinds.get((who, kind))
        if found is None or now_ns - found.begin_ns >= EVERY_NS:
            not_shown = found.not_shown if found is not None else 0
            self._kinds[who, kind] = _Kind(now_ns, shown=1)
            return f"{text} ({not_shown} more like this before it)" if not_shown else text
        if found.shown < self._shown:
            found.shown += 1
            return text
        found.not_shown += 1
        found.text = text
        return None

    def rest(self) -> list[tuple[str, str]]:
        """At the end: for each kind with hidden notices, its side and a line that counts them."""
        not_shown = [(who, kind) for (who, _), kind in self._kinds.items() if kind.not_shown]
        self._kinds.clear()
        return [(who, f"{kind.text} (the last of {kind.not_shown} more like this)") for who, kind in not_shown]


class Log:
    """Writes notices. A notice that cannot be written (full disk, closed pipe) is skipped; the run continues.

    Each line has the time of the monotonic clock and the time of day. The system clock is read only once, at the start,
    so its later steps have no effect.

    role : of this side.
    console : shows text; None: no text is shown.
    target : of the JSON lines: a file, "-" for standard output; None: they are not written.
    progress : log the run's progress too.

    Attributes
    ----------
    failure : one line with the reason why the file is not complete; None if it is.

    Raises HapnetError: the file cannot be written.
    """

    def __init__(self, role: str, console: Console | None, target: str | None, *, progress: bool = False) -> None:
        self._role, self._words, self._progress = role, console, progress
        self._file: int | None = None
        self._target = target
        self.failure: str | None = None
        self._repeats = Repeats()
        self._offset_ns = time.time_ns() - time.monotonic_ns()
        try:
            if target == "-":
                self._file = os.dup(sys.stdout.fileno())
            elif target is not None:
                self._file = os.open(target, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
        except OSError as error:
            raise HapnetError(f"cannot write the log {target}: {error.strerror or error}") from None

    def notify(self, notice: Notice) -> None:
        """Write a notice to the log and to the console."""
        if notice.kind == "progress" and not self._progress:
            return
        self.write(notice)
        text = self._repeats.line(self._role, notice.kind, notice.text, notice.at_ns)
        if notice.kind not in ("progress", "signal") and text is not None:
            self._say(replace(notice, text=text))

    def write(self, notice: Notice) -> None:
        """Write a notice to the log only."""
        if self._file is None:
            return
        line = json.dumps(record(notice, self._role, self._time(notice.at_ns)), ensure_ascii=False)
        try:
            write_line(self._file, f"{line}\n".encode(errors="replace"), f"the log {self._target}")
        except OutputError as error:
            if self.failure is None and not isinstance(error.__cause__, BrokenPipeError):
                self.failure = str(error)
                self._say(Notice("log", self.failure, time.monotonic_ns(), "warning"))

    def _say(self, notice: Notice) -> None:
        if self._words is not None:
            local = self._time(notice.at_ns).astimezone()
            stamp = f"{local:%H:%M:%S}.{local.microsecond // 1000:03d}"
            self._words.print(f"{stamp} {notice.text}", style=STYLES[notice.level], markup=False)

    def _time(self, at_ns: int) -> datetime:
        return datetime.fromtimestamp((at_ns + self._offset_ns) * 1e-9, UTC)

    def close(self) -> None:
        """Close the log."""
        for _, text in self._repeats.rest():
            self._say(Notice("repeats", text, time.monotonic_ns()))
        if self._file is not None:
            os.close(self._file)
            self._file = None


def record(notice: Notice, role: str, at: datetime) -> dict[str, Any]:
    """The JSON object of a notice."""
    return {
        "time": at.isoformat(timespec="microseconds"),
        "monotonic_ns": notice.at_ns,
        "level": notice.level,
        "role": role,
        "kind": notice.kind,
        "text": notice.text,
        **({"values": dict(notice.values)} if notice.values else {}),
    }


def check_target(log_to: str | None, json_to: str | None) -> None:
    """Raise InvalidParameter if `--log` and `--json` both want standard output."""
    if log_to == "-" and json_to == "-":
        raise InvalidParameter("--log", log_to, "a file, as --json has standard output")
