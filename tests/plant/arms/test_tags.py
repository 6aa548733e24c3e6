"""No tag of a URDF is left out without a word: the list, the page, the lines for the user."""

import math
import re
from pathlib import Path

import numpy as np
import pytest

import hapnet.ext.arms
from hapnet.assembly.build import prepare
from hapnet.errors import InvalidParameter
from hapnet.ext.arms import tags
from hapnet.ext.arms.table import ArmTable
from hapnet.ext.arms.urdf import table_from

LIMIT = '<limit lower="-2" upper="2" effort="10" velocity="5"/>'
INERTIA = 'ixx="1e-3" iyy="2e-3" izz="2.5e-3" ixy="1e-4" ixz="-2e-4" iyz="3e-4"'


def link(name: str, inertia: str = INERTIA, mass: str = "0.3") -> str:
    return (
        f'<link name="{name}"><inertial><origin xyz="0.1 0 0"/><mass value="{mass}"/><inertia {inertia}/></inertial>'
        f'<visual><geometry><mesh filename="$(find x)/a.stl"/></geometry></visual></link>'
    )


def joint(name: str, ends: str, axis: str, more: str = LIMIT, kind: str = "revolute") -> str:
    parent, child = ends.split()
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0.2 0.1 0"/><axis xyz="{axis}"/>{more}</joint>'
    )


def robot(second: str = "", middle: str = "", more: str = "") -> str:
    """Three links whose tip moves along all axes. second, middle : in place of the second joint and its link."""
    return (
        '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">'
        + "".join([link("b"), link("l1"), middle or link("l2"), link("l3"), '<link name="t"/>'])
        + joint("j1", "b l1", "0 0 1")
        + (second or joint("j2", "l1 l2", "0 1 0"))
        + joint("j3", "l2 l3", "0 1 0")
        + joint("jt", "l3 t", "1 0 0", "", "fixed")
        + f"{more}</robot>"
    )


def table(text: str) -> ArmTable:
    return table_from(text, "a.urdf", "t")


def second(more: str) -> str:
    return robot(joint("j2", "l1 l2", "0 1 0", more))


def shortly(value: str) -> str:
    """The name of a case without its URDF."""
    return "" if value.startswith("<robot") else value


def test_the_page_has_the_list() -> None:
    """Every row of the page's table as in the code, and no other."""
    page = (Path(hapnet.ext.arms.__file__).parent / "URDF.md").read_text("utf-8")
    rows = dict(re.findall(r"^\| `([^`]+)` \| ([a-z ]+) \|", page, re.MULTILINE))
    assert rows == tags.TAGS


