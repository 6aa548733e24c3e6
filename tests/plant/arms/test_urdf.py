"""URDF: the same arm as MuJoCo loads, and what is refused."""

import math
from pathlib import Path

import numpy as np
import pytest

from hapnet.errors import InvalidParameter
from hapnet.ext.arms.chain import difference, gravity, matrices
from hapnet.ext.arms.parameters import arm_values, table_of
from hapnet.ext.arms.table import apparent_masses, at_home, chain_of, felt_damping, home_of
from hapnet.ext.arms.urdf import table_from
from hapnet.params import Params
from hapnet.recording import frames
from hapnet.simulation.simulation import Simulation


def body(mass: float, xyz: str, rpy: str = "0.3 -0.2 0.5") -> str:
    return (
        f'<inertial><origin xyz="{xyz}" rpy="{rpy}"/><mass value="{mass}"/>'
        f'<inertia ixx="{1e-3 * mass}" iyy="{1.4e-3 * mass}" izz="{0.9e-3 * mass}" ixy="{1e-4 * mass}" ixz="0" '
        f'iyz="{-2e-4 * mass}"/></inertial>'
    )


ARM = f"""<robot name="test">
<link name="base"/> <link name="plate">{body(3.0, "0 0 0")}</link>
<link name="upper">{body(0.8, "0.02 0.1 0")}</link> <link name="motor">{body(0.3, "0 0 0.01")}</link>
<link name="fore">{body(0.5, "0 0.08 0.01")}</link> <link name="jaw">{body(0.1, "0 0.02 0")}</link>
<link name="hand">{body(0.2, "0.01 0 0.02")}</link> <link name="tip"/>
<joint name="bolted" type="fixed"><parent link="base"/><child link="plate"/>
  <origin xyz="0 0 0.1" rpy="0 0 0.4"/></joint>
<joint name="shoulder" type="revolute"><parent link="plate"/><child link="upper"/>
  <origin xyz="0 0.01 0.05" rpy="1 0 0"/>
  <axis xyz="0 0.6 0.8"/><limit lower="-1.5" upper="2" effort="7" velocity="3"/>
  <dynamics damping="0.1" friction="0.02"/></joint>
<joint name="screwed" type="fixed"><parent link="upper"/><child link="motor"/>
  <origin xyz="0 0.2 0" rpy="0 1.5707963267948966 0"/></joint>
<joint name="elbow" type="continuous"><parent link="motor"/><child link="fore"/>
  <origin xyz="0.03 0 0"/><axis xyz="1 0 0"/></joint>
<joint name="grip" type="prismatic"><parent link="fore"/><child link="jaw"/>
  <origin xyz="0 0.15 0"/><axis xyz="1 0 0"/>
  <limit lower="0" upper="0.1" effort="1" velocity="1"/></joint>
<joint name="wrist" type="revolute"><parent link="fore"/><child link="hand"/><origin xyz="0 0.16 0" rpy="0 0 -0.7"/>
  <limit lower="-1" upper="1" effort="0" velocity="0"/></joint>
<joint name="end" type="fixed"><parent link="hand"/><child link="tip"/><origin xyz="0.01 0.05 0"/></joint>
</robot>"""


SLIDING = ARM.replace(
    'type="continuous"><parent link="motor"/>',
    'type="prismatic"><limit lower="-0.2" upper="0.3" effort="5" velocity="1"/><parent link="motor"/>',
)


