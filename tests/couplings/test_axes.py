"""Axes are alike: with all of them in another order, a run is the same in that order."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from hapnet.checks import Vector
from hapnet.couplings.registry import COUPLINGS
from hapnet.params import Params
from hapnet.plant.operator import Impedance
from hapnet.recording.samples import Recording
from hapnet.simulation.simulation import Simulation

ORDER = (1, 0, 2)
"""A swap: an index that is off by one, in a ring, turns with all axes, and would be the same."""
OF_AXES = {
    "device.stiffness": (180.0, 200.0, 230.0), "device.damping": (0.5, 0.6, 0.8), "world.mass": (0.02, 0.03, 0.05),
    "world.stiffness": (400.0, 500.0, 600.0), "world.damping": (10.0, 14.0, 20.0),
}  # fmt: skip
LINKS = {"link.up": "delay 20ms 5ms", "link.down": "delay 20ms 5ms"}
PAPER = {
    "rendering": "paper", "device.resolution_m": 2e-5, "tdpa.predict": True, "device.force_limit_N": 2.0,
    "device.servo": "sampled",
}  # fmt: skip
OF_ONE_STIFFNESS = {"tdpa", "wave", "digital-wave", "pd"}
LOSSY = {"link.up": "delay 40ms 10ms loss 20%", "link.down": "delay 20ms loss 20%"}
"""Not with a contact model: of the box's six walls the first four are sent of those that are as near as others."""
RUN = {"scene": "box", "dof": 3, "duration_s": 1.5, "world.wall.half_width_m": 0.012, "record_hz": 1000.0}
"""In all corners of a box that is small beside the hand's motion."""


class Hand:
    """Each axis at a pace of its own, far enough to be in the box's walls."""

    def __init__(self, dof: int, impedance: Impedance, order: tuple[int, ...] = (0, 1, 2)) -> None:
        self.impedance = impedance
        self._order = order

    def reference(self, t: float) -> Vector:
        return tuple(0.03 * math.sin((4.0 + 1.5 * axis) * t) for axis in self._order)


class Reordered(Hand):
    def __init__(self, dof: int, impedance: Impedance) -> None:
        super().__init__(dof, impedance, ORDER)


def ran(changes: dict[str, Any], hand: type[Hand], order: tuple[int, ...]) -> Recording:
    named = {} if changes["coupling"] in OF_ONE_STIFFNESS else OF_AXES
    own = {name: tuple(values[axis] for axis in order) for name, values in named.items()}
    params = Params().set({**RUN, **own, **changes, "operator": f"{__name__}:{hand.__name__}"})
    return Simulation(params, 5, kernel=False).run().recording


@pytest.mark.parametrize("changes", [PAPER, {}], ids=["paper", "auto"])
@pytest.mark.parametrize("coupling", COUPLINGS)
def test_axes_in_another_order_are_the_same_run_in_that_order(coupling: str, changes: dict[str, Any]) -> None:
    """Sums over axes have another order then, so all but their rounding is the same."""
    changes = {"coupling": coupling, **(LOSSY if changes or coupling in OF_ONE_STIFFNESS else LINKS), **changes}
    one, other = ran(changes, Hand, (0, 1, 2)), ran(changes, Reordered, ORDER)
    for columns, found in ((one.device, other.device), (one.world, other.world)):
        assert found is not None
        for name, values in columns.items():
            expected = values[:, ORDER] if values.ndim == 2 else values
            if values.dtype.kind == "f":
                np.testing.assert_allclose(found[name], expected, rtol=1e-6, atol=1e-9, err_msg=name)
        touched = columns.get("contact_force_N")
        assert touched is None or np.abs(touched).max(axis=0).min() > 0.05
