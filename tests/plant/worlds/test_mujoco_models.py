"""MuJoCo models as their authors wrote them: defaults, keyframes, actuators, and what fails in a run."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapnet import cli
from hapnet.errors import HapnetError
from hapnet.ext.engines.engine_account import CEILING_J
from hapnet.ext.engines.mujoco_engine import mujoco_world
from tests.support.mujoco_models import BLOCK, BOX, found_of, made, model

pytest.importorskip("mujoco", reason="MuJoCo is not installed: hapnet-haptics[mujoco]")

OWN_DEFAULTS = (
    '<mujoco><compiler settotalmass="7"/><default><joint damping="0.75" armature="0.1" frictionloss="0.2" stiffness="3"'
    ' limited="true" range="-1 1" margin="0.1"/><geom contype="0" conaffinity="2" density="9000" friction="0.2"'
    ' condim="1" margin="0.01"/></default><worldbody><geom type="plane" size="1 1 .1"/><body name="a" pos="0 0 0.2">'
    '<joint type="slide" axis="0 0 1"/><geom type="box" size=".05 .05 .05"/></body></worldbody></mujoco>'
)


def test_the_hand_is_as_asked_whatever_the_models_defaults_are(tmp_path: Path) -> None:
    (tmp_path / "m.xml").write_text(OWN_DEFAULTS)
    world = mujoco_world(f"mujoco:{tmp_path / 'm.xml'}?at=0.2,0,0.1")
    world.proxy(0.3, 14.0, 500.0)
    model, dofs = found_of(world).model, list(found_of(world).dofs)
    joints, sphere = model.dof_jntid[dofs], int(model.body_geomadr[found_of(world).body])
    assert float(model.body_mass[found_of(world).body]) == pytest.approx(0.3, rel=1e-12)
    assert float(model.body_mass.sum()) == pytest.approx(7.3, rel=1e-12)  # the author asked for 7 kg without a hand
    for resists in (model.dof_damping, model.dof_armature, model.dof_frictionloss):
        assert not np.any(resists[dofs])
    assert not np.any(model.jnt_stiffness[joints])
    assert not np.any(model.jnt_limited[joints])
    assert float(model.geom_margin[sphere]) == 0.0


def test_what_is_touched_says_how_it_rubs_and_all_that_can_be_touched_is(tmp_path: Path) -> None:
    (tmp_path / "m.xml").write_text(OWN_DEFAULTS)
    world = mujoco_world(f"mujoco:{tmp_path / 'm.xml'}?at=0.2,0,0.002")  # 3 mm inside the plane
    contact = found_of(world).data.contact
    assert world.engine.depth() == pytest.approx(0.003, abs=1e-9)
    assert contact[0].dim == 1  # the model's has no friction
    assert not found_of(world).overlaps  # the sphere's own do not count


def test_weighing_the_hand_leaves_the_model_where_it_begins(tmp_path: Path) -> None:
    """A slide whose zero is at 1.25 m (as gymnasium's hopper): its potential energy is m g z."""
    slide, ball = (
        '<joint type="slide" axis="0 0 1" ref="1.25"/>',
        '<geom type="sphere" pos="0 0 1.25" size=".1" mass="2"/>',
    )
    content = f"<body>{slide}{ball}</body>"
    world, _ = made(model(tmp_path / "m.xml", content) + "?at=0.5,0,0.1")
    assert world.stored_J((0.0, 0.0, 0.0)) == pytest.approx(2.0 * 9.81 * 1.25, rel=1e-9)


KEYS = '<keyframe><key name="up" qpos="0.3" qvel="0.5" ctrl="2"/><key qpos="-0.2"/></keyframe>'
ROD = (
    '<body pos="0.5 0 0.5" gravcomp="1"><joint name="rod" type="slide" axis="1 0 0"/>'
    '<geom type="box" size=".01 .01 .01" mass="0.2"/></body>'
)
MOTOR = '<actuator><motor name="pull" joint="rod"/></actuator>'


@pytest.mark.parametrize(("key", "qpos", "ctrl"), [("up", 0.3, 2.0), ("0", 0.3, 2.0), ("1", -0.2, 0.0)])
def test_a_keyframe_is_where_the_model_begins(key: str, qpos: float, ctrl: float, tmp_path: Path) -> None:
    world, mass = made(model(tmp_path / "m.xml", ROD, more=MOTOR + KEYS) + f"?key={key}&at=0,0,0.03")
    data = found_of(world).data
    assert float(data.joint("rod").qpos[0]) == qpos
    assert float(data.ctrl[0]) == ctrl
    assert mass.position == (0.0, 0.0, 0.0)


def test_actuators_are_commanded_by_the_scenes_name_and_by_signals(tmp_path: Path) -> None:
    """A motor of F newtons on 0.2 kg: after a step of 20 ms the rod moves with F/m t."""
    world, mass = made(model(tmp_path / "m.xml", ROD, more=MOTOR) + "?ctrl=0.5&at=0,0,0.03")
    speed = 0.0
    commands: list[tuple[str, Any, float]] = [
        ("", 0.0, 0.5), ("ctrl", (-1.0,), -1.0), ("ctrl.pull", 3.0, 3.0), ("ctrl.push", 7.0, 3.0),
        ("ctrl", (1.0, 2.0), 3.0), ("ctrl.pull", np.nan, 3.0), ("ctrl.pull", "fast", 3.0), ("button", True, 3.0),
    ]  # fmt: skip
    for name, value, force in commands:
        world.signal(name, value)
        mass.step(0.02, (0.0, 0.0, 0.0))
        speed += force / 0.2 * 0.02
        assert float(found_of(world).data.joint("rod").qvel[0]) == pytest.approx(speed, rel=1e-9)


@pytest.mark.parametrize(
    ("query", "words"),
    [
        ("?key=down", "key= a keyframe of the model (up, 1)"),
        ("?ctrl=1,2", "ctrl= 1 numbers with commas, one for each actuator (pull)"),
        ("?ctrl=nan", "mujoco:FILE.xml"),
    ],
)
def test_a_wrong_keyframe_or_command_is_one_line(
    query: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = model(tmp_path / "m.xml", ROD, more=MOTOR + KEYS) + query
    assert cli.main(["simulate", "--scene", scene, "--duration", "1", "--no-files"]) == 2
    complaint = capsys.readouterr().err
    assert words in complaint
    assert complaint.count("\n") == 1


def test_what_mujoco_gives_up_in_the_middle_of_a_run_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Boxes that fall into one heap need more memory than the model's author gave."""
    boxes = "".join(
        f'<body pos="{0.05 * (i % 3) + 0.3} 0 {0.1 + 0.05 * (i // 3)}"><freejoint/>'
        '<geom type="box" size=".02 .02 .02"/></body>'
        for i in range(12)
    )
    scene = model(tmp_path / "m.xml", boxes, more='<size memory="60K"/>') + "?at=0,0,0.03"
    assert cli.main(["simulate", "--scene", scene, "--duration", "2", "--no-files"]) != 0
    complaint = capsys.readouterr().err
    assert f"the scene {scene} failed: " in complaint
    assert "Traceback" not in complaint


def test_a_model_that_diverges_by_itself_is_named_as_that(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """An actuator that pushes along with the motion: 0.2 kg grows by exp(50 N/(m/s) t / m) until it has failed."""
    pushes = '<general joint="rod" gainprm="1" biastype="affine" biasprm="0 0 50"/>'
    more = f'<actuator>{pushes}</actuator><keyframe><key name="go" qvel="1"/></keyframe>'
    scene = model(tmp_path / "m.xml", ROD, more=more)
    assert cli.main(["simulate", "--scene", scene + "?key=go&at=0,0,0.03", "--duration", "5", "--no-files"]) == 2
    complaint = capsys.readouterr().err
    assert "; the model diverges by itself, " in complaint
    assert complaint.count("\n") == 1
    world, mass = made(scene + "?at=0,0,0.03")
    found_of(world).data.qvel[-1] = np.nan  # nothing in the model explains it
    with pytest.raises(HapnetError, match=r"its position is \[.*nan\]$"):
        mass.step(0.05, mass.position)


def test_bodies_that_begin_inside_one_another_are_reported(tmp_path: Path) -> None:
    """Two boxes of 40 mm, 30 mm apart: each pair once, 10 mm deep."""
    two = BOX + BOX.replace('"box"', '"other"', 1).replace("0.03 0 0.02", "0.06 0 0.02")
    world, _ = made(model(tmp_path / "m.xml", two) + "?at=0,0,0.1")
    assert found_of(world).overlaps == ("box and other by 10 mm",)
    assert world.observed.overlaps == 1
    assert any("bodies begin inside one another: box and other by 10 mm" in line for line in world.warnings)


def test_the_account_closes_in_each_substep_also_where_one_is_undone(tmp_path: Path) -> None:
    """account = account + W + S - (U - U before), up to the ceiling: what stopping took counts as dissipated."""
    scene = model(tmp_path / "m.xml", BLOCK, solref="-3000 0", option='timestep="0.005" integrator="Euler"')
    world, mass = made(scene + "?at=0,0,0.02")
    engine, substep, stopped = world.account, world.account.substep, 0.0

    def witness(h: float, force: Any, most_J: float) -> Any:
        nonlocal stopped
        account, energy, supplied = engine.account_J, engine.energy_J, engine.supplied_J
        undone_J = engine.undone_J
        applied, work = substep(h, force, most_J)
        after = account + work + engine.supplied_J - supplied - (engine.energy_J - energy)
        assert engine.account_J == pytest.approx(min(after, CEILING_J), abs=1e-13)
        stopped += engine.undone_J - undone_J
        return applied, work

    engine.substep = witness  # type: ignore[method-assign]  # to see each substep
    for k in range(400):
        mass.step(0.01, (0.05 * np.sin(0.2 * k), 0.0, -0.01))
    assert stopped > 1e-6


def test_a_held_body_of_a_model_with_fewer_joints_than_axes(tmp_path: Path) -> None:
    """Two joints, three axes: the hand's force is felt, and no contact's is made up from the joints' own."""
    rod = '<joint type="hinge" axis="0 0 1"/><geom type="capsule" fromto="0 0 0 .1 0 0" size=".01" mass=".1"/>'
    tip = f'<body name="tip" pos=".1 0 0" gravcomp="1">{rod}</body>'
    arm = f'<body pos="0 0 .1" gravcomp="1">{rod}{tip}</body>'
    world, mass = made(model(tmp_path / "m.xml", arm) + "?proxy=tip")
    done = [mass.step(0.02, (0.0, 0.02, 0.0)) for _ in range(20)][-1]
    assert done.position[1] == pytest.approx(0.02, abs=2e-3)
    assert world.contact_force is None
