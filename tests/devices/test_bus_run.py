"""Runs with the emulators of servo buses, each in a process of its own, as a user starts them."""

import json
import os
import signal
from pathlib import Path

import pytest

from tests.support.processes import Program, read_json, started


class Bus(Program):
    """`hapnet emulate dynamixel`, ready to be opened at `link`."""

    def __init__(self, link: Path, *options: str, more: tuple[object, ...] = ()) -> None:
        super().__init__("emulate", ",".join([f"dynamixel:link={link}", *options]), *more)
        self.until_line("emulates dynamixel")


@pytest.mark.slow
def test_lost_bytes_and_a_servo_that_stops_answering(tmp_path: Path) -> None:
    """The force goes, with one line that names the servo, and nothing came out beyond the bound."""
    link, account = tmp_path / "arm", tmp_path / "emulator.json"
    hand = ("--operator", "sine", "--set", "operator_hand.amplitude_m=0.25", "--json", account)
    with Bus(link, "noise=0.01", "silent=3", "servo=2", more=hand) as emulator:
        given = ("--dof", 3, "--duration", 5, "--json", "-", "--out", tmp_path)
        with started("run", "--device", f"dynamixel:{link}", *given) as program:
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
        assert "no whole answer of servo 2 (shoulder)" in lines[-1]
        assert "the device is silent at the end" in device["stopped"]["why"]
        os.kill(emulator.process.pid, signal.SIGTERM)
        assert emulator.end()[0] == 0
        assert read_json(account)["most_given_J"] <= summary["theorem"]["bound_J"] + device["quantisation_J"]


@pytest.mark.slow
def test_the_arm_follows_a_leader(tmp_path: Path) -> None:
    link, account = tmp_path / "arm", tmp_path / "emulator.json"
    hand = ("--operator", "rest", "--set", "operator_hand.stiffness=0.2", "--set", "operator_hand.mass=0.001")
    with Bus(link, more=(*hand, "--json", account)) as emulator:
        given = ("--scene", "free", "--operator", "sine", "--dof", 3, "--duration", 3, "--json", "-", "--out", tmp_path)
        with started("run", "--follower", f"dynamixel:{link}", *given) as program:
            summary = program.summary()
        assert summary["verdict"]["passive"] is not False
        world = summary["world"]
        assert world["force"] == "applied"
        assert world["ledger"]["slack_J"] >= -1e-12
        assert summary["motion"]["free_rms_m"] < 0.02
        os.kill(emulator.process.pid, signal.SIGTERM)
        assert emulator.end()[0] == 0
        assert read_json(account)["most_given_J"] <= summary["theorem"]["bound_J"] + world["quantisation_J"]
