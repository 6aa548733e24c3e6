"""The URDFs of the package example-robot-data, from robots' makers: each moves in a hand, or a line says why not.

Skipped where the package is absent; none of its files is part of hapnet.
"""

import re
from importlib.metadata import PackageNotFoundError, files
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from hapnet.checks import Array
from hapnet.errors import InvalidParameter
from hapnet.ext.arms import home
from hapnet.ext.arms.chain import difference
from hapnet.ext.arms.device import SimulatedArm
from hapnet.ext.arms.table import ArmTable, apparent_masses, at_home, chain_of
from hapnet.ext.arms.urdf import table_from
from hapnet.plant.operator import Impedance, Sine

TRUE_LINES = (
    "the joints of .* is 1[1-9]; allowed: 1 to 10",
    "mimics .*, which is no moving joint between base and tip",
    "mimics the joint .*, which does not exist",
    "the lower stop of .* is 0.0; allowed: below the upper one, 0 rad",
    "has no mass: add an <inertial>",
    "the tip of .* is ''; allowed: .*a file with joints",
    "no joint moves its tip, the link ",
    "which the arm's weight needs at home",
)


def published() -> list[Path]:
    try:
        found = files("example-robot-data") or []
    except PackageNotFoundError:
        return []
    return sorted(Path(str(one.locate())) for one in found if one.suffix == ".urdf")


def longest(root: ElementTree.Element) -> str:
    """The last link behind the greatest number of joints."""
    joints = [one for one in root.findall("joint") if one.find("child") is not None]
    before = {one.find("child").get("link"): one for one in joints}  # type: ignore[union-attr]
    depths = {}
    for link in before:
        at, depth = link, 0
        while at in before:
            depth += before[at].get("type") != "fixed"
            at = before[at].find("parent").get("link")  # type: ignore[union-attr]
        depths[link] = depth
    parents = {one.find("parent").get("link") for one in joints}  # type: ignore[union-attr]
    return max((link for link in depths if link not in parents), key=depths.__getitem__, default="") or ""


def mujocos(root: ElementTree.Element, table: ArmTable, q: Array, tip: str) -> tuple[Array, Array] | None:
    """M and the Jacobian by MuJoCo at q, from the file without its shapes, and with G of its mimics; None: MuJoCo
    refuses it."""
    import mujoco

    for link in root.findall("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(shape)
    for joint in root.findall("joint"):
        for mimic in joint.findall("mimic"):
            joint.remove(mimic)
    for other in root.findall("mujoco"):
        root.remove(other)
    compiler = ElementTree.SubElement(ElementTree.SubElement(root, "mujoco"), "compiler")
    compiler.attrib |= {"fusestatic": "false"}
    try:
        model: Any = mujoco.MjModel.from_xml_string(ElementTree.tostring(root, "unicode"))
    except ValueError:
        return None
    data = mujoco.MjData(model)
    at = [model.joint(joint.name) for joint in table.joints]
    G = np.zeros((len(at), len(q)))
    for i, (joint, (k, share, offset)) in enumerate(zip(at, table.coordinates, strict=True)):
        data.qpos[joint.qposadr[0]] = share * q[k] + offset
        G[i, k] = share
    mujoco.mj_forward(model, data)
    M, J = np.zeros((model.nv, model.nv)), np.zeros((3, model.nv))
    mujoco.mj_fullM(model, data, M)
    mujoco.mj_jacBody(model, data, J, None, model.body(tip).id)
    where = [joint.dofadr[0] for joint in at]
    return G.T @ M[np.ix_(where, where)] @ G, J[:, where] @ G


def made(text: str, name: str, tip: str) -> tuple[str, ArmTable | None, SimulatedArm | None]:
    """The arm in a hand, or the line that refuses it."""
    try:
        table = table_from(text, name, tip)
        at_home(table)
        return "", table, SimulatedArm(table, Sine(3, Impedance(), 0.02, 2.0, start_s=0.01), substeps=2)
    except InvalidParameter as error:
        return str(error), None, None


@pytest.mark.slow
@pytest.mark.parametrize("file", published(), ids=lambda file: str(file.name))
def test_a_published_arm_moves_or_a_line_says_why_not(file: Path) -> None:
    """Held at its outermost link: M and J are MuJoCo's at home, where MuJoCo loads the file; in a hand the tip moves by
    a millimetre and the energy closes. Lines are single ones; no refusal is of an unknown kind."""
    text = file.read_text("utf-8")
    root = ElementTree.fromstring(text)
    tip = longest(root)
    refused, table, arm = made(text, file.name, tip)
    if table is None or arm is None:
        assert "\n" not in refused
        assert any(re.search(line, refused) for line in TRUE_LINES), refused
        return
    assert all("\n" not in line for line in table.remarks)
    stuck = home.remarks(table)
    assert home.openness(table) >= home.OPEN or stuck
    found = mujocos(root, table, np.array(table.home), tip)
    if found is not None:
        M, J = found
        chain = chain_of(table)
        difference(chain, chain.tip, table.home, table.home)
        np.testing.assert_allclose(at_home(table)[1], M, rtol=1e-6, atol=1e-9 * np.abs(M).max())
        np.testing.assert_allclose(np.array(chain.tip.columns)[: chain.n].T, J, rtol=0.0, atol=1e-6)
    before, taken, furthest = arm.kinetic + arm.potential, 0.0, 0.0
    for _ in range(150):
        taken += arm.advance()
        furthest = max(furthest, float(np.linalg.norm(arm.position)))
    assert abs(taken - arm.arm.lost - (arm.kinetic + arm.potential - before)) <= 1e-9
    assert furthest > 1e-3 or min(apparent_masses(table)) > 1.0 or stuck
