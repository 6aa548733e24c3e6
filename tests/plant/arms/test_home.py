"""The posture in which an arm begins: not singular, or the user is told so."""

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hapnet.assembly.build import prepare
from hapnet.ext.arms.home import OPEN, open_home, openness, remarks
from hapnet.ext.arms.table import ArmTable, Joint, home_of, omni
from hapnet.simulation.simulation import Simulation
from tests.plant.arms.references import in_mujoco, random_arm

BODY = Joint(
    "",
    (0.0, 0.0, 0.0),
    mass=0.3,
    inertia=((1e-3, 0.0, 0.0), (0.0, 1e-3, 0.0), (0.0, 0.0, 1e-3)),
    centre=(0.1, 0.0, 0.0),
)


def straight(joints: int = 3, stops: float = 2.0, effort: float = math.inf, long: float = 0.2) -> ArmTable:
    """An arm along x whose first joint turns about z and whose others turn about y, straight at 0."""
    axes = ((0.0, 0.0, 1.0), *((0.0, 1.0, 0.0),) * (joints - 1))
    found = tuple(
        replace(
            BODY,
            name=f"j{i}",
            xyz=(long if i > 1 else 0.0, 0.0, 0.0),
            axis=axis,
            lower=-stops,
            upper=stops,
            effort=effort,
        )
        for i, axis in enumerate(axes)
    )
    return ArmTable("straight", found, (long, 0.0, 0.0), (0.0,) * joints)


def mujocos(table: ArmTable) -> float:
    """The third singular value of the tip's Jacobian by MuJoCo, over the lengths of the links."""
    import mujoco

    model, data = in_mujoco(table)
    data.qpos[:] = table.home
    mujoco.mj_forward(model, data)
    J = np.zeros((3, model.nv))
    mujoco.mj_jacSite(model, data, J, None, 0)
    reach = sum(np.linalg.norm(joint.xyz) for joint in table.joints[1:]) + np.linalg.norm(table.tip)
    return float(np.linalg.svd(J)[1][2] / reach)


def test_the_measure_is_of_mujocos_jacobian() -> None:
    rng = np.random.default_rng(3)
    for n in (3, 5, 7):
        table = random_arm(rng, n)
        assert openness(table) == pytest.approx(mujocos(table), rel=1e-9)


@pytest.mark.parametrize("joints", [3, 4, 6])
def test_a_straight_arm_begins_bent(joints: int) -> None:
    """With symmetric stops the middle is straight: openness 0. Home has 0.1 at least, by MuJoCo; it is the same each
    time, and its first joint, which changes nothing, stays in the middle."""
    table = straight(joints)
    assert openness(table) < 1e-9
    (line,) = remarks(table)
    assert line == "at the home of straight no joint moves the tip along (1, 0, 0): choose another posture with &home="
    bent = replace(table, home=open_home(table))
    assert mujocos(bent) >= OPEN
    assert bent.home[0] == 0.0
    assert remarks(bent) == ()
    assert open_home(table) == bent.home


def test_a_posture_that_is_open_is_kept() -> None:
    table = replace(omni(), home=home_of(omni().joints))
    assert openness(table) > OPEN
    assert open_home(table) == table.home


def test_motors_carry_the_weight_in_the_posture() -> None:
    """Upright, an arm weighs nothing on its joints; 0.9 kg bent over does: home is one that half the torque carries."""
    upright = straight(3)
    first = replace(upright.joints[0], rpy=(0.0, -math.pi / 2.0, 0.0), axis=(1.0, 0.0, 0.0))
    strong = replace(upright, joints=(first, *upright.joints[1:]))
    weak = replace(strong, joints=tuple(replace(joint, effort=0.25) for joint in strong.joints))
    assert max(_loads(replace(strong, home=open_home(strong)))) > 0.125
    assert max(_loads(replace(weak, home=open_home(weak)))) < 0.125


def _loads(table: ArmTable) -> list[float]:
    import mujoco

    model, data = in_mujoco(table)
    data.qpos[:] = table.home
    mujoco.mj_forward(model, data)
    return [abs(float(one)) for one in data.qfrc_bias]


def test_stops_leave_no_other_posture() -> None:
    """With stops at 0.05 rad the arm stays nearly straight, and a line says so with the figure."""
    table = straight(3, stops=0.05)
    home = open_home(table)
    assert all(abs(angle) <= 0.05 for angle in home)
    (line,) = remarks(replace(table, home=home))
    assert line.startswith("at the home of straight the joints hardly move the tip along (1, ")
    assert "of the reach a radian, less than 0.1)" in line
    assert "choose" not in line


def test_heavy_damping_is_said() -> None:
    """30 Nms/rad at levers of at most 0.4 m: three joints together are at least a third of one, 30 / 0.4^2 Ns/m."""
    table = replace(straight(), home=(0.0, 0.5, 0.5))
    heavy = replace(table, joints=tuple(replace(joint, damping=30.0) for joint in table.joints))
    assert remarks(table) == ()
    (line,) = remarks(heavy)
    found = re.fullmatch(
        "the joints' damping in straight is (.*) Ns/m or more at the tip: a hand hardly moves it", line
    )
    assert found is not None
    assert 30.0 / 0.4**2 / 3.0 < float(found[1]) < 30.0 / 0.2**2


def test_two_joints_leave_a_direction() -> None:
    table = straight(2)
    (line,) = remarks(replace(table, home=open_home(table)))
    assert line == "at the home of straight no joint moves the tip along (1, 0, 0)"


@pytest.mark.parametrize("axes", ["tip", "joints"])
def test_a_straight_arm_moves_under_a_hand(tmp_path: Path, axes: str) -> None:
    """The user's case: it stood still under 5 N. With &home= straight, a warning says which way it cannot move; joint
    by joint that does not matter."""
    links = "".join(
        f'<link name="l{i}"><inertial><origin xyz="0.1 0 0"/><mass value="0.3"/>'
        '<inertia ixx="1e-3" iyy="1e-3" izz="1e-3"/></inertial></link>'
        for i in range(4)
    )
    joints = "".join(
        f'<joint name="j{i}" type="revolute"><parent link="l{i - 1}"/><child link="l{i}"/>'
        f'<origin xyz="{0.2 if i > 1 else 0} 0 0"/><axis xyz="{axis}"/>'
        '<limit lower="-2" upper="2" effort="30" velocity="9"/></joint>'
        for i, axis in ((1, "0 0 1"), (2, "0 1 0"), (3, "0 1 0"))
    )
    ends = '<parent link="l3"/><child link="t"/><origin xyz="0.2 0 0"/>'
    tip = f'<link name="t"/><joint name="jt" type="fixed">{ends}</joint>'
    file = tmp_path / "a.urdf"
    file.write_text(f'<robot name="r">{links}{joints}{tip}</robot>')
    name = f"arm:{file}?tip=t&axes={axes}"
    params = {"hardware": name, "scene": "free" if axes == "tip" else "joints", "operator": "sine",
              "device.substeps": 1, "duration_s": 0.5}  # fmt: skip
    assert prepare(params).warnings == ()
    told = prepare({**params, "hardware": name + "&home=0,0,0"}).warnings
    assert len(told) == (axes == "tip")
    if axes == "tip":
        result = Simulation(prepare(params).params, 1).run()
        assert result.recording.device is not None
        moved = np.ptp(result.recording.device["position_m"], axis=0)
        assert result.summary["verdict"]["passive"] is True
        assert moved.max() > 0.005
