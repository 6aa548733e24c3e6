"""The recorded energies are those of recorded forces, ways and speeds, added up without the ledger."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapnet.couplings.registry import COUPLINGS
from hapnet.params import Params
from hapnet.recording.samples import Columns
from hapnet.simulation.simulation import Simulation, simulate
from tests.conftest import mostly_slow
from tests.support.scene_runs import words, write_files

STIFFNESS = 100.0
"""K [N/m]."""

ROUNDING_J = 1e-13
"""Of sums of some thousand terms, each far below a joule [J]."""

BASE = Params().set(
    {"operator": "press", "duration_s": 2.5, "record_hz": 1000.0, "link.up": "wifi", "link.down": "wifi"}
)


def columns(params: Params, seed: int = 1) -> tuple[Columns, Columns]:
    recording = simulate(params, seed=seed, kernel=False).recording
    assert recording.device is not None
    assert recording.world is not None
    return recording.device, recording.world


def running(force: Any, position: Any) -> Any:
    """Force times way since the first sample [J]; forces act up to the sample at which they stand."""
    return np.append(0.0, np.cumsum(np.sum(force[1:] * np.diff(position, axis=0), axis=1)))


def since_the_first(energy: Any) -> Any:
    return energy - energy[0]


def kinetic(mass: float, velocity: Any) -> Any:
    return 0.5 * mass * np.sum(velocity**2, axis=1)


def spring(stiffness: float, side: Columns) -> Any:
    return 0.5 * stiffness * np.sum((side["position_m"] - side["set_position_m"]) ** 2, axis=1)


@pytest.mark.parametrize("resolution_m", [0.0, 5e-5])
@pytest.mark.parametrize("scene", mostly_slow(["wall", "box", "sphere"], 1))
def test_a_held_force_does_its_work_on_the_way_of_the_tick_that_follows(scene: str, resolution_m: float) -> None:
    """-sum tau . dx of what was really applied. What the spring does not hold of it is in the reservoir."""
    settings = {"device.servo": "sampled", "scene": scene, "device.resolution_m": resolution_m}
    params = BASE.set({**settings, "device.force_limit_N": 1.0, "device.stiffness": STIFFNESS})
    device, _ = columns(params)
    held = np.roll(device["force_N"], 1, axis=0)
    work = -running(held, device["position_m"])
    np.testing.assert_allclose(since_the_first(device["work_J"]), work, rtol=0.0, atol=ROUNDING_J)
    assert np.abs(work).max() > 1e-3
    np.testing.assert_array_equal(device["stored_J"], device["potential_J"])
    left = device["bound_J"] + work + device["work_J"][0] + device["credited_J"] - device["sent_J"]
    np.testing.assert_allclose(device["account_J"], left - device["potential_J"], rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("servo", mostly_slow(["sampled", "continuous"], 1))
@pytest.mark.parametrize("operator", ["press", "sine"])
def test_the_hands_work_is_that_of_its_force_in_every_substep(operator: str, servo: str) -> None:
    """One substep a tick: force times way. With four only the last one's force is recorded.

    Within a tick the force changes as much as from tick to tick. Beside that it goes to and fro with what steps between
    two ticks and rests within one: by its damper with the speed at which the hand aims, by the spring with its end.
    """
    for substeps in (1, 4):
        params = BASE.set({"device.servo": servo, "device.substeps": substeps, "operator": operator})
        params = params.set({"device.stiffness": STIFFNESS})
        device, _ = columns(params)
        force, way = device["operator_force_N"], np.abs(np.diff(device["position_m"], axis=0))[1:]
        speed = 1e3 * np.diff(device["operator_target_m"], axis=0)
        steps = params.operator_model.damping * np.abs(np.diff(speed, axis=0))
        steps += STIFFNESS * np.abs(np.diff(device["set_position_m"], axis=0))[1:]
        due_J = np.sum((np.abs(np.diff(force, axis=0))[1:] + steps) * way)
        lost_J = np.abs(since_the_first(device["operator_work_J"]) - running(force, device["position_m"])).max()
        if substeps == 1:
            assert lost_J < ROUNDING_J
        else:
            assert lost_J < due_J
            assert due_J < 0.2 * np.sum(np.abs(force[2:]) * way)
        if servo == "continuous":
            np.testing.assert_array_equal(device["work_J"], device["operator_work_J"])


def test_what_is_stored_is_kinetic_energy_and_springs_and_the_rest_is_in_the_reservoir() -> None:
    params = BASE.set({"device.servo": "continuous", "rendering": "paper", "device.force_limit_N": 0.0})
    device, world = columns(params)
    for side, mass, stiffness in ((device, params.device.mass, 100.0), (world, 0.02, 500.0)):
        stored = kinetic(float(np.ravel(mass)[0]), side["velocity_mps"]) + spring(stiffness, side)
        np.testing.assert_allclose(side["stored_J"], stored, rtol=1e-9, atol=1e-12)
        assert stored.max() > 1e-4
    np.testing.assert_array_equal(device["account_J"], device["reservoir_J"] - device["deficit_J"])
    np.testing.assert_array_equal(world["account_J"], world["reservoir_J"])
    assert set(device["bound_J"]) == {params.device.ceiling_J}  # all begins at rest, with the springs slack
    assert set(world["bound_J"]) == {params.world.ceiling_J}


@pytest.mark.parametrize("name", mostly_slow(["wall", "walls", "sphere", "mesh", "wedge"], 3))
def test_the_worlds_work_is_force_times_way(name: str, tmp_path: Path) -> None:
    """A step's force is constant, so that nothing is lost between samples."""
    if name == "mesh":
        pytest.importorskip("igl", reason="libigl is not installed")
    scene = "wall" if name == "wall" else words(name, write_files(tmp_path), friction=0.0)
    changes: dict[str, Any] = {"scene": scene}
    if name != "wall":
        changes |= {"dof": 3, "operator": "tests.support.scene_runs:Stroke"}
    _, world = columns(BASE.set(changes))
    work = running(world["contact_force_N"], world["position_m"])
    np.testing.assert_allclose(since_the_first(world["work_J"]), work, rtol=0.0, atol=ROUNDING_J)
    assert np.abs(work).max() > 1e-4


