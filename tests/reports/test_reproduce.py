import numpy as np
import pytest

from hapnet.ext.pictures.commands import SECTION_4
from hapnet.ext.pictures.paper import profiles
from hapnet.params import Params
from hapnet.simulation.simulation import simulate


@pytest.mark.parametrize(
    ("changes", "ratio"),
    [
        ({}, 5.0),
        ({"world.stiffness": 240.0}, 2.4),
        ({"device.stiffness": ((125.0,),), "world.stiffness": (250.0,)}, 2.0),
    ],
)
def test_the_walls_force_is_divided_by_the_ratio_of_the_run(changes: dict[str, object], ratio: float) -> None:
    params = Params().set({**SECTION_4, "duration_s": 1.5, **changes})
    recording = simulate(params, 1).recording
    axes = profiles(recording, params).axes[1]
    (curve,) = (line for line in axes.get_lines() if str(line.get_label()).endswith(f"divided by K'/K = {ratio:g}"))
    force = recording.world["contact_force_N"][:, 0]
    assert np.abs(force).max() > 0.1
    np.testing.assert_allclose(curve.get_ydata(), -force / ratio, rtol=1e-12)
