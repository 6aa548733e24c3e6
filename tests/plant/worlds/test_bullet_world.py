"""The example of another engine, PyBullet: what is felt, what is undone, what comes back."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from examples.bullet_world import FRICTION, RADIUS, STIFFNESS, Boxes
from hapnet import EngineWorld, Plane, simulate
from tests.conftest import mostly_slow

pytest.importorskip("pybullet", reason="PyBullet is not installed: pip install pybullet")

pytestmark = pytest.mark.slow  # CI has PyBullet for the slow tests

K_PROXY = 500.0
FACE = 0.03 - RADIUS
"""Where the ball's centre just touches the block [m]."""


def made() -> tuple[EngineWorld, Any]:
    world = EngineWorld(Boxes())
    return world, world.proxy(0.02, 14.0, K_PROXY)


@pytest.mark.parametrize(
    ("operator", "seconds"),
    mostly_slow([("press", 2.0), ("sine", 2.0), *((one, 6.0) for one in ("press", "hand-6", "sine", "hand-3"))], 0, 2),
)
def test_over_4g_it_is_passive_and_nothing_is_undone(operator: str, seconds: float) -> None:
    link = {"link.up": "4g", "link.down": "4g", "duration_s": seconds}
    result = simulate({"scene": "examples.bullet_world:Boxes", "operator": operator, **link}, seed=1)
    own, world = result.summary["environment"], result.recording.world
    assert result.summary["verdict"]["passive"] is True
    assert own["env_slack_J"] >= 0.0
    assert own["env_undone"] == 0
    assert np.abs(world["contact_force_N"]).max() > 1.0  # it is felt


def test_what_it_makes_at_long_substeps_is_paid_or_undone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Over the table with substeps of 5 ms its contacts give out energy; the world does not."""
    monkeypatch.setattr(Boxes, "substep_s", 0.005)
    soft = {"link.up": "4g", "link.down": "4g", "duration_s": 5.0, "device.stiffness": 200.0}
    result = simulate({"scene": "examples.bullet_world:Boxes", "operator": "sine", **soft}, seed=1)
    own = result.summary["environment"]
    assert result.summary["verdict"]["passive"] is True
    assert own["env_given_J"] > 1e-3
    assert own["env_paid_J"] > 1e-3
    assert own["env_slack_J"] >= -1e-12


def test_the_block_is_as_hard_as_it_says() -> None:
    """K' (ybar - x) = K depth at rest; table and block are told as planes of that stiffness."""
    world, mass = made()
    for _ in range(60):
        done = mass.step(0.02, (0.03, 0.0, 0.0))
    rest = (K_PROXY * 0.03 + STIFFNESS * FACE) / (K_PROXY + STIFFNESS)
    assert done.position[0] == pytest.approx(rest, abs=2e-5)
    assert done.penetration_m == pytest.approx(rest - FACE, abs=2e-5)
    assert world.contact_force[0] == pytest.approx(-K_PROXY * (0.03 - rest), rel=0.02)
    assert world.observed.undone == 0


def test_its_planes_are_the_fixed_faces_and_none_while_it_touches_a_box() -> None:
    world, mass = made()
    planes = world.planes(mass.position, 0.05)
    block, table = sorted(planes, key=lambda plane: -plane.normal[0])
    for plane, normal, offset in ((block, (1.0, 0.0, 0.0), FACE), (table, (0.0, 0.0, -1.0), 0.02 - RADIUS)):
        assert isinstance(plane, Plane)
        assert plane.normal == pytest.approx(normal, abs=1e-9)
        assert plane.offset_m == pytest.approx(offset, abs=1e-6)
        assert (plane.stiffness, plane.friction) == (STIFFNESS, FRICTION)
    told = [world.planes(mass.step(0.01, (-0.05, 0.0, -0.005)).position, 0.05) for _ in range(20)]
    assert None in told
    assert told[0] is not None


def test_what_is_undone_comes_back_to_the_bit_with_its_contacts() -> None:
    """Three boxes on the table and the ball that strikes it: a hundred substeps, each made twice."""
    boxes = Boxes()
    for _ in range(30):
        boxes.substep(0.001, (-0.5, 0.0, -0.3))

    def state() -> bytes:
        return np.array([*boxes.poses(), [*boxes.velocity(), *boxes.contact_force(), boxes.depth()]]).tobytes()

    touching = 0
    for _ in range(100):
        before, saved = state(), boxes.save()
        boxes.substep(0.001, (-0.5, 0.0, -0.3))
        first = state()
        boxes.restore(saved)
        assert state()[: len(before) - 32] == before[: len(before) - 32]  # contacts are found anew in the substep
        boxes.substep(0.001, (-0.5, 0.0, -0.3))
        assert state() == first
        assert first != before
        touching += boxes.depth() > 0.0
    assert touching > 30


def test_a_pushed_box_has_the_work_and_the_picture_shows_it() -> None:
    """What was put in is in what moves, or was lost to friction and dampers: nothing came from nowhere."""
    world, mass = made()
    picture = world.picture()
    assert len(picture.parts) == 6
    before, start, work = picture.poses(), world.stored_J(()), 0.0
    for k in range(40):
        work -= mass.step(0.02, (-0.0015 * k, 0.0, -0.005)).work_J
        assert work - (world.stored_J(()) - start) >= -1e-12
    after = picture.poses()
    moved = np.abs(after[:, :3] - before[:, :3]).max(axis=1) > 5e-3
    assert moved.tolist() == [False, False, False, True, False, True]
    np.testing.assert_allclose(np.linalg.norm(after[:, 3:], axis=1), 1.0, atol=1e-9)
    assert tuple(after[-1, :3]) == mass.position
