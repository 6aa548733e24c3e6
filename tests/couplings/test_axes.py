"""Axes are alike: with all of them in another order, a run is the same in that order."""

import math
from typing import Any

import numpy as np
import pytest

from hapnet.assembly.scenes import for_its_scene
from hapnet.checks import Vector
from hapnet.couplings.registry import COUPLINGS
from hapnet.ext.solids.rigid import RigidScene, rigid
from hapnet.params import Params
from hapnet.plant.operator import Impedance
from hapnet.simulation.result import Result
from hapnet.simulation.simulation import Simulation
from tests.conftest import mostly_slow

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
OF_ONE_STIFFNESS = {"tdpa", "wave", "digital-wave", "pd", "two-layer"}
LOSSY = {"link.up": "delay 40ms 10ms loss 20%", "link.down": "delay 20ms loss 20%"}
"""Not with a contact model: of the box's six walls the first four are sent of those that are as near as others."""
RUN = {"scene": "box", "dof": 3, "duration_s": 1.5, "world.wall.half_width_m": 0.012, "record_hz": 1000.0}
"""In all corners of a box that is small beside the hand's motion."""


def solids(order: tuple[int, ...] = (0, 1, 2)) -> RigidScene:
    """On all sides of the hand's motion, with all that a surface may have."""

    def words(*numbers: float, unit: str = "mm") -> str:
        return ",".join(f"{numbers[axis]}{unit}" for axis in order)

    return rigid(
        f"sphere?at={words(32, 8, -6)}&radius=15mm&friction=0.5&texture=0.8,4mm&viscosity=1"
        f" + cuboid?at={words(-35, -3, 4)}&size={words(30, 90, 70)}&friction=0.3&stick=0.8&snap=1,2mm"
        f" + cylinder?at={words(3, 31, 2)}&radius=15mm&length=60mm&axis={'xyz'[order.index(0)]}&friction=0.4"
        f"&grain=0.1mm,5mm&grain_along={words(1.0, 0.5, 0.2, unit='')}"
        f" + plane?normal={words(0.2, -0.3, -0.9, unit='')}&at={words(0, 0, -15)}&relief=0.5mm,9mm&friction=0.2"
    )


def solids_reordered() -> RigidScene:
    return solids(ORDER)


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


SOLIDS = {"scene": f"{__name__}:solids", "duration_s": 1.0, "coupling": "pspm", **LINKS}
WITHOUT_MASS = {name: values for name, values in OF_AXES.items() if name != "world.mass"}
STAGES = {
    "device.servo": "sampled", "device.resolution_m": 2.1e-5, "device.predict_s": 0.02, "device.smoothing_s": 0.01,
    "world.predict_s": 0.02, "world.smoothing_s": 0.01, "wire.deadband": 0.05, "operator_model.tremor_m": 0.0,
    "device.on_silence": "release", "device.silence_after_s": 0.06, "world.on_silence": "release",
    "device.trusted_damping": 0.1, **LOSSY,
}  # fmt: skip


def ran(changes: dict[str, Any], hand: type[Hand], order: tuple[int, ...], of_axes: dict[str, Any]) -> Result:
    own = {name: tuple(values[axis] for axis in order) for name, values in of_axes.items()}
    params = for_its_scene(Params().set({**RUN, **own, **changes, "operator": f"{__name__}:{hand.__name__}"}))
    return Simulation(params, 5, kernel=False).run()


def leaves(figures: Any, name: str = "") -> dict[str, float]:
    """The numbers of a summary."""
    if isinstance(figures, dict):
        return {key: value for part, whole in figures.items() for key, value in leaves(whole, f"{name}.{part}").items()}
    return {name: figures} if isinstance(figures, int | float) else {}


def assert_same(one_run: Result, other_run: Result) -> None:
    """Sums over axes have another order, so all but their rounding is the same."""
    for key in ("theorem", "device", "world", "motion"):
        assert leaves(other_run.summary[key]) == pytest.approx(leaves(one_run.summary[key]), rel=1e-6, abs=1e-9)
    one, other = one_run.recording, other_run.recording
    for columns, found in ((one.device, other.device), (one.world, other.world)):
        assert found is not None
        for name, values in columns.items():
            expected = values[:, ORDER] if values.ndim == 2 else values
            if values.dtype.kind == "f":
                np.testing.assert_allclose(found[name], expected, rtol=1e-6, atol=1e-9, err_msg=name)
        touched = columns.get("contact_force_N")
        assert touched is None or np.abs(touched).max(axis=0).min() > 0.05


@pytest.mark.parametrize("changes", [PAPER, {}], ids=["paper", "auto"])
@pytest.mark.parametrize("coupling", mostly_slow([(one,) for one in COUPLINGS], 1))
def test_axes_in_another_order_are_the_same_run_in_that_order(coupling: str, changes: dict[str, Any]) -> None:
    changes = {"coupling": coupling, **(LOSSY if changes or coupling in OF_ONE_STIFFNESS else LINKS), **changes}
    of_axes = {} if coupling in OF_ONE_STIFFNESS else OF_AXES
    assert_same(ran(changes, Hand, (0, 1, 2), of_axes), ran(changes, Reordered, ORDER, of_axes))


@pytest.mark.parametrize(
    ("changes", "of_axes"),
    mostly_slow(
        [
            ({}, OF_AXES),
            (STAGES, WITHOUT_MASS),
            ({"coupling": "wave", **LOSSY}, {}),
            ({}, WITHOUT_MASS),
            ({"coupling": "zoh", "device.servo": "sampled"}, WITHOUT_MASS),
            ({"coupling": "tdpa"}, {}),
        ],
        3,
    ),
    ids=["masses", "stages", "wave", "continuous", "zoh", "tdpa"],
)
def test_so_are_those_of_solids_that_bend_and_rub(changes: dict[str, Any], of_axes: dict[str, Any]) -> None:
    one = ran({**SOLIDS, **changes}, Hand, (0, 1, 2), of_axes)
    assert_same(one, ran({**SOLIDS, **changes, "scene": f"{__name__}:solids_reordered"}, Reordered, ORDER, of_axes))
