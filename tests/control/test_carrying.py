"""The proxy is carried through free space only, without any energy."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hapnet.checks import Array, Vector
from hapnet.control import carrying
from hapnet.control.carrying import GAP_M
from hapnet.control.predicted_device import PredictedDevice
from hapnet.control.prediction import MotionPredictor
from hapnet.ext.solids.rigid import Solid
from hapnet.ext.solids.rigid_contacts import SEARCHED_M, RigidContacts
from hapnet.ext.solids.shapes import Cuboid, Sphere
from hapnet.plant.operator import Impedance
from hapnet.plant.worlds.walls import Contacts, Wall
from hapnet.simulation.simulation import simulate


def solids(*chosen: Solid) -> RigidContacts:
    return RigidContacts(chosen, 3)


CORNER = Contacts([Wall((1.0, 0.0, 0.0), 0.02, 3000.0), Wall((0.6, 0.8, 0.0), 0.05, 3000.0)])
SCENES = {
    "walls": CORNER,
    "solids": solids(Solid(Sphere((0.05, 0.0, 0.0), 0.03)), Solid(Cuboid((0.0, 0.06, 0.0), (0.02, 0.01, 0.2)))),
}


@pytest.mark.parametrize("scene", SCENES)
def test_within_the_clearance_nothing_touches(scene: str) -> None:
    """Places at random; directions at random, up to the clearance."""
    contacts, rng = SCENES[scene], np.random.default_rng(11)
    tried = 0
    for _ in range(300):
        place = rng.uniform(-0.1, 0.1, 3)
        clear = contacts.clearance(tuple(place.tolist()))
        depth = contacts.penetration(tuple(place.tolist()))
        assert (clear <= 0.0) or depth == 0.0
        if clear > 0.0:
            tried += 1
            for way in rng.normal(size=(20, 3)):
                end = place + way / np.linalg.norm(way) * clear * 0.999
                assert contacts.penetration(tuple(end.tolist())) == 0.0
    assert tried > 100


def test_the_clearance_of_walls_is_the_distance_from_the_nearest() -> None:
    assert CORNER.clearance((0.0, 0.0, 0.0)) == pytest.approx(0.02)
    assert CORNER.clearance((-0.1, 0.125, 0.0)) == pytest.approx(0.05 - (-0.06 + 0.1))
    assert SCENES["solids"].clearance((-1.0, 0.0, 0.0)) == SEARCHED_M


def moving(x: Array, velocity: Array) -> PredictedDevice:
    """A device at x (n,) [m] that has moved at this constant velocity [m/s]; the world's steps take 50 ms."""
    predicted = PredictedDevice(tuple(x.tolist()), 0.028, MotionPredictor(0.06, 0.2, 0.1))
    for k in range(13):
        before = 0.005 * (k - 12)
        predicted.receive(tuple((x + velocity * before).tolist()), 1.0 + before, 0.0)
    predicted.mean_step = 0.05
    return predicted


@pytest.mark.parametrize("scene", SCENES)
def test_the_way_is_free_and_ends_at_the_goal_or_in_front_of_an_obstacle(scene: str) -> None:
    contacts, rng = SCENES[scene], np.random.default_rng(12)
    whole = part = 0
    for _ in range(200):
        x = rng.uniform(-0.08, 0.04, 3)
        if contacts.clearance(tuple(x.tolist())) <= GAP_M:
            continue
        velocity = rng.normal(size=3) * 1.5
        predicted = moving(x, velocity)
        y = (x + 0.05 * velocity).tolist()
        coupling = SimpleNamespace(carried=[0.0] * 3, y=y)
        carrying.plan(coupling, predicted, contacts, 3, tuple(x.tolist()))  # type: ignore[arg-type]  # all that it uses
        way, carried = coupling.carried, coupling.y == x.tolist()
        length, far = float(np.linalg.norm(way)), float(np.linalg.norm(velocity) * 0.05)
        assert carried == (length > 0.0)
        assert length <= far * (1.0 + 1e-9)
        if length > 0.0:
            np.testing.assert_allclose(np.array(way) / length, velocity / np.linalg.norm(velocity), atol=1e-6)
        for share in np.linspace(0.0, 1.0, 101):
            assert contacts.penetration(tuple((x + share * np.array(way)).tolist())) == 0.0
        if length > far * (1.0 - 1e-9):
            whole += 1
        elif length > 0.0:
            part += 1
            assert length >= 0.5 * far * (1.0 - 1e-9)
            assert contacts.clearance(tuple((x + np.array(way)).tolist())) > GAP_M * 0.99
    assert whole > 30
    assert part > 10


