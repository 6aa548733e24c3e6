"""Estimates a run's memory before it begins, and refuses a run that does not fit into this machine's memory."""

from __future__ import annotations

import math
import os
from contextlib import suppress

from hapnet.errors import InvalidParameter
from hapnet.params import Params


def installed_bytes() -> float:
    """This machine's memory; infinite where it is not known."""
    if hasattr(os, "sysconf"):
        with suppress(OSError, ValueError):
            return float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    return math.inf


def bytes_a_second(params: Params, dof: int) -> float:
    """The size of a recording in memory per simulated second. Measured: 2.2 kB a sample for one axis, 3.2 for three."""
    steps_hz = 2.0 / (params.world.step_min_s + params.world.step_max_s)
    return (min(params.record_hz, params.device.servo_hz) + steps_hz) * (1700.0 + 510.0 * dof)


def require_room(name: str, value: object, amount: float, each_bytes: float, unit: str) -> None:
    """Raise InvalidParameter unless `amount` times `each_bytes` fits; `unit` names what is counted."""
    have = installed_bytes()
    if amount * each_bytes <= have:
        return
    most = f"at most {have // each_bytes:,.0f} {unit} at {_words(each_bytes)} each"
    need = f"{amount:,.0f} need {_words(amount * each_bytes)} of memory, and this machine has {_words(have)}"
    raise InvalidParameter(name, value, f"{most}: {need}")


def _words(size: float) -> str:
    for unit in ("B", "kB", "MB", "GB", "TB", "PB"):
        if size < 1000.0 or unit == "PB":
            return f"{size:.3g} {unit}"
        size /= 1000.0
    raise AssertionError
