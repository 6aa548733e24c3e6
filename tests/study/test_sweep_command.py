"""`hapnet sweep` and `hapnet sweep plot`, as a user types them."""

import ast
import csv
import os
import re
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from hapnet import cli
from hapnet.errors import HapnetError
from hapnet.ext.study.backend import Backend, TaskOutcome
from hapnet.ext.study.export import TIMING
from hapnet.ext.study.journal import NAME, Journal
from hapnet.ext.study.spec import Spec
from hapnet.ext.study.task import CaseResult, Task, run
from hapnet.processes.pool import EndedTask
from tests.conftest import ENVIRONMENT, ROOT, mostly_slow
from tests.study.sweeps import FATAL, SHORT, TOUCHY, done, spec_file
from tests.support.commands import Tab
from tests.support.processes import Program, read_json, started, without_progress

Capture = pytest.CaptureFixture[str]


@pytest.fixture(autouse=True)
def directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    return tmp_path


def rows(directory: Path) -> list[dict[str, str]]:
    """The results, but for the timing."""
    with (directory / "results.csv").open(newline="", encoding="utf-8") as file:
        return [{name: word for name, word in row.items() if name not in TIMING} for row in csv.DictReader(file)]


def summary(*argv: object, code: int = 0) -> dict[str, Any]:
    assert cli.main(["sweep", *map(str, argv), "--json", "summary.json"]) == code
    return read_json(Path("summary.json"))


@pytest.mark.slow
def test_a_sweep_from_its_spec_to_its_figure(directory: Path, capsys: Capture) -> None:
    spec_file(directory, f"{TOUCHY}[vary]\nworld.wall.stiffness = [1000, 13, 3000]\nseed = '0:3'")
    reported = summary("study.toml", "--workers", 1, code=3)
    assert {name: reported[name] for name in ("cases", "done", "failed", "run")} == {
        "cases": 9,
        "done": 9,
        "failed": 3,
        "run": 9,
    }
    out, err = capsys.readouterr()
    assert "3 of 9 cases failed:" in out
    assert "  3 x the scene tests.study.sweeps:touchy failed: " in out
    assert not without_progress(err)
    found = rows(Path("runs/sweep-study"))
    assert [int(row["case"]) for row in found] == list(range(9))
    assert [row["world.wall.stiffness"] for row in found] == ["1000.0"] * 3 + ["13.0"] * 3 + ["3000.0"] * 3
    assert [bool(row["error"]) for row in found] == [False] * 3 + [True] * 3 + [False] * 3
    assert reported["files"] == ["runs/sweep-study/results.csv", "runs/sweep-study/results.parquet"]

    again = summary("study.toml", "--format", "csv", code=3)  # nothing is left to run
    assert (again["run"], again["done"], again["files"]) == (0, 9, ["runs/sweep-study/results.csv"])
    assert rows(Path("runs/sweep-study")) == found
    retried = summary("study.toml", "--retry-failed", "--workers", 1, code=3)
    assert (retried["run"], retried["failed"]) == (3, 3)
    capsys.readouterr()

    assert cli.main(["sweep", "plot", "runs/sweep-study"]) == 0
    assert capsys.readouterr().out == "figure: runs/sweep-study/energy_out_J-world.wall.stiffness.png\n"
    flags = ("--x", "seed", "--y", "world.wall.stiffness", "--value", "peak_force_N", "--stat", "max", "--out", "a.png")
    assert cli.main(["sweep", "plot", "runs/sweep-study", *flags]) == 0
    assert Path("a.png").read_bytes().startswith(b"\x89PNG")


def test_a_claim_that_was_not_kept_ends_with_4(directory: Path, capsys: Capture) -> None:
    spec_file(directory, SHORT)
    spec = Spec.read(Path("study.toml"), {})
    path = Path("runs/sweep-study")
    path.mkdir(parents=True)
    journal = Journal.create_or_resume(path, spec, spec.cases())
    journal.record([CaseResult(case.number, {"claim_kept": float(case.number != 3)}) for case in journal.pending()])
    journal.close()
    assert summary("study.toml", "--format", "csv", code=4)["done"] == 40
    assert "in 1 of 40 cases (claim_kept) the coupling claims to be passive, and was not" in capsys.readouterr().err


