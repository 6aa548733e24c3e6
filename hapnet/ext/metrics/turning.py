"""Metrics of a tool that turns, without a value in other runs: the angle between device and proxy, and the torque."""

from __future__ import annotations

import math

from hapnet.ext.metrics.force import force_error, force_meanwhile, largest_step, rms_difference
from hapnet.ext.metrics.measured import Measured, metric, scaled
from hapnet.recording.poses import of_turning
from hapnet.recording.samples import Recording


@metric("angle between, free", "°", "lower", over="time with the proxy touching nothing")
def free_rms_deg(run: Measured) -> float | None:
    """Root mean square of the angle between device and proxy at the same time, while the proxy touches nothing."""
    return scaled(run.summary["motion"]["free_rms_rad"], math.degrees(1.0))


@metric("angle between, contact", "°", "lower", over="time with the proxy touching a solid")
def contact_rms_deg(run: Measured) -> float | None:
    """Root mean square of the angle between device and proxy at the same time, while the proxy touches a solid."""
    return scaled(run.summary["motion"]["contact_rms_rad"], math.degrees(1.0))


@metric("peak torque", "Nm", "lower", over="extreme over the recorded ticks")
def peak_torque_Nm(run: Measured) -> float | None:
    """Largest torque on the device."""
    return run.summary["motion"]["peak_torque_Nm"]


@metric("largest torque step", "Nm", "lower", over="extreme over neighbouring ticks")
def torque_step_Nm(run: Measured) -> float | None:
    """The largest change of the torque on the device from one servo tick to the next."""
    return None if run.turning is None or run.turning.device is None else largest_step(run.turning.device)


@metric("torque error", "%", "lower", over="time in which both runs have begun")
def torque_error_percent(run: Measured) -> float | None:
    """As the force error: root mean square of the difference between the torque on the device and the torque in the
    same run over an ideal link, in % of the ideal run's peak torque."""
    ideal = _turning(run.ideal)
    found = None if run.turning is None or ideal is None else force_error(run.turning, ideal)
    return None if found is None else found[1]


@metric("true torque error", "%", "lower", over="time")
def true_torque_error_percent(run: Measured) -> float | None:
    """As the true force error: root mean square of the difference from the torque at the same time in the same run
    over an ideal link, with a world that steps at 1 kHz; in % of its peak."""
    local = _turning(run.local)
    if run.turning is None or run.turning.device is None or local is None:
        return None
    return rms_difference(run.turning.device, force_meanwhile(run.turning, local))[1]


def _turning(recording: Recording | None) -> Recording | None:
    return None if recording is None else of_turning(recording)
