"""The MuJoCo models that come with gymnasium and dm_control, as their authors wrote them.

Only the packages' files are needed: `pip install --no-deps gymnasium dm_control`.
"""

from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapnet.errors import InvalidParameter
from hapnet.ext.engines.mujoco_engine import mujoco_world
from hapnet.params import Params
from hapnet.simulation.simulation import Simulation
from tests.support.mujoco_models import found_of

mujoco: Any = pytest.importorskip("mujoco", reason="MuJoCo is not installed: hapnet-haptics[mujoco]")

PACKAGES = {"gymnasium": "envs/mujoco/assets", "dm_control": ""}


def _files() -> Iterator[Any]:
    for name, folder in PACKAGES.items():
        spec = find_spec(name)
        for place in (spec.submodule_search_locations or ()) if spec else ():
            for file in sorted(Path(place, folder).rglob("*.xml")):
                yield pytest.param(file, id=f"{name}/{file.relative_to(place)}")


FILES = [*_files()] or [pytest.param(None, marks=pytest.mark.skip("gymnasium and dm_control are not installed"))]

EVERY_THIRD = [
    pytest.param(*one.values, id=one.id, marks=[*one.marks, *[pytest.mark.soak] * (number % 3 > 0)])
    for number, one in enumerate(FILES)
]
"""All of them, of which the slow tests run every third."""

pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore:compiler attribute:UserWarning"),  # MuJoCo, of what a model's author wrote
]


def refusal(file: Path) -> str | None:
    """Why MuJoCo itself does not load the model; None: it does."""
    try:
        mujoco.MjSpec.from_file(str(file)).compile()
    except ValueError as error:
        return str(error).splitlines()[0]
    return None


@pytest.mark.parametrize("file", FILES)
def test_each_loads_or_is_refused_for_a_reason_that_is_its_own(file: Path) -> None:
    if (why := refusal(file)) is not None:
        with pytest.raises(InvalidParameter) as caught:
            mujoco_world(f"mujoco:{file}")
        assert why in str(caught.value)
        return
    world = mujoco_world(f"mujoco:{file}")
    world.proxy(0.123, 14.0, 500.0)
    model, own = found_of(world).model, found_of(world)
    dofs, joints = list(own.dofs), model.dof_jntid[list(own.dofs)]
    assert float(model.body_mass[own.body]) == pytest.approx(0.123, rel=1e-12)
    assert not np.any(model.dof_damping[dofs])
    assert not np.any(model.dof_armature[dofs])
    assert not np.any(model.dof_frictionloss[dofs])
    assert not np.any(model.jnt_stiffness[joints])
    assert not np.any(model.jnt_limited[joints])
    sphere = int(model.body_geomadr[own.body])
    touchable = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    met = ((model.geom_contype & model.geom_conaffinity[sphere]) != 0) | (
        (model.geom_conaffinity & model.geom_contype[sphere]) != 0
    )
    assert np.array_equal(met, touchable)


@pytest.mark.parametrize("file", EVERY_THIRD)
def test_each_runs_over_a_link_and_its_account_closes(file: Path) -> None:
    if refusal(file) is not None:
        pytest.skip("MuJoCo does not load it")
    params = {"scene": f"mujoco:{file}", "duration_s": 0.5, "operator": "sine", "link.up": "4g", "link.down": "4g"}
    summary = Simulation(Params().set(params), 1).run().summary
    assert summary["verdict"]["passive"] is True
    own = summary["environment"]
    assert own["env_slack_J"] >= -1e-12 * (1.0 + own["env_given_J"])
