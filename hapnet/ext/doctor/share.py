"""The report of `hapnet doctor --device NAME --share`, for others to read: a file and a picture.

The file holds what was measured and declared. It holds no names, addresses, serial numbers or paths: of the device's
text only the driver's name, of a run only the figures listed here.
"""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from importlib import metadata
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from hapnet.assembly.user_device import UserDevice
from hapnet.devices.registry import known
from hapnet.errors import InvalidParameter, OutputError, RecordingError
from hapnet.ext.doctor.machine import WARNING, Check
from hapnet.processes import start
from hapnet.recording.mcap import read_recording
from hapnet.recording.whole_file import complete_or_absent
from hapnet.summary.structure import Summary
from hapnet.summary.words import get

FORMAT = "hapnet device report, version 1"

LINKS = ("lan", "4g")
"""The links of the two runs at a wall."""

RUN_S, LEAST_RUN_S, MOST_RUN_S = 60.0, 3.0, 600.0
"""The length of each run by default, at least and at most [s]."""

PUSH_N = 0.3
"""The force of the pushes, unless the user gives another, or the device has less [N]."""

SHOWN_S, SHOWN_HZ = 10.0, 100.0
"""The length of the part of a run that the file holds [s], and its rows a second."""

FIGURES = {
    "passive": "verdict.passive",
    "margin_J": "theorem.margin_J",
    "bound_J": "theorem.bound_J",
    "wall_N_m": "environment.stiffness_N_m",
    "felt_N_m": "environment.felt_stiffness_N_m",
    "local_limit_N_m": "environment.local_limit_N_m",
    "modulated_share": "device.modulated_share",
    "ticks": "device.servo.ticks",
    "skipped": "device.servo.skipped",
    "late_p99_us": "device.servo.late_p99_us",
    "longest_ms": "device.servo.longest_ms",
    "without_force_s": "device.servo.without_force_s",
    "force": "device.force",
    "missed_readings": "device.driver.missed",
    "silences": "device.driver.silences",
    "contacts": "motion.contacts",
    "peak_force_N": "motion.peak_force_N",
    "free_rms_m": "motion.free_rms_m",
    "speed_max_mps": "device.speed_max_mps",
    "round_trip_p50_ms": "path.round_trip_p50_ms",
}
"""The figures of a run that the file holds, and their places in its summary."""


class Files:
    """The paths of the file and the picture, in `folder`. Raises InvalidParameter: one of them is there already."""

    def __init__(self, hardware: str, folder: Path) -> None:
        stem = f"hapnet-{driver_of(hardware)}"
        self.report, self.picture = folder / f"{stem}.json", folder / f"{stem}.png"
        for path in (self.report, self.picture):
            if path.exists():
                raise InvalidParameter("--share", path.name, "", why="this file exists: move it, or remove it")


def run_length(seconds: float | None) -> float:
    """The length of a run [s]; None: the default. Raises InvalidParameter."""
    if seconds is None:
        return RUN_S
    if not LEAST_RUN_S <= seconds <= MOST_RUN_S:
        raise InvalidParameter("--duration", seconds, f"{LEAST_RUN_S:g} to {MOST_RUN_S:g} s")
    return seconds


def driver_of(hardware: str) -> str:
    """The driver's name in a device's text; that of a user's own is not told."""
    name = hardware.partition(":")[0]
    return name if name in known() else "own"


def push_N(device: UserDevice) -> float:
    """The force of the pushes [N]; 0: the device has no motors, or too weak ones."""
    limit = device.force_limit
    return PUSH_N if limit is None else min(PUSH_N, 0.5 * limit)


def declared(device: UserDevice) -> dict[str, Any]:
    """The driver's declarations."""
    return {
        "axes": device.dof,
        "rate_hz": device.rate_hz,
        "force_limit_N": device.force_limit,
        "resolution_m": device.resolution,
        "smallest_mass_kg": device.smallest_mass,
        "watchdog_s": device.watchdog_s,
        "dead_man_switch": device.dead_man is not None,
    }


