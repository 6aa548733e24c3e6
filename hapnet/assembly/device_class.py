"""The class of a user's own device, ``module:Class``, read before a device is made; and the device's declared range."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from inspect import signature
from typing import Any

from hapnet import checks
from hapnet.devices.registry import known, options, resolve
from hapnet.errors import InvalidParameter
from hapnet.loading import load
from hapnet.params import ARMS, DeviceParams, is_simulated
from hapnet.plant.device import Device
from hapnet.plant.operating_range import SPEED_MPS, NamedValue, OperatingRange, operating_range

FOLLOWER = "follower.robot"


def allowed() -> str:
    """The allowed names and forms of a device, as text."""
    named = ", ".join(("simulated", *ARMS, *known()))
    return f"{named}, or module:Class with dof, force_limit, resolution, read and apply"


def load_class(name: str, parameter: str = "hardware") -> Callable[..., Any]:
    """Import the class, but make no device: making one may open the hardware, which only one process can do.

    Its options are already bound. parameter : the parameter that names the device.

    Raises InvalidParameter: there is no such class, or no such option; or the class lacks a method, or takes no `dof`.
    """
    target, words = resolve(name)
    found = load(parameter, target, allowed(), ("simulated", *ARMS, *known()))
    if not callable(found):
        raise InvalidParameter(parameter, name, allowed())
    if (chosen := getattr(found, "class_for_options", None)) is not None:
        found = chosen(words)
    made: Callable[..., Any] = partial(found, **options(name, found, words)) if words else found
    if why := _unusable(found, made, takes_positions=parameter == FOLLOWER and is_position_robot(found)):
        raise InvalidParameter(parameter, name, allowed(), why=why)
    return made


def is_position_robot(made: Callable[..., Any]) -> bool:
    """Whether a class makes robots that take positions: it has a method `move`, and no `apply`."""
    return callable(declared(made, "move")) and not callable(declared(made, "apply"))


def _unusable(found: Callable[..., Any], made: Callable[..., Any], *, takes_positions: bool) -> str:
    """The reason why a class cannot be a device, as far as that is known before it is made; empty: none.

    takes_positions : whether it is to be a robot that takes positions.
    """
    if isinstance(found, type) and not hasattr(found, "__getattr__"):
        gives = "move" if takes_positions else "apply"
        lacks = [method for method in ("read", gives) if not callable(getattr(found, method, None))]
        if lacks and lacks == ["apply"] and is_position_robot(found):
            return f"the class {found.__name__} takes positions, so it can only follow: --follower"
        if lacks:
            return f"the class {found.__name__} has no method {' and no method '.join(lacks)}"
    try:
        signature(made).bind(dof=1)
    except TypeError as error:
        return f"it cannot be made with dof=1: {error}"
    except ValueError:  # of a class in C
        pass
    return ""


def may_have_jaw(made: Callable[..., Any]) -> bool:
    """Whether a device can have a jaw: its class declares it, or the option `jaw` is set, or nothing is known."""
    bound = made if isinstance(made, partial) else partial(made)
    return not isinstance(bound.func, type) or bool(getattr(bound.func, "jaw", False) or bound.keywords.get("jaw"))


def servo_rate(hardware: str, wanted_hz: float) -> float:
    """The rate of the servo [Hz]: the wanted rate, or the device's own if that is lower.

    Raises InvalidParameter: there is no such device, or its rate is not a number.
    """
    own = None if is_simulated(hardware) else declared(load_class(hardware), "rate_hz")
    return wanted_hz if own is None else min(wanted_hz, checks.positive("rate_hz", own))


def is_blocking(hardware: str) -> bool:
    """Whether reading this device waits for its next reading."""
    return not is_simulated(hardware) and bool(declared(load_class(hardware), "blocking"))


def declared(made: Callable[..., Any], part: str) -> Any:
    """An attribute declared by a class, or by a function that makes devices, before the call; None: not declared."""
    return getattr(made.func if isinstance(made, partial) else made, part, None)


def declared_range(params: DeviceParams, dof: int, device: Device | None = None) -> OperatingRange:
    """The operating range: `device` declares parts of it, and `params` completes it.

    Raises InvalidParameter: a number in it is impossible.
    """

    def declared_or(part: str, name: str, value: object) -> NamedValue:
        declared = getattr(device, part, None)
        return (name, value) if declared is None else (part, declared)

    return operating_range(
        dof,
        declared_or("workspace", "device.workspace_m", params.workspace_m),
        declared_or("greatest_speed", "device.greatest_speed", _unless_declared(params.greatest_speed)),
        declared_or("stiffness_range", "device.stiffness_range", params.stiffness_range),
    )


def _unless_declared(speed: float) -> float:
    low, high = SPEED_MPS
    return min(max(10.0 * speed, low), high)
