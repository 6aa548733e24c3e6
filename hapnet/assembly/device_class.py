"""The class of a user's own device, given as ``module:Class``: found by its name, and asked before a device is made."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from hapnet import checks
from hapnet.devices.registry import known, options, resolve
from hapnet.errors import InvalidParameter
from hapnet.loading import load
from hapnet.params import ARMS, Params, is_simulated


def allowed() -> str:
    """The names and forms that a device can be given as, as text."""
    named = ", ".join(("simulated", *ARMS, *known()))
    return f"{named}, or module:Class with dof, force_limit, resolution, read and apply"


def load_class(name: str, parameter: str = "hardware") -> Callable[..., Any]:
    """Import the class, but make no device: that may open the hardware, which only one process can do.

    Its options are bound already. parameter : that names it.

    Raises InvalidParameter: there is no such class, or no such option.
    """
    target, words = resolve(name)
    found = load(parameter, target, allowed(), ("simulated", *ARMS, *known()))
    if not callable(found):
        raise InvalidParameter(parameter, name, allowed())
    return partial(found, **options(name, found, words)) if words else found


def servo_rate(params: Params) -> float:
    """The rate of the servo [Hz]: the device's own, if that is below the one that the parameters give.

    Raises InvalidParameter: there is no such device, or its rate is not a number.
    """
    wanted = params.device.servo_hz
    if is_simulated(params.hardware):
        return wanted
    own = declared(load_class(params.hardware), "rate_hz")
    return wanted if own is None else min(wanted, checks.positive("rate_hz", own))


def is_blocking(hardware: str) -> bool:
    """Whether reading this device waits for its next reading."""
    return not is_simulated(hardware) and bool(declared(load_class(hardware), "blocking"))


def declared(made: Callable[..., Any], part: str) -> Any:
    """The declaration of a class, or of a function that makes devices, before it is called; None: there is none."""
    return getattr(made.func if isinstance(made, partial) else made, part, None)
