"""Long runs: the accounts stay exact and memory flat. By hand: ``pytest -n 0 -s -m soak``."""

import json
import os
import time
from pathlib import Path

import numpy as np
import pytest

from hapnet.params import Params
from hapnet.side.device import Write
from hapnet.simulation.simulation import Simulation
from hapnet.summary.run import Summary
from tests.support.processes import assert_accounts_agree, child_of, read_json, resident_kB, started

WORST = {
    "link.up": "worst", "link.down": "worst", "operator": "sine", "operator_model.frequency_hz": 1.5,
    "device.damping": 2.0,
}  # fmt: skip
"""A hand that shakes, so that both sides harvest more than they keep, and energy flows all the time."""

REAL_S = 3600.0
VIRTUAL_S = 86_400.0
SETTLED_S = 300.0
"""Memory is compared from then on: code is loaded, buffers have their size."""

GROWTH_KB = 1_000
"""Memory grows by no more from then on, whatever it records: of a day it must be the same."""


def assert_exact(summary: Summary) -> None:
    assert_accounts_agree(summary)
    assert summary["theorem"]["margin_J"] > 0.0
    for way in ("up", "down"):
        flow = summary["energy"][way]
        assert (flow["in_flight_nJ"], flow["abandoned_nJ"]) == (0, 0)
        assert flow["credited_nJ"] == flow["sent_nJ"] > 0
    for side in ("device", "world"):
        assert summary[side]["ledger"]["slack_J"] >= -1e-9
        assert summary[side]["reservoir_min_J"] >= 0.0


class Unrecorded(Simulation):
    """A simulation that keeps no samples."""

    def _writer(self) -> Write:
        return lambda sample: None


def reported(what: str, summary: Summary, memory: dict[str, list[int]]) -> None:
    print(f"\n{what}: margin {summary['theorem']['margin_J']:.6f} J")
    for way in ("up", "down"):
        link = summary["links"][way]
        print(f"  {way}: {summary['energy'][way]}, {link['lost']} of {link['offered']} messages lost")
    for side in ("device", "world"):
        print(f"  {side}: slack {summary[side]['ledger']['slack_J']:.3e} J, outages {summary[side]['outages']}")
    for name, values in memory.items():
        print(f"  memory of {name} [kB]: {values[0]} at {SETTLED_S:.0f} s, {values[-1]} at the end, most {max(values)}")


@pytest.mark.soak
def test_a_day_in_virtual_time() -> None:
    simulation = Unrecorded(Params().set({**WORST, "duration_s": VIRTUAL_S}), seed=1)
    memory = []
    start_ns = simulation.pair()
    end_ns = start_ns + round(VIRTUAL_S * 1e9)
    for at_ns in range(start_ns + round(SETTLED_S * 1e9), end_ns, round(SETTLED_S * 1e9)):
        simulation._until(at_ns)
        memory.append(resident_kB(os.getpid()))
    simulation._until(end_ns)
    summary = simulation.close(end_ns)
    reported("a day in virtual time", summary, {"the process": memory})
    assert_exact(summary)
    assert memory[-1] - memory[0] < 2_000


@pytest.mark.soak
@pytest.mark.parametrize("link", ["worst", "4g"])
def test_an_hour_in_real_time(link: str, tmp_path: Path) -> None:
    """Recording, as `hapnet run` does."""
    changes = {**WORST, "link.up": link, "link.down": link}
    words = [word for name, value in changes.items() for word in ("--set", f"{name}={value}")]
    argv = ["run", "--duration", REAL_S, *words, "--verbose", "--out", tmp_path / "run"]
    memory: dict[str, list[int]] = {}
    with started(*argv, "--json", tmp_path / "s.json") as program:
        program.until_line("device: paired")
        began = time.monotonic()
        for at in np.arange(SETTLED_S, REAL_S, 60.0):
            time.sleep(max(0.0, began + at - time.monotonic()))
            for role in ("device", "world"):
                memory.setdefault(role, []).append(resident_kB(child_of(program.process.pid, role)))
        time.sleep(max(0.0, began + REAL_S - time.monotonic()))
        code, _, errors = program.end()
        assert code == 0, errors
    summary = read_json(tmp_path / "s.json")
    reported(f"an hour in real time over {link}", summary, memory)
    print(f"  servo: {json.dumps({k: v for k, v in summary['device']['servo'].items() if 'histogram' not in k})}")
    assert_exact(summary)
    for values in memory.values():
        assert max(values) - values[0] <= GROWTH_KB
