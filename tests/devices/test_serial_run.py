"""Runs with the serial axis's emulator, in a process of its own, as a user starts it."""

import json
import os
import signal
from pathlib import Path

import pytest

from hapnet.transport.config import free_address
from tests.support.processes import Program, assert_passive, read_json, started


class Axis(Program):
    """`hapnet emulate serial`, ready to be opened at `link`."""

    def __init__(self, link: Path, *options: str, more: tuple[object, ...] = ()) -> None:
        super().__init__("emulate", ",".join([f"serial:link={link}", *options]), *more)
        self.until_line("emulates serial")


@pytest.mark.slow
def test_a_run_with_the_axis(tmp_path: Path) -> None:
    """Paired, a contact felt, passive by both accounts: hapnet's, and that of the forces that really acted."""
    link, account = tmp_path / "axis", tmp_path / "emulator.json"
    with Axis(link, more=("--json", account)) as emulator:
        with started("run", "--device", f"serial:{link}", "--duration", 3, "--json", "-", "--out", tmp_path) as program:
            summary = program.summary()
        assert_passive(summary)
        device = summary["device"]
        assert device["force"] == "applied"
        assert device["driver"]["name"] == f"serial:{link}"
        assert device["ledger"]["slack_J"] >= -device["quantisation_J"]
        assert summary["motion"]["contacts"] >= 1
        assert summary["motion"]["peak_force_N"] > 0.3
        log = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text("utf-8").splitlines()]
        reported = {(entry["role"], entry["text"]) for entry in log if entry["kind"] == "signal"}
        assert reported == {("device", "buttons = [true]"), ("world", "buttons = [true]")}
        os.kill(emulator.process.pid, signal.SIGTERM)
        assert emulator.end()[0] == 0
        bound = summary["theorem"]["bound_J"] + device["quantisation_J"]
        assert read_json(account)["most_given_J"] <= bound


@pytest.mark.slow
def test_the_axis_follows_a_leader(tmp_path: Path) -> None:
    """As a robot in the world's place; scaled, so the account counts three halves of what the emulator gave out."""
    link, account = tmp_path / "axis", tmp_path / "emulator.json"
    hand = ("--operator", "rest", "--set", "operator_hand.stiffness=20", "--set", "operator_hand.mass=0.1")
    scales = ("--set", "follower.motion_scale=0.5", "--set", "follower.force_scale=0.75")
    with Axis(link, more=(*hand, "--json", account)) as emulator:
        given = ("--scene", "free", "--operator", "sine", "--duration", 4, "--json", "-", "--out", tmp_path)
        with started("run", "--follower", f"serial:{link}", *scales, *given) as program:
            summary = program.summary()
        assert_passive(summary)
        world = summary["world"]
        assert world["force"] == "applied"
        assert world["driver"]["name"] == f"serial:{link}"
        assert world["ledger"]["slack_J"] >= -world["quantisation_J"]
        assert summary["motion"]["free_rms_m"] < 0.01
        assert world["step"]["count"] > 2000
        os.kill(emulator.process.pid, signal.SIGTERM)
        assert emulator.end()[0] == 0
        bound = summary["theorem"]["bound_J"] + world["quantisation_J"]
        assert 1.5 * read_json(account)["most_given_J"] <= bound


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "says"),
    [("stall=2", "is silent, no force: no whole state"), ("noise=0.01", ""), ("rubbish=0.5", "")],
)
def test_a_faulty_axis_is_survived(fault: str, says: str, tmp_path: Path) -> None:
    link, reported = tmp_path / "axis", tmp_path / "emulator.json"
    with Axis(link, fault, more=("--json", reported)) as emulator:
        with started("run", "--device", f"serial:{link}", "--duration", 5, "--json", "-", "--out", tmp_path) as program:
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
        os.kill(emulator.process.pid, signal.SIGTERM)
        emulator.end()
        found = read_json(reported)
        assert found["most_given_J"] <= summary["theorem"]["bound_J"] + summary["device"]["quantisation_J"]
        assert found["released"] > 0 or not says  # its own watchdog took the force away


@pytest.mark.slow
def test_the_worlds_side_stops_the_force(tmp_path: Path) -> None:
    """SIGUSR1 to the world's process: the device renders no force any more, and the run stays passive."""
    link = tmp_path / "axis"
    address = free_address()
    with Axis(link):
        with (
            started("world", "-l", address, "--duration", 6, "--json", tmp_path / "world.json") as world,
            started("device", "--device", f"serial:{link}", "-e", address, "--duration", 6, "--json", "-") as device,
        ):
            device.until_line("paired")
            os.kill(world.process.pid, signal.SIGUSR1)
            device.until_line("renders no force any more: SIGUSR1")
            world.until_line("the device is told to give no force: SIGUSR1")
            code, stdout, stderr = device.end()
        assert code == 3, stderr
        assert json.loads(stdout)["device"]["stopped"]["asked"] is True


@pytest.mark.slow
def test_an_axis_in_millimetres_is_stopped(tmp_path: Path) -> None:
    link = tmp_path / "axis"
    with Axis(link, "units=1000"):
        with started("run", "--device", f"serial:{link}", "--duration", 5, "--out", tmp_path) as program:
            code, _, stderr = program.end()
        assert code in (2, 3), stderr
        assert "millimetres" in stderr


@pytest.mark.slow
def test_an_axis_that_is_killed_may_come_back(tmp_path: Path) -> None:
    link = tmp_path / "axis"
    with Axis(link) as emulator:
        with started("run", "--device", f"serial:{link}", "--duration", 8, "--json", "-", "--out", tmp_path) as program:
            program.until_line("running: ")
            emulator.kill()
            program.until_line("has gone")
            with Axis(link):
                program.until_line("is back after")
                code, stdout, stderr = program.end()
        assert code == 0, stderr
        assert json.loads(stdout)["device"]["driver"]["silences"] >= 1


@pytest.mark.soak
def test_ten_minutes(tmp_path: Path) -> None:
    link, account = tmp_path / "axis", tmp_path / "emulator.json"
    with Axis(link, more=("--json", account)) as emulator:
        words = ("--realtime", "--duration", 600, "--json", "-", "--out", tmp_path)
        with started("run", "--device", f"serial:{link}", *words) as program:
            program.process.wait(700)
            summary = program.summary()
        assert_passive(summary)
        device = summary["device"]
        print({key: device["servo"][key] for key in ("late_p50_us", "late_p99_us", "late_max_us", "overruns")})
        os.kill(emulator.process.pid, signal.SIGTERM)
        emulator.end()
        print(device["driver"], summary["theorem"], read_json(account))
        assert device["driver"]["silent_s"] < 6.0  # a machine that others use too; the emulator has no priority
        assert summary["motion"]["contacts"] >= 100
