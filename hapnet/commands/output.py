"""The output of every command: the summary as text and as JSON, and recordings and figures in one directory."""

from __future__ import annotations

import errno
import json
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, cast

from hapnet.errors import HapnetError, OutputError, RecordingError
from hapnet.installing import require

if TYPE_CHECKING:
    from rich.console import Console

    from hapnet.params import Params


def asker() -> Callable[[str], object] | None:
    """Return the function that asks the user on the terminal; None if there is no terminal."""
    return input if sys.stdin.isatty() and sys.stdout.isatty() else None


def console(json_to: str | None) -> Console:
    """The console for text: standard error if the JSON object goes to standard output, otherwise standard output."""
    from rich.console import Console

    stream = _ForgivingStream(sys.stderr if json_to == "-" else sys.stdout)
    return Console(file=cast(IO[str], stream), highlight=False, soft_wrap=True)


def progress_console(words: Console | None) -> Console:
    """The console that shows progress beside `words`: the same on a terminal, otherwise of standard error."""
    return words if words is not None and words.is_terminal and sys.stderr.isatty() else console("-")


class _ForgivingStream:
    """A stream that discards output, without an error, once it cannot be written (``| head``, a full disk)."""

    def __init__(self, stream: IO[str]) -> None:
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        with self._ignoring_errors():
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        with self._ignoring_errors():
            self._stream.flush()

    @contextmanager
    def _ignoring_errors(self) -> Iterator[None]:
        try:
            yield
        except OSError:
            silence(self._stream)


