"""The journal of a sweep or a tuning, an SQLite file with its cases and the results so far.

Only the sweep's own process writes it, with several results in a transaction. Whatever ends that process, the file
holds all committed transactions and no part of an uncommitted one, and the next process continues from there.

    about (name, value)                                               the spec, its digest, hapnet's versions
    cases (number, key, seed, varied)                                 varied: JSON
    results (number, measures, error, wall_s, worker)                 measures: JSON, by name
"""

from __future__ import annotations

import hashlib
import json
import os
import sqlite3
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from hapnet.errors import HapnetError
from hapnet.ext.study.case import Measures
from hapnet.ext.study.spec import Case, Spec, Values, flat_of, shown
from hapnet.ext.study.task import CaseResult
from hapnet.file_content import read_json
from hapnet.installing import versions
from netem.versions import DISTRIBUTION

Kind = TypeVar("Kind")

NAME = "journal.sqlite"
FORMAT = 1
_WAIT_S = 10.0  # while a figure is drawn from the same file
_TABLES = """
CREATE TABLE about (name TEXT PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE cases (number INTEGER PRIMARY KEY, key TEXT UNIQUE NOT NULL, seed INTEGER NOT NULL, varied TEXT NOT NULL);
CREATE TABLE results (number INTEGER PRIMARY KEY REFERENCES cases, measures TEXT NOT NULL, error TEXT, wall_s REAL,
                      worker TEXT);
"""
_ROWS = (
    "SELECT number, varied, seed, key, results.number IS NOT NULL, measures, error, wall_s, worker "
    "FROM cases LEFT JOIN results USING (number)"
)


@dataclass(frozen=True)
class JournalRow:
    """A case and its result; `done` is False if the case has not been run yet."""

    case: Case
    done: bool
    measures: Measures
    error: str | None
    wall_s: float | None
    worker: str | None


class Journal:
    """An open journal, from `create_or_resume` or, to read only, from `look`.

    Attributes
    ----------
    fixed, varied : of the spec. versions : of the software that began the journal.
    """

    def __init__(self, path: Path, connection: sqlite3.Connection, lock: int | None) -> None:
        self.path: Path = path
        self._db, self._lock = connection, lock
        about = {name: read_json(value) for name, value in self._db.execute("SELECT name, value FROM about")}
        if about.get("format") != FORMAT:
            raise HapnetError(f"{path} has format {about.get('format')}, of another hapnet version; allowed: {FORMAT}")
        self.name: str = _is(str, about["name"])
        self.fixed: Values = _is(dict, about["fixed"])
        self.varied: list[str] = [_is(str, one) for one in _is(list, about["varied"])]
        self.versions: dict[str, str] = _is(dict, about["versions"])
        self.fingerprint: str = _is(str, about["fingerprint"])

    @classmethod
    def create_or_resume(cls, directory: Path, spec: Spec, cases: Sequence[Case], *, fresh: bool = False) -> Journal:
        """The journal of `spec` in `directory`, which must exist; `fresh`: always begin a new journal.

        Raises HapnetError: another process runs this sweep, or the journal has another spec or cannot be used.
        """
        path = directory / NAME
        with ExitStack() as undo:
            lock = _lock(directory)
            undo.callback(os.close, lock)
            with _readable(path):
                if fresh:
                    for leftover in (path, path.with_name(NAME + "-journal")):
                        leftover.unlink(missing_ok=True)
                connection = undo.enter_context(closing(_open(path, "rwc")))
                if not connection.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]:
                    _begin(connection, spec, cases)
                journal = cls(path, connection, lock)
                journal._same(cases)
            undo.pop_all()
        return journal

    @classmethod
    def look(cls, directory: Path) -> Journal:
        """The journal in `directory`, to read only; its sweep may still run. Raises HapnetError if there is none."""
        path = directory / NAME
        if not path.is_file():
            raise HapnetError(f"no sweep in {directory}: it has no {NAME}")
        with ExitStack() as undo, _readable(path):
            journal = cls(path, undo.enter_context(closing(_open(path, "rw"))), None)
            undo.pop_all()
        return journal

    def count(self) -> tuple[int, int, int]:
        """The number of cases, the number of results, and the number of failures among them."""
        with _readable(self.path):
            (cases,) = self._db.execute("SELECT count(*) FROM cases").fetchone()
            done, failed = self._db.execute("SELECT count(*), count(error) FROM results").fetchone()
        return cases, done, failed

    def pending(self) -> list[Case]:
        """The cases without a result, in order."""
        return [row.case for row in self.rows() if not row.done]

    def rows(self) -> Iterator[JournalRow]:
        """All cases, in order."""
        with _readable(self.path):
            for found in self._db.execute(f"{_ROWS} ORDER BY number"):
                yield self._row(found)

    def find(self, keys: Sequence[str]) -> list[JournalRow]:
        """The cases with these keys, in this order. All must exist."""
        with _readable(self.path):
            return [self._row(self._db.execute(f"{_ROWS} WHERE key = ?", (key,)).fetchone()) for key in keys]

    def add(self, cases: Sequence[Case]) -> None:
        """Add the cases that the journal does not have yet; their numbers continue from the last number."""
        with _readable(self.path), self._db:
            (number,) = self._db.execute("SELECT count(*) FROM cases").fetchone()
            for case in cases:
                row = number, case.key, case.seed, json.dumps(case.given)
                number += self._db.execute("INSERT OR IGNORE INTO cases VALUES (?, ?, ?, ?)", row).rowcount

    def record(self, results: Sequence[CaseResult]) -> None:
        """Add results; they are on the disk when this returns. Raises HapnetError if they cannot be written."""
        rows = [(r.number, json.dumps(r.measures), r.error, r.wall_s, r.worker) for r in results]
        with _readable(self.path), self._db:
            self._db.executemany("INSERT OR REPLACE INTO results VALUES (?, ?, ?, ?, ?)", rows)

    def forget_failed(self) -> int:
        """Delete the results of failed cases, so that these are run again; returns the number."""
        with _readable(self.path), self._db:
            return self._db.execute("DELETE FROM results WHERE error IS NOT NULL").rowcount

    def close(self) -> None:
        self._db.close()
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    @property
    def other_version(self) -> str | None:
        """The version of hapnet that began this sweep, if it differs from this one."""
        before = self.versions.get(DISTRIBUTION)
        return None if before == versions()[DISTRIBUTION] else str(before)

    def _row(self, found: Sequence[Any]) -> JournalRow:
        number, varied, seed, key, done, measures, *rest = found
        values: Values = _is(dict, read_json(varied))
        if unset := tuple(name for name in self.varied if name not in values):
            values |= shown(unset, flat_of(self.fixed, values))
        case = Case(number, values, seed, key, unset)
        return JournalRow(case, bool(done), _measures(read_json(measures)) if done else {}, *rest)

    def _same(self, cases: Sequence[Case]) -> None:
        if self.fingerprint == _fingerprint(cases):
            return
        before = {key for (key,) in self._db.execute("SELECT key FROM cases")}
        now = {case.key for case in cases}
        raise HapnetError(
            f"{self.path} is of another spec: {len(now - before)} cases are new, {len(before - now)} are gone, "
            f"{len(now & before)} are the same; --out for another directory, or --fresh to discard its results"
        )


