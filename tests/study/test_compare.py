"""The comparison: its plan, its workers, its statistics, and what the command writes and refuses."""

import io
import json
import os
import re
import signal
import statistics
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from hapnet import cli
from hapnet.errors import HapnetError, InvalidParameter
from hapnet.ext.metrics import METRICS
from hapnet.ext.study import backend, compare, plans, tables, task
from hapnet.ext.study.backend import ThisProcess, local_workers
from hapnet.ext.study.case import Measures, measure
from hapnet.ext.study.commands import compare as command
from hapnet.ext.study.compare import ComparedRun, Plan, Variant, parted
from hapnet.ext.study.journal import JournalRow
from hapnet.ext.study.sections import QUICK
from hapnet.ext.study.spec import params_of
from hapnet.params import Params
from hapnet.processes.pool import usable_cores
from tests.conftest import DATA
from tests.study.comparisons import LINKS, QUICK_PARAMS, compared, known, outcomes, plan
from tests.support.processes import started, without_progress

Capture = pytest.CaptureFixture[str]

QUICKLY = ("--duration", "0.2", "--seeds", "0:1", "--operator", "press", "--workers", "1")


# -- the plan --------------------------------------------------------------------------------------------------------


def test_every_case_once_each_with_its_own_parameters() -> None:
    cases = plan().cases()
    assert len({(one.variant, one.link, one.operator, one.seed) for one in cases}) == len(cases) == 16
    for one in cases:
        found = one.params
        light = one.operator.endswith("@light")
        assert (found.coupling, found.link.up, found.link.down) == (one.variant.coupling, *LINKS[one.link])
        assert found.operator == one.operator.removesuffix("@light")
        assert found.operator_model.mass == (0.1 if light else 0.554)
        assert found.device.servo == "sampled"


def test_each_coupling_is_tried_with_each_deadband() -> None:
    both = Plan(QUICK_PARAMS, ("pspm",), LINKS, ("press",), (0,), (0.0, 0.1))
    assert [str(variant) for variant in both.variants] == ["pspm", "pspm, deadband 10 %"]
    assert {one.params.get("wire.deadband") for one in both.cases()} == {0.0, 0.1}


def test_an_operator_may_have_parameters_of_its_own() -> None:
    """What one sets, the others have as it is for all; and a relaxed hand may have more."""
    far, light = "press:operator_model.start_m=-0.1", "press@light:operator_model.reach_s=0.5"
    asked = Plan(QUICK_PARAMS.set({"operator_model.reach_s": 0.7}), ("pspm",), LINKS, (far, light, "hand-3"), (0,))
    found = {
        one.operator: (one.params.operator, hand.start_m, hand.reach_s, hand.mass)
        for one in asked.cases()
        for hand in [one.params.operator_model]
    }
    assert found == {
        far: ("press", -0.1, 0.7, 0.554), light: ("press", 0.0, 0.5, 0.1), "hand-3": ("hand-3", 0.0, 0.7, 0.554),
    }  # fmt: skip
    cases = asked.spec.cases()
    assert len(cases) == 6
    assert {params_of(asked.spec.fixed, one.given) for one in cases} == {one.params for one in asked.cases()}


# -- running ---------------------------------------------------------------------------------------------------------


def test_a_coupling_may_have_parameters_of_its_own(tmp_path: Path) -> None:
    """What one column sets, the others have as it is for all; and the journal finds each case again."""
    names = ("pspm", "pspm:rendering=paper", "zoh", "wave:wave.impedance=2:wave.recovery_s=0")
    params = QUICK_PARAMS.set({"wave.recovery_s": 0.3, "duration_s": 0.5})
    asked = Plan(params, names, {"near": ("lan", "lan")}, ("press",), (0,))
    found = {
        str(one.variant): tuple(map(one.params.get, ("coupling", "rendering", "wave.impedance", "wave.recovery_s")))
        for one in asked.cases()
    }
    assert found == {
        "pspm": ("pspm", "auto", 0.0, 0.3),
        "pspm:rendering=paper": ("pspm", "paper", 0.0, 0.3),
        "zoh": ("zoh", "auto", 0.0, 0.3),
        "wave:wave.impedance=2:wave.recovery_s=0": ("wave", "auto", 2.0, 0.0),
    }
    cases = asked.spec.cases()
    assert len(cases) == 4
    assert {params_of(asked.spec.fixed, one.given) for one in cases} == {one.params for one in asked.cases()}
    measured = compared(asked, tmp_path, local_workers(1))
    assert [str(one.case.variant) for one in measured] == list(names)
    assert all(one.error is None for one in measured)


