"""`hapnet run` whose processes are killed, ended or stopped at any time: verdict, summary and report all the same.

By hand, 30 random times for each process and each signal, with a line for each on how it ended:
``pytest -n 4 --dist load -rP -m soak tests/faults/test_ended_runs.py``.
"""

from __future__ import annotations

import os
import random
import re
import signal
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import pytest

from hapnet.recording.mcap import read_recording
from hapnet.summary.words import headline
from tests.faults.support import let_pass
from tests.support.processes import Program, child_of, read_json, size, started

VERDICTS = ("PASSIVE: ", "NOT PASSIVE: ", "PASSIVITY NOT KNOWN: ")
WHO = ("launcher", "device", "world", "servo")
SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGSTOP)
DURATION_S = 2.5
LIMIT_S = 180.0
"""How long a run may take on a machine that does much else."""

HOW = {
    signal.SIGKILL: "was killed by SIGKILL",
    signal.SIGTERM: "was ended by SIGTERM",
    signal.SIGSTOP: "was stopped by a signal, and not continued",
}


class Moment(NamedTuple):
    """So long [s] after the process was `there`, after both sides were `recording`, or after both had `ended`."""

    since: str
    after_s: float

    @classmethod
    def drawn(cls, rng: random.Random, who: str) -> Moment:
        since = rng.choices(["there", "recording", "ended"], [2, 7, 1 if who == "launcher" else 0])[0]
        return cls(since, rng.uniform(0.0, {"there": 1.5, "recording": DURATION_S, "ended": 0.7}[since]))


def number_of(who: str, launcher: int) -> int | None:
    """The process's; None: it is not there, nor, for the launcher, both sides."""
    with suppress(AssertionError, FileNotFoundError):
        match who:
            case "launcher":
                child_of(launcher, "device"), child_of(launcher, "world")
                return launcher
            case "servo":
                return child_of(child_of(launcher, "device"), "hapnet.realtime.servo_child")
            case _:
                return child_of(launcher, who)
    return None


def at(moment: Moment, program: Program, who: str, recordings: list[Path]) -> int | None:
    """Wait until then; returns the number of the process. None: it has ended by then."""
    launcher = program.process.pid
    program.until("the process", lambda: number_of(who, launcher) is not None)
    if moment.since != "there":
        program.until("samples on disk", lambda: all(size(file) > 2_000 for file in recordings))
    if moment.since == "ended":
        program.until("the end of both sides", lambda: not any(number_of(side, launcher) for side in WHO[1:3]))
    let_pass(moment.after_s)
    return launcher if who == "launcher" else number_of(who, launcher)


def ended(who: str, number: signal.Signals, moment: Moment, out: Path) -> None:
    """A run one of whose processes gets this signal at that moment."""
    more = ("--realtime",) if who == "servo" else ()
    with started("run", "--duration", DURATION_S, *more, "--out", out) as program:
        recordings = [out / f"{side}.mcap" for side in ("device", "world")]
        pid = at(moment, program, who, recordings)
        if pid is None:
            pytest.skip("it ended before")
        os.kill(pid, number)
        if number == signal.SIGSTOP and who == "launcher":  # whoever stops it continues it
            let_pass(2.0)
            os.kill(pid, signal.SIGCONT)
        code, stdout, stderr = program.end(LIMIT_S)
        program.until_gone()
    killed = number == signal.SIGKILL
    there = [file for file in recordings if file.exists()]
    page = "report.html"
    if who == "launcher" and killed:
        assert not any(read_recording(file).torn for file in there)
        with started("report", out, "--json", out / "summary.json") as program:
            code, stdout, stderr = program.end()
        page = f"{'-'.join(file.stem for file in there)}.html"
        if not there:  # nothing was recorded yet
            assert (code, stdout) == (2, "")
            assert "allowed: a recording, or a directory with run.mcap, device.mcap or world.mcap" in stderr
            return
        assert (code, stderr) == (0, "")
        young = moment.since != "ended" and moment.after_s < DURATION_S - 1.0
        assert not young or "hapnet run, which had started it, was killed" in stdout
    elif who == "launcher":
        assert (code, stderr) == (143 if number == signal.SIGTERM else 0, "")
    elif code == 0:  # it was woken at the end of the run, or its own end came first
        assert who == "servo" or moment.after_s > DURATION_S - 1.0
    else:
        assert code == 2, stdout + stderr
        process = "the servo's process" if who == "servo" else f"the {who} process"
        early = "did not start: it " if who == "servo" and "did not start" in stderr else ""
        how = HOW[number] if moment.since != "there" else f"{HOW[number]}|was killed by {number.name}"
        assert re.search(f"^hapnet: {process} {early}({how})$", stderr, re.MULTILINE), stderr
    verdict = read_json(out / "summary.json")["verdict"]
    said = next(line for line in stdout.splitlines() if line.startswith(VERDICTS))
    assert said == headline(read_json(out / "summary.json"))[0]
    assert all((out / page).stat().st_size > 10_000 for file in there)
    if code == 2 and verdict["passive"] is not None:
        assert f"the {'device' if who == 'servo' else who} ended before its time: " in verdict["reason"]
    torn = [file.stem for file in there if read_recording(file).torn]
    assert torn == ([who] if killed and out / f"{who}.mcap" in there else [])
    if torn:
        assert verdict["passive"] is not True
        assert re.search(f"the {who}'s (recording is incomplete|account is missing)", verdict["reason"])
    when = f"{who:8} {number.name} {moment.after_s:.2f} s after {moment.since:9}"
    print(f"{when}: code {code:3}, {len(there)} recordings, {verdict['passive']}: {verdict['reason']}")


CASES = [(who, number) for who in WHO for number in SIGNALS]
OFTEN = [
    ("launcher", signal.SIGKILL), ("world", signal.SIGKILL), ("device", signal.SIGTERM), ("servo", signal.SIGSTOP),
]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(("who", "number"), OFTEN)
def test_whatever_ends_a_run_there_is_a_verdict(who: str, number: signal.Signals, tmp_path: Path) -> None:
    rng = random.Random(f"{who} {number}")
    ended(who, number, Moment("recording", rng.uniform(0.0, DURATION_S - 1.0)), tmp_path / "run")


@pytest.mark.soak
@pytest.mark.parametrize(("who", "number"), CASES)
@pytest.mark.parametrize("seed", range(30))
def test_at_thirty_random_times(who: str, number: signal.Signals, seed: int, tmp_path: Path) -> None:
    ended(who, number, Moment.drawn(random.Random(f"{who} {number} {seed}"), who), tmp_path / "run")