def _is(kind: type[Kind] | tuple[type[Kind], ...], value: object) -> Kind:
    """Return the value, which must be of one of these types. Raises TypeError."""
    if not isinstance(value, kind):
        raise TypeError(f"{value!r:.40} is of a wrong type")
    return value


def _measures(tree: object) -> Measures:
    found: Measures = _is(dict, tree)
    for one in found.values():
        if one is not None:
            _is((int, float), one)
    return found


def _begin(connection: sqlite3.Connection, spec: Spec, cases: Sequence[Case]) -> None:
    """Write tables and cases in one transaction, so that a journal is complete or empty."""
    about: dict[str, Any] = {
        "format": FORMAT,
        "name": spec.name,
        "fixed": spec.fixed,
        "varied": spec.varied,
        "fingerprint": _fingerprint(cases),
        "versions": versions(),
    }
    with connection:
        connection.execute("BEGIN")
        for statement in _TABLES.split(";")[:-1]:
            connection.execute(statement)
        connection.executemany("INSERT INTO about VALUES (?, ?)", [(k, json.dumps(v)) for k, v in about.items()])
        rows = ((number, case.key, case.seed, json.dumps(case.given)) for number, case in enumerate(cases))
        connection.executemany("INSERT INTO cases VALUES (?, ?, ?, ?)", rows)


def _fingerprint(cases: Sequence[Case]) -> str:
    """A digest of the cases, independent of their order and wording in the spec."""
    return hashlib.sha256("\n".join(sorted(case.key for case in cases)).encode()).hexdigest()


def _open(path: Path, mode: str) -> sqlite3.Connection:
    """Open with SQLite's rollback journal, fully synced: write-ahead logs do not work on network file systems."""
    return sqlite3.connect(f"{path.absolute().as_uri()}?mode={mode}", uri=True, timeout=_WAIT_S)


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    try:
        yield
    except sqlite3.OperationalError as error:
        raise HapnetError(f"cannot use the journal {path}: {error}") from error
    except (sqlite3.DatabaseError, ValueError, KeyError, TypeError, OverflowError) as error:
        raise HapnetError(f"{path} is not the journal of a sweep ({error}); --fresh begins a new one") from error
    except OSError as error:
        raise HapnetError(f"cannot write to {path}: {error.strerror or error}") from error


def _lock(directory: Path) -> int:
    """Lock the directory for this process; the system releases the lock when the process ends."""
    path = directory / "lock"
    try:
        lock = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            if sys.platform != "win32":  # which has no such lock
                import fcntl

                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BaseException:
            holder = os.read(lock, 32).decode("ascii", "replace").strip()
            os.close(lock)
            raise
        os.ftruncate(lock, 0)
        os.write(lock, f"process {os.getpid()}".encode())
    except BlockingIOError:
        raise HapnetError(f"another process runs the sweep in {directory}: {holder}") from None
    except OSError as error:
        raise HapnetError(f"cannot write to {path}: {error.strerror or error}") from None
    return lock
