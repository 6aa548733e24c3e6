"""Runs with a tool of six degrees of freedom: the theorem over bad links and through 180 degrees."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hapnet.control.pspm import SetPositionModulator
from hapnet.errors import InvalidParameter
from hapnet.ext.compiled.real_time import CompiledDevices, CompiledTicks
from hapnet.ext.tools.device import SimulatedHandle, TurningHand, turned
from hapnet.mechanics import pose as poses
from hapnet.mechanics.pose import ARM_M, AXES
from hapnet.params import Params
from hapnet.plant.operator import Impedance, Rest, Sine
from hapnet.records.machine_code import no_compiler
from hapnet.simulation.simulation import simulate
from tests.conftest import mostly_slow
from tests.support.theorem_cases import TOLERANCE_J

TABLE = "tool:box?size=60mm,40mm,20mm + plane?normal=0,0,-1&at=0,0,-20mm"


@pytest.mark.parametrize(
    ("scene", "link", "turn_rad"),
    mostly_slow(
        [
            (TABLE, "4g", 0.3),
            ("tool:stick", "delay 80ms 40ms loss 40%", 3.0),
            ("tool:peg + hole?at=0,0,-20mm", "intercontinental", 0.05),
        ],
        2,
    ),
)
def test_both_sides_are_passive(scene: str, link: str, turn_rad: float) -> None:
    """Rounding is some 1e-16 J; the orientation goes through 180 degrees in the second."""
    params = Params().set(
        {"scene": scene, "link.up": link, "link.down": link, "duration_s": 4.0, "operator_model.turn_rad": turn_rad}
    )
    result = simulate(params, seed=3)
    summary = result.summary
    assert summary["verdict"]["passive"]
    for side in ("device", "world"):
        assert summary[side]["ledger"]["slack_J"] >= -1e-13
        assert summary[side]["reservoir_min_J"] >= 0.0
    assert summary["device"]["true_slack_J"] >= -1e-13
    assert summary["environment"]["env_slack_J"] >= -1e-15
    assert summary["theorem"]["margin_J"] >= -TOLERANCE_J


def test_six_degrees_of_freedom_may_be_said_and_no_others() -> None:
    assert simulate({"scene": "tool:stick", "dof": 6, "duration_s": 0.1}).recording is not None
    with pytest.raises(InvalidParameter, match="6 with a tool"):
        simulate({"scene": "tool:stick", "dof": 3, "duration_s": 0.1})
    with pytest.raises(InvalidParameter, match="did you mean peg"):
        simulate({"scene": "tool:pegg", "duration_s": 0.1})


def test_pspm_projects_in_the_energy_metric_with_one_share() -> None:
    """xbar = x + s (y - x) for position and orientation alike, and phi(xbar) is all that the reservoir had."""
    rng = np.random.default_rng(2)
    for _ in range(300):
        x = poses.coordinates(rng.normal(0.0, 0.02, 3), rng.normal(size=4))
        y = poses.coordinates(rng.normal(0.0, 0.02, 3), rng.normal(size=4))
        modulator = SetPositionModulator(stiffness=300.0, position=x, ceiling=0.05, energy=0.01)
        found = modulator.update(set_position=y, position=x, dissipated=0.0)
        way, went = np.array(y) - np.array(x), found.set_position - np.array(x)
        share = float(went @ way / (way @ way))
        assert went == pytest.approx(share * way, abs=1e-15)
        assert 0.5 * 300.0 * float(went @ went) == pytest.approx(min(0.01, 0.5 * 300.0 * float(way @ way)), rel=1e-12)
        assert found.energy >= 0.0


def test_a_handle_in_a_hand_pays_for_its_motion() -> None:
    """The hand's work is the change of kinetic energy, what damping took, and the work of the force that was held."""
    rng = np.random.default_rng(4)
    hand = TurningHand(Rest(3, Impedance(0.5, 6.45, 135.0)), 1.5, 1.0)
    device = SimulatedHandle(hand, mass=0.045, damping=0.3, substeps=1)
    force = (0.0,) * AXES
    for k in range(1000):
        if k % 50 == 0:
            force = tuple(rng.normal(0.0, 0.3, AXES))
        begun, before = np.array(device.position), device.kinetic
        assert device.apply(force) == force
        work = device.advance()
        moved = np.array(device.position) - begun
        lost = 0.3 / 1e-3 * float(moved @ moved)
        assert device.kinetic - before == pytest.approx(work + float(np.dot(force, moved)) - lost, abs=1e-15)


