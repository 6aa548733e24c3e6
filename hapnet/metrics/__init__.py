"""Figures of merit of a run: tracking error, rendered force, messages sent, and passivity."""

from __future__ import annotations

from hapnet.metrics.definitions import METRICS as METRICS
from hapnet.metrics.definitions import Metric as Metric
from hapnet.metrics.position import motion as motion