@pytest.mark.parametrize(("timestep_s", "substeps"), [(0.02, 1), (0.004, 5)])
def test_of_an_engine_it_is_force_times_way_in_every_substep(timestep_s: float, substeps: int, tmp_path: Path) -> None:
    """By the engine's own arrays: the force that it was given, and where it put the proxy.

    With one substep a step the recorded mean force is that force. With more it is not: that is why work is recorded.
    """
    pytest.importorskip("mujoco", reason="MuJoCo is not installed: hapnet-haptics[mujoco]")
    from tests.support.mujoco_models import BLOCK, BOX, model

    file = model(tmp_path / "m.xml", BLOCK + BOX, option=f'timestep="{timestep_s}"')
    steps = {"world.step_min_s": 0.02, "world.step_max_s": 0.02}
    simulation = Simulation(BASE.set({"scene": file, "operator": "sine", "dof": 1, **steps}), 1)
    scene: Any = simulation.world.scene
    joint = scene.engine.found.data.joint("hapnet_proxy_x")
    substep, seen = scene.account.substep, [0.0]

    def witness(h: float, force: Any, most_J: float) -> Any:
        before = float(joint.qpos[0])
        done = substep(h, force, most_J)
        seen.append(seen[-1] - float(joint.qfrc_applied[0]) * (float(joint.qpos[0]) - before))
        return done

    scene.account.substep = witness
    world = simulation.run().recording.world
    assert len(seen) == substeps * len(world["work_J"]) + 1
    np.testing.assert_allclose(world["work_J"], seen[substeps::substeps], rtol=0.0, atol=ROUNDING_J)
    of_means = running(world["contact_force_N"], world["position_m"])
    lost_J = np.abs(since_the_first(world["work_J"]) - of_means).max()
    assert lost_J > 1e-4 if substeps > 1 else lost_J < ROUNDING_J


@pytest.mark.parametrize("coupling", mostly_slow([(one,) for one in sorted(COUPLINGS)], 3))
def test_the_recorded_margin_and_slack_are_their_sums_in_every_coupling(coupling: str) -> None:
    for side in columns(BASE.set({"coupling": coupling, "device.servo": "sampled"})):
        margin = side["work_J"] + side["bound_J"] + side["credited_J"] - side["sent_J"]
        np.testing.assert_array_equal(margin, side["margin_J"])
        np.testing.assert_array_equal(margin - side["stored_J"] - side["account_J"], side["slack_J"])
        assert np.any(side["work_J"] != 0.0)
