"""`hapnet tune`, as a user types it. What a case measures is a formula, but where a test says otherwise."""

import csv
import re
import sys
from pathlib import Path
from typing import Any

import pytest
from matplotlib.figure import Figure

from hapnet import cli
from hapnet.ext.study import figures, search_space
from hapnet.ext.study.backend import TaskOutcome, ThisProcess
from hapnet.ext.study.case import Measures
from hapnet.ext.study.figures import tuned as draw
from hapnet.installing import install_command
from hapnet.params import Params
from tests.conftest import ROOT
from tests.study.sweeps import spec_file
from tests.support.commands import Tab
from tests.support.processes import read_json, without_progress

Capture = pytest.CaptureFixture[str]

SPEC = """
[tune]
objective = { free_rms_mm = 1.0, buzz_N2 = 0.5 }
constraints = ["passive", "stiffness_percent >= 90"]
trials = 16
generation = 4
[search]
contact_model.lead = { from = 0.0, to = 1.0 }
contact_model.window_s = { from = 0.01, to = 0.5, scale = "log" }
device.on_silence = ["hold", "release"]
[fixed]
duration_s = 0.2
operator = "sine"
[vary]
link = ["lan", "4g"]
[score]
link = ["wifi"]
seed = [5, 6, 7]
"""
LEAD, WINDOW_S = Params().contact_model.lead, Params().contact_model.window_s
FILES = ["results.csv", "trials.csv", "tune.png", "found.toml"]


def formula(params: Params, seed: int) -> Measures:
    """Free motion wants a lead of 0.3, the wall one of 0.4 at least."""
    lead = params.contact_model.lead
    return {
        "free_rms_mm": abs(lead - 0.3) + (params.device.on_silence == "hold"),
        "buzz_N2": 0.01 * seed,
        "stiffness_percent": 50.0 + 100.0 * lead,
        "margin_J": 0.1,
        "claim_kept": 1.0,
    }


@pytest.fixture(autouse=True)
def directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.setattr("hapnet.ext.study.backend.local_workers", lambda count: ThisProcess())
    monkeypatch.setattr("hapnet.ext.study.task.measure", formula)
    monkeypatch.setattr(figures, "tuned", lambda search: Figure(figsize=(1, 1)))
    spec_file(tmp_path, SPEC)
    return tmp_path


def tuned(*argv: object, code: int = 0) -> dict[str, Any]:
    assert cli.main(["tune", "study.toml", *map(str, argv), "--json", "told.json"]) == code
    return read_json(Path("told.json"))


def trials(directory: Path) -> list[dict[str, str]]:
    with (directory / "trials.csv").open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


