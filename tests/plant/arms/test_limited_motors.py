"""A run whose arm has motors that are too weak: the recording has the force that they held, and the text says so."""

import numpy as np
import pytest

from hapnet.ext.metrics.world import force_cut_percent
from hapnet.ext.study.case import simulated
from hapnet.params import Params
from hapnet.simulation.simulation import Simulation, simulate
from hapnet.summary.structure import read
from hapnet.summary.tables import felt_line
from tests.conftest import mostly_slow

STIFF = {
    "hardware": "omni", "device.force_limit_N": 0.0, "device.stiffness": 1500.0, "operator_model.stiffness": 900.0,
    "scene": "wall", "record_hz": 1000.0, "duration_s": 4.0,
}  # fmt: skip


@pytest.mark.parametrize("record_hz", mostly_slow([1000.0, 200.0], 1))
def test_the_recorded_force_is_the_force_that_was_held(record_hz: float) -> None:
    """Each tick's force is what the arm's joints held after it, tick by tick from the arm itself."""
    simulation = Simulation(Params().set({**STIFF, "record_hz": record_hz}), 1)
    device, held, cut = simulation.device.device, [], 0
    inner = device._tick  # type: ignore[attr-defined]

    def tick(begin: tuple[float, ...], end: tuple[float, ...]) -> float:
        nonlocal cut
        work: float = inner(begin, end)
        held.append(tuple(device.arm.force[:3]))  # type: ignore[attr-defined]
        cut += device.arm.limited  # type: ignore[attr-defined]
        return work

    device._tick = tick  # type: ignore[attr-defined]
    result = simulation.run()
    recorded = result.recording.device
    assert recorded is not None
    every = round(1000.0 / record_hz)
    count = len(recorded["force_N"])
    # the first tick has no sample, and the force after the last tick was never held
    truth = np.array(held)[every::every][: count - 1]
    assert np.abs(recorded["force_N"][: len(truth)] - truth).max() == 0.0
    assert cut / len(held) > 0.2
    assert result.summary["device"]["cut_ticks"] == cut


def test_its_work_is_that_of_the_ledger() -> None:
    """Own sum over the samples, on both sides of the ledger's value."""
    result = simulate(STIFF, seed=1)
    device, part = result.recording.device, result.summary["device"]
    own = -float(np.sum(device["force_N"][:-1] * np.diff(device["position_m"], axis=0)))
    assert own == pytest.approx(part["ledger"]["work_J"], abs=1e-12)
    assert part["force"] == "applied"
    share = part["cut_ticks"] / part["servo"]["ticks"]
    assert f"The motors could not hold the whole force in {share:.0%} of the ticks." in felt_line(read(result.summary))
    assert result.summary["motion"]["peak_force_N"] == np.linalg.norm(device["force_N"], axis=1).max()


def test_strong_motors_are_not_spoken_of() -> None:
    result = simulate({**STIFF, "device.stiffness": 100.0, "operator_model.stiffness": 100.0}, seed=1)
    assert result.summary["device"]["cut_ticks"] == 0
    assert "motors" not in felt_line(read(result.summary))


def test_the_metric_is_the_share() -> None:
    run = simulated(Params().set(STIFF), 1)
    part = run.sides[0]
    assert force_cut_percent(run) == pytest.approx(100.0 * part["cut_ticks"] / part["servo"]["ticks"])
