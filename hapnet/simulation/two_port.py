"""Theorem 1 as a run goes on: the energy put in at both ports, in virtual time."""

from __future__ import annotations

import math
from typing import NamedTuple


class TwoPortState(NamedTuple):
    """Of a `TwoPort`, but for `device_lowest` [J]."""

    lowest: float
    """Up to the running step."""
    device: float
    device_low: float
    """The lowest since the running step began."""
    world: float
    before: float | None
    """The minimum up to the end of the start; None: that is still to come."""
    open: float | None
    """The device's lowest in the step in which the start ended, up to there; None: there is none that runs."""


class TwoPort:
    """Theorem 1 over both ports: the minimum over time of the energy put in at both, plus d^2.

    For every time T the world's sum includes the step that has begun by then. A step's work is known only at its end.
    So each step is paired with the smallest work of the device's port since it began, both with and without that step.
    """

    def __init__(self) -> None:
        self._lowest = 0.0
        self._device = 0.0
        self._device_low = 0.0
        self._device_lowest = 0.0
        self._world = 0.0
        self._before: float | None = None
        self._open: float | None = None  # the device's lowest before `begin`, in the step that was running then

    def begin(self) -> None:
        """End the start: `later` counts from now on."""
        self._before, self._device_lowest = self.lowest, self.device_lowest
        self._open = self._device_low
        self._lowest, self._device_low = math.inf, self._device

    @property
    def lowest(self) -> float:
        """The minimum so far [J]. The running step counts without its work, which is not known yet."""
        least = min(self._lowest, self._device_low + self._world)
        return least if self._before is None else min(least, self._before)

    @property
    def later(self) -> float | None:
        """The minimum since the start ended [J]; None: it has not ended."""
        return None if self._before is None else min(self._lowest, self._device_low + self._world)

    @property
    def now(self) -> float:
        """The energy put in at both ports so far [J]."""
        return self._device + self._world

    @property
    def device_lowest(self) -> float:
        """The minimum of the device's port alone so far [J]."""
        return min(self._device_lowest, self._device_low)

    def device(self, work: float) -> None:
        """Set the device port's W so far [J]."""
        self._device = work
        if work < self._device_low:
            self._device_low = work

    def world(self, work: float) -> None:
        """Set the world port's W so far, including its last step [J]."""
        if self._before is not None and self._open is not None:
            self._before, self._open = min(self._before, self._open + work), None
        self._lowest = min(self._lowest, self._device_low + self._world, self._device_low + work)
        self._device_lowest = min(self._device_lowest, self._device_low)
        self._world = work
        self._device_low = self._device

    def state(self) -> TwoPortState:
        """What `restore` takes."""
        return TwoPortState(self._lowest, self._device, self._device_low, self._world, self._before, self._open)

    def restore(self, state: TwoPortState) -> None:
        """Go on from there."""
        self._lowest, self._device, self._device_low, self._world, self._before, self._open = state
