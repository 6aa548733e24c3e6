"""Position-force with a robot that is not simulated: which drivers measure the force of its surroundings."""

from __future__ import annotations

from contextlib import suppress
from functools import partial

from hapnet.assembly.device_class import load_class
from hapnet.assembly.user_device import UserDevice
from hapnet.devices.driver import Driver
from hapnet.devices.registry import known
from hapnet.errors import DeviceSilent, InvalidParameter


def require_contact_force(hardware: str, device: UserDevice | None = None) -> None:
    """Raise InvalidParameter if this driver measures no contact force.

    device : the open driver, of which a reading must have a force; None: it is not open yet. Then only its class can be
    asked, and nothing is known of a function that makes drivers, or of a driver on the other host.
    """
    if device is not None:
        measured = _measures(device)
    else:
        try:
            measured = _may_measure(hardware)
        except InvalidParameter:
            return
    if not measured:
        have = ", ".join(filter(_named, known()))
        allowed = f"position with {hardware}, which measures no contact force: contact_force() is for that ({have})"
        raise InvalidParameter("follower.feedback", "force", allowed)


def _measures(device: UserDevice) -> bool:
    with suppress(DeviceSilent):
        device.read()
    return device.contact_force() is not None


def _may_measure(hardware: str) -> bool:
    made = load_class(hardware)
    made = made.func if isinstance(made, partial) else made
    return not isinstance(made, type) or getattr(made, "contact_force", None) not in (None, Driver.contact_force)


def _named(hardware: str) -> bool:
    with suppress(InvalidParameter):
        return _may_measure(hardware)
    return False
