"""A batch gives what `simulate` gives one at a time."""

import json
from pathlib import Path

import numpy as np
import pytest

from hapnet import HapnetError, InvalidParameter, Params, cli, simulate, simulate_batch
from hapnet.simulation.batch import BatchRun
from tests.conftest import mostly_slow
from tests.support.kernel_edges import LIVELY
from tests.support.paper import PAPER

SEEDS = range(6)


def check(run: BatchRun) -> None:
    """It is what `simulate` gives, with the state of both sides at the end."""
    result = simulate(run.params, run.seed)
    assert run.summary == result.summary
    mass = result.world.mass
    for side, found, (x, v) in (
        (result.device, run.device, result.device.device.read()),
        (result.world, run.world, (mass.position, mass.velocity)),
    ):
        modulator, ledger = side.coupling.modulator, side.coupling.ledger
        energies = modulator.energy, modulator.deficit, ledger.work, ledger.credited, ledger.sent
        assert found == (x, v, modulator.set_position, *energies)


@pytest.mark.parametrize(
    "changes",
    mostly_slow(
        [
            {},
            {**LIVELY, "link.up": "4g", "link.down": "lossy-wifi"},
            {"scene": "box"},
            {"link.up_timeline": "at 0.2s: down"},
        ],
        1,
    ),
    ids=str,
)
@pytest.mark.parametrize("servo", ["sampled", "continuous"])
def test_each_run_is_that_of_a_single_simulation(changes: dict[str, object], servo: str) -> None:
    runs = simulate_batch(Params().set({"duration_s": 0.8, "device.servo": servo, **changes}), [4, 2])
    assert [run.seed for run in runs] == [4, 2]
    for run in runs:
        check(run)


def test_the_summaries_are_whole() -> None:
    (run,) = simulate_batch(PAPER.set({"duration_s": 3.0, "operator": "press"}))
    turning = ("free_rms_rad", "contact_rms_rad", "peak_torque_Nm")
    assert [name for name, value in run.summary["motion"].items() if value is None] == list(turning)
    assert run.summary["path"]["round_trip_p50_ms"] is not None


def test_energy_flows_in_these_cases() -> None:
    runs = simulate_batch(PAPER.set({"duration_s": 2.0, **LIVELY}), SEEDS)
    assert all(run.summary["energy"][way]["credited_nJ"] > 1_000_000 for run in runs for way in ("up", "down"))
    assert all(run.summary["world"]["dropped"]["stale"] > 0 for run in runs)


def test_links_may_differ_within_a_batch() -> None:
    base = PAPER.set({"duration_s": 1.5, **LIVELY})
    several = [base.set({"link.up": words, "link.down": words}) for words in ("delay 35ms", "delay 5ms 5ms", "loss 5%")]
    runs = simulate_batch(several, range(3))
    assert [(run.params.link.up, run.seed) for run in runs] == [(p.link.up, s) for p in several for s in range(3)]
    for run in runs:
        check(run)


def test_runs_that_end_before_the_handshake_are_right_too() -> None:
    runs = simulate_batch(PAPER.set({"duration_s": 0.07}), range(20))
    for run in runs:
        check(run)


@pytest.mark.slow
def test_processes_share_the_work() -> None:
    params = PAPER.set({"duration_s": 0.3})
    reported: list[float] = []
    alone = simulate_batch(params, range(20), progress=reported.append)
    shared = simulate_batch(params, range(20), workers=2)
    # another test may have compiled the kernel meanwhile: the runs are the same to the bit, whoever made them
    assert [run._replace(not_compiled=None) for run in shared] == [run._replace(not_compiled=None) for run in alone]
    assert reported == sorted(reported)
    assert reported[-1] == 1.0


def test_nothing_is_refused_in_silence() -> None:
    with pytest.raises(InvalidParameter, match="workers"):
        simulate_batch(workers=0)
    with pytest.raises(HapnetError, match=r"seed 3: .*did not find each other"):
        simulate_batch(PAPER.set({"link.up": "loss 100%"}), [3])
    with pytest.raises(HapnetError, match="duration"):
        simulate_batch(PAPER.set({"duration_s": 0.0}))
    assert simulate_batch(PAPER, []) == []


def test_the_command_prints_one_table_and_one_object_a_seed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "batch.json"
    assert (
        cli.main(["simulate", "--rendering", "paper", "--seeds", "3:13", "--duration", "0.3", "--json", str(file)]) == 0
    )
    out = capsys.readouterr().out
    assert "came out of both ports, most" in out
    assert "credited down [mJ]" in out
    assert "largest force [N]" in out
    assert "of 10 scenarios 10 were passive, 0 were not" in out
    runs = json.loads(file.read_text("utf-8"))
    assert [run["seed"] for run in runs] == list(range(3, 13))
    assert all(np.isfinite(run["final"]["device"]["position_m"][0]) for run in runs)


NO_OUT = {
    "--seeds": "--seeds writes no files; leave --out out, or use --json FILE",
    "--no-files": "--no-files writes no files; leave one of the two out",
}


@pytest.mark.parametrize("words", ["5", "7:7", "9:2", "a:b", "-1:3"])
def test_seeds_are_a_range(words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["simulate", f"--seeds={words}"]) == 2
    assert "--seeds" in capsys.readouterr().err


@pytest.mark.parametrize("words", ["simulate --seeds 0:2", "simulate --no-files", "run --no-files"])
def test_what_writes_no_files_takes_no_directory(
    words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command, flag, *more = words.split()
    assert cli.main([command, flag, *more, "--out", str(tmp_path / "runs")]) == 2
    assert capsys.readouterr().err == f"hapnet: --out {tmp_path}/runs: {NO_OUT[flag]}\n"
    assert list(tmp_path.iterdir()) == []
