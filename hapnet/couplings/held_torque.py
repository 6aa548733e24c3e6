"""What a device declares of itself, made into the guard of its held torque; see hapnet/control/reserve.py."""

from __future__ import annotations

import math

import numpy as np

from hapnet import checks
from hapnet.control.harvest import damping_conditions
from hapnet.control.reserve import ForceGuard, Holding, reserve
from hapnet.control.set_position_servo import Harvest
from hapnet.errors import InvalidParameter
from hapnet.params import DeviceParams

UNKNOWN_MASS = 1e9
"""So heavy [kg] that no torque speeds it up: of a device that does not tell its own."""

RESERVED_SHARE = 0.5
"""No more of the ceiling than this is kept in reserve: the spring must be able to move with the rest."""


def guard(device: DeviceParams, harvest: Harvest, dof: int) -> tuple[ForceGuard, Holding]:
    """What keeps the force to its limits and, where its work is measured, to its account; and what it was made from."""
    period, speed = 1.0 / device.servo_hz, device.greatest_speed
    holding = _holding(device, dof)
    measured = harvest == "measured"
    return (
        ForceGuard(
            limit=device.force_limit_N or math.inf,
            step=device.step_limit_N or math.inf,
            reach=speed * period + device.resolution_m if measured else 0.0,
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
        resolution=device.resolution_m,
        limit=device.force_limit_N or math.inf,
        step=device.step_limit_N or math.inf,
    )
    return Holding(speed, hold, device.resolution_m, needed)


def check(device: DeviceParams, harvest: Harvest, dof: int) -> list[str]:
    """Warnings of what will not be rendered as asked for, or may go beyond the account.

    Raises
    ------
    InvalidParameter : the range harvest, with less of the device's own damping than any held spring needs.
    """
    if harvest == "range":
        return _range(device, dof)
    warnings = []
    holding = _holding(device, dof)
    if holding.reserve > device.ceiling_J:
        need = f"{holding.reserve:.3g} J" if holding.reserve < math.inf else "no ceiling is enough"
        warnings.append(
            f"device.ceiling_J {device.ceiling_J:g} leaves too little in reserve for a torque that is held for "
            f"{holding.time:g} s at up to {holding.speed:g} m/s ({need}): a low reservoir limits the force, and a "
            f"servo that stops may give out more than was in the account"
        )
    B = max(checks.diagonal("device.damping", device.damping, dof))
    least = B / device.servo_hz / 2.0  # B T < 2 m: a lighter one is turned round, faster each time
    if device.mass <= least:
        warnings.append(
            f"device.damping {B:g} is held for a tick, which slows down masses above {least:.3g} kg only; this device "
            f"has {device.mass:g}: the damper is rendered as far as the account and the greatest speed allow"
        )
    return warnings


def _range(device: DeviceParams, dof: int) -> list[str]:
    K = checks.spd("device.stiffness", device.stiffness, dof)
    B = checks.diagonal("device.damping", device.damping, dof)
    own = (device.own_damping,) * dof
    period = 1.0 / device.servo_hz
    necessary, _ = damping_conditions(own, tuple(np.diagonal(K).tolist()), B, period)
    rows = tuple(np.abs(K).sum(axis=1).tolist())  # bound a K that couples the axes (Gershgorin)
    need = max(k * period / 2.0 + 2.0 * b for k, b in zip(rows, B, strict=True))
    if not necessary:
        least = float(np.max(np.diagonal(K))) * period / 2.0
        raise InvalidParameter(
            "device.harvest", "range",
            f"measured with a sampled servo whose device damps by {device.own_damping:g} Ns/m: range needs more than "
            f"K T/2 = {least:.3g} of it, and is passive for any motion above {need:.3g}",
        )  # fmt: skip
    if damping_conditions(own, rows, B, period)[1]:
        return []
    return [
        f"the range harvest can be not passive with a sampled servo: own damping {device.own_damping} Ns/m, "
        f"passive for any motion above {need:.3g} Ns/m; use device.harvest=measured"
    ]