@pytest.mark.parametrize("text", [ARM, SLIDING], ids=["turns", "slides"])
def test_the_arm_is_mujocos(text: str) -> None:
    """Fixed links are carried, and a jaw as it is at 0; M, C q' + g and the tip within 1e-9 at 200 states."""
    import mujoco

    table = table_from(text, "test.urdf", "tip")
    assert [joint.slides for joint in table.joints] == [False, text == SLIDING, False]
    extra = '<mujoco><compiler fusestatic="false"/></mujoco>'
    model = mujoco.MjModel.from_xml_string(text.replace('<robot name="test">', f'<robot name="test">{extra}'))
    data = mujoco.MjData(model)
    where = [model.joint(joint.name).id for joint in table.joints]
    chain, g, whole = chain_of(table), [0.0] * 3, np.zeros((4, 4))
    rng = np.random.default_rng(4)
    for _ in range(200):
        q, v = rng.uniform(-3.0, 3.0, 3), rng.normal(size=3)
        data.qpos[:], data.qvel[:] = 0.0, 0.0
        data.qpos[where], data.qvel[where] = q, v
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, whole)
        matrices(chain, q.tolist(), v.tolist())
        gravity(chain, q.tolist(), q.tolist(), g)
        difference(chain, chain.tip, q.tolist(), q.tolist())
        inertia, coriolis = (np.array(matrix)[:3, :3] for matrix in (chain.inertia, chain.coriolis))
        np.testing.assert_allclose(inertia, whole[np.ix_(where, where)], rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(coriolis @ v + g, data.qfrc_bias[where], rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(chain.tip.begin, data.body("tip").xpos, rtol=0.0, atol=1e-9)


def test_limits_and_home() -> None:
    """An effort or a velocity of 0 is none; the middle between the stops; home is what is asked for."""
    shoulder, elbow, wrist = table_from(ARM, "test.urdf", "tip").joints
    assert (shoulder.lower, shoulder.upper, shoulder.effort, shoulder.speed) == (-1.5, 2.0, 7.0, 3.0)
    assert (shoulder.damping, shoulder.friction) == (0.1, 0.02)
    assert (elbow.lower, elbow.upper, elbow.effort) == (-math.inf, math.inf, math.inf)
    assert (wrist.effort, wrist.speed, wrist.axis) == (math.inf, math.inf, (1.0, 0.0, 0.0))
    assert home_of((shoulder, elbow, wrist)) == (0.25, 0.0, 0.0)
    assert table_from(ARM, "test.urdf", "tip", home=(0.1, 0.2, 0.3)).home == (0.1, 0.2, 0.3)
    assert [joint.name for joint in table_from(ARM, "test.urdf", "tip", "motor").joints] == ["elbow", "wrist"]


@pytest.mark.parametrize(
    ("old", "new", "tip", "message"),
    [
        ("", "", "", "the tip of test.urdf is ''"),
        ("", "", "nose", "the tip of test.urdf is 'nose'; allowed: .tip=LINK of fore"),
        ('type="continuous"', 'type="planar"', "tip", "the type of test.urdf's joint elbow is 'planar'"),
        ("", "", "plate", "the arm test.urdf: no joint moves its tip, the link plate"),
        ("</robot>", "", "tip", "the arm test.urdf: it is not a URDF: its XML is broken .no element found"),
        ("robot", "sdf", "tip", "its root is <sdf>; that of a URDF is <robot>"),
        ('effort="7"', 'effort="much"', "tip", "effort in test.urdf is 'much'"),
        ('xyz="0 0.6 0.8"', 'xyz="0 0.6"', "tip", "xyz in test.urdf is '0 0.6'; allowed: three numbers"),
        (
            '<parent link="fore"/><child link="hand"/>',
            '<parent link="arm"/><child link="hand"/>',
            "tip",
            "joint wrist names the link 'arm', which the file does not have",
        ),
        (body(0.2, "0.01 0 0.02"), "", "tip", "the link hand, which joint wrist moves, has no mass: add an <inertial>"),
        ('<child link="jaw"/>', '<child link="motor"/>', "tip", "the link motor is the child of two joints"),
    ],
)
def test_what_is_no_arm_is_refused(old: str, new: str, tip: str, message: str) -> None:
    with pytest.raises(InvalidParameter, match=message):
        table_from(ARM.replace(old, new) if old else ARM, "test.urdf", tip)


def test_two_joints_of_one_name_with_one_child_are_named() -> None:
    """A joint that was copied: `its joints go round` would be the wrong reason."""
    twice = '<joint name="end" type="fixed"><parent link="hand"/><child link="tip"/></joint></robot>'
    with pytest.raises(InvalidParameter, match=r"the arm test\.urdf: it has two joints named 'end'"):
        table_from(ARM.replace("</robot>", twice), "test.urdf", "tip")


def test_joints_that_go_round_are_refused() -> None:
    ring = '<robot name="r"><link name="a"/><link name="b"/>' + "".join(
        f'<joint name="{a}{b}" type="revolute"><parent link="{a}"/><child link="{b}"/></joint>' for a, b in ("ab", "ba")
    )
    with pytest.raises(InvalidParameter, match=r"the arm ring\.urdf: its joints go round in a loop at the link a"):
        table_from(ring + "</robot>", "ring.urdf", "a")


def test_a_loop_beside_the_chain_is_refused() -> None:
    """Links that are fixed to one another, of which two have the same child; and a loop through the base."""
    loop = '<link name="x"/><link name="y"/>' + "".join(
        f'<joint name="{a}{b}" type="fixed"><parent link="{a}"/><child link="{b}"/></joint>'
        for a, b in ("hx", "xy", "yx")
    ).replace('"h"', '"hand"')
    with pytest.raises(InvalidParameter, match="is the child of two joints"):
        table_from(ARM.replace("</robot>", loop + "</robot>"), "test.urdf", "tip")
    back = '<joint name="back" type="fixed"><parent link="tip"/><child link="base"/></joint></robot>'
    with pytest.raises(InvalidParameter, match=r"in a loop at the link|is the child of two joints"):
        table_from(ARM.replace("</robot>", back), "test.urdf", "tip", "plate")


@pytest.mark.parametrize(
    ("old", "new", "home", "message"),
    [
        ('velocity="3"', 'velocity="-3"', (), "the speed of test.urdf's joint shoulder is -3.0; allowed: above 0"),
        ('effort="7"', 'effort="-7"', (), "the effort of test.urdf's joint shoulder is -7.0; allowed: above 0"),
        (
            'lower="-1.5"',
            'lower="2.5"',
            (),
            "the lower stop of test.urdf's joint shoulder is 2.5; allowed: below .* 2",
        ),
        ('lower="-1.5"', 'lower="inf"', (), "the lower stop of test.urdf's joint shoulder is inf"),
        ('damping="0.1"', 'damping="-0.5"', (), "the damping of test.urdf's joint shoulder is -0.5; allowed: a finite"),
        ('damping="0.1"', 'damping="inf"', (), "the damping of test.urdf's joint shoulder is inf; allowed: a finite"),
        ('friction="0.02"', 'friction="-1"', (), "the friction of test.urdf's joint shoulder is -1.0; allowed: a fin"),
        ("", "", (9.0, 0.0, 0.0), "home of test.urdf's joint shoulder is 9.0; allowed: within its stops, -1.5 to 2"),
        ("", "", (0.0, math.inf, 0.0), "home of test.urdf's joint elbow is inf"),
        ("", "", (0.0, 0.0), "home of test.urdf is .0.0, 0.0.; allowed: 3 angles"),
    ],
)
def test_what_would_make_energy_is_refused(old: str, new: str, home: tuple[float, ...], message: str) -> None:
    """In the table, so of any arm, whatever it was read from."""
    text = ARM.replace(old, new, 1) if old else ARM
    with pytest.raises(InvalidParameter, match=message):
        chain_of(table_from(text, "test.urdf", "tip", home=home))


ONE = """<robot name="one"><link name="base"/><link name="arm"><inertial>{}<mass value="0.2"/></inertial></link>
<joint name="hinge" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0.6 0.8"/>
<limit lower="0.5" effort="5" velocity="3"/><dynamics damping="0.1"/></joint>
<link name="tip"/><joint name="end" type="fixed"><parent link="arm"/><child link="tip"/>
<origin xyz="{}"/></joint></robot>"""


@pytest.mark.parametrize("centre", ["", '<origin xyz="0 0.3 0.4"/>'])
def test_a_mass_on_its_joints_axis_is_refused(centre: str) -> None:
    with pytest.raises(InvalidParameter, match=r"the inertia that one\.urdf's joint hinge turns at home"):
        apparent_masses(table_from(ONE.format(centre, "0.1 0 0"), "one.urdf"))


@pytest.mark.parametrize("tip", ["0 0 0", "0 0.06 0.08"])
def test_a_tip_on_its_joints_axis_is_refused(tmp_path: Path, tip: str) -> None:
    """No joint moves it, so its mass is infinite; 0.1 m beside the axis 0.2 kg are 0.2 kg, and 0.1 Nms/rad 10 Ns/m."""
    off = '<origin xyz="0.1 0 0"/>'
    fixed, moved = (table_from(ONE.format(off, place), "one.urdf") for place in (tip, "0.1 0 0"))
    assert (apparent_masses(fixed), felt_damping(fixed)) == ((math.inf,) * 3, math.inf)
    assert (apparent_masses(moved)[0], felt_damping(moved)) == pytest.approx((0.2, 10.0))
    assert fixed.home == (0.5,)  # there is one stop: as near to 0 as that allows
    (tmp_path / "one.urdf").write_text(ONE.format(off, tip))
    with pytest.raises(InvalidParameter, match="allowed: a tip that moves"):
        arm_values(Params().set({"hardware": f"arm:{tmp_path / 'one.urdf'}"}))


def test_a_slide_in_a_run(tmp_path: Path) -> None:
    """Over 4g in a hand that moves it: passive, the slide moves; its column is in m; joint by joint it is refused."""
    file = tmp_path / "slides.urdf"
    file.write_text(SLIDING)
    name = f"arm:{file}?tip=tip&home=0.3,0.1,0.2"
    params = Params().set(
        {"hardware": name, "duration_s": 0.4, "link.up": "4g", "link.down": "4g", "device.substeps": 1, "scene": "free",
         "operator": "sine", "device.resolution_m": 1e-5}
    )  # fmt: skip
    result = Simulation(params, 1).run()
    assert result.summary["verdict"]["passive"] is True
    columns = frames.table(result.recording)
    assert np.nanmax(np.abs(columns["joint_2_m"] - 0.1)) > 1e-3
    assert {"joint_1_rad", "joint_3_rad"} <= columns.keys()
    with pytest.raises(InvalidParameter, match=r"its joint elbow slides; axes=joints needs joints that turn"):
        arm_values(params.set({"hardware": name + "&axes=joints"}))
    endless = SLIDING.replace('lower="-0.2" ', "")
    with pytest.raises(InvalidParameter, match=r"the range of test.urdf's joint elbow is '-inf to 0.3 m'; .* finite"):
        table_from(endless, "test.urdf", "tip")


def test_rotors_add_to_the_diagonal(tmp_path: Path) -> None:
    """From <dynamics>, from Drake's transmission (1e-5 kg m^2 behind a gear of 100: 0.1 kg m^2), or from the name."""
    drake = (
        '<transmission><joint name="{}"/><actuator name="m"><drake:rotor_inertia value="1e-5"/>'
        '<drake:gear_ratio value="100"/></actuator></transmission>'
    )
    text = (
        ARM.replace('name="test"', 'name="test" xmlns:drake="http://drake.mit.edu"')
        .replace('damping="0.1"', 'damping="0.1" armature="0.02"')
        .replace("</robot>", drake.format("shoulder") + drake.format("wrist") + "</robot>")
    )
    plain, heavier = (table_from(one, "test.urdf", "tip") for one in (ARM, text))
    assert heavier.remarks == plain.remarks
    added = at_home(heavier)[1] - at_home(plain)[1]
    np.testing.assert_allclose(added, np.diag([0.12, 0.0, 0.1]), rtol=0.0, atol=1e-12)
    file = tmp_path / "a.urdf"
    file.write_text(text)
    for words, values in (("0.3", (0.3, 0.3, 0.3)), ("1,0,0.5", (1.0, 0.0, 0.5))):
        assert tuple(j.armature for j in table_of(f"arm:{file}?tip=tip&armature={words}").joints) == values
    with pytest.raises(InvalidParameter, match=r"armature of a.urdf is '1,2'; allowed: one number, or 3"):
        table_of(f"arm:{file}?tip=tip&armature=1,2")
    with pytest.raises(InvalidParameter, match=r"the armature of a.urdf's joint shoulder is -1.0; allowed: a finite"):
        at_home(table_of(f"arm:{file}?tip=tip&armature=-1"))


def test_a_run_with_an_arm_from_a_file(tmp_path: Path) -> None:
    """Three hinges in a hand, over 4g: passive; the options behind the file's name."""
    file = tmp_path / "test.urdf"
    file.write_text(ARM)
    params = Params().set(
        {"hardware": f"arm:{file}?tip=tip&home=0.3,1.2,0.2", "duration_s": 0.4, "link.up": "4g", "link.down": "4g",
         "device.substeps": 1, "scene": "free", "operator": "rest"}
    )  # fmt: skip
    result = Simulation(params, 1).run()
    assert result.summary["verdict"]["passive"] is True
    for words in ("arm:", f"arm:{file}?top=tip", f"arm:{tmp_path / 'none.urdf'}?tip=tip", f"arm:{file}?tip=tip&home=a",
                  f"arm:{file}?tip=tip&tip=hand"):  # fmt: skip
        with pytest.raises(InvalidParameter):
            table_of(words)