def test_what_a_coupling_is_called() -> None:
    assert parted("pspm") == ("pspm", {})
    assert parted("mine.py:LAW:device.damping=2") == ("mine.py:LAW", {"device.damping": "2"})
    for words in ("pspm:rendering=paper:rendering=hapnet", "pspm:rendering=paper:wave"):
        with pytest.raises(InvalidParameter, match="PARAMETER=VALUE after each further colon"):
            parted(words)


def test_the_cases_are_those_of_a_sweep(tmp_path: Path) -> None:
    """The same parameters after their way through the journal, where each case finds its own row."""
    base = QUICK_PARAMS.set({"operator_model.mass": 0.3, "device.stiffness": [[100.0, 5.0], [5.0, 80.0]]})
    for params, operators in (
        (base, ("press", "sine@light")),
        (base, ("press", "sine")),
        (QUICK_PARAMS, ("press@light",)),
    ):
        asked = Plan(params, ("pspm", "zoh"), LINKS, operators, (0, 3), (0.0,), (Variant("zoh", 0.1),))
        fixed, cases = json.loads(json.dumps(asked.spec.fixed)), asked.spec.cases()
        rows = [JournalRow(one, True, known(margin_J=float(one.number)), None, None, None) for one in cases]
        found = asked.outcomes(rows)
        assert len(cases) == len(found) == 3 * 2 * len(operators) * 2
        for one in found:
            case = cases[int(one.measures["margin_J"] or 0.0)]
            assert params_of(fixed, json.loads(json.dumps(case.given))) == one.case.params
            assert case.seed == one.case.seed


@pytest.mark.slow
def test_the_same_from_any_number_of_workers(tmp_path: Path) -> None:
    asked = plan(seeds=1)
    alone = compared(asked, tmp_path, ThisProcess())
    assert [one.case for one in alone] == asked.cases()
    assert all(one.error is None for one in alone)
    (tmp_path / "two").mkdir()
    assert compared(asked, tmp_path / "two", local_workers(2)) == alone
    for one in alone[3:5]:
        assert one.measures == measure(one.case.params, one.case.seed)


