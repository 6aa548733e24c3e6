"""`hapnet run` beside busy loops: the bound holds, and nothing that is known is reported as not known.

By hand, with a line for each run, 45 minutes: ``pytest -n 0 -s -m soak tests/faults/test_busy_machine.py``.
"""

import random
from pathlib import Path
from typing import Any

import pytest

from hapnet.processes.child import busy
from netem.presets import PRESETS
from tests.support.processes import read_json, started

LOOPS = 4
SCENES = ("wall", "box", "free", "paper", "moving", "sphere", "cuboid", "cylinder + plane")
OPERATORS = ("press", "sine", "rest", *(f"hand-{number}" for number in range(1, 9)))


def ran(what: str, out: Path, *argv: object) -> dict[str, Any]:
    """The summary of a run, with a line on what is known of it."""
    with started("run", *argv, "--out", out) as program:
        limit_s = 240.0 + 2.0 * float(str(argv[argv.index("--duration") + 1]))
        code, stdout, stderr = program.end(limit_s)
    summary = read_json(out / "summary.json")
    device, theorem = summary["device"], summary["theorem"]
    servo = {name: device["servo"][name] for name in ("ticks", "late_p99_us", "skipped", "overruns", "longest_ms")}
    print(f"\n{what}: exit code {code}, margin {theorem['margin_J'] * 1e3:.2f} of {theorem['bound_J'] * 1e3:.0f} mJ, "
          f"slack {device['ledger']['slack_J']:.2e}, {summary['world']['ledger']['slack_J']:.2e} J, "
          f"leak {device['overrun_leak_J']} J, {servo}\n  {summary['verdict']['reason']}")  # fmt: skip
    assert code == 0, (stdout, stderr)
    return summary


@pytest.mark.parametrize(
    ("more", "duration_s"),
    [
        pytest.param(("--realtime",), 10.0, marks=pytest.mark.slow),
        *(pytest.param(*case, marks=pytest.mark.soak) for case in (((), 10.0), ((), 600.0), (("--realtime",), 600.0))),
    ],
)
def test_beside_four_busy_loops_no_run_is_below_the_bound(
    more: tuple[str, ...], duration_s: float, tmp_path: Path
) -> None:
    with busy(LOOPS):
        name = f"{duration_s:.0f} s over 4g, {more[0] if more else 'thread'}"
        summary = ran(name, tmp_path / "run", "--duration", duration_s, "--profile", "4g", *more)
    assert summary["theorem"]["margin_J"] > 0.0
    assert summary["hand"]["margin_J"] is None or summary["hand"]["margin_J"] > 0.0
    assert summary["verdict"]["passive"] is True


def ordinary(seed: int) -> list[object]:
    """A run as anybody may start it."""
    rng = random.Random(seed)
    words: list[object] = ["--duration", round(rng.uniform(5.0, 10.0), 1), "--seed", rng.randrange(10**6)]
    words += ["--profile", rng.choice(sorted(PRESETS)), "--scene", rng.choice(SCENES)]
    words += ["--operator", rng.choice(OPERATORS)]
    words += rng.choice([[], ["--realtime"]])
    words += rng.choice([[], [], ["--rendering", "paper"]])
    words += rng.choice([[], [], ["--deadband", 0.1]])
    words += rng.choice([[], [], ["--on-silence", "release"]])
    return words


@pytest.mark.parametrize(
    "seed", [pytest.param(seed, marks=pytest.mark.slow if seed < 1 else pytest.mark.soak) for seed in range(30)]
)
def test_of_an_ordinary_run_everything_is_known(seed: int, tmp_path: Path) -> None:
    argv = ordinary(seed)
    with busy(LOOPS):
        summary = ran(" ".join(map(str, argv)), tmp_path / "run", *argv)
    assert summary["verdict"]["passive"] is True
