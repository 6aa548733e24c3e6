"""Whole runs with an arm as the device, in virtual time."""

from pathlib import Path
from typing import Any

import pytest

from hapnet.assembly.build import prepare
from hapnet.assembly.simulated_device import real_time_warnings
from hapnet.errors import InvalidParameter
from hapnet.ext.arms.device import SimulatedArm
from hapnet.ext.arms.table import ArmTable, omni
from hapnet.ext.bench.plants import seven_joints
from hapnet.ext.compiled.real_time import CompiledDevices, CompiledTicks
from hapnet.params import Params
from hapnet.plant.operator import Impedance, Sine
from hapnet.records.machine_code import no_compiler
from hapnet.simulation.simulation import Simulation
from tests.plant.arms.references import cylindrical, led

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
    assert result.recording.device["position_m"].shape[1] == 3
    summary = result.summary
    if changes.get("coupling", "pspm") == "pspm":
        assert summary["verdict"]["passive"] is True
        assert summary["theorem"]["margin_J"] > 0.0
        true_slack = result.device.true_slack
        assert true_slack >= -1e-13 - (result.device.quantisation or 0.0)


@pytest.mark.parametrize(("joints", "rendering"), [(3, "auto"), (7, "auto")])
def test_runs_joint_by_joint_over_4g(joints: int, rendering: str, tmp_path: Path) -> None:
    """Axes in rad and torques in Nm through the whole run, pressed against the world's stops at 0.3 rad."""
    file = tmp_path / "seven.urdf"
    file.write_text(seven_joints(), "utf-8")
    name = "omni?axes=joints" if joints == 3 else f"arm:{file}?tip=l7&home=0,0.5,0,0.8,0,0.5,0&axes=joints"
    K = (3.0, 2.0, 2.5, 2.0, 1.5, 1.0, 0.5)[:joints]
    changes = {"hardware": name, "scene": "joints", "rendering": rendering, "device.stiffness": K}
    result = Simulation(Params().set(OVER_4G | changes), 3).run()
    summary = result.summary
    assert result.recording.device["position_m"].shape[1] == joints
    assert summary["units"] == result.recording.meta["params"]["units"] == "rad"
    assert summary["verdict"]["passive"] is True
    assert summary["motion"]["peak_force_N"] > (0.05 if joints == 3 else 0.0)
    assert (result.device.true_slack or 0.0) >= -1e-13


def test_joints_and_metres_do_not_meet() -> None:
    for hardware, scene, says in (
        ("omni?axes=joints", "wall", "axes are in m, as those of the scene wall; this one's are in rad"),
        ("omni", "joints", "axes are in rad, as those of the scene joints; this one's are in m"),
        ("omni?axes=tips", "wall", r"omni, or omni\?axes=joints"),
        ("omni?axes=joints&axes=joints", "wall", r"omni, or omni\?axes=joints"),
    ):
        with pytest.raises(InvalidParameter, match=says):
            prepare(Params().set({"hardware": hardware, "scene": scene}))
    with pytest.raises(InvalidParameter, match=r"device.stiffness is 20000.0; allowed: 0.001 to 10000 Nm/rad"):
        prepare(Params().set({"hardware": "omni?axes=joints", "scene": "joints", "device.stiffness": 2e4}))


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
@pytest.mark.parametrize(
    "table", [omni(), cylindrical(), led(cylindrical(), (2, 1, 0.05, -0.03))], ids=lambda table: str(table.name)
)
def test_compiled_ticks_are_pythons(table: ArmTable) -> None:
    """To the last bit, with forces that a motor cuts and a hand that presses against stops; with a slide too."""
    if no_compiler() is not None:
        pytest.skip("nothing can be compiled here")
    plain, compiled = (SimulatedArm(table, Sine(3, Impedance(), 0.2, 1.0, start_s=0.3), substeps=2) for _ in range(2))
    CompiledDevices().simulated(compiled)
    assert isinstance(compiled.compiled, CompiledTicks)
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