def test_a_dry_run_says_what_would_run_and_writes_nothing(directory: Path, capsys: Capture) -> None:
    spec_file(directory, SHORT)
    assert cli.main(["sweep", "study.toml", "--dry-run"]) == 0
    out = capsys.readouterr().out.splitlines()
    assert out[0] == "40 cases, 10 seeds, into runs/sweep-study"
    assert out[1] == "  0: coupling = pspm, link = lan, seed = 0"
    assert out[-2] == "  39: coupling = zoh, link = 4g, seed = 9"
    assert re.fullmatch(r"a case takes \S+ s \(mean of 8\); all of them, with \d+ workers?: about .+", out[-1])
    assert sorted(path.name for path in directory.iterdir()) == ["study.toml"]


def test_a_dry_run_estimates_by_the_cases_that_can_run(directory: Path, capsys: Capture) -> None:
    """The first one cannot, and they do not last equally long."""
    spec_file(directory, "[vary]\ndevice.stiffness = [-1, 100]\nduration_s = [0.2, 0.4]\nseed = [0, 1]")
    assert cli.main(["sweep", "study.toml", "--dry-run", "--workers", "1"]) == 0
    out = capsys.readouterr().out.splitlines()
    assert out[0] == "4 of 8 cases cannot run; the first: device.stiffness is -1.0; allowed: 0 or above"
    assert re.fullmatch(r"a case takes \S+ s \(mean of 2\); all of them, with 1 worker: about .+", out[-1])


MIXED = """
[fixed]
duration_s = 0.2
[vary]
coupling = ["wave", "zoh"]
device.servo = ["sampled", "continuous"]
link = ["lan", "4g"]
seed = "0:3"
"""
NOT_WAVE = "device.servo is 'continuous'; allowed: sampled with the coupling wave"


def test_combinations_that_cannot_run_are_rows_that_say_why(directory: Path, capsys: Capture) -> None:
    spec_file(directory, MIXED)
    assert cli.main(["sweep", "study.toml", "--dry-run"]) == 0
    line = f"6 of 24 cases cannot run; the first: {NOT_WAVE}"
    assert capsys.readouterr().out.splitlines()[0] == line
    reported = summary("study.toml", "--workers", 1, code=3)
    out = capsys.readouterr().out.splitlines()
    assert out[0] == line
    assert f"  6 x {NOT_WAVE}" in out
    assert (reported["done"], reported["failed"], reported["errors"]) == (24, 6, {NOT_WAVE: 6})
    found = rows(Path("runs/sweep-study"))
    assert [row["error"] for row in found] == [""] * 6 + [NOT_WAVE] * 6 + [""] * 12
    assert all(bool(row["margin_J"]) != bool(row["error"]) for row in found)
    assert [row["link"] for row in found] == (["lan"] * 3 + ["4g"] * 3) * 4


def test_where_no_case_can_run_the_spec_is_refused(directory: Path, capsys: Capture) -> None:
    spec_file(directory, MIXED.replace('"sampled", ', "").replace(', "zoh"', ""))
    for flags in ([], ["--dry-run"]):
        assert cli.main(["sweep", "study.toml", *flags]) == 2
        assert capsys.readouterr() == ("", f"hapnet: no case can run; the first: {NOT_WAVE}\n")
    assert not (directory / "runs").exists()


def test_what_is_wrong_with_fixed_parameters_alone_does_not_hide_results(directory: Path) -> None:
    spec_file(directory, "[fixed]\nduration_s = 0.2\nworld.step_min_s = 0.1\n[vary]\nworld.step_max_s = [0.2, 0.05]")
    summary("study.toml", "--workers", 1, code=3)
    assert [bool(row["error"]) for row in rows(Path("runs/sweep-study"))] == [False, True]


def test_parameters_that_a_scene_does_not_read_are_refused(directory: Path, capsys: Capture) -> None:
    spec_file(directory, f"{TOUCHY}[vary]\nworld.wall.damping = [1, 10, 100]")
    assert cli.main(["sweep", "study.toml", "--dry-run"]) == 2
    assert "world.wall.damping 1.0: the scene" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("argv", "said"),
    [
        (["none.toml"], "SPEC is 'none.toml'; allowed: a TOML file (No such file or directory)"),
        (["bad.toml"], "no case can run; the first: unknown scene 'wal'; did you mean wall?"),
        (["nothing.toml"], "duration_s is 0.0; allowed: above 0 in virtual time"),
        (["study.toml", "--set", "duration_s"], "--set is 'duration_s'; allowed: NAME=VALUE"),
        (["study.toml", "--set", "seed=3"], "--set is 'seed=3'; allowed: a parameter that does not vary"),
        (["study.toml", "--format", "xls"], "--format is 'xls'"),
        (["study.toml", "--workers", "-1"], "--workers"),
        (["study.toml", "--dask", "here"], "--dask is 'here'; allowed: a scheduler's address"),
        (["study.toml", "--dask", "tcp://127.0.0.1:9", "--workers", "2"], "the cluster has its own"),
        (["study.toml", "--out", "study.toml"], "--out: cannot write to study.toml: it is a file, not a directory"),
        ([], "Missing argument 'SPEC.toml'"),
        (["plot"], "Missing argument 'DIRECTORY'"),
        (["plot", "nowhere"], f"no sweep in nowhere: it has no {NAME}"),
    ],
)
def test_what_is_wrong_is_one_line(directory: Path, capsys: Capture, argv: list[str], said: str) -> None:
    spec_file(directory, SHORT)
    spec_file(directory, "[vary]\nscene = ['wal', 'bocks']", "bad")
    spec_file(directory, "[fixed]\nduration_s = 0\n[vary]\nseed = [1]", "nothing")
    assert cli.main(["sweep", *argv]) == 2
    out, err = capsys.readouterr()
    assert said in err
    assert err.count("\n") == 1
    assert not out
    assert not list(directory.glob("runs/*/results.*"))


