"""Whole runs with an arm as the device, in virtual time."""

from __future__ import annotations

from typing import Any

import pytest

from hapnet.assembly.arms import real_time_warnings
from hapnet.kernel import real_time
from hapnet.kernel.real_time import CompiledDevices
from hapnet.params import Params
from hapnet.plant.arms.device import SimulatedArm
from hapnet.plant.arms.omni import omni
from hapnet.plant.operator import Impedance, Sine
from hapnet.records.machine_code import no_compiler
from hapnet.simulation.simulation import Simulation

OVER_4G = {"hardware": "omni", "link.up": "4g", "link.down": "4g", "duration_s": 1.5, "device.substeps": 1}


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"operator": "sine", "scene": "free", "device.resolution_m": 5.5e-5},
        {"coupling": "zoh", "operator": "sine"},
        {"coupling": "tdpa", "rendering": "paper"},
    ],
)
def test_runs_over_4g(changes: dict[str, Any]) -> None:
    """Three axes; the device's half of the theorem to rounding with the laws that claim it; the kernel says why not."""
    simulation = Simulation(Params().set(OVER_4G | changes), 3)
    assert simulation.not_compiled == "the device omni"
    result = simulation.run()
    assert isinstance(result.device.device, SimulatedArm)
    assert result.recording.device is not None
    assert result.recording.device["position_m"].shape[1] == 3
    summary = result.summary
    if changes.get("coupling", "pspm") == "pspm":
        assert summary["verdict"]["passive"] is True
        assert summary["theorem"]["margin_J"] > 0.0
        true_slack = result.device.true_slack
        assert true_slack is not None
        assert true_slack >= -1e-13 - (result.device.quantisation or 0.0)


def test_an_arm_without_the_compiler_says_what_it_needs(monkeypatch: pytest.MonkeyPatch) -> None:
    arm = Params().set({"hardware": "omni"})
    monkeypatch.setenv("NUMBA_DISABLE_JIT", "1")
    (line,) = real_time_warnings(arm)
    assert "the extra fast" in line
    assert "--set device.substeps=1" in line
    assert real_time_warnings(Params()) == real_time_warnings(arm.set({"device.substeps": 1})) == ()
    monkeypatch.delenv("NUMBA_DISABLE_JIT")
    monkeypatch.setattr("hapnet.records.machine_code.find_spec", lambda name: name)
    assert real_time_warnings(arm) == ()


@pytest.mark.slow
def test_compiled_ticks_are_pythons() -> None:
    """To the last bit, with forces that a motor cuts and a hand that presses against stops."""
    if no_compiler() is not None:
        pytest.skip("nothing can be compiled here")
    plain, compiled = (SimulatedArm(omni(), Sine(3, Impedance(), 0.2, 1.0, start_s=0.3), substeps=2) for _ in range(2))
    CompiledDevices().arm(compiled)
    assert type(compiled) is real_time.CompiledArm
    for k in range(400):
        force = (4.0 * (-1.0) ** (k // 50), 2.0, -3.0)
        plain.apply(force)
        compiled.apply(force)
        assert plain.advance() == compiled.advance()
        assert plain.position == compiled.position
        assert tuple(plain.state.torque) == tuple(compiled.state.torque)
        assert plain.read() == compiled.read()
        assert (plain.kinetic, plain.potential) == (compiled.kinetic, compiled.potential)
    assert plain.arm.limited
    assert plain.arm.lost == compiled.arm.lost
