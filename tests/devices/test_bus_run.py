"""Runs with the emulators of servo buses, each in a process of its own, as a user starts them."""

import json
from pathlib import Path

import pytest

from hapnet.recording.mcap import read_recording
from tests.support.buses import urdf
from tests.support.processes import Emulator, started


@pytest.mark.slow
def test_lost_bytes_and_a_servo_that_stops_answering(tmp_path: Path) -> None:
    """The force goes, with one line that names the servo, and nothing came out beyond the bound."""
    hand = ("--operator", "sine", "--set", "operator_model.amplitude_m=0.25")
    with Emulator("dynamixel", tmp_path, "noise=0.01", "silent=3", "servo=2", more=hand) as emulator:
        given = ("--dof", 3, "--duration", 5, "--json", "-", "--out", tmp_path)
        with started("run", "--device", emulator.device, *given) as program:
            code, stdout, stderr = program.end()
        assert code == 3, stderr
        summary = json.loads(stdout)
        assert summary["verdict"]["passive"] is not False
        device = summary["device"]
        assert device["force"] == "applied"
        assert device["ledger"]["slack_J"] >= -1e-12
        assert device["driver"]["missed"] > 0
        assert summary["motion"]["contacts"] >= 1
        lines = [line for line in stderr.splitlines() if "is silent, no force" in line]
        assert len(lines) == device["driver"]["silences"]
        assert "no complete answer of servo 2 (shoulder)" in lines[-1]
        assert "the device is silent at the end" in device["stopped"]["why"]
        assert emulator.ended()["most_given_J"] <= summary["theorem"]["bound_J"] + device["quantisation_J"]


@pytest.mark.slow
def test_the_arm_follows_a_leader(tmp_path: Path) -> None:
    hand = ("--operator", "rest", "--set", "operator_model.stiffness=0.2", "--set", "operator_model.mass=0.001")
    with Emulator("dynamixel", tmp_path, more=hand) as emulator:
        given = ("--scene", "free", "--operator", "sine", "--dof", 3, "--duration", 3, "--json", "-", "--out", tmp_path)
        with started("run", "--follower", emulator.device, *given) as program:
            summary = program.summary()
        assert summary["verdict"]["passive"] is not False
        world = summary["world"]
        assert world["force"] == "applied"
        assert world["ledger"]["slack_J"] >= -1e-12
        assert summary["motion"]["free_rms_m"] < 0.02
        assert emulator.ended()["most_given_J"] <= summary["theorem"]["bound_J"] + world["quantisation_J"]


@pytest.mark.slow
def test_the_jaw_of_an_arm_follows_a_grip(tmp_path: Path) -> None:
    """An arm that is a jaw only, 30 mm open, and a hand of 0.2 Nm/rad holds it; its leader's closes from 50 to 10 mm
    over 4g. So it begins to follow at 30 mm; the hand's spring is 500 N/m at its lever of 20 mm, as the coupling's."""
    arm = f"arm={urdf(tmp_path, 1)},tip=l1"
    hand = ("--operator", "rest", "--set", "operator_model.stiffness=0.2", "--set", "operator_model.mass=0.001")
    with Emulator("dynamixel", tmp_path, *arm.split(","), more=hand) as emulator:
        press = ("--operator", "press", "--set", "operator_model.hold_s=3", "--set", "world.ceiling_J=0.2")
        given = ("--scene", "grip:empty", *press, "--duration", 4, "--link", "4g", "--json", "-")
        with started(
            "run", "--follower", f"{emulator.device},{arm},jaw=0.02", *given, "--out", tmp_path / "run"
        ) as program:
            summary = program.summary()
        assert summary["verdict"]["passive"] is not False
        world = summary["world"]
        assert world["force"] == "applied"
        assert world["ledger"]["slack_J"] >= -1e-12
        assert emulator.ended()["most_given_J"] <= summary["theorem"]["bound_J"] + world["quantisation_J"]
    recorded = read_recording(tmp_path / "run" / "world.mcap").world
    assert recorded is not None
    opening = recorded["position_m"][:, 0]
    assert opening[0] == pytest.approx(0.03, abs=1e-3)
    # at rest 500 (30 - r) = 500 (r - x) at the robot, and 100 (r - x) = 135 (x - 10) at the leader: x 15.4, r 22.7 mm
    # and F is -3.65 N; a busy machine's servos fall silent now and then, so the closest are compared
    assert opening.min() == pytest.approx(0.0227, abs=2.5e-3)
    assert recorded["coupling_force_N"][:, 0].min() < -3.0
