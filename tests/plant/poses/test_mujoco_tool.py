"""A tool in a MuJoCo model: what its coordinates say beside the engine's own motion, and runs over 4g."""

from pathlib import Path

import numpy as np
import pytest

from hapnet.errors import InvalidParameter
from hapnet.ext.engines.engine_world import EngineWorld
from hapnet.ext.tools.mujoco_tool import MujocoToolEngine
from hapnet.ext.tools.tool import box, peg
from hapnet.mechanics.pose import AXES
from hapnet.simulation.simulation import simulate
from tests.conftest import mostly_slow

pytest.importorskip("mujoco")

TABLE = """<mujoco><option timestep="0.001" gravity="0 0 -9.81"/><worldbody>
<geom type="plane" size="1 1 .1" pos="0 0 -0.03" friction="0.05"/>
{more}</worldbody></mujoco>"""
SLED = """<body pos="0.06 0 -0.01"><freejoint/><geom type="box" size=".02 .02 .02" mass="30" friction="0.05"/></body>"""


@pytest.fixture
def table(tmp_path: Path) -> str:
    (tmp_path / "table.xml").write_text(TABLE.format(more=""))
    return f"mujoco:{tmp_path / 'table.xml'}"


def test_coordinates_move_as_their_velocity_says_and_answer_to_a_push(table: str) -> None:
    """Differences of positions, and of velocities after one substep of a small force, beside what the engine says."""
    engine, rng = MujocoToolEngine(table, box((0.04, 0.03, 0.02))), np.random.default_rng(1)
    engine.substep(0.001, tuple(rng.normal(0.0, 0.5, AXES)))
    for _ in range(20):
        engine.substep(0.001, (0.0,) * AXES)
    before, v = np.array(engine.position()), np.array(engine.velocity())
    engine.substep(1e-5, (0.0,) * AXES)
    assert (np.array(engine.position()) - before) / 1e-5 == pytest.approx(v, abs=2e-3 * float(np.abs(v).max()))
    assert np.abs(v[3:]).max() > 0.01
    state = np.array(engine.save())
    engine.substep(1e-5, (0.0,) * AXES)
    plain = np.array(engine.velocity())
    for force in np.eye(AXES):
        engine.restore(state)
        engine.substep(1e-5, tuple(0.1 * force))
        gained = (np.array(engine.velocity()) - plain) / (0.1 * 1e-5)
        expected = engine.inverse_mass() @ force
        assert gained == pytest.approx(expected, abs=2e-3 * float(np.abs(expected).max() + 1.0))


def test_planes_before_it_touches_are_those_of_its_corners(table: str) -> None:
    """Each plane's depth after a small motion is the corner's, by the rotation's own formula."""
    engine = MujocoToolEngine(table, box((0.04, 0.03, 0.02)))
    engine.substep(0.001, (0.0,) * AXES)
    planes = engine.planes(engine.position(), 0.03)
    assert len(planes) == 4
    assert [plane.depth(engine.position()) < 0.0 for plane in planes] == [True] * 4
    stiffness = min(plane.stiffness for plane in planes)
    angle, down = 0.01, -0.002
    x = (0.0, 0.0, down, 0.0, 0.0, 0.0, 0.0, 0.04 * (np.cos(angle) - 1.0), 0.04 * np.sin(angle), 0.0,
         -0.04 * np.sin(angle), 0.04 * (np.cos(angle) - 1.0))  # fmt: skip
    heights = sorted(side * 0.015 * np.sin(angle) - 0.01 * np.cos(angle) + down + 0.03 for side in (-1, -1, 1, 1))
    sizes = [np.sqrt(plane.stiffness / stiffness) for plane in planes]
    scale = 0.02 / -planes[0].depth(engine.position())  # 20 mm above the table
    found = sorted(-plane.depth(x) * scale / sizes[0] * size for plane, size in zip(planes, sizes, strict=True))
    assert found == pytest.approx(heights, abs=2e-5)


@pytest.mark.parametrize("turn_rad", mostly_slow([0.3, 0.1], 1))
def test_a_box_on_a_table_over_4g(table: str, turn_rad: float) -> None:
    result = simulate(
        {"scene": f"tool:box + {table}", "link.up": "4g", "link.down": "4g", "duration_s": 4.0,
         "operator_model.turn_rad": turn_rad}
    )  # fmt: skip
    summary = result.summary
    assert summary["verdict"]["passive"]
    assert summary["motion"]["contacts"]
    assert summary["motion"]["peak_torque_Nm"] > 0.01
    for side in ("device", "world"):
        assert summary[side]["ledger"]["slack_J"] >= -1e-13
    assert summary["environment"]["env_slack_J"] >= -1e-13


def test_a_peg_pushes_a_sled(tmp_path: Path) -> None:
    (tmp_path / "sled.xml").write_text(TABLE.format(more=SLED))
    engine = MujocoToolEngine(f"mujoco:{tmp_path / 'sled.xml'}", peg(0.005, 0.03))
    world = EngineWorld(engine)
    mass, start = world.proxy(0.02, 14.0, 500.0), float(engine.found.data.xpos[1, 0])
    for k in range(100):
        step = mass.step(0.02, (min(0.08, 0.001 * k), *(0.0,) * 11), world)
    assert float(engine.found.data.xpos[1, 0]) > start + 0.01
    assert step.force[0] < 0.0
    assert world.observed.given_J < 1e-3


def test_a_model_goes_with_no_other_solids(table: str) -> None:
    with pytest.raises(InvalidParameter, match=r"a tool and one mujoco:FILE\.xml"):
        simulate({"scene": f"tool:box + {table} + sphere", "duration_s": 0.1})
