"""A device's own damping, measured over a serial port in real time."""

import json
from pathlib import Path

import pytest

from hapnet import cli
from hapnet.ext.doctor.machine import Check
from tests.doctor.test_own_damping import bound
from tests.support.processes import Program


@pytest.mark.slow
def test_an_emulated_axis_in_real_time(tmp_path: Path) -> None:
    """Over the serial protocol: 40 s. What its handle has is not sent over the wire."""
    link, reported = tmp_path / "axis", tmp_path / "doctor.json"
    free = [word for part in ("mass", "damping", "stiffness") for word in ("--set", f"operator_model.{part}=0")]
    with Program("emulate", f"serial:link={link}", *free, "--set", "device.own_damping=0.4") as emulator:
        emulator.until_line("emulates serial")
        assert cli.main(["doctor", "--device", f"serial:{link}", "--damping", "0.3", "--json", str(reported)]) == 0
        (row,) = [row for row in json.loads(reported.read_text("utf-8")) if row["name"] == "own damping"]
        assert 0.2 <= bound(Check(**row)) <= 0.4