FLOOR, SIDE = Wall((1.0, 0.0, 0.0), 0.02, 3000.0), Wall((0.0, -0.6, 0.8), 0.03, 500.0)


@pytest.mark.parametrize("depth", [0.003, 1e-5, -0.5 * GAP_M])
def test_along_a_wall_the_way_changes_no_depth_and_ends_in_front_of_the_next(depth: float) -> None:
    contacts, rng, shortened = Contacts([FLOOR, SIDE]), np.random.default_rng(13), 0
    n, m = np.array(FLOOR.normal), np.array(SIDE.normal)
    for _ in range(100):
        x = np.array([0.02 + depth, *rng.uniform(-0.03, 0.03, 2)])
        if SIDE.penetration(x.tolist()) > -2.0 * GAP_M:
            continue
        velocity = rng.normal(size=3) * 0.5
        y = x + rng.normal(size=3) * 0.02
        coupling = SimpleNamespace(carried=[0.0] * 3, y=y.tolist())
        carrying.plan(coupling, moving(x, velocity), contacts, 3, tuple(x.tolist()))  # type: ignore[arg-type]
        way, full = np.array(coupling.carried), 0.05 * (velocity - n * (n @ velocity))
        np.testing.assert_allclose(coupling.y, x + n * (n @ (y - x)), atol=1e-12)
        room_m = -SIDE.penetration(x.tolist()) - GAP_M
        share = min(1.0, room_m / max(1e-9, float(m @ full)))
        np.testing.assert_allclose(way, share * full, atol=1e-7)
        assert contacts.stays(x.tolist(), (x + way).tolist())
        assert not contacts.stays(x.tolist(), (x + way + 0.004 * n).tolist())
        shortened += share < 1.0
    assert shortened > 5


def test_between_walls_that_are_not_at_a_right_angle_the_spring_moves_the_proxy() -> None:
    x = np.array([0.0205, 0.0475, 0.0])  # in the corner, in both walls
    coupling = SimpleNamespace(carried=[0.0] * 3, y=[0.03, 0.05, 0.01])
    carrying.plan(coupling, moving(x, np.ones(3)), CORNER, 3, tuple(x.tolist()))  # type: ignore[arg-type]
    assert coupling.carried == [0.0] * 3
    assert coupling.y == [0.03, 0.05, 0.01]


class Sweeping:
    """A hand that presses into the wall at 20 mm and sweeps over it, with peaks of 0.6 m/s."""

    def __init__(self, dof: int, impedance: Impedance) -> None:
        self.impedance = Impedance(0.5, 60.0, 3000.0)

    def reference(self, t: float) -> Vector:
        begun = min(t, 1.0)
        return (0.021 * begun * begun * (3.0 - 2.0 * begun), 0.05 * np.sin(2.0 * np.pi * 2.0 * max(0.0, t - 1.0)), 0.0)


