"""`hapnet run` whose processes are killed, ended or stopped at any time: verdict, summary and report all the same."""

from __future__ import annotations

import os
import random
import signal
from pathlib import Path

import pytest

from hapnet.recording.mcap import read_recording
from tests.faults.support import let_pass
from tests.processes import child_of, read_json, size, started

VERDICTS = ("passive: ", "NOT passive: ", "passivity not known: ")
WHO = ("launcher", "device", "world")
SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGSTOP)


def ended(who: str, number: signal.Signals, after_s: float, out: Path) -> None:
    """A run of 4 s, one of whose processes gets this signal so long after both have begun to record."""
    with started("run", "--duration", 4, "--out", out) as program:
        recordings = [out / f"{side}.mcap" for side in ("device", "world")]
        program.until("samples on disk", lambda: all(size(file) > 2_000 for file in recordings))
        let_pass(after_s)
        launcher = program.process.pid
        pid = launcher if who == "launcher" else child_of(launcher, who)
        os.kill(pid, number)
        if number == signal.SIGSTOP and who == "launcher":  # whoever stops it continues it
            let_pass(2.0)
            os.kill(pid, signal.SIGCONT)
        code, stdout, stderr = program.end()
        program.until_gone()
    if (who, number) == ("launcher", signal.SIGKILL):
        for file in recordings:
            assert not read_recording(file).torn
        with started("report", out, "--json", out / "summary.json") as program:
            code, stdout, stderr = program.end()
        assert (code, stderr) == (0, "")
        page = "device-world.html"
    else:
        expected = {"launcher": {signal.SIGTERM: 143, signal.SIGSTOP: 0}}.get(who, {}).get(number, 2)
        assert code == expected, stdout + stderr
        if code == 2:
            how = {signal.SIGKILL: "was killed by SIGKILL", signal.SIGTERM: "was ended by SIGTERM"}
            said = how.get(number, "was stopped by a signal, and did not go on")
            assert stderr.endswith(f"hapnet: the {who} process {said}\n")
        page = "report.html"
    assert any(line.startswith(VERDICTS) for line in stdout.splitlines()), stdout
    verdict = read_json(out / "summary.json")["verdict"]
    torn = who != "launcher" and number == signal.SIGKILL
    if torn:
        assert verdict["passive"] is not True
        assert f"the {who}'s recording is torn" in verdict["reason"]
    assert (out / page).stat().st_size > 10_000
    assert [read_recording(file).torn for file in recordings] == [torn and who == side for side in WHO[1:]]


CASES = [(who, number) for who in WHO for number in SIGNALS]


@pytest.mark.slow
@pytest.mark.parametrize(("who", "number"), CASES)
def test_whatever_ends_a_run_there_is_a_verdict(who: str, number: signal.Signals, tmp_path: Path) -> None:
    ended(who, number, random.Random(f"{who} {number}").uniform(0.0, 2.5), tmp_path / "run")


@pytest.mark.soak
@pytest.mark.parametrize("seed", range(30))
def test_at_thirty_random_times(seed: int, tmp_path: Path) -> None:
    rng = random.Random(seed)
    ended(*CASES[seed % len(CASES)], rng.uniform(0.0, 2.5), tmp_path / "run")
