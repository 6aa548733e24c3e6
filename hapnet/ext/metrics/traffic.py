"""Metrics of the number of messages in a simulated run."""

from __future__ import annotations

import math

from hapnet.ext.metrics.measured import Measured, metric


@metric("packets", "1/s", "lower", over="duration")
def packets_per_s(run: Measured) -> float | None:
    """Messages of all kinds offered to both links per second."""
    return _per_s(run, 0) + _per_s(run, 1)


@metric("packets up", "1/s", "lower", over="duration")
def packets_up_per_s(run: Measured) -> float | None:
    """Messages of all kinds per second from the device."""
    return _per_s(run, 0)


@metric("packets down", "1/s", "lower", over="duration")
def packets_down_per_s(run: Measured) -> float | None:
    """Messages of all kinds per second from the virtual world."""
    return _per_s(run, 1)


def _per_s(run: Measured, direction: int) -> float:
    return (run.links[direction]["offered"] or 0) / (run.summary["duration_s"] or math.inf)