def silence(stream: IO[str]) -> None:
    """Discard all later output to `stream`; otherwise the interpreter would fail at its exit."""
    with suppress(OSError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


_SIGPIPE = 141


def unless_closed(command: Callable[[], int]) -> int:
    """The exit code of `command`; 141, as after SIGPIPE, if the reader of standard output has exited (``| head``).

    If standard output cannot be written (a full disk), one line reports it.
    """
    try:
        code = command()
        sys.stdout.flush()
    except BrokenPipeError:
        silence(sys.stdout)
        return _SIGPIPE
    except OSError as error:
        if error.filename is not None or error.errno not in (errno.ENOSPC, errno.EBADF, errno.EIO):
            raise
        from hapnet.summary.causes import INCOMPLETE

        silence(sys.stdout)
        complain(f"cannot write standard output: {error.strerror}")
        return INCOMPLETE
    except SystemExit as error:
        if not isinstance(error.__context__, BrokenPipeError):  # click makes this of it
            raise
        silence(sys.stdout)
        return _SIGPIPE
    return code


class Written:
    """Collects the failures of a run's output, so that each part is written even if another part has failed.

    Attributes
    ----------
    missing : a line for each part that is missing or not complete, and a line if the servo stalled for too long.
    broken : a line for each broken claim. contradicted : True if a third party sent messages in the name of a side.
    """

    def __init__(self) -> None:
        self.missing: list[str] = []
        self.broken: list[str] = []
        self.contradicted: bool = False

    def judge(self, summary: Mapping[str, Any], params: Params | None, *, virtual: bool, ran: bool = True) -> None:
        """Note if the coupling of a run broke its claim; the arguments are those of `verdict.broken`.

        ran : the run was made here, so its coupling may be loaded; a module that only a file names is not loaded.
        """
        from hapnet.assembly.own_parts import named_failures
        from hapnet.couplings import registry
        from hapnet.summary import verdict

        spec = registry.coupling(params.coupling) if ran and params is not None else None
        self.contradicted = verdict.contradicted(summary)
        with nullcontext() if params is None else named_failures(params):  # a user's own law states its claim
            broken = verdict.broken(summary, params, virtual=virtual, spec=spec)
        if broken:
            why = verdict.judge(summary)["reason"]
            self.broken.append(f"the coupling {summary.get('coupling')} claims to be passive, but was not: {why}")
        elif (line := verdict.overloaded(summary)) is not None:
            self.missing.append(line)

    @contextmanager
    def part(self) -> Iterator[None]:
        """A context in which one part is written; a failure is reported at the end."""
        try:
            yield
        except (OutputError, RecordingError) as error:
            self.missing.append(str(error))

    def code(self, code: int = 0) -> int:
        """The exit code of a run that otherwise ends with `code`; prints the missing parts and the broken claims."""
        from hapnet.summary.causes import CONTRADICTED, INCOMPLETE, NOT_PASSIVE

        for lines in (self.missing, self.broken):
            if lines:
                complain("; ".join(dict.fromkeys(lines)))
        if self.broken:
            return NOT_PASSIVE
        if self.contradicted:
            return code or CONTRADICTED
        return code or (INCOMPLETE if self.missing else 0)


def complain(line: str) -> None:
    """Write one line to standard error, if it is still open."""
    with suppress(OSError):
        sys.stderr.write(f"hapnet: {line}\n")


_made: list[Path] = []
"""Directories that this process has created for output."""


def remove_empty() -> None:
    """Remove the created directories that are still empty, so that a failed command leaves none."""
    for path in sorted(_made, key=lambda path: -len(path.parts)):  # the inner ones first
        with suppress(OSError):
            path.rmdir()
    _made.clear()


def run_directory(out: Path | None, which: int | str | None) -> Path:
    """The directory for a command's output, created if needed: `out`, or runs/<UTC time>-<seed or name>.

    Raises MissingLibrary: the extra for recordings and figures is not installed. HapnetError: it cannot be created.
    """
    require("report", "writing recordings and figures")
    path, by = default_directory(out, which), "" if out is None else "--out: "
    new = [each for each in (path, *path.parents) if not each.exists()]
    try:
        path.mkdir(parents=True, exist_ok=True)
        _made.extend(new)
    except FileExistsError:
        raise HapnetError(f"{by}cannot write to {path}: it is a file, not a directory") from None
    except OSError as error:
        raise HapnetError(f"{by}cannot write to {path}: {error.strerror or error}") from None
    return path


def default_directory(out: Path | None, which: int | str | None) -> Path:
    """`out`, or runs/<UTC time>-<seed or name>; it need not exist."""
    return out if out is not None else Path("runs") / f"{datetime.now(UTC):%Y%m%dT%H%M%SZ}-{which}"


def discard(directory: Path, *names: str) -> None:
    """Remove the directory of a run that never began, with these files, unless it contains other files."""
    with suppress(OSError):
        if {file.name for file in directory.iterdir()} <= set(names):
            for name in names:
                (directory / name).unlink(missing_ok=True)
            directory.rmdir()
            directory.parent.rmdir()  # only if it is empty


def write_json(value: Mapping[str, Any] | Sequence[Mapping[str, Any]], json_to: str | None) -> None:
    """Write `value` to a file, or to standard output for "-"; None: not at all. The file appears when it is complete.

    Raises OutputError: it cannot be written.
    """
    if json_to is None:
        return
    from hapnet.recording.samples import plain  # JSON has no infinities and no NaN
    from hapnet.recording.whole_file import complete_or_absent

    text = json.dumps(plain(value), indent=2, allow_nan=False)
    if json_to != "-":
        with complete_or_absent(Path(json_to), "", OutputError) as part:
            part.write_text(text + "\n", encoding="utf-8")
        return
    try:
        sys.stdout.write(text + "\n")
        sys.stdout.flush()
    except OSError as error:
        silence(sys.stdout)
        raise OutputError(f"cannot write standard output: {error.strerror or error}") from None


def write_csv(rows: Sequence[Mapping[str, Any]], file: Path) -> None:
    """Write `rows`, which have the same keys; None is an empty cell. Raises OutputError if that fails."""
    from hapnet.recording import export
    from hapnet.recording.whole_file import complete_or_absent

    with complete_or_absent(file, "", OutputError) as part:
        export.write_csv(part, rows[0] if rows else [], (row.values() for row in rows))


def write_line(file: int, line: bytes, name: str) -> None:
    """Append `line` to the open file with this name. Raises OutputError if it cannot be written."""
    try:
        while line:  # on a nearly full disk only a part may be written
            line = line[os.write(file, line) :]
    except OSError as error:
        raise OutputError(f"cannot write {name}: {error.strerror or error}") from error


def show_warnings(out: Console, warnings: tuple[str, ...]) -> None:
    """Show each warning."""
    for warning in warnings:
        out.print(f"warning: {warning}", style="yellow", markup=False)


def show_kernel(out: Console, why_not: str | None) -> None:
    """Print whether the compiled kernel made the run, and if not the reason."""
    out.print("run by the compiled kernel" if why_not is None else f"not run by the compiled kernel: {why_not}")


def show_verdict(out: Console, summary: Mapping[str, Any], *, verbose: bool) -> None:
    """Print the verdict in one line or, if `verbose`, with all figures."""
    from hapnet.summary.tables import summary_text, verdict_text

    out.print(summary_text(summary) if verbose else verdict_text(summary))


def show_fact(out: Console, summary: Mapping[str, Any], more: str = "", fact: str | None = None) -> None:
    """Print the second line of a run's output, and one line for each warning. It follows `show_verdict`.

    more : where there is more to read. fact : in place of how stiff the wall was felt.
    """
    from hapnet.summary.structure import read
    from hapnet.summary.tables import felt_line
    from hapnet.summary.words import headline

    if line := " ".join(filter(None, (fact or felt_line(read(summary)), more))):
        out.print(line, markup=False)
    show_warnings(out, headline(summary)[1])


def more_in(directory: Path | None, page: str, command: str = "") -> str:
    """Where there is more to read: with -v and, if it was written, in the file `page` of that directory."""
    if directory is None or not (directory / page).exists():
        return "More: -v"
    return f"More: -v, or {command}{directory / page}"


def show_files(out: Console, names: Iterable[str], directory: Path, more: str = "") -> None:
    """Print the last line of a run: the files of `names` that exist in `directory`."""
    if there := [name for name in names if (directory / name).exists()]:
        out.print(f"files: {', '.join(there)} in {directory}{more}", markup=False)
