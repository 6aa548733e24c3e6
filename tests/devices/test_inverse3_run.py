"""A run with the Inverse3's emulator as its service: processes as a user starts them."""

from __future__ import annotations

import json
import os
import signal
from pathlib import Path
from typing import Any, Self

import pytest

from hapnet.recording.mcap import read_recording
from tests.conftest import mostly_slow
from tests.faults.invariants import columns_of
from tests.support.processes import Emulator, assert_passive, started

SOAK_S = 600.0


class Service(Emulator):
    """`hapnet emulate inverse3`, ready; `device` is what to give to `hapnet run`."""

    def __init__(self, tmp_path: Path, *options: str, again: Self | None = None) -> None:
        port, events = ("port=0", "events=0") if again is None else again.ports
        super().__init__("inverse3", tmp_path, events, *options, at=port, more=("--operator", "press"))
        line = next(line for line in self.out + self.err if "emulates" in line)
        self.device = line.split("--device ")[1].strip()
        port, events = self.device.removeprefix("inverse3:localhost:").split(",events=")
        self.ports = f"port={port}", f"events={events}"


def run(service: Service, out: Path, seconds: float, *more: str) -> tuple[object, ...]:
    return (
        "run", "--device", service.device, "--dof", 3, "--scene", "wall", "--duration", seconds, "--json", "-",
        "--out", out, *more,
    )  # fmt: skip


def assert_within_bound(found: dict[str, Any], summary: dict[str, Any], out: Path) -> None:
    """The emulator's account, which owes nothing to hapnet's, is that of hapnet within the last ticks' motion."""
    device = summary["device"]
    near = device["quantisation_J"] + 1e-3
    assert found["most_given_J"] <= summary["theorem"]["bound_J"] + device["quantisation_J"]
    assert found["given_J"] <= -device["ledger"]["work_J"] + near
    # what the margin shows of the hand's port: that of the world shuffles energy here, and back
    columns = columns_of(read_recording(out / "device.mcap"))
    given_J = device["ledger"]["bound_J"] + columns["credited_J"] - columns["sent_J"] - columns["margin_J"]
    assert found["most_given_J"] <= given_J.max() + near


@pytest.mark.parametrize("more", mostly_slow([(("--realtime",),), ((),)], 0, 1), ids=["realtime", "thread"])
def test_a_run_with_the_arm(more: tuple[str, ...], tmp_path: Path) -> None:
    """Paired, a contact felt, margins and slack as with the simulated device; passive by both accounts."""
    with Service(tmp_path) as service:
        with started(*run(service, tmp_path / "run", 5, *more)) as program:
            code, stdout, stderr = program.end()
        assert code == 0, stderr
        assert "Traceback" not in stderr
        summary = json.loads(stdout)
        assert_passive(summary)
        device = summary["device"]
        assert device["force"] == "commanded"  # the service does not report what the motors made
        assert device["driver"]["name"] == service.device
        assert summary["motion"]["contacts"] >= 1
        assert summary["motion"]["peak_force_N"] > 0.3
        found = service.ended()
        assert found["commands"] > 0.5 * device["servo"]["ticks"]  # one a tick
        assert_within_bound(found, summary, tmp_path / "run")


@pytest.mark.slow
def test_a_service_that_stalls_is_silent_and_comes_back(tmp_path: Path) -> None:
    with Service(tmp_path) as service:
        with started(*run(service, tmp_path / "run", 8)) as program:
            program.until_line("running: ")
            os.kill(service.process.pid, signal.SIGSTOP)
            program.until_line("is silent, no force: no state from ws://localhost:")
            os.kill(service.process.pid, signal.SIGCONT)
            program.until_line("is back after")
            code, stdout, stderr = program.end()
        assert code == 0, stderr
        summary = json.loads(stdout)
        lines = [line for line in stderr.splitlines() if "is silent" in line]
        assert len(lines) == summary["device"]["driver"]["silences"] >= 1
        assert summary["verdict"]["passive"] is not False
        assert_within_bound(service.ended(), summary, tmp_path / "run")


@pytest.mark.slow
def test_a_service_that_is_killed_may_come_back(tmp_path: Path) -> None:
    with Service(tmp_path) as service:
        with started(*run(service, tmp_path / "run", 12)) as program:
            program.until_line("running: ")
            service.kill()
            program.until_line("is silent, no force: ")
            with Service(tmp_path, again=service) as restarted:
                program.until_line("is back after")
                code, stdout, stderr = program.end()
                account = restarted.ended()
        assert code == 0, stderr
        assert "Traceback" not in stderr
        summary = json.loads(stdout)
        assert summary["device"]["driver"]["silences"] >= 1
        assert summary["verdict"]["passive"] is not False
        assert account["most_given_J"] <= summary["theorem"]["bound_J"]


@pytest.mark.slow
def test_rubbish_is_missed_and_nothing_else(tmp_path: Path) -> None:
    with Service(tmp_path, "rubbish=0.02") as service:
        with started(*run(service, tmp_path / "run", 5)) as program:
            summary = program.summary()
        assert summary["device"]["driver"]["missed"] > 0
        assert summary["verdict"]["passive"] is not False
        assert summary["motion"]["contacts"] >= 1
        assert_within_bound(service.ended(), summary, tmp_path / "run")


@pytest.mark.slow
def test_an_arm_in_millimetres_is_refused_or_stopped(tmp_path: Path) -> None:
    with Service(tmp_path, "units=1000") as service:
        with started(*run(service, tmp_path / "run", 5)) as program:
            code, _, stderr = program.end()
        assert code in (2, 3), stderr
        assert "workspace" in stderr or "faster" in stderr
        assert len([line for line in stderr.splitlines() if service.device in line]) == (code == 2)


@pytest.mark.slow
def test_the_brake_takes_the_force_away_and_it_grows_again(tmp_path: Path) -> None:
    with Service(tmp_path, "brake=3") as service:
        with started(*run(service, tmp_path / "run", 8)) as program:
            program.until_line("renders no force: its emergency brake is on")
            program.until_line("renders force again: it grows")
            summary = program.summary()
        assert summary["verdict"]["passive"] is not False
        assert_within_bound(service.ended(), summary, tmp_path / "run")


@pytest.mark.soak
def test_ten_minutes(tmp_path: Path) -> None:
    with Service(tmp_path) as service:
        with started(*run(service, tmp_path / "run", SOAK_S, "--realtime")) as program:
            assert program.process.wait(SOAK_S + 120.0) == 0
            summary = program.summary()
        assert_passive(summary)
        found = service.ended()
        assert_within_bound(found, summary, tmp_path / "run")
        device = summary["device"]
        servo = {name: value for name, value in device["servo"].items() if name != "late_histogram_us"}
        print(f"\n{servo}\n{device['driver']}\n{device['ledger']}\n{summary['theorem']}\n{found}")
