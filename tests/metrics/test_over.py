"""What each metric is taken over: the page's table, and recordings of which half of the samples are gone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hapnet.ext.metrics import METRICS
from hapnet.ext.metrics.measured import Measured
from hapnet.ext.study.case import measures, simulated
from hapnet.params import Params
from hapnet.recording.samples import Columns, Recording
from hapnet.summary.from_samples import motion
from hapnet.summary.structure import Summary
from tests.support.metric_recordings import device, recording, world

PAGE = Path(__file__).parents[2] / "hapnet/ext/metrics/README.md"

LINK = "delay 40ms 10ms loss 2%"

NEIGHBOURS = {"force_step_N", "torque_step_Nm", "buzz_N2"}
"""Metrics that need neighbouring samples, as the page says."""

WITHIN = 0.05

FLOOR = {"ms": 5.0, "mm/min": 0.05, "N": 5e-4, "%": 0.02}
"""A time is known to a few samples, a drift to what a fit of it scatters by, and a force to half a millinewton."""


def test_the_page_has_every_metric_with_what_it_is_over() -> None:
    rows = [line for line in PAGE.read_text("utf-8").splitlines() if line.startswith("| `")]
    assert rows == [
        f"| `{one.name}` | {one.label} | {one.unit or '-'} | {one.better} | {one.over} |" for one in METRICS.values()
    ]
    assert all(one.over for one in METRICS.values())


def test_a_stall_counts_for_as_long_as_it_lasted() -> None:
    """1 mm apart for a second in 1,000 samples, then 10 mm for a second in one: sqrt((1 + 100) / 2) mm."""
    samples = [device(k / 1000.0, (0.001,), (0.0,)) for k in range(1000)]
    samples += [device(1.0, (0.01,), (0.0,)), device(2.0, (0.0,), (0.0,))]
    still = [world(at, (0.0,), -1.0) for at in (0.0, 3.0)]
    found = motion(recording(*samples, *still))
    assert found["free_rms_m"] == pytest.approx(np.sqrt((1e-6 + 100e-6) / 2.001), rel=1e-3)


def half(columns: Columns | None, rng: np.random.Generator) -> Columns | None:
    if columns is None:
        return None
    count = len(columns["time_s"])
    kept = np.sort(rng.choice(count, count // 2, replace=False))
    return {name: values[kept] for name, values in columns.items()}


def halved(run: Measured, rng: np.random.Generator) -> Measured:
    """The same run, of whose recording half of the device's samples are gone, and of the reference's."""

    def thin(whole: Recording) -> Recording:
        return replace(whole, device=half(whole.device, rng))

    kept = thin(run.result.recording)
    summary: Summary = {**run.summary, "motion": motion(kept)}
    assert run.ideal is not None
    return Measured(run.params, replace(run.result, recording=kept, summary=summary), run.scene, thin(run.ideal))


@pytest.mark.slow
def test_half_of_the_samples_say_the_same() -> None:
    given = Params().set({"operator": "press", "duration_s": 20.0, "operator_model.end_hold_s": 4.0})
    given = given.set({"device.servo": "sampled", "link.up": "", "link.down": ""})
    ideal = simulated(given, 1).result.recording
    run = replace(simulated(given.set({"link.up": LINK, "link.down": LINK}), 1), ideal=ideal)
    whole, rng = measures(run), np.random.default_rng(5)
    for _ in range(3):
        found = measures(halved(run, rng))
        for name in METRICS.keys() - NEIGHBOURS:
            floor = FLOOR.get(METRICS[name].unit, 1e-12)
            assert found[name] == pytest.approx(whole[name], rel=WITHIN, abs=floor), name
    assert sum(value is not None for value in whole.values()) > 35
