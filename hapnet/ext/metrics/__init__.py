"""Figures of merit of a simulated run: tracking error, rendered force, messages sent, and passivity.

Each metric is a function of a `Measured` with the decorator `metric`, in any module of this package; see `METRICS`.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from pkgutil import iter_modules
from types import MappingProxyType

from hapnet.ext.metrics.measured import DEFINED, Measures as Measures, Metric as Metric

_FIRST = ("passivity", "motion", "contact", "force")

for _module in (*_FIRST, *sorted({each.name for each in iter_modules(__path__)} - {*_FIRST})):
    import_module(f"{__name__}.{_module}")

METRICS: Mapping[str, Metric] = MappingProxyType(DEFINED)
"""Every metric by its name, first the metrics of the modules `_FIRST`."""
