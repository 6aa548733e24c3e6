"""The table of causes: each row has a run that shows it, with its verdict, its sentence and its exit code."""

import re
from pathlib import Path
from typing import Any

import pytest

from hapnet.commands.output import Written
from hapnet.params import Params
from hapnet.summary.causes import CAUSES
from hapnet.summary.verdict import findings, incomplete, judge
from tests.conftest import ROOT
from tests.summary.test_verdict import FLOW, but

NO_MARGIN = {"theorem.margin_J": None}
FAST = {"speed_max_mps": 1.2, "speed_limit_mps": 1.0}
STOPPED = {"after_s": 2.5, "why": "it is hot", "asked": False}

CASES: dict[str, tuple[dict[str, Any], str]] = {
    "diverged": ({"theorem.diverged": True}, "the run diverged: its energy account is no longer finite"),
    "bound": (
        {"theorem.margin_J": -0.0125},
        "gave out 112.5 mJ, more than the 100 mJ allowed",
    ),
    "margin": ({"theorem": {"margin_J": -0.0125}}, "the margin fell to -12.5 mJ"),
    "half": ({"world.ledger.margin_J": -0.003}, "the margin of the world's half fell to -3 mJ"),
    "slack": (
        {"device.ledger": {"margin_J": 0.05, "slack_J": -0.004}},
        "the device's half of the theorem fails by 4 mJ",
    ),
    "true positions": (
        {"device.true_slack_J": -0.004},
        "with the true positions the device's half of the theorem fails by 4 mJ",
    ),
    "hand": ({"hand": {"work_J": 9.0, "margin_J": -0.15}}, "the margin at the hand and the walls fell to -150 mJ"),
    "never sent": (
        {"energy.down": FLOW | {"credited_nJ": 10_466_000_010}},
        "the device credited 10466 mJ that the world never sent",
    ),
    "torn": ({"torn": ["device"]}, "the device's recording is incomplete: the rest of its account is missing"),
    "peer lost": (
        {"peer_report": {"side": "world", "as_of_s": 4.25, "final": False, "whole": False}},
        "the rest of the world's account is missing since its last report, 4.2 s after pairing",
    ),
    "no reading": (
        {**NO_MARGIN, "device.ledger": {}, "device.driver": {"name": "mine:Handle", "missed": 900}},
        "the device's account is missing: mine:Handle gave no reading",
    ),
    "account": (
        {**NO_MARGIN, "device": None},
        "the device's account is missing; the world's half held and gave out at most 0 mJ of its 50 mJ",
    ),
    "accounts": (
        {**NO_MARGIN, "device": None, "world": None},
        "there is no energy account",
    ),
    "joint account": (
        {**NO_MARGIN, "device": None, "coupling": "wave"},
        "this coupling is passive only at both ports together, and the device's account is missing",
    ),
    "not at once": (
        {**NO_MARGIN, "coupling": "wave"},
        "this coupling is passive only at both ports together, and no clock covers both",
    ),
    "no fit": (NO_MARGIN, "the accounts of the two sides do not match"),
    "restart": (
        {**NO_MARGIN, "world.incarnations": 2},
        "the account of an earlier device is not known",
    ),
    "former": (
        {"world.incarnations": 2, "world.former": {"count": 1, "whole": 0, "margin_J": 0.0}},
        "the rest of the account of an earlier device is missing since its last report",
    ),
    "early": ({"energy.down": FLOW | {"early_J": 0.002}}, "the device credited 2 mJ before the world sent it"),
    "contradiction": (
        {"device.contradictions": {"senders": 3}},
        "another sender used the world's name: 3 of its energy messages cannot all be of one sender",
    ),
    "deficit": ({"world.deficit_max_J": 0.001}, "the world gave out 1 mJ that its reservoir did not have"),
    "dead stream": (
        {"world.unanswered_s": 55.25},
        "the world's energy stream is dead: no acknowledgement for 55.2 s",
    ),
    "stopped": ({"device.stopped": STOPPED}, "the device's force was stopped after 2.5 s: it is hot"),
    "leak": (
        {"device.overrun_leak_J": 0.0058, "device.servo": {"overruns": 2, "longest_ms": 80.4}},
        "the servo stalled for longer than watchdog_s 2 times, for up to 80 ms: 5.8 mJ came out beyond the account",
    ),
    "risk": (
        {"device.overrun_risk_J": 0.11},
        "while the servo stalled, 110 mJ may have come out unseen, more than the margin",
    ),
    "speed": (
        {f"device.{name}": value for name, value in FAST.items()},
        "the device moved at 1.2 m/s, and declares at most 1 m/s",
    ),
    "repeats": (
        {**{f"device.{name}": value for name, value in FAST.items()}, "device.driver": {"reads_hz": 250.0}},
        "the device's speed is not known: its readings are new every 4 ms only, and jump at 1.2 m/s, more than the "
        "1 m/s that it declares; let it declare rate_hz = 250",
    ),
    "blur": (
        {"device.quantisation_J": 0.11},
        "the encoders are coarse: the account may be off by 110 mJ, over the margin of 100 mJ",
    ),
    "world failed": (
        {"world.failed": "no strength"},
        "the world failed, and its own account is not known: no strength",
    ),
    "world's account": (
        {"environment": {"env_diverged": True}},
        "the world's own account is not finite (stored_J or supplied_J): its energy is not known",
    ),
    "blocked": (
        {"device.driver": {"blocked": "read() of mine:Handle took 4.0 s"}},
        "the device's driver blocks: read() of mine:Handle took 4.0 s",
    ),
    "unproved": (
        {"device.peer": {"proof": "nobody"}},
        "the peer's identity is not proven: there was neither a secret nor a certificate",
    ),
}  # fmt: skip


