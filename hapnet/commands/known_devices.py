"""The real devices that were checked on this machine, in a file of the user, who is asked once about a new device."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hapnet.checks import Vector
from hapnet.errors import RecordingError
from hapnet.param_sources import DEVICE
from hapnet.params import Params, is_simulated
from hapnet.recording.whole_file import complete_or_absent

if TYPE_CHECKING:
    from hapnet.summary.structure import Summary

MASS = "mass_kg"


def file() -> Path:
    """The path of the file."""
    return Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state") / "hapnet" / "devices.json"


def mass_of(device: str, dof: int) -> Vector | None:
    """The apparent mass of each axis, measured when the device was checked [kg]; None: the device is new here.

    Empty: it could not be measured, or the device was checked with another number of axes than `dof`.
    """
    try:
        masses = [float(mass) for mass in _all()[device][MASS]]
    except (KeyError, TypeError, ValueError):
        return None
    return tuple(masses) if len(masses) == dof else ()


def remember(device: str, mass: Vector) -> None:
    """Store that the device was checked. If the file cannot be written, the user is asked again next time."""
    known = _all()
    known[device] = {MASS: list(mass)}
    try:
        file().parent.mkdir(parents=True, exist_ok=True)
        with complete_or_absent(file(), "known devices") as part:
            part.write_text(json.dumps(known, indent=1), "utf-8")
    except (OSError, RecordingError):
        return


def introduced(params: Params, ask: Callable[[str], object] | None) -> Params:
    """The parameters, with the stored mass of the device; for a new device the user is asked first.

    ask : shows a text and waits for the user; None: no user to ask.
    """
    if not _is_pushed(params):
        return params
    if (mass := mass_of(params.hardware, params.dof)) is None:
        if ask is not None:
            ask(
                f"hapnet has not used {params.hardware} on this machine before. First it pushes the handle back and"
                f" forth with up to {params.device.self_test_N:g} N for 0.4 s, to check that it moves as it should.\n"
                "Hold the handle loosely, away from the ends of its range, and press Enter (Ctrl-C to cancel) "
            )
        return params
    if not mass or "device.known_mass_kg" in params.given:
        return params
    return params.set({"device.known_mass_kg": mass}, DEVICE)


def learn(params: Params, summary: Summary) -> None:
    """After a run: store a device that was new."""
    device = summary["device"]
    if (
        _is_pushed(params)
        and device is not None
        and device["driver"] is not None
        and mass_of(params.hardware, params.dof) is None
    ):
        remember(params.hardware, tuple(device["driver"]["mass_kg"] or ()))


def _is_pushed(params: Params) -> bool:
    return not is_simulated(params.hardware) and params.device.self_test_N > 0.0


def _all() -> dict[str, Any]:
    try:
        found = json.loads(file().read_text("utf-8"))
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}
