"""The device's stiffness by rule (`hapnet.couplings.stiffness`), if the parameters set none."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np

from hapnet.assembly.choices import Choice, choosing
from hapnet.assembly.device_class import declared, load_class
from hapnet.couplings import held_torque, rendering
from hapnet.couplings.registry import coupling
from hapnet.couplings.stiffness import PAPERS, colgate_bound, default_stiffness, local_limit
from hapnet.errors import InvalidParameter
from hapnet.param_sources import RULE
from hapnet.params import DeviceParams, Params, is_simulated, known_damping

MOST_CEILING_J = 0.5
"""A stiff spring needs a full reservoir: the ceiling grows with the stiffness up to this [J], if the user set none."""

_ROUNDS = 30


def spring(params: Params) -> Choice:
    """Choose `device.stiffness` [N/m] if it is 0, and with it perhaps `device.ceiling_J`.

    The rule is for the couplings with the stages of ``rendering = "hapnet"``. All others have the paper's spring, with
    which they were tuned.

    Raises InvalidParameter: there is no such device, or no such coupling, or one axis of several has no stiffness.
    """
    stiffness = params.device.stiffness
    if isinstance(stiffness, tuple) and not np.all(np.linalg.norm(np.atleast_2d(stiffness), axis=0)):
        raise InvalidParameter("device.stiffness", stiffness, "0 for all axes (by rule), or above 0 for each")
    values: dict[str, object] = {}
    if stiffness == 0.0:
        values = _by_rule(params) if coupling(params.coupling).staged(params) else {"device.stiffness": PAPERS}
    return Choice(values, RULE)


def _by_rule(params: Params) -> dict[str, object]:
    """The rule's spring. If it is stiffer than the paper's, the ceiling must cover its held torque; a ceiling that the
    user did not set grows for it.
    """
    held, range_ = _as_declared(params), _declared_range(params)
    most = rendering.largest(params.world.stiffness) + params.world.wall.stiffness
    if held.harvest == "range":  # passive for any motion only below this (held_torque.py)
        most = min(most, colgate_bound(known_damping(params), 2.0 * float(np.max(held.damping)), held.servo_hz))
    K = default_stiffness(limit(params), most, range_, resolution_m=held.resolution_m)
    ceiling_J = held.ceiling_J
    if "device.ceiling_J" not in params.given and K > PAPERS:
        needed_J = held_torque.ceiling_for(dataclasses.replace(held, stiffness=K))
        needed_J = math.ceil(1e3 * min(needed_J, MOST_CEILING_J)) / 1e3
        ceiling_J = min(max(ceiling_J, needed_J), MOST_CEILING_J)
    chosen: dict[str, object] = {"device.stiffness": _covered(dataclasses.replace(held, ceiling_J=ceiling_J), K)}
    return chosen if ceiling_J == held.ceiling_J else {**chosen, "device.ceiling_J": ceiling_J}


def limit(params: Params) -> float:
    """The stiffest wall that the device renders without a network [N/m], as far as it is known; 0: unknown."""
    exact = is_simulated(params.hardware)
    return local_limit(known_damping(params), params.device.servo_hz, _declared_range(params), exact=exact)


def without_rule(params: Params) -> Params:
    """The reverse of `spring`: unset the values that the rule would choose again."""
    springs = ("device.stiffness", "device.ceiling_J")
    if params.asked("device.stiffness"):
        return params
    for names in (springs[:1],) if params.asked("device.ceiling_J") else (springs, springs[:1]):
        left_open = params.unset(*names)
        try:
            chosen = choosing(left_open, spring)
            if all(chosen.get(name) == params.get(name) for name in springs):
                return left_open
        except InvalidParameter:  # the device or the coupling cannot be loaded
            return params
    return params


def _as_declared(params: Params) -> DeviceParams:
    """The device's parameters, replaced by the values that its class declares."""
    device = dataclasses.replace(params.device, damping=float(np.max(params.device.damping)))
    if not is_simulated(params.hardware):
        made = load_class(params.hardware)
        limits = [limit for limit in (device.force_limit_N, declared(made, "force_limit")) if _is_number(limit)]
        values = {"greatest_speed": declared(made, "greatest_speed"), "resolution_m": declared(made, "resolution")}
        known: dict[str, Any] = {name: float(value) for name, value in values.items() if _is_number(value)}
        device = dataclasses.replace(device, force_limit_N=float(min(limits, default=0.0)), **known)
    return device


def _is_number(value: object) -> bool:
    """Whether the value is a number above 0. A class may declare a property, or nothing."""
    return isinstance(value, int | float) and value > 0


def _declared_range(params: Params) -> tuple[float, float] | None:
    """The stiffness range that the device, or else `device.stiffness_range`, declares [N/m]; None: neither does."""
    limits: Any = None if is_simulated(params.hardware) else declared(load_class(params.hardware), "stiffness_range")
    if not isinstance(limits, tuple | list):
        limits = params.device.stiffness_range if "device.stiffness_range" in params.given else None
    if limits is None:
        return None
    minimum, maximum = np.atleast_1d(limits)[[0, -1]]
    return float(np.max(minimum)), float(np.min(maximum))


def _covered(device: DeviceParams, K: float) -> float:
    """The stiffest spring from the paper's up to K whose held torque the device's ceiling covers [N/m]."""

    def covers(stiffness: float) -> bool:
        return held_torque.ceiling_for(dataclasses.replace(device, stiffness=stiffness)) <= device.ceiling_J

    if K <= PAPERS or covers(K):
        return K
    low, high = PAPERS, K
    for _ in range(_ROUNDS):
        middle = (low + high) / 2.0
        low, high = (middle, high) if covers(middle) else (low, middle)
    return float(math.floor(low))