def code_of(summary: dict[str, Any], capsys: pytest.CaptureFixture[str]) -> int:
    """The exit code of a run with this summary, as `hapnet run` makes it."""
    written = Written()
    written.judge(summary, Params(), virtual=False)
    written.missing += incomplete(summary)
    code = written.code()
    capsys.readouterr()
    return code


@pytest.mark.parametrize("cause", CAUSES)
def test_each_cause_gives_its_verdict_its_sentence_and_its_code(cause: str, capsys: pytest.CaptureFixture[str]) -> None:
    changes, sentence = CASES[cause]
    summary, row = but(changes), CAUSES[cause]
    shown = {one.cause: one.text for one in findings(summary)}
    assert shown[cause] == sentence
    assert judge(summary)["passive"] is row.passive
    if row.passive is False or not any(CAUSES[other].passive is False for other in shown):
        assert sentence in judge(summary)["reason"]
    ended = 0 if row.code == 2 else row.code  # of the process that failed
    assert code_of(summary, capsys) == ended


@pytest.mark.parametrize("cause", [cause for cause, row in CAUSES.items() if row.passive])
def test_what_changes_no_verdict_is_said_with_each(cause: str) -> None:
    changes, sentence = CASES[cause]
    for other, passive in (("slack", False), ("deficit", None)):
        verdict = judge(but({**CASES[other][0], **changes}))
        assert verdict["passive"] is passive
        assert CASES[other][1] in verdict["reason"]
        assert sentence in verdict["reason"]


def test_no_run_without_the_devices_account_ends_with_0(capsys: pytest.CaptureFixture[str]) -> None:
    """Whatever else is known of it, and whatever the coupling claims."""
    for coupling in ("pspm", "zoh", "wave"):
        for part in ({"device": None}, {"device.ledger": {}}, {"device": None, "world": None}):
            assert code_of(but({**NO_MARGIN, **part, "coupling": coupling}), capsys) == 3, (coupling, part)


def test_a_world_that_was_killed_did_not_fail() -> None:
    """Its recording is incomplete, which is the cause."""
    changes = {"torn": ["world"], "world.failed": "was killed by SIGKILL"}
    assert [one.cause for one in findings(but(changes))] == ["torn"]


@pytest.mark.parametrize("coupling", ["pspm", "zoh"])
def test_encoders_are_not_blamed_where_there_are_none(coupling: str) -> None:
    """Without a reservoir, the true slack below zero says nothing of encoders."""
    changes = {"coupling": coupling, "device.true_slack_J": -0.2, "device.quantisation_J": 0.0}
    assert not any(one.cause == "blur" for one in findings(but(changes)))


def test_the_page_has_each_row_of_the_table_and_no_other() -> None:
    page = (ROOT / "hapnet" / "summary" / "README.md").read_text("utf-8")
    table = page.partition("| cause | verdict | exit code | sentence |\n|---|---|---|---|\n")[2].partition("\n\n")[0]
    rows = [re.split(r" *\| *", line.strip("| ")) for line in table.splitlines()]
    words = {False: "*NOT PASSIVE*", None: "*NOT KNOWN*", True: "any"}
    assert rows == [[name, words[row.passive], str(row.code), row.sentence] for name, row in CAUSES.items()]


def test_each_row_has_a_case() -> None:
    assert set(CASES) == set(CAUSES)
    assert Path(__file__).name in (ROOT / "hapnet" / "summary" / "causes.py").read_text("utf-8")