@pytest.mark.parametrize(
    "argv", [["sweep", "--help"], ["sweep", "run", "-h"], ["sweep", "plot", "--help"], ["tune", "-h"]]
)
def test_help(argv: list[str], capsys: Capture) -> None:
    assert cli.main(argv) == 0
    out = capsys.readouterr().out
    assert ("--where" if "plot" in argv else "--retry-failed") in out
    assert f"hapnet {argv[0]}" in out


@pytest.mark.parametrize("command", ["sweep", "tune"])
def test_help_loads_nothing_heavy(command: str) -> None:
    code = "import sys; from hapnet.cli import main; main(sys.argv[1:]); print(sorted(sys.modules), file=sys.stderr)"
    ended = subprocess.run(
        [sys.executable, "-c", code, command, "-h"], capture_output=True, text=True, timeout=60, env=ENVIRONMENT
    )
    assert ended.returncode == 0
    assert not {"numpy", "matplotlib", "sqlite3", "multiprocessing", "distributed", "optuna"} & set(
        ast.literal_eval(ended.stderr)
    )


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        (["sweep", ""], ["run", "plot", "plan.toml", "study.toml"]),
        (["sweep", "pl"], ["plot", "plan.toml"]),
        (["sweep", "st"], ["study.toml"]),
        (["sweep", "--wo"], ["--workers"]),
        (["sweep", "study.toml", "--re"], ["--retry-failed"]),
        (["sweep", "run", "st"], ["study.toml"]),
        (["sweep", "plot", "--wh"], ["--where"]),
    ],
)
def test_tab(
    directory: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch, words: list[str], offered: list[str]
) -> None:
    for name in ("study", "plan"):
        spec_file(directory, SHORT, name)
    assert Tab(monkeypatch, capsys)("hapnet", *words) == offered


@pytest.mark.slow
def test_the_spec_of_the_page_is_one(directory: Path, capsys: Capture) -> None:
    found = re.search(
        r"```toml\n(# study.toml.*?)```",
        (ROOT / "hapnet" / "ext" / "study" / "README.md").read_text("utf-8"),
        re.DOTALL,
    )
    spec_file(directory, found[1])
    assert cli.main(["sweep", "study.toml", "--dry-run"]) == 0
    *warnings, first = capsys.readouterr().out.partition(", into runs/sweep-study")[0].splitlines()
    # 3.3 N 21 mm - (3.2 N)^2 / 2K: 56.5 mJ with the stiffest, 400 N/m; 0.7 of the ceiling of 0.1 J are in reserve
    assert warnings == []
    assert first == "2000 cases, 50 seeds"