def test_a_case_that_fails_is_told_and_the_rest_is_measured(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def pretended(params: Params, seed: int) -> Measures:
        if params.coupling == "zoh" and seed == 1:
            raise ZeroDivisionError("somebody's\n own scene")
        if params.coupling == "zoh" and seed == 2:
            raise HapnetError("no way")
        return known()

    monkeypatch.setattr(task, "measure", pretended)
    asked = plan(seeds=3)
    found = compared(asked, tmp_path, ThisProcess())
    assert {one.error for one in found if one.measures is None} == {
        "ZeroDivisionError: somebody's own scene", "no way"
    }  # fmt: skip
    assert sum(one.measures is not None for one in found) == 16
    groups = {(one.variant.coupling, one.link): one for one in compare.groups(asked, found) if one.operator is None}
    assert (groups["zoh", "far"].cases, groups["zoh", "far"].failed, groups["zoh", "far"].passive) == (6, 4, 2)
    assert groups["pspm", "far"].failed == 0
    lines = tables.failures(found, most=3)
    assert lines[0] == "failed: zoh over near, press, seed 1: ZeroDivisionError: somebody's own scene"
    assert lines[-1] == "and 5 more"


# -- statistics ------------------------------------------------------------------------------------------------------


def test_medians_and_quartiles_of_what_is_known() -> None:
    """Against the standard library's inclusive quantiles, of the means of several hands, or of one hand's cases; what a
    case does not know does not count."""
    asked = plan(seeds=5)
    values = {(one.operator, one.seed): (3.0 * one.seed - 1.0) * (2.0 if one.operator == "press" else -1.0)
              for one in asked.cases()}  # fmt: skip

    def measured(one: ComparedRun) -> Measures:
        felt = None if one.operator == "press" else 5.0
        return known(buzz_N2=values[one.operator, one.seed], first_contact_ms=felt)

    groups = compare.groups(asked, outcomes(asked, measured))
    assert len(groups) == 2 * 2 * 3
    for group in groups:
        own = [value for (operator, _), value in values.items() if group.operator in (None, operator)]
        means = [statistics.fmean(v for (o, _), v in values.items() if o == name) for name in asked.operators]
        units = own if group.operator else means
        q1, median, q3 = statistics.quantiles(units, n=4, method="inclusive")
        spread = group.spreads["buzz_N2"]
        assert (spread.count, spread.least, spread.most) == (len(own), min(own), max(own))
        assert (spread.q1, spread.median, spread.q3) == pytest.approx((q1, median, q3))
        assert "drift_mm_per_min" not in group.spreads
        assert group.median("drift_mm_per_min") is None
        felt = group.spreads.get("first_contact_ms")
        assert (felt.count if felt else 0) == (0 if group.operator == "press" else 5)


def test_passive_is_what_is_not_negative_but_for_rounding() -> None:
    margins = [0.1, 0.0, -1e-12, -1e-6, -3.0]
    asked = Plan(QUICK_PARAMS, ("pspm",), {"near": LINKS["near"]}, ("press",), tuple(range(5)))
    found = outcomes(asked, lambda one: known(margin_J=margins[one.seed], hand_margin_J=0.05 - one.seed))
    (group,) = compare.groups(asked, found)
    assert (group.passive, group.hand_passive) == (3, 1)


# -- what is shown ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("width", [80, 165])
def test_a_table_a_link_fits_the_terminal(width: int) -> None:
    asked = Plan(QUICK_PARAMS, ("pspm", "zoh"), LINKS, ("press",), tuple(range(12)))
    worst = known(**dict.fromkeys(METRICS, -1234.5678))
    found = outcomes(asked, lambda one: worst if one.variant.coupling == "zoh" else known(buzz_N2=0.002))
    console = Console(width=width, record=True, file=io.StringIO())
    shown = tables.tables(asked, compare.groups(asked, found), width)
    for table in shown:
        console.print(table)
    text = console.export_text()
    assert max(map(len, text.splitlines())) <= width
    assert [table.title for table in shown] == [
        "near: delay 1ms", "far: up delay 20ms 5ms loss 5%; down delay 30ms",
    ]  # fmt: skip
    pspm, zoh = (next(line for line in text.splitlines() if name in line) for name in ("pspm", "zoh"))
    assert "12/12" in pspm
    assert "–" in pspm
    assert "0/12" in zoh
    assert "…" not in text  # nothing is cut


def test_every_metric_is_defined_on_demand(capsys: Capture) -> None:
    assert cli.main(["compare", "--metrics"]) == 0
    words = " ".join(capsys.readouterr().out.split())
    assert all(metric.unit in words for metric in METRICS.values())


@pytest.mark.slow
def test_what_is_written(tmp_path: Path, capsys: Capture) -> None:
    """One object, the same but for the wall clock on standard output and in its file, and two figures."""
    out = tmp_path / "out"
    asked = ("compare", "--link", "lan", "--link", "slow=delay 30ms|delay 5ms", *QUICKLY, "--out", str(out))
    assert cli.main([*asked, "--json", "-"]) == 0
    whole = json.loads(capsys.readouterr().out)
    assert whole == json.loads((out / "compare.json").read_text("utf-8"))
    written = {"compare.json", "compare.csv", "compare.md", "traces.png", "tradeoff.png"}
    assert {file.name for file in out.iterdir()} == {*written, "journal.sqlite", "lock"}
    assert all((out / name).read_bytes().startswith(b"\x89PNG") for name in ("traces.png", "tradeoff.png"))
    couplings = whole["settings"]["couplings"]
    assert {"pspm", "zoh"} <= set(couplings)
    assert whole["settings"]["links"]["slow"] == {"up": "delay 30ms", "down": "delay 5ms"}
    assert len(whole["cases"]) == 2 * len(couplings) + 2  # of the local wall, once for each link
    assert list(whole["cases"][0]["measures"]) == list(METRICS)
    assert whole["metrics"]["margin_J"]["unit"] == "J"
    K = 600.0  # by the rule: 2 b/T, with b = 0.3 Ns/m and T = 1 ms
    assert whole["tunings"]["pspm"]["slow"]["device.stiffness"] == K
    assert whole["tunings"]["pspm"]["slow"]["ideal_stiffness_N_per_m"] == pytest.approx(K * 3000.0 / 3500.0)
    again: dict[str, Any] = {}
    assert cli.main([*asked, "--no-files", "--json", str(tmp_path / "again.json")]) == 0
    again |= json.loads((tmp_path / "again.json").read_text("utf-8"))
    again["wall_clock"] = whole["wall_clock"]
    assert again == whole


def test_the_same_command_goes_on_and_another_is_refused(
    here: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    """Cases with a result are not run again; those that failed are."""
    ran: list[str] = []

    def pretended(params: Params, seed: int) -> Measures:
        ran.append(params.coupling)
        if len(ran) == 2:
            raise HapnetError("this time")
        if len(ran) == 5:
            raise KeyboardInterrupt
        return known()

    monkeypatch.setattr(task, "measure", pretended)
    monkeypatch.setattr(command, "_write", lambda *given: [])
    out = tmp_path / "out"
    asked = (
        "compare",
        "--link",
        "lan",
        "--coupling",
        "zoh,eba,pd,popc",
        "--deadband",
        "0",
        *QUICKLY,
        "--out",
        str(out),
    )
    assert cli.main([*asked]) == 130
    reported = without_progress(capsys.readouterr().err)
    assert reported == f"hapnet: stopped: 4 of 5 cases are done; with --out {out} the same command continues\n"
    assert cli.main([*asked]) == 0
    assert "5 cases, 3 of them from an earlier run, in " in capsys.readouterr().out
    assert len(ran) == 7
    assert cli.main([*asked, "--seeds", "0:2"]) == 2
    assert "is of another spec: 5 cases are new, 0 are gone, 5 are the same" in capsys.readouterr().err
    assert cli.main([*asked, "--seeds", "0:2", "--fresh"]) == 0
    assert len(ran) == 17


def test_a_journal_from_before_a_metric_is_gone_on_with(
    here: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of the cases that were run before the metric is not known."""
    before = {name: value for name, value in known().items() if name not in ("buzz_N2", "energy_out_J")}
    monkeypatch.setattr(task, "measure", lambda params, seed: before)
    asked = ("compare", "--link", "lan", "--coupling", "zoh,eba", *QUICKLY, "--out", str(tmp_path))
    assert cli.main([*asked]) == 0
    whole = json.loads((tmp_path / "compare.json").read_text("utf-8"))
    assert list(whole["cases"][0]["measures"]) == list(METRICS)
    assert whole["cases"][0]["measures"]["buzz_N2"] is None


def test_a_recorded_link_is_one_more() -> None:
    trace = DATA / "links" / "ATT-LTE-driving-2016"
    links = plans.links_of(list(QUICK.links), [f"lte={trace}", "other name/x y"])
    assert list(links) == [*QUICK.links, "lte", "x y"]
    assert links["lte"] == (f"trace {trace}.up", f"trace {trace}.down")
    assert links["x y"] == ('trace "other name/x y.up"', 'trace "other name/x y.down"')
    assert links["intercontinental"] == ("wan-intercontinental", "wan-intercontinental")


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        (("--link", "nowhere"), "nowhere"),
        (("--link", "x=dealy 3ms"), "dealy"),
        (("--link", "x=delay 3ms|loss 200%"), "200%"),
        (("--link", "lan", "--link", "lan"), "lan"),
        (("--trace", "no/such"), "no/such.up"),
        (("--operator", "nobody"), "nobody"),
        (("--operator", "press@heavy"), "press@heavy"),
        (("--coupling", "glue"), "glue"),
        (("--coupling", "pspm:rendering=nice"), "nice"),
        (("--coupling", "pspm:fell=paper"), "fell"),
        (("--coupling", "pspm:link.up=lan"), "--link"),
        (("--operator", "press:link.up=lan"), "--link"),
        (("--operator", "press:dof=1:dof=2"), "--operator"),
        (("--coupling", "pspm:world.mass=1", "--operator", "press:world.mass=2"), "--coupling sets world.mass"),
        (("--bench", "slow"), "quick, full, or of its sections hands, minutes"),
        (("--bench", "full", "--case", "4g"), "--case"),
        (("--seeds", "3"), "3"),
        (("--deadband", "ten"), "ten"),
        (("--deadband", "1.5"), "1.5"),
        (("--case", "lan,press,9"), "lan,press,9"),
        (("--duration", "0"), "--duration"),
        (("--set", "world.mass=heavy"), "world.mass"),
    ],
)
def test_what_makes_no_comparison_is_one_line(flags: tuple[str, ...], said: str, capsys: Capture) -> None:
    assert cli.main(["compare", *flags]) == 2
    out, err = capsys.readouterr()
    assert not out
    assert len(err.splitlines()) == 1
    assert said in err


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch) -> None:
    """The command's cases run in this process."""
    monkeypatch.setattr(backend, "local_workers", lambda count: ThisProcess())


def test_nothing_but_failures_is_an_error(here: None, monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> None:
    def fails(params: Params, seed: int) -> Measures:
        raise HapnetError("no way")

    monkeypatch.setattr(task, "measure", fails)
    assert cli.main(["compare", *QUICKLY, "--no-files"]) == 2
    assert "no way" in capsys.readouterr().err


def test_a_claim_that_was_not_kept_ends_with_4(here: None, monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> None:
    def measured(params: Params, seed: int) -> Measures:
        return known(margin_J=-0.1, claim_kept=float(params.coupling == "zoh"))

    monkeypatch.setattr(task, "measure", measured)
    words = ["compare", "--link", "lan", *QUICKLY, "--no-files"]
    assert cli.main([*words, "--coupling", "zoh"]) == 0
    assert cli.main([*words, "--coupling", "pspm,zoh"]) == 4
    assert "pspm over lan, press, seed 0: the coupling claims to be passive, and was not" in capsys.readouterr().err


def test_the_case_that_is_drawn() -> None:
    asked = plan()
    default = plans.drawn_case(asked, None)
    assert (default.link, default.operator, default.seed) == ("far", "sine@light", 0)  # the slowest
    chosen = plans.drawn_case(asked, "near, press, 1")
    assert (chosen.link, chosen.operator, chosen.seed) == ("near", "press", 1)
    assert chosen.variant == Variant("pspm")


# -- a process -------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_ctrl_c_ends_it_and_its_workers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with started("compare", "--workers", "2", "--duration", "1000", "--seeds", "0:1") as program:
        pid = program.process.pid
        children = Path(f"/proc/{pid}/task/{pid}/children")
        program.until("a tracker and two workers", lambda: len(children.read_text("ascii").split()) == 3)
        program.until_line("comparing")
        os.killpg(pid, signal.SIGINT)
        code, _, err = program.end()
        assert code == 130
        assert re.fullmatch(
            r"hapnet: stopped: 0 of 37 .* with --out runs/\S+-compare the same command continues\n", err
        )
        program.until_gone()


@pytest.mark.slow
def test_pspm_is_passive_in_the_whole_default_set(tmp_path: Path) -> None:
    asked = Plan(plans.BASE, ("pspm",), plans.links_of(QUICK.links, ()), QUICK.operators, (0, 1, 2))
    for one in compared(asked, tmp_path, local_workers(usable_cores())):
        assert one.error is None
        margins = [one.measures[name] for name in ("margin_J", "hand_margin_J", "actuator_margin_J")]
        assert all(margin is not None and margin > 0.0 for margin in margins), one.case