def test_a_tick_in_parts_is_as_many_ticks_of_one_part() -> None:
    """The hand's reference goes through a tick from its begin to its end."""
    hand, path = Rest(AXES, Impedance(0.1, 3.0, 400.0)), turned((0.02, -0.01, 0.005), (0.1, 0.3, -0.2))
    whole = SimulatedHandle(hand, mass=0.045, damping=0.3, period=4e-3, substeps=4)
    parts = SimulatedHandle(hand, mass=0.045, damping=0.3, period=1e-3, substeps=1)
    work = whole._run((0.0,) * AXES, path)
    shares = [tuple((0.25 * k * np.array(path)).tolist()) for k in range(5)]
    assert work == pytest.approx(sum(parts._run(*shares[k : k + 2]) for k in range(4)), rel=1e-12)
    assert whole.handle.body.x == pytest.approx(parts.handle.body.x, abs=1e-15)
    assert max(map(abs, whole.handle.body.x)) > 1e-4


def test_a_step_of_a_handle_that_is_not_found_at_once_is_cut() -> None:
    """A stiff hand that turns by 2 rad within a step of 50 ms: all steps are found, and the handle follows."""
    away = turned((0.0, 0.0, 0.0), (0.0, 0.0, 2.0))
    device = SimulatedHandle(Rest(AXES, Impedance(0.01, 1.0, 5000.0), away), period=0.05, substeps=1)
    device.place((0.0,) * AXES)
    device.references = [away]
    for _ in range(40):
        device.advance()
    assert device.handle.unsettled == 0
    assert poses.angle_between(device.position, away) < 0.1  # it still swings


def test_turned_is_the_rotation_vector() -> None:
    x = turned((0.0, 0.0, 0.0), (0.0, 0.0, np.pi / 2), ARM_M)
    assert np.array(x[3:6]) == pytest.approx([-ARM_M, ARM_M, 0.0], abs=1e-15)


def test_a_turning_hand_has_three_frequencies() -> None:
    """Its rotation vector, by scipy from where the arms of the pose are, beside the sines that its parameters say."""
    hand = TurningHand(Sine(3, Impedance(0.1, 1.0, 10.0)), turn_rad=0.3, turn_hz=0.8)
    for t in (1.0, 1.37, 2.9, 7.1):
        pose = np.array(hand.reference(t))
        assert pose[:3] == pytest.approx(hand.hand.reference(t))
        arms = np.eye(3) + pose[3:].reshape(3, 3).T / ARM_M
        expected = [0.3 * np.sin(2.0 * np.pi * 0.8 * rate * t) for rate in (1.0, 0.73, 0.59)]
        assert Rotation.from_matrix(arms).as_rotvec() == pytest.approx(expected, abs=1e-9)


@pytest.mark.slow
def test_turning_may_have_a_stiffness_of_its_own() -> None:
    """Two numbers: N/m and Nm/rad. The largest torque of a turn beyond the world's answer follows the second."""
    changes = {"scene": TABLE, "link.up": "4g", "link.down": "4g", "duration_s": 4.0}
    plain = simulate(changes, seed=3).summary
    soft = simulate(
        {
            **changes,
            "device.stiffness": [200.0, 0.16],
            "world.stiffness": [500.0, 0.4],
            "world.damping": [14.0, 0.0112],
        },
        seed=3,
    ).summary
    for summary in (plain, soft):
        assert summary["verdict"]["passive"]
        assert min(summary[side]["ledger"]["slack_J"] for side in ("device", "world")) >= -1e-13
    assert soft["motion"]["peak_torque_Nm"] < 0.7 * plain["motion"]["peak_torque_Nm"]
    with pytest.raises(InvalidParameter, match="one number above 0 for the point, and one for turning"):
        simulate({**changes, "world.stiffness": [*range(1, 13)], "duration_s": 0.1})


@pytest.mark.skipif(no_compiler() is not None, reason="nothing can be compiled")
def test_a_handles_compiled_ticks_have_the_same_bits() -> None:
    rng = np.random.default_rng(6)
    plain, compiled = (SimulatedHandle(TurningHand(Sine(3, Impedance()), 0.5, 0.7), damping=0.3) for _ in range(2))
    assert CompiledDevices().simulated(compiled) is compiled
    assert isinstance(compiled.compiled, CompiledTicks)
    for k in range(300):
        if k % 30 == 0:
            force = tuple(rng.normal(0.0, 0.3, AXES).tolist())
        assert compiled.apply(force) == plain.apply(force)
        assert compiled.advance() == plain.advance()
        assert (compiled.position, compiled.velocity, compiled.hand_force) == (
            plain.position, plain.velocity, plain.hand_force,
        )  # fmt: skip