def machine() -> dict[str, Any]:
    """The kind of this machine."""
    return {
        "hapnet": metadata.version("hapnet-haptics"),
        "python": platform.python_version(),
        "system": f"{platform.system()} {'.'.join(platform.release().split('.')[:2])}",
        "processor": platform.machine(),
        "processors": os.cpu_count(),
    }


def run_at_a_wall(hardware: str, dof: int, link: str, duration_s: float) -> dict[str, Any]:
    """Run both sides with the device at a wall, over an emulated link: its figures, and `SHOWN_S` of it."""
    with TemporaryDirectory() as folder:
        argv = [
            *("run", "--device", hardware, "--dof", str(dof), "--scene", "wall", "--link", link),
            *("--duration", f"{duration_s:g}", "--json", "-", "--out", folder),
        ]
        program = start.started(start.module("hapnet", *argv), stdout=start.PIPE)
        stdout, _ = program.communicate()
        found: dict[str, Any] = {"exit_code": program.returncode}
        try:
            summary: Summary = json.loads(stdout)
        except json.JSONDecodeError:
            return found
        found |= {name: get(summary, *place.split(".")) for name, place in FIGURES.items()}
        found["shown"] = {}
        with suppress(RecordingError):  # a run that failed may have none
            if (recorded := read_recording(Path(folder) / "device.mcap").device) is not None:
                found["shown"] = shown(recorded)
    return found


def shown(rows: Mapping[str, Any]) -> dict[str, list[Any]]:
    """The part of a run around its greatest force: times [s], and along the axis of that force places and force."""
    time_s = (rows["time_ns"] - rows["time_ns"][0]) * 1e-9
    force = np.asarray(rows["force_N"])
    at, axis = np.unravel_index(np.argmax(np.abs(force)), force.shape)
    start_s = max(0.0, min(time_s[at] - SHOWN_S / 2.0, time_s[-1] - SHOWN_S))
    wanted = np.arange(start_s, min(start_s + SHOWN_S, time_s[-1]), 1.0 / SHOWN_HZ)
    k = np.searchsorted(time_s, wanted)
    part = {"time_s": time_s[k] - start_s, "force_N": force[k, axis]}
    for name, column in (("position_mm", "position_m"), ("set_position_mm", "set_position_m")):
        part[name] = 1e3 * np.asarray(rows[column])[k, axis]
    return {name: np.round(values, 4).tolist() for name, values in part.items()}


def findings(checks: Iterable[Check], runs: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """The reasons against the device, a line each; none: it works."""
    found = [f"{check.name}: {check.value}" for check in checks if check.state == WARNING]
    for link, run in runs.items():
        if run["exit_code"] != 0:
            found.append(f"{link}: the run ended with exit code {run['exit_code']}")
        elif run["passive"] is not True:
            found.append(f"{link}: not shown to be passive")
        elif not run["contacts"]:
            found.append(f"{link}: the wall was not touched")
        else:
            ticks, skipped = run["ticks"], run["skipped"]
            if skipped > 0.01 * (ticks + skipped):
                found.append(f"{link}: {skipped} of {ticks + skipped} ticks skipped")
            if silences := run["silences"]:
                found.append(f"{link}: the device fell silent {silences} time{'s' * (silences > 1)}")
    return found


def report(
    hardware: str, said: Mapping[str, Any], checks: Sequence[Check], runs: Mapping[str, Mapping[str, Any]]
) -> dict[str, Any]:
    """The whole report; `said`: the driver's declarations."""
    return {
        "format": FORMAT,
        "driver": driver_of(hardware),
        "made_with": machine(),
        "declared": dict(said),
        "checks": [{"name": check.name, "state": check.state, "value": check.value} for check in checks],
        "runs": {link: dict(run) for link, run in runs.items()},
        "findings": findings(checks, runs),
    }


def write(made: Mapping[str, Any], files: Files, draw: Callable[[Mapping[str, Any], Path], object]) -> None:
    """Write the report, and its picture by `draw`. Raises OutputError."""
    with complete_or_absent(files.report, "", OutputError) as part:
        part.write_text(json.dumps(made, indent=1) + "\n", "utf-8")
    draw(made, files.picture)