def test_a_sweep_that_cannot_go_on_writes_what_it_has(
    directory: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Gone(Backend):
        """One task, then nobody is there."""

        workers = room = 1

        def submit(self, task: Task) -> None:
            self.task: Task | None = task

        def wait(self, limit_s: float) -> list[TaskOutcome]:
            if self.task is None or self.task.cases[0].number:
                raise HapnetError("the scheduler is gone")
            return [EndedTask(self.task, run(self.task))]

        def close(self) -> None: ...

    monkeypatch.setattr("hapnet.ext.study.backend.local_workers", lambda workers: Gone())
    spec_file(directory, SHORT)
    assert cli.main(["sweep", "study.toml", "--workers", "1"]) == 2
    assert without_progress(capsys.readouterr().err) == (
        "hapnet: the scheduler is gone: 2 of 40 cases are done; the same command continues\n"
    )
    assert [row["case"] for row in rows(Path("runs/sweep-study"))] == ["0", "10"]  # one task: the same but for the link


@pytest.mark.slow
def test_another_version_warns(directory: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    spec_file(directory, "[fixed]\nduration_s = 0.05\n[vary]\nseed = [1]")
    summary("study.toml")
    capsys.readouterr()
    monkeypatch.setattr("hapnet.ext.study.journal.versions", lambda: {"hapnet-haptics": "99"})
    summary("study.toml")
    assert "warning: hapnet 0." in capsys.readouterr().out


@pytest.mark.slow
def test_interrupted_before_a_result_it_says_one_line_and_offers_no_figure(directory: Path) -> None:
    """Its workers are starting: the moment at which they are easiest to hit."""
    spec_file(directory, SHORT.replace("0.2", "1000"))
    results = directory / "runs" / "sweep-study"
    with started("sweep", "study.toml", "--workers", "2") as program:
        program.until("workers", lambda: len(workers_of(program)) == 2)
        os.killpg(program.process.pid, signal.SIGINT)
        code, out, err = program.end()
        program.until_gone()
    assert (code, err) == (130, "hapnet: stopped: 0 of 40 cases are done; the same command continues\n")
    assert "sweep plot" not in out
    assert not rows(results)


def workers_of(program: Program) -> list[str]:
    """The command lines of the workers that it has started."""
    pid = program.process.pid
    found = []
    for child in Path(f"/proc/{pid}/task/{pid}/children").read_text("ascii").split():
        with suppress(OSError):
            found.append(Path(f"/proc/{child}/cmdline").read_text("utf-8"))
    return [line for line in found if "spawn_main" in line]


@pytest.mark.slow
def test_interrupted_it_keeps_and_writes_what_is_done(directory: Path) -> None:
    some_long = SHORT.replace("duration_s = 0.2\n", "").replace("[vary]", "[vary]\nduration_s = [0.2, 1000]")
    spec_file(directory, some_long)
    results = directory / "runs" / "sweep-study"
    with started("sweep", "study.toml", "--workers", "2") as program:
        program.until("a result on the disk", lambda: done(results) > 0)
        os.killpg(program.process.pid, signal.SIGINT)  # as a terminal does: to all of them
        code, out, err = program.end()
        program.until_gone()
    assert code == 130, out + err
    kept = len(rows(results))
    assert 0 < kept < 80
    assert err == f"hapnet: stopped: {kept} of 80 cases are done; the same command continues\n"
    assert done(results) == kept


@pytest.mark.parametrize("whom", mostly_slow(["one", "all"], 0, 1))
def test_killed_half_way_and_resumed_the_rows_are_the_same(directory: Path, whom: str) -> None:
    """The whole group at once, or the program alone, whose workers then end by themselves."""
    file = spec_file(directory, f"{TOUCHY}[vary]\nworld.wall.stiffness = [1000, {FATAL}, 3000]\nseed = '0:15'")
    half = directory / "half"
    program = Program("sweep", "study.toml", "--out", "half", "--workers", "2", env={"WHOM": whom})
    try:
        assert program.end()[0] == -signal.SIGKILL
        program.until_gone()
    finally:
        program.kill()
    before = done(half)
    assert 0 < before < 45
    resumed = summary("study.toml", "--out", "half", "--workers", 1)
    assert (resumed["run"], resumed["done"], resumed["failed"]) == (45 - before, 45, 0)
    spec = Spec.read(file)
    whole = run(Task(spec.fixed, tuple(spec.cases())))  # here, and in one go
    assert len({case.measures["free_rms_mm"] for case in whole}) == 15  # each seed has its own; no wall is reached
    assert [float(row["free_rms_mm"]) for row in rows(half)] == [case.measures["free_rms_mm"] for case in whole]
    journal = Journal.look(half)
    assert [row.measures for row in journal.rows()] == [case.measures for case in whole]
    journal.close()


@pytest.mark.slow
def test_a_second_one_beside_it_is_refused(directory: Path) -> None:
    spec_file(directory, SHORT.replace("0.2", "1000"))  # the first one is under way, however late the second comes
    with started("sweep", "study.toml", "--workers", "1") as program:
        program.until("a journal", lambda: done(directory / "runs" / "sweep-study") >= 0)
        second = subprocess.run(
            [sys.executable, "-m", "hapnet", "sweep", "study.toml"],
            capture_output=True,
            text=True,
            timeout=60,
            env=ENVIRONMENT,
        )
        assert second.returncode == 2
        assert second.stderr == (
            f"hapnet: another process runs the sweep in runs/sweep-study: process {program.process.pid}\n"
        )