def test_what_is_used_is_read() -> None:
    """The code that reads a URDF asks for each tag and attribute that the list calls used."""
    code = (Path(hapnet.ext.arms.__file__).parent / "urdf.py").read_text("utf-8")
    for key in (key for key, fate in tags.TAGS.items() if fate == tags.USED):
        path, _, attribute = key.partition("@")
        assert f'"{path.split("/")[-1].removeprefix("drake:")}"' in code, key
        assert f'"{attribute}"' in code or attribute.startswith("soft_"), key
    assert table(second(LIMIT)).remarks == ()


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (second(LIMIT + '<safety_controller k_velocity="10"/>'), "not used: k_velocity of <safety_controller>"),
        (second(LIMIT + '<brake force="3"/>'), "not used: <brake>"),
        (second(LIMIT.replace("/>", ' jerk="3"/>')), "not used: jerk of <limit>"),
        (robot(more="<gazebo/><gazebo/><mujoco/>"), "not used: <gazebo>, <mujoco>"),
        (robot(more=link("x") + joint("jaw", "l2 x", "1 0 0")), "carried in their posture at 0, joints: jaw"),
        (
            second('<limit upper="2" effort="1" velocity="1"/>'),
            "no lower stop, which URDF requires: free there, joints: j2",
        ),
        (second('<limit lower="-1" effort="1" velocity="1"/>'), "no upper stop, which .*, joints: j2"),
        (second('<limit lower="-120" upper="120" effort="1" velocity="1"/>'), "degrees.* joints: j2 -120, j2 120"),
        (second('<limit lower="-1" upper="1" effort="0" velocity="1"/>'), "the effort of 0 is taken for no limit.* j2"),
        (second('<limit lower="-1" upper="1" effort="1" velocity="0"/>'), "the velocity of 0 is taken for no .* j2"),
        (second(LIMIT + '<mimic joint="j1"/>'), "the effort of a joint with <mimic> is not used, its leader's .*: j2"),
        (
            robot(joint("j2", "l1 l2", "0 1 0", '<limit lower="-1" effort="1" velocity="1"/>', "continuous")),
            "a continuous joint has no stops.*: j2",
        ),
        (robot(middle=link("l2", 'ixx="1e-3" iyy="1e-3" izz="9e-3"')), r"A \+ B < C .*: l2 \(0.001, 0.001, 0.009\)"),
        (robot(middle=link("l2", 'ixx="1e3" iyy="1e3" izz="1e3"')), "very large for the mass .*: l2"),
        (robot(middle=link("l2", "")), "mass without inertia is taken for a point's, links: l2"),
        (robot(more=link("x", mass="0") + joint("jx", "l3 x", "1 0 0", "", "fixed")), "inertia without mass, links: x"),
    ],
    ids=shortly,
)
@pytest.mark.long
def test_a_line_says_what_is_left_out_or_looks_wrong(text: str, says: str) -> None:
    (line,) = table(text).remarks
    assert re.search(f"^a.urdf: .*{says}", line)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (second(LIMIT + '<mimic joint="j2"/>'), "its joint j2 mimics itself"),
        (second(LIMIT + '<mimic joint="nose"/>'), "its joint j2 mimics the joint nose, which does not exist"),
        (
            second(LIMIT + '<mimic joint="jt"/>'),
            "its joint j2 mimics jt, which is no moving joint",
        ),
        (
            robot(
                joint("j2", "l1 l2", "0 1 0", LIMIT + '<mimic joint="jx"/>'),
                more=link("x") + joint("jx", "b x", "1 0 0"),
            ),
            "its joint j2 mimics jx, which is no moving joint between base and tip",
        ),
        (
            second(LIMIT + '<mimic joint="j1" multiplier="0"/>'),
            "the multiplier of a.urdf's mimic j2 is 0.0; allowed: a f",
        ),
        (
            second(LIMIT + '<mimic joint="j1" multiplier="inf"/>'),
            "the multiplier of a.urdf's mimic j2 is inf; allowed: ",
        ),
        (
            second(LIMIT + '<mimic joint="j1" offset="-inf"/>'),
            "the offset of a.urdf's mimic j2 is -inf; allowed: a fin",
        ),
        (
            second(LIMIT + '<mimic joint="j1" multiplier="0.5" offset="9"/>'),
            "the range of a.urdf's joint j1 is '-2 to -14 rad'; allowed: one that its mimics' stops leave to it",
        ),
        (robot().replace('name="j3"', 'name="j2"'), "it has two joints named 'j2'"),
        (robot().replace('link name="l3"', 'link name="l2"'), "it has two links named 'l2'"),
        (robot().replace('link name="t"', "link"), "a link has no name"),
        (robot(more=link("x") + link("y") + joint("jx", "x y", "1 0 0")), "the roots of a.urdf is 'b, x'"),
        (robot(more='<link name="x"/>'), "the roots of a.urdf is 'b, x'; allowed: one link without a parent"),
        (robot(more=link("x") + joint("jx", "l2 x", "1 0 0", "", "ball")), "the type of a.urdf's joint jx is 'ball'"),
        (robot(middle=link("l2", mass="-0.3")), r"the mass of a.urdf's link l2 is -0.3; allowed: 0 to 1e\+06 kg"),
        (robot(middle=link("l2", mass="inf")), "the mass of a.urdf's link l2 is inf"),
        (robot(middle=link("l2", 'ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="5e-3"')), "as no body can have"),
        (robot(more='<xacro:property name="a"/>'), "<xacro:property>.* plain URDF"),
        (robot().replace('value="0.3"', 'value="${m}"'), "value of <mass> in a.urdf is '${m}'; allowed: plain URDF"),
        (robot().replace("<axis", '<origin quat_xyzw="0 0 0 1"/><axis'), "there twice"),
        (robot().replace('<origin xyz="0.2 0.1 0"/>', '<origin quat_xyzw="0 0 0 1"/>'), "quat_xyzw of <origin>"),
        (second(LIMIT + LIMIT), "<limit> of a.urdf's joint j2 is 'there twice'; allowed: one"),
        (
            second(LIMIT + '<safety_controller k_position="9" k_velocity="1" soft_lower_limit="3"/>'),
            "the safety_controller's range of a.urdf's joint j2 is '3 to 2 rad'; .* -2 to 2 rad",
        ),
        (
            robot(more=link("x") + joint("jaw", "l2 x", "1 0 0", LIMIT + '<mimic joint="j1" offset="inf"/>')),
            "the offset of a.urdf's mimic jaw is inf; allowed: a finite one",
        ),
        (robot().replace("0.2 0.1 0", "1e300 0.1 0"), "xyz in a.urdf is '1e300 0.1 0'; allowed: three numbers"),
        (
            robot(more=link("x") + joint("jaw", "l2 x", "1 0 0", LIMIT + '<mimic joint="nose"/>')),
            "its joint jaw mimics the joint nose, which does not exist",
        ),
    ],
    ids=shortly,
)
def test_what_would_be_another_arm_is_refused(text: str, says: str) -> None:
    with pytest.raises(InvalidParameter, match=says.replace("$", r"\$").replace("{m}", r"\{m\}")):
        table(text)


