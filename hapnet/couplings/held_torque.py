"""Builds the guard of a held torque from what the device declares; see hapnet/control/reserve.py."""

from __future__ import annotations

import math

import numpy as np

from hapnet import checks
from hapnet.control.harvest import damping_conditions
from hapnet.control.reserve import ForceGuard, Holding, reserve
from hapnet.control.set_position_servo import Harvest
from hapnet.errors import InvalidParameter
from hapnet.mechanics.encoders import rounding
from hapnet.params import DeviceParams

UNKNOWN_MASS = 1e9
"""The mass of a device that does not declare its own [kg]: so heavy that no torque accelerates it."""

LIGHT_MASS = 0.01
"""The smallest mass of a handle that a hand can hold [kg]."""

RESERVED_SHARE = 0.7
"""Largest share of the ceiling that is kept in reserve: the spring needs the rest to move."""


def guard(device: DeviceParams, harvest: Harvest, dof: int) -> tuple[ForceGuard, Holding]:
    """The guard of the force, and the values it was computed from.

    The guard limits the force. If the force's work is measured, it also keeps the force within the energy account.
    """
    period, speed = 1.0 / device.servo_hz, device.greatest_speed
    holding = _holding(device, dof)
    measured = harvest == "measured"
    return (
        ForceGuard(
            limit=device.force_limit_N or math.inf,
            step=device.step_limit_N or math.inf,
            reach=speed * period + rounding(device.resolution_m, dof) if measured else 0.0,
            speed=speed if measured else math.inf,
            inertia=device.mass / period,
        ),
        holding,
    )


def _holding(device: DeviceParams, dof: int) -> Holding:
    period, speed = 1.0 / device.servo_hz, device.greatest_speed
    hold = period + device.watchdog_s
    needed = reserve(
        stiffness=float(np.linalg.eigvalsh(checks.spd("device.stiffness", device.stiffness, dof))[-1]),
        damping=max(checks.diagonal("device.damping", device.damping, dof)),
        speed=speed,
        period=period,
        hold=hold,
        rounding=rounding(device.resolution_m, dof),
        limit=device.force_limit_N or math.inf,
        step=device.step_limit_N or math.inf,
    )
    far = speed * hold + rounding(device.resolution_m, dof)
    drag = speed * max(checks.diagonal("device.damping", device.damping, dof))
    return Holding(speed, hold, needed, min(needed, device.ceiling_J * RESERVED_SHARE), far, drag)


def ceiling_for(device: DeviceParams) -> float:
    """The ceiling that covers a held torque of this device's spring on one axis [J]; infinite if no ceiling does."""
    return _holding(device, 1).needed / RESERVED_SHARE


def check(device: DeviceParams, harvest: Harvest, dof: int) -> list[str]:
    """Warnings about forces that will be limited, or that may output more energy than the account holds.

    Raises InvalidParameter: the range harvest is set, but the device has less own damping than a held spring needs.
    """
    if harvest == "range":
        return _range(device, dof)
    warnings = []
    holding = _holding(device, dof)
    if holding.reserve < holding.needed:
        ceiling_J = holding.needed / RESERVED_SHARE
        enough = f"device.ceiling_J={ceiling_J:.3g} would do" if holding.needed < math.inf else "none is enough"
        warnings.append(
            f"device.ceiling_J {device.ceiling_J:g} keeps {holding.reserve:.3g} J in reserve, too little for a force "
            f"that is held for {holding.time:g} s at up to {holding.speed:g} m/s ({enough}): a low reservoir limits "
            f"the force, and a servo that stops may output more energy than the account held"
        )
    B = max(checks.diagonal("device.damping", device.damping, dof))
    floor = B / device.servo_hz / 2.0  # B T < 2 m: a lighter device is reversed at each tick, faster each time
    if device.mass <= floor:
        warnings.append(
            f"device.damping {B:g} is held for a tick and slows down only masses above {floor:.3g} kg; this device has "
            f"{device.mass:g} kg, so its damper is limited by the energy account and the maximum speed"
        )
    elif device.mass == UNKNOWN_MASS and floor > LIGHT_MASS:
        warnings.append(
            f"device.damping {B:g} is held for a tick and slows down only masses above {floor:.3g} kg; this device may "
            f"be lighter, as it declares no smallest_mass"
        )
    return warnings


def _range(device: DeviceParams, dof: int) -> list[str]:
    K = checks.spd("device.stiffness", device.stiffness, dof)
    B = checks.diagonal("device.damping", device.damping, dof)
    own = (device.own_damping,) * dof
    period = 1.0 / device.servo_hz
    necessary, _ = damping_conditions(own, tuple(np.diagonal(K).tolist()), B, period)
    rows = tuple(np.abs(K).sum(axis=1).tolist())  # Gershgorin bounds, for a K that couples the axes
    need = max(k * period / 2.0 + 2.0 * b for k, b in zip(rows, B, strict=True))
    if not necessary:
        floor = float(np.max(np.diagonal(K))) * period / 2.0
        raise InvalidParameter(
            "device.harvest", "range",
            f"measured, with a sampled servo on a device with {device.own_damping:g} Ns/m of own damping: range needs "
            f"more than K T/2 = {floor:.3g} Ns/m, and is passive for any motion above {need:.3g} Ns/m",
        )  # fmt: skip
    if damping_conditions(own, rows, B, period)[1]:
        return []
    return [
        f"the range harvest may not be passive with a sampled servo: the device's own damping is {device.own_damping} "
        f"Ns/m, and it is passive for any motion only above {need:.3g} Ns/m; use device.harvest=measured"
    ]
