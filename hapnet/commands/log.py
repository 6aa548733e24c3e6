"""Writes a side's notices: as text on the console, and as one JSON object per line for programs.

A notice that repeats is shown on the console once, and then only counted; a log for programs has all notices.
"""

from __future__ import annotations

import json
import os
import re
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from hapnet.commands.output import write_line
from hapnet.errors import HapnetError, InvalidParameter, OutputError
from hapnet.side.notices import Notice

if TYPE_CHECKING:
    from rich.console import Console

STYLES = {"info": "", "warning": "yellow", "error": "red"}

EVERY_NS = 60_000_000_000
"""A kind of notice is shown once in this time [ns], with the number of those that were not shown."""

REPEATING: Mapping[str, str] = MappingProxyType({
    "silent": "silence_s", "heard": "silence_s", "link": "gone_s", "overrun": "", "rate": ""
})  # fmt: skip
"""Kinds of notices that a bad network or a busy machine causes again and again, with the name of their duration."""

_COUNTED_AS = {"heard": "silent"}
"""A silence has two notices, one when it begins and one when it ends; only the first is counted."""


@dataclass
class _Kind:
    text: str
    begin_ns: int
    count: int = 0  # of those that are not shown
    longest_s: float = 0.0

    def counted(self) -> str:
        """The line for those that are not shown."""
        longest = f", the longest {self.longest_s:.2g} s" if self.longest_s else ""
        return f"{self.text} ... {self.count} more time{'s' * (self.count > 1)}{longest}"


class Repeats:
    """Decides which notices are shown on the console; `who` is the name of the side that sends them."""

    def __init__(self) -> None:
        self._kinds: dict[tuple[str, str], _Kind] = {}

    def line(self, who: str, notice: Mapping[str, Any]) -> str | None:
        """The line to show for a notice, as `record` makes it; None: do not show it."""
        name, text, now_ns = str(notice["kind"]), str(notice["text"]), int(notice["monotonic_ns"])
        if name not in REPEATING:
            return text
        key = who, re.sub(r"[0-9.]+", "", text) if name == "link" else name
        kind = self._kinds.get(key)
        if kind is None:
            self._kinds[key] = _Kind(text, now_ns)
            return text
        counted = self._kinds.get((who, _COUNTED_AS.get(name, "")), kind)
        counted.longest_s = max(counted.longest_s, float(notice.get("values", {}).get(REPEATING[name], 0.0)))
        if counted is kind:
            kind.count, kind.text = kind.count + 1, text
        if not kind.count or now_ns - kind.begin_ns < EVERY_NS:
            return None
        self._kinds[key] = _Kind(text, now_ns)
        return kind.counted()

    def rest(self) -> list[tuple[str, str]]:
        """At the end: for each kind with notices that were not shown, its side and a line that counts them."""
        found = [(who, kind.counted()) for (who, _), kind in self._kinds.items() if kind.count]
        self._kinds.clear()
        return found


class Log:
    """Writes notices. A notice that cannot be written (full disk, closed pipe) is skipped; the run continues.

    Each line has the time of the monotonic clock and the time of day. The system clock is read only once, at the start,
    so its later steps have no effect.

    role : of this side.
    console : shows text; None: no text is shown.
    target : of the JSON lines: a file, "-" for standard output; None: they are not written.
    progress : log the run's progress too. verbose : show the state of the path too.

    Attributes
    ----------
    failure : one line with the reason why the file is not complete; None if it is.

    Raises HapnetError: the file cannot be written.
    """

    def __init__(
        self, role: str, console: Console | None, target: str | None, *, progress: bool = False, verbose: bool = False
    ) -> None:
        self._role, self._words, self._progress = role, console, progress
        self._hidden = {"progress", "signal"} | (set() if verbose else {"path"})
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
        text = self._repeats.line(self._role, record(notice, self._role, self._time(notice.at_ns)))
        if notice.kind not in self._hidden and text is not None:
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
