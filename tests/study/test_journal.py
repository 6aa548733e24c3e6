"""The journal: what was recorded is there, nobody else writes, another spec is refused."""

import os
import signal
import sqlite3
import subprocess
import sys
from pathlib import Path

import pytest

from hapnet.errors import HapnetError
from hapnet.ext.study import journal as module
from hapnet.ext.study.journal import NAME, Journal
from hapnet.ext.study.spec import Spec
from hapnet.ext.study.task import CaseResult
from netem.versions import DISTRIBUTION
from tests.conftest import ENVIRONMENT
from tests.study.sweeps import SHORT, journal_of, spec_file

AXES = "[vary]\ndevice.stiffness = [50, [[100.0]]]\nlink = ['lan', { up = 'lan', down = '4g' }]\nseed = [3, 4]"


def result(number: int, error: str | None = None) -> CaseResult:
    return CaseResult(number, {} if error else {"margin_J": 0.1 + number, "lag": None, "n": 3}, error, 0.25, "host:1")


def test_what_is_recorded_is_there_for_the_next_process(tmp_path: Path) -> None:
    first = journal_of(tmp_path, AXES)
    assert first.count() == (8, 0, 0)
    first.record([result(5, "it broke"), result(2)])
    first.close()
    second = journal_of(tmp_path, AXES)
    assert second.count() == (8, 2, 1)
    assert [case.number for case in second.pending()] == [0, 1, 3, 4, 6, 7]
    rows = list(second.rows())
    assert rows[2].measures == {"margin_J": 2.1, "lag": None, "n": 3}
    assert (rows[2].error, rows[2].wall_s, rows[2].worker) == (None, 0.25, "host:1")
    assert (rows[5].error, rows[5].measures, rows[5].done) == ("it broke", {}, True)
    assert rows[2].case.values == {"device.stiffness": 50.0, "link": {"up": "lan", "down": "4g"}}
    assert [row.case.seed for row in rows] == [3, 4] * 4
    assert rows[4].case.values["device.stiffness"] == [[100.0]]
    assert second.forget_failed() == 1
    assert second.count() == (8, 1, 0)
    second.close()


def test_cases_can_be_added_and_each_is_there_once(tmp_path: Path) -> None:
    journal = journal_of(tmp_path, "[vary]\nseed = [3, 4]")
    journal.record([result(1)])
    more = Spec.read(spec_file(tmp_path, "[vary]\nseed = [9, 4, 5]", "more")).cases()
    for _ in range(2):
        journal.add(more)
    assert [(row.case.number, row.case.seed, row.done) for row in journal.rows()] == [
        (0, 3, False),
        (1, 4, True),
        (2, 9, False),
        (3, 5, False),
    ]
    found = journal.find([case.key for case in more])
    assert [(row.case.number, row.measures.get("margin_J")) for row in found] == [(2, None), (1, 1.1), (3, None)]
    journal.close()
    journal_of(tmp_path, "[vary]\nseed = [3, 4]").close()  # it is still the journal of what it began with


def test_only_one_process_runs_a_sweep(tmp_path: Path) -> None:
    first = journal_of(tmp_path, SHORT)
    with pytest.raises(HapnetError, match=rf"another process runs the sweep in .*: process {os.getpid()}$"):
        journal_of(tmp_path, SHORT, fresh=True)
    looked = Journal.look(tmp_path)  # others may read
    assert looked.count() == (40, 0, 0)
    looked.close()
    first.close()
    journal_of(tmp_path, SHORT).close()


def test_another_spec_is_refused_and_the_same_in_other_words_is_not(tmp_path: Path) -> None:
    begun = journal_of(tmp_path, SHORT)
    begun.record([result(0)])
    begun.close()
    journal_of(tmp_path, SHORT.replace('"0:10"', "[9, 8, 7, 6, 5, 4, 3, 2, 1, 0]").replace("0.2", "2e-1")).close()
    with pytest.raises(HapnetError, match=r"20 cases are new, 0 are gone, 40 are the same; --out .*, or --fresh"):
        journal_of(tmp_path, SHORT.replace("0:10", "0:15"))
    with pytest.raises(HapnetError, match="40 cases are new, 40 are gone, 0 are the same"):
        journal_of(tmp_path, SHORT.replace("0.2", "0.3"))
    fresh = journal_of(tmp_path, SHORT.replace("0.2", "0.3"), fresh=True)
    assert fresh.count() == (40, 0, 0)
    fresh.close()


def test_another_version_of_hapnet_shows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    begun = journal_of(tmp_path, SHORT)
    assert begun.other_version is None
    before = begun.versions[DISTRIBUTION]
    begun.close()
    monkeypatch.setattr(module, "versions", lambda: {DISTRIBUTION: "99.0"})
    resumed = journal_of(tmp_path, SHORT)
    assert resumed.other_version == before
    resumed.close()


def test_what_is_no_journal_is_said_to_be_none(tmp_path: Path) -> None:
    with pytest.raises(HapnetError, match=f"no sweep in .*{NAME}"):
        Journal.look(tmp_path)
    (tmp_path / NAME).write_bytes(b"something else, long enough to be looked at" * 30)
    with pytest.raises(HapnetError, match="not the journal of a sweep"):
        journal_of(tmp_path, SHORT)
    with pytest.raises(HapnetError, match="not the journal of a sweep"):
        Journal.look(tmp_path)
    journal_of(tmp_path, SHORT, fresh=True).close()
    with sqlite3.connect(tmp_path / NAME) as database:
        database.execute("UPDATE about SET value = '2' WHERE name = 'format'")
    database.close()
    with pytest.raises(HapnetError, match="format 2"):
        Journal.look(tmp_path)


WRITER = """
import os, sys
from pathlib import Path
from hapnet.ext.study.journal import CaseResult, Journal
journal = Journal.look(Path(sys.argv[1]))
journal.record([CaseResult(0, {}), CaseResult(1, {})])
journal._db.execute("PRAGMA cache_spill = 1")
journal._db.execute("PRAGMA cache_size = 1")
journal._db.executemany("INSERT INTO about VALUES (?, ?)", [(str(n), "x" * 3000) for n in range(300)])
assert os.path.getsize(journal.path) > 500_000, "spilled to the file in the middle of a transaction"
os.kill(os.getpid(), 9)
"""


def test_killed_in_the_middle_of_a_transaction_nothing_of_it_is_left(tmp_path: Path) -> None:
    journal_of(tmp_path, SHORT).close()
    done = subprocess.run(
        [sys.executable, "-c", WRITER, str(tmp_path)], env=ENVIRONMENT, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == -signal.SIGKILL, done.stderr
    assert (tmp_path / f"{NAME}-journal").exists()  # torn indeed
    resumed = journal_of(tmp_path, SHORT)
    assert resumed.count() == (40, 2, 0)
    resumed.close()
    with sqlite3.connect(tmp_path / NAME) as database:
        assert database.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    database.close()


def test_a_full_disk_is_said_in_one_line(tmp_path: Path) -> None:
    journal = journal_of(tmp_path, SHORT)
    journal._db.execute("PRAGMA max_page_count = 1")
    with pytest.raises(HapnetError, match=r"cannot use the journal .*full"):
        journal.record([CaseResult(n, {}, "x" * 5000) for n in range(20)])
    assert journal.count() == (40, 0, 0)
    journal.close()
