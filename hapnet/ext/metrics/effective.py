"""Effective delay and error of the motion: how late, and how wrong, the world follows the device.

After the effective time- and value-offset (ETVO; Kroep et al., IEEE TMC 23(3), 2024): a delay that was
compensated does not count, and an error that is only a delay does not count as an error. Kroep et al. find an offset
for each sample by dynamic time warping; here one delay stands for the whole run, the one with the smallest error.
"""

from __future__ import annotations

import numpy as np

from hapnet.checks import Array
from hapnet.ext.metrics.measured import Mask, Measured, metric

EARLIEST_S, LATEST_S = -0.2, 1.2
"""The range of delays that are tried [s]; below 0 the world is ahead, as with a prediction."""

COARSE_S, FINE_S = 0.005, 0.0005
_MOST, _FEWEST = 20_000, 100


@metric("effective delay", "ms", "nearer 0", over="time with the device in no wall")
def effective_delay_ms(run: Measured) -> float | None:
    """The delay by which the proxy's motion fits the device's best, from -200 to 1200 ms, while the device is in no
    wall; a prediction makes it smaller than the link's (after ETVO: Kroep et al. 2024)."""
    return None if (found := run.once(_effective)) is None else 1e3 * found[0]


@metric("effective error", "mm", "lower", over="time with the device in no wall")
def effective_error_mm(run: Measured) -> float | None:
    """Root mean square of the distance between device and proxy at the effective delay, while the device is in no
    wall."""
    return None if (found := run.once(_effective)) is None else 1e3 * found[1]


def _effective(run: Measured) -> tuple[float, float] | None:
    if run.inside is None or run.world is None or not run.recording.meta.get("aligned", True):
        return None
    device, world = run.device, run.world
    return effective_offset(device["time_s"], device["position_m"], ~run.inside, world["time_s"], world["position_m"])


def effective_offset(
    times: Array, sent: Array, counts: Mask, received_times: Array, received: Array
) -> tuple[float, float] | None:
    """(the delay with the smallest root mean square error [s], that error [m]) of a signal that was sent and received.

    times (N,) [s], sent (N, n) [m] : counts (N,) : the samples that count. received_times (M,), received (M, n) : of
    the signal as it was received, linear in between. None: fewer than 100 samples count at every delay that is tried.
    """
    if not len(received_times):
        return None
    whole = counts & (times + EARLIEST_S >= received_times[0]) & (times + LATEST_S <= received_times[-1])
    chosen = np.flatnonzero(whole)
    if len(chosen) < _FEWEST:
        return None
    chosen = chosen[:: 1 + len(chosen) // _MOST]
    at, wanted = times[chosen], sent[chosen]

    def error(delay_s: float) -> float:
        found = np.column_stack([np.interp(at + delay_s, received_times, axis) for axis in received.T])
        return float(np.sqrt(np.mean(np.sum((found - wanted) ** 2, axis=1))))

    coarse = min(np.arange(EARLIEST_S, LATEST_S + COARSE_S / 2.0, COARSE_S).tolist(), key=error)
    near = np.arange(max(coarse - COARSE_S, EARLIEST_S), min(coarse + COARSE_S, LATEST_S) + FINE_S / 2.0, FINE_S)
    delay_s = min(near.tolist(), key=error)
    return delay_s, error(delay_s)
