"""Theorem 1 as a run goes on: `hapnet.simulation.two_port`."""

from __future__ import annotations

import math

from hapnet.records.equation import equation
from hapnet.records.record import Record


class TwoPort(Record):
    """The attributes of `TwoPort`; NaN stands for None."""

    lowest: float
    at_device: float
    device_low: float
    device_lowest: float
    at_world: float
    before: float
    open: float


@equation
def on_device(port: TwoPort, work: float) -> None:
    """`TwoPort.device`."""
    port.at_device = work
    if work < port.device_low:
        port.device_low = work


@equation
def on_world(port: TwoPort, work: float) -> None:
    """`TwoPort.world`."""
    if not (math.isnan(port.before) or math.isnan(port.open)):
        port.before = min(port.before, port.open + work)
        port.open = math.nan
    port.lowest = min(port.lowest, port.device_low + port.at_world, port.device_low + work)
    port.device_lowest = min(port.device_lowest, port.device_low)
    port.at_world = work
    port.device_low = port.at_device
