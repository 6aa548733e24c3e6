"""Builds the conditions under which a device leads the other side: its clutch, and the switch that a hand holds."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from hapnet.errors import InvalidParameter
from hapnet.mechanics.frame import Frame
from hapnet.mechanics.pose_frame import PoseFrame
from hapnet.params import Params
from hapnet.plant.device import Device
from hapnet.side.clutch import ALLOWED, ENABLED, Clutch, button, spans
from hapnet.side.sampled_device import SampledDeviceSide
from hapnet.units import POSE


def let_lead(params: Params, units: str, side: SampledDeviceSide, *, has_switch: bool = False) -> None:
    """Set when the device leads. units : of its axes. has_switch : whether it has a dead-man switch.

    Raises InvalidParameter.
    """
    side.same = _same(units, side.device.dof)
    text = params.device.enable
    if text == "auto":
        return
    side.leads_while_held = True
    if text != "hold":
        held_at = spans("device.enable", text, ENABLED)
        side.is_held = lambda t: any(begin <= t < end for begin, end in held_at)
    elif not has_switch:
        allowed = "auto, or spans of time [s]: this device has neither a dead-man switch nor a button"
        raise InvalidParameter("device.enable", text, allowed)


def clutch_of(
    params: Params, units: str, device: Device, buttons: Callable[[], Sequence[bool]] = tuple
) -> Clutch | None:
    """The clutch of the device; None: it has none. buttons : reads the device's buttons. Raises InvalidParameter."""
    text = params.device.clutch
    if not text:
        return None
    frame = _same(units, device.dof)
    if (number := button(text)) is None:
        open_at = spans("device.clutch", text, ALLOWED)
        return Clutch(frame, lambda t: any(begin <= t < end for begin, end in open_at))
    if not number < len(buttons()):
        raise InvalidParameter("device.clutch", text, "spans of time [s], or a button that the device has")
    return Clutch(frame, lambda t: buttons()[number])


def _same(units: str, dof: int) -> Frame:
    """The frame of a coupling that has the device's own axes."""
    return PoseFrame(1.0, 1.0) if units == POSE else Frame(1.0, 1.0, (0.0,) * dof)