@pytest.mark.slow
def test_a_tuning_from_spec_to_figure(directory: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(figures, "tuned", draw)
    reported = tuned()
    runs = directory / "runs" / "tune-study"
    lead = reported["parameters"]["contact_model.lead"]
    assert (lead["default"], lead["range"]) == (LEAD, {"from": 0.0, "to": 1.0, "log": False})
    assert 0.4 <= lead["found"] < 0.5
    assert reported["parameters"]["device.on_silence"]["found"] == "release"
    assert reported["objective"] == ["1 x median of free_rms_mm", "0.5 x median of buzz_N2"]
    scoring = reported["scoring"]
    assert scoring["found"]["objective"] == pytest.approx(lead["found"] - 0.3 + 0.5 * 0.06)
    assert scoring["default"]["objective"] == pytest.approx(1.0 + LEAD - 0.3 + 0.5 * 0.06)
    assert scoring["found"]["metrics"]["buzz_N2"]["median"] == 0.06
    assert scoring["found"]["constraints"][1] == {"constraint": "stiffness_percent >= 90", "kept": 3, "met": True}
    assert reported["files"] == [f"runs/tune-study/{name}" for name in FILES]
    assert Params().load(runs / "found.toml").contact_model.lead == lead["found"]
    assert (runs / "tune.png").read_bytes().startswith(b"\x89PNG")
    rows = trials(runs)
    assert [int(row["trial"]) for row in rows] == list(range(16))
    assert [row["generation"] for row in rows[3:5]] == ["0", "1"]
    (chosen,) = [row for row in rows if row["chosen"] == "true"]
    assert (int(chosen["trial"]), chosen["stiffness_percent >= 90"]) == (reported["best_trial"], "2/2")
    low = [row for row in rows if float(row["contact_model.lead"]) < 0.4]
    assert low
    assert {row["allowed"] for row in low} == {"false"}
    out, err = capsys.readouterr()
    assert "objective" in out
    assert not err

    again = tuned("--workers", 2)
    assert (again.pop("run"), reported.pop("run")) == (0, reported["done"])
    again.pop("wall_s"), reported.pop("wall_s")
    assert again == reported


def test_interrupted_it_goes_on_where_it_was(directory: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    tuned("--out", "whole")
    whole = trials(directory / "whole")

    class Interrupted(ThisProcess):
        """Ctrl-C comes while a task runs."""

        waits = 0

        def wait(self, limit_s: float) -> list[TaskOutcome]:
            self.waits += 1
            if self.waits == 12:
                raise KeyboardInterrupt
            return super().wait(limit_s)

    monkeypatch.setattr("hapnet.ext.study.backend.local_workers", lambda count: Interrupted())
    capsys.readouterr()
    cut = tuned("--out", "cut", code=130)
    done = cut["done"]
    assert 5 < done < 38
    said = without_progress(capsys.readouterr().err)
    assert said == f"hapnet: stopped: {done} of 38 cases are done; the same command continues\n"
    assert cut["files"] == ["cut/results.csv", "cut/trials.csv", "cut/tune.png"]
    begun = trials(directory / "cut")
    assert begun
    assert [{**row, "chosen": ""} for row in begun] == [{**row, "chosen": ""} for row in whole[: len(begun)]]
    monkeypatch.setattr("hapnet.ext.study.backend.local_workers", lambda count: ThisProcess())
    resumed = tuned("--out", "cut")
    assert resumed["run"] + done == resumed["done"] == tuned("--out", "whole")["done"]
    assert trials(directory / "cut") == whole


def test_a_metric_without_any_value_is_told(directory: Path, capsys: Capture) -> None:
    spec_file(directory, SPEC.replace("buzz_N2", "drift_mm_per_min"))
    tuned()
    out = capsys.readouterr().out.splitlines()
    assert [line for line in out if "no tuning case" in line] == [
        "warning: no tuning case has a value of drift_mm_per_min: it had no influence on the search"
    ]


def test_a_metric_that_is_missed_throughout_is_infinite(
    directory: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    missed: Measures = {"first_contact_ms": None, "first_contact_missed": 1.0}
    monkeypatch.setattr("hapnet.ext.study.task.measure", lambda params, seed: formula(params, seed) | missed)
    spec_file(directory, SPEC.replace("buzz_N2", "first_contact_ms"))
    reported = tuned(code=3)
    out, err = capsys.readouterr()
    assert "inf..inf" in out
    assert err.startswith("hapnet: no trial of 16 keeps all constraints and has a finite objective")
    assert reported["tuning"]["default"]["objective"] is None


def test_where_no_trial_is_allowed_nothing_is_chosen(directory: Path, capsys: Capture) -> None:
    tuned()
    assert (directory / "runs/tune-study/found.toml").exists()
    capsys.readouterr()
    spec_file(directory, SPEC.replace(">= 90", ">= 151"))
    reported = tuned(code=3)
    err = capsys.readouterr().err
    assert err.startswith("hapnet: no trial of 16 keeps all constraints and has a finite objective; the nearest, ")
    assert err.endswith(", breaks: stiffness_percent >= 151\n")
    assert err.count("\n") == 1
    assert reported["best_trial"] is None
    assert reported["parameters"]["contact_model.lead"]["found"] is None
    assert reported["scoring"]["found"] is None
    assert reported["scoring"]["default"]["cases"] == 3
    assert not (directory / "runs/tune-study/found.toml").exists()


@pytest.mark.parametrize(
    ("where", "code", "said"),
    [
        (lambda params, seed: seed == 0 and params.contact_model.lead < 0.5, 0, ""),
        (lambda params, seed: seed == 6, 3, "hapnet: 1 of the scoring cases failed with the values found\n"),
    ],
    ids=["tuning", "scoring"],
)
def test_values_whose_cases_fail_are_not_chosen(
    directory: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch, where: Any, code: int, said: str
) -> None:
    def failing(params: Params, seed: int) -> Measures:
        if where(params, seed):
            raise ZeroDivisionError("it broke")
        return formula(params, seed)

    monkeypatch.setattr("hapnet.ext.study.task.measure", failing)
    reported = tuned(code=code)
    assert without_progress(capsys.readouterr().err) == said
    found = reported["parameters"]["contact_model.lead"]["found"]
    assert found >= 0.5 if code == 0 else found < 0.5
    assert reported["failed"] > 0


def test_a_claim_that_was_not_kept_ends_with_4(capsys: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    def lying(params: Params, seed: int) -> Measures:
        return {**formula(params, seed), "claim_kept": float(params.link.up != "wifi")}

    monkeypatch.setattr("hapnet.ext.study.task.measure", lying)
    tuned(code=4)
    assert "(claim_kept) the coupling claims to be passive, and was not" in capsys.readouterr().err


def test_a_dry_run_says_what_would_run_and_writes_nothing(directory: Path, capsys: Capture) -> None:
    assert cli.main(["tune", "study.toml", "--dry-run"]) == 0
    *out, estimated = [line for line in capsys.readouterr().out.splitlines() if not line.startswith("warning")]
    assert out == [
        "16 trials of 2 cases, scored on 3 others, into runs/tune-study",
        f"  contact_model.lead: 0 to 1, default {LEAD:g}",
        f"  contact_model.window_s: 0.01 to 0.5, log, default {WINDOW_S:g}",
        "  device.on_silence: hold | release, default hold",
        "  objective: 1 x median of free_rms_mm, 0.5 x median of buzz_N2",
        "  constraints: passive, stiffness_percent >= 90",
        "  first case of tuning: link = lan, seed = 0",
        "  first case of scoring: link = wifi, seed = 5",
    ]
    assert re.fullmatch(r"a case takes \S+ s \(mean of \d\); all of them, with \d+ workers?: about .+", estimated)
    assert sorted(path.name for path in directory.iterdir()) == ["study.toml"]


def test_without_its_library_it_says_what_to_install(capsys: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(search_space, "find_spec", lambda name: None)
    assert cli.main(["tune", "study.toml"]) == 2
    out, err = capsys.readouterr()
    needs = "hapnet tune needs optuna, of the extra `tune`, which is not installed"
    assert err == f"hapnet: {needs}: {install_command('optuna')}\n"
    assert not out


@pytest.mark.parametrize(
    ("argv", "said"),
    [
        ([], "Missing argument 'SPEC.toml'; see hapnet tune --help"),
        (["none.toml"], "SPEC is 'none.toml'; allowed: a TOML file (No such file or directory)"),
        (
            ["same.toml"],
            "score is 'link lan, operator sine, seed 0'; allowed: a link, hand or seed that is not tuned on",
        ),
        (["study.toml", "--set", "contact_model.lead=1"], "either under [search] or under another table"),
        (["study.toml", "--set", "link=lan"], "--set is 'link=lan'; allowed: a parameter that does not vary"),
        (["study.toml", "--set", "scene=wal"], "no case can run; the first: unknown scene 'wal'; did you mean wall?"),
        (["study.toml", "--dask", "here"], "--dask is 'here'; allowed: a scheduler's address"),
        (["study.toml", "--dask", "tcp://127.0.0.1:9", "--workers", "2"], "the cluster has its own"),
        (["study.toml", "--trials", "3"], "No such option: --trials"),
    ],
)
def test_what_is_wrong_is_one_line(directory: Path, capsys: Capture, argv: list[str], said: str) -> None:
    spec_file(directory, SPEC.replace('"wifi"]\nseed = [5, 6, 7]', '"lan"]'), "same")
    assert cli.main(["tune", *argv]) == 2
    err = capsys.readouterr().err
    assert said in err
    assert err.count("\n") == 1
    assert not (directory / "runs/tune-study/results.csv").exists()


def test_another_spec_in_the_same_directory_is_refused(directory: Path, capsys: Capture) -> None:
    tuned()
    capsys.readouterr()
    assert cli.main(["tune", "study.toml", "--set", "duration_s=0.3"]) == 2
    assert "is of another spec: 5 cases are new" in capsys.readouterr().err
    assert tuned("--set", "duration_s=0.3", "--fresh")["run"] > 5


def test_the_example_is_a_spec(capsys: Capture) -> None:
    assert cli.main(["tune", str(ROOT / "examples" / "tune" / "pspm.toml"), "--dry-run"]) == 0
    assert "into runs/tune-pspm" in capsys.readouterr().out


def test_the_spec_of_the_page_is_one(directory: Path, capsys: Capture) -> None:
    found = re.search(
        r"```toml\n(# pd.toml.*?)```", (ROOT / "hapnet" / "ext" / "study" / "README.md").read_text("utf-8"), re.DOTALL
    )
    spec_file(directory, found[1], "pd")
    assert cli.main(["tune", "pd.toml", "--dry-run"]) == 0
    assert "64 trials of 8 cases, scored on 12 others, into runs/tune-pd" in capsys.readouterr().out


def test_tab(directory: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    spec_file(directory, SPEC, "other")
    for words, offered in ((["tune", "st"], ["study.toml"]), (["tune", ""], ["other.toml", "study.toml"]),
                           (["tune", "study.toml", "--dr"], ["--dry-run"]), (["tu"], ["tune"])):  # fmt: skip
        assert Tab(monkeypatch, capsys)("hapnet", *words) == offered


@pytest.mark.slow
def test_simulated_on_one_worker_or_two_it_finds_the_same(directory: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.undo()
    monkeypatch.chdir(directory)
    few = SPEC.replace("trials = 16", "trials = 6").replace(', "stiffness_percent >= 90"', "")
    spec_file(directory, few)
    one, two = (tuned("--out", str(n), "--workers", n) for n in (1, 2))
    assert one["parameters"] == two["parameters"]
    assert one["scoring"] == two["scoring"]
    assert trials(directory / "1") == trials(directory / "2")
