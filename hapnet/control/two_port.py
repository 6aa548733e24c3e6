"""Theorem 1 during a run: the energy put in at both ports, in virtual time."""

from __future__ import annotations

import math

from hapnet.records.record import Record, equation


class TwoPort(Record):
    """Theorem 1 over both ports: the minimum over time of the energy put in at both; with d^2 added, the margin.

    For every time T the world's sum includes the step that has begun by then. A step's work is known only at its end.
    So each step is paired with the smallest work of the device's port since it began, both with and without that step.

    Attributes
    ----------
    minimum : the smallest sum up to the running step [J]. at_device, at_world : the ports' W [J].
    device_low : the smallest W of the device since the running step began; device_min : before that.
    before : the minimum up to the end of the start phase; NaN: the phase has not ended. open : the smallest W of the
        device in the step in which that phase ended, up to its end; NaN: no such step is running.
    """

    minimum: float
    at_device: float
    device_low: float
    device_min: float
    at_world: float
    before: float
    open: float

    def __init__(self) -> None:
        super().__init__()
        self.before = self.open = math.nan

    @equation
    def begin(self) -> None:
        """End the start phase: `later` counts from now on."""
        lowest = min(self.minimum, self.device_low + self.at_world)
        self.before = lowest if math.isnan(self.before) else min(lowest, self.before)
        self.device_min = min(self.device_min, self.device_low)
        self.open = self.device_low
        self.minimum, self.device_low = math.inf, self.at_device

    @property
    def lowest(self) -> float:
        """The minimum so far [J]. The running step counts without its work, which is known only at its end."""
        minimum = min(self.minimum, self.device_low + self.at_world)
        return minimum if math.isnan(self.before) else min(minimum, self.before)

    @property
    def later(self) -> float | None:
        """The minimum since the start phase ended [J]; None: it has not ended."""
        return None if math.isnan(self.before) else min(self.minimum, self.device_low + self.at_world)

    @property
    def now(self) -> float:
        """The energy put in at both ports so far [J]."""
        return self.at_device + self.at_world

    @property
    def device_lowest(self) -> float:
        """The minimum of the device's port alone so far [J]."""
        return min(self.device_min, self.device_low)

    @equation
    def device(self, work: float) -> None:
        """Set the device port's W so far [J]."""
        self.at_device = work
        if work < self.device_low:
            self.device_low = work

    @equation
    def world(self, work: float) -> None:
        """Set the world port's W so far, including its last step [J]."""
        if not (math.isnan(self.before) or math.isnan(self.open)):
            self.before = min(self.before, self.open + work)
            self.open = math.nan
        self.minimum = min(self.minimum, self.device_low + self.at_world, self.device_low + work)
        self.device_min = min(self.device_min, self.device_low)
        self.at_world = work
        self.device_low = self.at_device


begin, on_device, on_world = TwoPort.begin, TwoPort.device, TwoPort.world
"""The methods of `TwoPort` for equations."""