def test_a_hand_that_sweeps_over_a_wall_spends_no_energy_and_feels_the_wall() -> None:
    """The wall's force beside K_felt times the hand's own depth; the account beside the sum of force times way."""
    result = simulate(
        {"scene": "wall", "dof": 3, "operator": f"{__name__}:Sweeping", "world.wall.position_m": 0.02, "link.up": "4g",
         "link.down": "4g", "duration_s": 6.0, "record_hz": 1000.0, "device.servo": "sampled"}, seed=3,
    )  # fmt: skip
    device, world, later = result.recording.device, result.recording.world, 2.0
    touching = world["contact_force_N"][1:, 0] < -0.01
    assert np.mean(touching[world["time_s"][1:] > later]) > 0.9
    assert np.abs(np.diff(world["position_m"][1:, 1]))[touching[1:]].max() > 0.015
    short = np.linalg.norm(world["set_position_m"] - world["target_m"], axis=1)
    assert np.mean(short[world["time_s"] > later] > 1e-7) == 0.0
    at = device["time_s"] > later
    K = result.summary["environment"]["felt_stiffness_N_m"]
    ideal = K * np.maximum(0.0, device["position_m"][at, 0] - 0.02)
    assert np.sqrt(np.mean((-device["force_N"][at, 0] - ideal) ** 2) / np.mean(ideal**2)) < 0.02
    work = np.sum(world["contact_force_N"][1:] * np.diff(world["position_m"], axis=0))
    assert work == pytest.approx(result.summary["environment"]["work_J"], abs=1e-6)
    assert result.summary["world"]["ledger"]["slack_J"] >= -1e-12


def test_a_carried_proxy_keeps_both_accounts_and_its_step_has_no_force() -> None:
    """A hand of up to 0.5 m/s in the air: nothing is modulated, and the world's own account never moves."""
    changes: dict[str, Any] = {
        "scene": "wall", "operator": "sine", "operator_model.amplitude_m": 0.08, "operator_model.frequency_hz": 1.0,
        "world.wall.position_m": 0.2, "link.up": "4g", "link.down": "4g", "duration_s": 4.0, "device.servo": "sampled",
    }  # fmt: skip
    result = simulate(changes, seed=6)
    world = result.recording.world
    assert np.ptp(world["position_m"][:, 0]) > 0.12
    assert not np.any(world["contact_force_N"])
    assert np.abs(world["set_position_m"] - world["target_m"]).max() < 1e-9
    assert np.ptp(world["reservoir_J"]) < 1e-4
    assert result.summary["environment"]["work_J"] == 0.0
    assert result.summary["world"]["ledger"]["slack_J"] == pytest.approx(0.0, abs=1e-15)


def test_with_the_papers_rendering_the_spring_does_all() -> None:
    changes = {"scene": "wall", "rendering": "paper", "link.up": "4g", "link.down": "4g", "duration_s": 2.0}
    world = simulate(changes, seed=6).recording.world
    assert np.abs(world["position_m"] - world["set_position_m"]).max() > 1e-3


class Along:
    """A hand that slides to and fro along the wall at 20 mm, 1.2 mm in front of it, with peaks of 0.4 m/s."""

    def __init__(self, dof: int, impedance: Impedance) -> None:
        self.impedance = Impedance(0.5, 60.0, 3000.0)

    def reference(self, t: float) -> Vector:
        begun = min(t, 1.0)
        return (0.0188 * begun * begun * (3.0 - 2.0 * begun), 0.03 * np.sin(2.0 * np.pi * 2.0 * max(0.0, t - 1.0)), 0.0)


@pytest.mark.parametrize("coupling", ["pspm", "zoh"])
def test_the_proxy_follows_a_hand_that_slides_close_to_a_wall(coupling: str) -> None:
    """The free way is short there, so the spring moves the proxy: it must not be carried by a hair, and stay behind."""
    result = simulate(
        {"coupling": coupling, "scene": "wall", "dof": 3, "operator": f"{__name__}:Along", "link.up": "lan",
         "link.down": "lan", "duration_s": 4.0, "record_hz": 1000.0, "device.servo": "sampled"}, seed=3,
    )  # fmt: skip
    device, world = result.recording.device, result.recording.world
    place = device["position_m"][
        np.searchsorted(device["time_ns"], world["time_ns"]).clip(0, len(device["time_ns"]) - 1)
    ]
    off = np.linalg.norm(world["position_m"] - place, axis=1)[world["time_s"] > 1.5]
    assert np.abs(place[:, 1]).max() > 0.025
    assert np.sqrt(np.mean(off**2)) < 0.006  # some 15 ms at 0.27 m/s (rms)
