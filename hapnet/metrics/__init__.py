"""Figures of merit of a run: how well the proxy followed, what was felt, what was sent, and whether it was passive."""

from __future__ import annotations

from hapnet.metrics.definitions import METRICS as METRICS
from hapnet.metrics.definitions import Metric as Metric
from hapnet.metrics.position import motion as motion
