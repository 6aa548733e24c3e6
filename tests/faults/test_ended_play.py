"""`hapnet play` whose processes are killed or ended at any time of its life: a verdict and a summary all the same.

By hand, 30 random times for each process and each signal, with a line for each on how it ended:
``pytest -n 3 --dist load -rP -m soak tests/faults/test_ended_play.py``.
"""

from __future__ import annotations

import os
import random
import re
import signal
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

import pytest

from hapnet.ext.page.watcher import Watcher
from hapnet.recording.telemetry import Status, Telemetry
from hapnet.summary.words import headline
from hapnet.transport.config import ZenohSettings
from tests.conftest import mostly_slow
from tests.faults import test_ended_runs
from tests.faults.support import let_pass
from tests.support.processes import Program, read_json, started, until

VERDICTS = r"\d+: .*, \d+ s: (PASSIVE|NOT PASSIVE|PASSIVITY NOT KNOWN): "
WHO = ("launcher", "device", "world", "servo", "standby")
SIDES = ("device", "world")
SIGNALS = (signal.SIGKILL, signal.SIGTERM)
CASES = [(who, number) for who in WHO for number in SIGNALS]
LIMIT_S = 180.0
KNOWN_S = 1.0
"""So long after pairing a side's account is there, on a busy machine too."""


class Moment(NamedTuple):
    """So long [s] after the process was `there`, after the sides were `paired`, or after the play was told to end
    (`ending`)."""

    since: str
    after_s: float

    @classmethod
    def drawn(cls, rng: random.Random) -> Moment:
        since = rng.choices(["there", "paired", "ending"], [2, 7, 1])[0]
        return cls(since, rng.uniform(0.0, {"there": 2.0, "paired": 5.0, "ending": 1.0}[since]))


def number_of(who: str, launcher: int) -> int | None:
    """The process's; None: it is not there, nor, for the launcher, both sides."""
    return test_ended_runs.number_of("hapnet.commands.standby" if who == "standby" else who, launcher)


def until_paired(program: Program) -> None:
    """Wait until both sides say that they are paired, to whoever watches them."""
    program.until_line("hapnet view -e ")
    address = next(found[1] for line in program.out if (found := re.search(r"hapnet view -e (\S+)`", line)))
    paired = set[str]()

    def take(message: Telemetry) -> None:
        if isinstance(message, Status) and message.paired:
            paired.add(message.role)

    watcher = Watcher(ZenohSettings(connect=(address,)), take)
    watcher.open()
    with closing(watcher):
        program.until("a pair", lambda: len(paired) == len(SIDES), LIMIT_S)


def ended(who: str, number: signal.Signals, moment: Moment, folder: Path) -> None:
    """A play one of whose processes gets this signal at that moment."""
    file, more = folder / "summary.json", ("--realtime",) if who == "servo" else ()
    with started("play", "--no-browser", "--port", 0, *more, "--json", file, "--out", folder / "left") as program:
        launcher = program.process.pid
        program.until("the process", lambda: number_of(who, launcher) is not None, LIMIT_S)
        if moment.since != "there":
            until_paired(program)
        sides = [number_of(side, launcher) for side in SIDES]
        if moment.since == "ending":
            let_pass(KNOWN_S)
            os.kill(launcher, signal.SIGTERM)
        let_pass(moment.after_s)
        pid = launcher if who == "launcher" else number_of(who, launcher)
        gone = pid is None or program.process.poll() is not None
        if pid is not None and not gone:
            os.kill(pid, number)
        if who == "standby" and moment.since != "ending":  # the pair goes on without
            let_pass(1.0)
            assert program.process.poll() is None
            os.kill(launcher, signal.SIGTERM)
        code, stdout, stderr = program.end(LIMIT_S)
        program.until_gone(LIMIT_S)
        until(lambda: not any(side and Path(f"/proc/{side}").exists() for side in sides), LIMIT_S)  # own groups
    assert "Traceback" not in stderr
    when = f"{who:8} {number.name} {moment.after_s:.2f} s after {moment.since:6}: code {code:4}"
    known = moment.since == "ending" or (moment.since == "paired" and moment.after_s > KNOWN_S)
    if who == "launcher" and number == signal.SIGKILL and not gone:
        assert_sides_left_theirs(code, folder / "left", when, moment.since, both=known and moment.since == "paired")
        return
    asked = moment.since == "ending" or who in ("launcher", "standby")
    if asked:
        assert (code, stderr) == (143, "")
    else:
        process = "the servo's process" if who == "servo" else f"the {who} process"
        early = "did not start: it " if who == "servo" and "did not start" in stderr else ""
        assert code == 2
        assert re.search(f"^hapnet: {process} {early}.*{number.name}$", stderr, re.MULTILINE), stderr
    summary = read_json(file)
    said = [line for line in stdout.splitlines() if re.match(VERDICTS, line)]
    assert len(said) == 1, stdout
    assert said[0].endswith(f": {headline(summary)[0]}")
    whole = all(summary[side] is not None and summary[side]["ledger"]["margin_J"] is not None for side in SIDES)
    killed = number == signal.SIGKILL and who in SIDES
    if killed and not asked:
        assert summary["verdict"]["passive"] is None
        assert re.search(f"the (rest of the )?{who}'s account is |there is no energy account", said[0])
    elif known and (number != signal.SIGKILL or who != "servo"):  # whose process has the device's account
        assert whole
        assert summary["verdict"]["passive"]
    if not killed and whole and code == 2:
        assert stdout.count(f"the {'device' if who == 'servo' else who} ended before its time") == 1
    print(f"{when}{' gone' if gone else ''}, {said[0]}")


def assert_sides_left_theirs(code: int, folder: Path, when: str, since: str, *, both: bool) -> None:
    """A launcher that is killed can say nothing: each side that had begun leaves its summary, with the verdict.

    both : both sides had.
    """
    assert code == -signal.SIGKILL
    left = sorted(folder.glob("*-summary.json")) if folder.exists() else []
    assert len(left) == len(SIDES) or not both
    for file in left:
        summary = read_json(file)
        assert summary["verdict"]["passive"] is not False
        if since != "ending":  # it may have ended in order before
            assert "hapnet play, which had started it, was killed" in summary["verdict"]["reason"]
        if summary["verdict"]["passive"]:
            assert summary[file.name.partition("-")[0]]["ledger"]["margin_J"] > 0.0
    print(f"{when}, {[read_json(file)['verdict']['reason'] for file in left]}")


@pytest.mark.slow
@pytest.mark.parametrize(("who", "number"), mostly_slow([("device", signal.SIGTERM), ("world", signal.SIGKILL)], 0, 1))
def test_a_side_that_ends_leaves_a_verdict_and_a_summary(who: str, number: signal.Signals, tmp_path: Path) -> None:
    ended(who, number, Moment("paired", 2.0), tmp_path)


@pytest.mark.soak
@pytest.mark.parametrize(("who", "number"), CASES)
@pytest.mark.parametrize("seed", range(30))
def test_at_thirty_random_times(who: str, number: signal.Signals, seed: int, tmp_path: Path) -> None:
    ended(who, number, Moment.drawn(random.Random(f"{who} {number} {seed}")), tmp_path)
