"""`hapnet play` whose processes are killed or ended at any time: a verdict and a summary all the same.

By hand, 30 random times for each process and each signal, with a line for each on how it ended:
``pytest -n 3 --dist load -rP -m soak tests/faults/test_ended_play.py``.
"""

from __future__ import annotations

import os
import random
import re
import signal
from pathlib import Path

import pytest

from tests.faults import test_ended_runs
from tests.faults.support import let_pass
from tests.support.processes import read_json, started, until

VERDICTS = r"\d+: .*, \d+ s: (passive|NOT passive|passivity not known): "
WHO = ("launcher", "device", "world", "servo", "standby")
SIDES = ("device", "world")
SIGNALS = (signal.SIGKILL, signal.SIGTERM)
CASES = [(who, number) for who in WHO for number in SIGNALS]
LIMIT_S = 180.0


def number_of(who: str, launcher: int) -> int | None:
    """The process's; None: it is not there, nor, for the launcher, both sides."""
    return test_ended_runs.number_of("hapnet.commands.standby" if who == "standby" else who, launcher)


def ended(who: str, number: signal.Signals, after_s: float, folder: Path) -> None:
    """A play one of whose processes gets this signal so long after it is there [s]."""
    file, more = folder / "summary.json", ("--realtime",) if who == "servo" else ()
    with started("play", "--no-browser", "--port", 0, *more, "--json", file, "--out", folder / "left") as program:
        launcher = program.process.pid
        program.until("the process", lambda: number_of(who, launcher) is not None, LIMIT_S)
        let_pass(after_s)
        if (pid := number_of(who, launcher)) is None:
            pytest.skip("it has ended")
        sides = [number_of(side, launcher) for side in SIDES]
        os.kill(pid, number)
        if who == "standby":  # the pair goes on without
            let_pass(1.0)
            assert program.process.poll() is None
            os.kill(launcher, signal.SIGTERM)
        code, stdout, stderr = program.end(LIMIT_S)
        program.until_gone(LIMIT_S)
        until(lambda: not any(side and Path(f"/proc/{side}").exists() for side in sides), LIMIT_S)  # own groups
    assert "Traceback" not in stderr
    when = f"{who:8} {number.name} {after_s:.2f} s after it was there: code {code:4}"
    if who == "launcher" and number == signal.SIGKILL:
        assert_sides_left_theirs(code, folder / "left", when)
        return
    if who in ("launcher", "standby"):
        assert (code, stderr) == (143, "")
    else:
        process = "the servo's process" if who == "servo" else f"the {who} process"
        assert code == 2
        assert re.search(f"^hapnet: {process} .*{number.name}$", stderr, re.MULTILINE), stderr
    summary = read_json(file)
    said = [line for line in stdout.splitlines() if re.match(VERDICTS, line)]
    assert len(said) == 1, stdout
    assert said[0].endswith(f": {summary['verdict']['reason']}")
    assert "tracking error" in stdout
    whole = all(summary[side] is not None and summary[side]["ledger"]["margin_J"] is not None for side in SIDES)
    if number == signal.SIGKILL and who in SIDES:
        assert summary["verdict"]["passive"] is None
        assert re.search(f"the (rest of the )?{who}'s account is |there is no energy account", said[0])
    elif whole and code == 2:
        assert f"the {'device' if who == 'servo' else who} ended before its time" in said[0]
    print(f"{when}, {said[0]}")


def assert_sides_left_theirs(code: int, folder: Path, when: str) -> None:
    """A launcher that is killed can say nothing: each side that had begun leaves its summary, with the verdict."""
    assert code == -signal.SIGKILL
    left = sorted(folder.glob("*-summary.json")) if folder.exists() else []
    for file in left:
        summary = read_json(file)
        assert summary["verdict"]["passive"] is not False
        assert "hapnet play, which had started it, was killed" in summary["verdict"]["reason"]
        if summary["verdict"]["passive"]:
            assert summary[file.name.partition("-")[0]]["ledger"]["margin_J"] > 0.0
    print(f"{when}, {[read_json(file)['verdict']['reason'] for file in left]}")


@pytest.mark.slow
@pytest.mark.parametrize(("who", "number"), [(who, number) for who, number in CASES if who in SIDES])
def test_a_side_that_ends_leaves_a_verdict_and_a_summary(who: str, number: signal.Signals, tmp_path: Path) -> None:
    ended(who, number, 3.0, tmp_path)


@pytest.mark.soak
@pytest.mark.parametrize(("who", "number"), CASES)
@pytest.mark.parametrize("seed", range(30))
def test_at_thirty_random_times(who: str, number: signal.Signals, seed: int, tmp_path: Path) -> None:
    ended(who, number, random.Random(f"{who} {number} {seed}").uniform(0.0, 12.0), tmp_path)
