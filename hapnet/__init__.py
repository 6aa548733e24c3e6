"""hapnet: passive haptics over bad networks.

>>> from hapnet import Params, simulate
>>> result = simulate(Params().set({"link.up": "4g", "link.down": "4g"}), seed=1)
>>> result.summary["theorem"]["margin_J"] > 0.0
True
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hapnet.control.pspm import SetPositionModulator
    from hapnet.errors import HapnetError, InvalidParameter
    from hapnet.params import Params
    from hapnet.plant.integrator import PassiveIntegrator
    from hapnet.runtime.batch.run import simulate_batch
    from hapnet.runtime.virtual import simulate

_HOMES = {
    "HapnetError": "hapnet.errors",
    "InvalidParameter": "hapnet.errors",
    "Params": "hapnet.params",
    "PassiveIntegrator": "hapnet.plant.integrator",
    "SetPositionModulator": "hapnet.control.pspm",
    "simulate": "hapnet.runtime.virtual",
    "simulate_batch": "hapnet.runtime.batch.run",
}

__all__ = [
    "HapnetError",
    "InvalidParameter",
    "Params",
    "PassiveIntegrator",
    "SetPositionModulator",
    "simulate",
    "simulate_batch",
]


def __getattr__(name: str) -> Any:
    """Public names are loaded on first use: a command's --help needs neither numpy nor Zenoh."""
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'hapnet' has no attribute {name!r}")