def test_soft_limits_are_stops() -> None:
    """ROS: with k_position a safety controller lets no joint beyond its soft limits; with 0 they are off."""
    soft = '<safety_controller soft_lower_limit="-0.5" soft_upper_limit="9" k_position="{}" k_velocity="10"/>'
    for gain, stops in ((100, (-0.5, 2.0)), (0, (-2.0, 2.0))):
        found = table(second(LIMIT + soft.format(gain))).joints[1]
        assert (found.lower, found.upper) == stops


def test_a_carried_mimic_is_at_its_offset() -> None:
    """A jaw that mimics a jaw at 0: turned by its offset about its axis, so its centre lies there, and its mass too."""
    jaws = (
        link("x", mass="0.0")
        + link("y", mass="0.5")
        + joint("jx", "l3 x", "0 0 1", LIMIT + '<mimic joint="jy" multiplier="-2" offset="0.1"/>')
        + joint("jy", "l3 y", "0 0 1", LIMIT + '<mimic joint="jz" offset="{}"/>')
        + link("z", mass="0.0")
        + joint("jz", "l3 z", "0 0 1")
    )
    for angle in (0.0, math.pi / 2.0, -0.4):
        last = table(robot(more=jaws.format(angle))).joints[-1]
        place = np.array([0.2, 0.1, 0.0]) + 0.1 * np.array([math.cos(angle), math.sin(angle), 0.0])
        assert last.mass == pytest.approx(0.8)
        np.testing.assert_allclose(np.array(last.centre) * 0.8, 0.5 * place + [0.03, 0.0, 0.0], atol=1e-15)


def test_a_branch_of_the_base_is_not_checked(tmp_path: Path) -> None:
    """It stands still, so its inertia has no part; `prepare` hands the lines on, the file's and the home's."""
    file = tmp_path / "a.urdf"
    file.write_text(robot(more="<gazebo/>" + link("x", 'ixx="-1"') + joint("jx", "b x", "1 0 0")))
    warnings = prepare({"hardware": f"arm:{file}?tip=t"}).warnings
    assert "a.urdf: not used: <gazebo>" in warnings
    assert not any("no body" in one for one in warnings)
