"""Runs with the serial axis's emulator, in a process of its own, as a user starts it."""

import json
import os
import signal
from pathlib import Path

import pytest

from hapnet.transport.config import free_address
from tests.conftest import mostly_slow
from tests.support.processes import Emulator, assert_passive, started


@pytest.mark.slow
def test_a_run_with_the_axis(tmp_path: Path) -> None:
    """Paired, a contact felt, passive by both accounts: hapnet's, and that of the forces that really acted."""
    with Emulator("serial", tmp_path) as emulator:
        with started("run", "--device", emulator.device, "--duration", 3, "--json", "-", "--out", tmp_path) as program:
            summary = program.summary()
        assert_passive(summary)
        device = summary["device"]
        assert device["force"] == "applied"
        assert device["driver"]["name"] == emulator.device
        assert device["ledger"]["slack_J"] >= -device["quantisation_J"]
        assert summary["motion"]["contacts"] >= 1
        assert summary["motion"]["peak_force_N"] > 0.3
        log = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text("utf-8").splitlines()]
        reported = {(entry["role"], entry["text"]) for entry in log if entry["kind"] == "signal"}
        assert reported == {("device", "buttons = [true]"), ("world", "buttons = [true]")}
        assert emulator.ended()["most_given_J"] <= summary["theorem"]["bound_J"] + device["quantisation_J"]


@pytest.mark.slow
def test_the_axis_follows_a_leader(tmp_path: Path) -> None:
    """As a robot in the world's place; scaled, so the account counts three halves of what the emulator gave out."""
    hand = ("--operator", "rest", "--set", "operator_model.stiffness=20", "--set", "operator_model.mass=0.1")
    scales = ("--set", "follower.motion_scale=0.5", "--set", "follower.force_scale=0.75")
    with Emulator("serial", tmp_path, more=hand) as emulator:
        given = ("--scene", "free", "--operator", "sine", "--duration", 4, "--json", "-", "--out", tmp_path)
        with started("run", "--follower", emulator.device, *scales, *given) as program:
            summary = program.summary()
        assert_passive(summary)
        world = summary["world"]
        assert world["force"] == "applied"
        assert world["driver"]["name"] == emulator.device
        assert world["ledger"]["slack_J"] >= -world["quantisation_J"]
        assert summary["motion"]["free_rms_m"] < 0.01
        assert world["step"]["count"] > 2000
        assert 1.5 * emulator.ended()["most_given_J"] <= summary["theorem"]["bound_J"] + world["quantisation_J"]


@pytest.mark.parametrize(
    ("fault", "says"),
    mostly_slow([("stall=2", "is silent, no force: no complete state"), ("rubbish=0.5", ""), ("noise=0.01", "")], 0, 1),
)
def test_a_faulty_axis_is_survived(fault: str, says: str, tmp_path: Path) -> None:
    with Emulator("serial", tmp_path, fault) as emulator:
        with started("run", "--device", emulator.device, "--duration", 5, "--json", "-", "--out", tmp_path) as program:
            code, stdout, stderr = program.end()
        assert code == 0, stderr
        summary = json.loads(stdout)
        assert summary["verdict"]["passive"] is not False
        assert summary["motion"]["contacts"] >= 1
        driver = summary["device"]["driver"]
        assert driver["missed"] > 0
        lines = [line for line in stderr.splitlines() if "silent" in line]
        assert len(lines) == driver["silences"]
        if says:
            assert driver["silences"] >= 1  # a busy machine may add some
            assert any(says in line for line in lines)
            assert "is back after" in stderr
            assert driver["silent_s"] >= 0.4
        found = emulator.ended()
        assert found["most_given_J"] <= summary["theorem"]["bound_J"] + summary["device"]["quantisation_J"]
        assert found["released"] > 0 or not says  # its own watchdog took the force away


@pytest.mark.slow
def test_the_worlds_side_stops_the_force(tmp_path: Path) -> None:
    """SIGUSR1 to the world's process: the device renders no force any more, and the run stays passive."""
    address = free_address()
    with Emulator("serial", tmp_path) as emulator:
        with (
            started("world", "-l", address, "--duration", 6, "--json", tmp_path / "world.json") as world,
            started("device", "--device", emulator.device, "-e", address, "--duration", 6, "--json", "-") as device,
        ):
            device.until_line("paired")
            os.kill(world.process.pid, signal.SIGUSR1)
            device.until_line("renders no force any more: SIGUSR1")
            world.until_line("the device's force is ended: SIGUSR1")
            code, stdout, stderr = device.end()
        assert code == 3, stderr
        assert json.loads(stdout)["device"]["stopped"]["asked"] is True


@pytest.mark.slow
def test_an_axis_in_millimetres_is_stopped(tmp_path: Path) -> None:
    with Emulator("serial", tmp_path, "units=1000") as emulator:
        with started("run", "--device", emulator.device, "--duration", 5, "--out", tmp_path) as program:
            code, _, stderr = program.end()
        assert code in (2, 3), stderr
        assert "millimetres" in stderr


@pytest.mark.slow
def test_an_axis_that_is_killed_may_come_back(tmp_path: Path) -> None:
    with Emulator("serial", tmp_path) as emulator:
        with started("run", "--device", emulator.device, "--duration", 8, "--json", "-", "--out", tmp_path) as program:
            program.until_line("running: ")
            emulator.kill()
            program.until_line("was disconnected")
            with Emulator("serial", tmp_path):
                program.until_line("is back after")
                code, stdout, stderr = program.end()
        assert code == 0, stderr
        assert json.loads(stdout)["device"]["driver"]["silences"] >= 1


@pytest.mark.soak
def test_ten_minutes(tmp_path: Path) -> None:
    with Emulator("serial", tmp_path) as emulator:
        words = ("--realtime", "--duration", 600, "--json", "-", "--out", tmp_path)
        with started("run", "--device", emulator.device, *words) as program:
            program.process.wait(700)
            summary = program.summary()
        assert_passive(summary)
        device = summary["device"]
        print({key: device["servo"][key] for key in ("late_p50_us", "late_p99_us", "late_max_us", "overruns")})
        print(device["driver"], summary["theorem"], emulator.ended())
        assert device["driver"]["silent_s"] < 6.0  # a machine that others use too; the emulator has no priority
        assert summary["motion"]["contacts"] >= 100
