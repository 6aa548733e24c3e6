"""Joints that mimic others: beside a Lagrangian by hand, and beside MuJoCo's matrices of all joints."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from hapnet.assembly.build import prepare
from hapnet.checks import Array
from hapnet.errors import InvalidParameter
from hapnet.ext.arms import motion
from hapnet.ext.arms.chain import difference, gravity, height, matrices
from hapnet.ext.arms.made import SLIP_RADPS, arm_of
from hapnet.ext.arms.parameters import table_of
from hapnet.ext.arms.picture import ArmPicture, described
from hapnet.ext.arms.table import ArmTable, apparent_masses, at_home, chain_of, felt_damping, omni
from hapnet.ext.arms.urdf import table_from
from hapnet.ext.robots.bus_joints import joints_of
from hapnet.plant.operator import Impedance
from hapnet.recording import frames
from hapnet.simulation.simulation import Simulation
from tests.conftest import mostly_slow
from tests.plant.arms.references import cylindrical, in_mujoco, led, random_arm
from tests.plant.arms.test_chain import christoffel
from tests.plant.arms.test_motion import NO_HAND, STILL, T, energy, loose, set_going, with_joints

LONG_M, FORE_M, NEAR_M, FAR_M = 0.3, 0.25, 0.12, 0.1
ONE_KG, TWO_KG, ONE_KGM2, TWO_KGM2 = 0.8, 0.5, 2e-3, 1.5e-3
ROTOR_KGM2, OWN_KGM2 = 0.01, 0.003
OFFSET = 0.4
"""Two bars in an upright plane; the second turns by -2 times the first and 0.4 rad, so its slope is 0.4 - q."""


def bar(name: str, mass: float, centre: float, inertia: float) -> str:
    return (
        f'<link name="{name}"><inertial><origin xyz="{centre} 0 0"/><mass value="{mass}"/>'
        f'<inertia ixx="{inertia}" iyy="{inertia}" izz="{inertia}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )


PLANAR = f"""<robot name="planar"><link name="base"/>{bar("upper", ONE_KG, NEAR_M, ONE_KGM2)}
{bar("fore", TWO_KG, FAR_M, TWO_KGM2)}<link name="tip"/>
<joint name="first" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 -1 0"/>
  <limit lower="-1.5" upper="1" effort="30" velocity="4"/>
  <dynamics damping="0.1" friction="0.02" armature="{ROTOR_KGM2}"/></joint>
<joint name="second" type="revolute"><parent link="upper"/><child link="fore"/><origin xyz="{LONG_M} 0 0"/>
  <axis xyz="0 -1 0"/><limit lower="-1.2" upper="2" effort="30" velocity="6"/>
  <dynamics damping="0.03" friction="0.05" armature="{OWN_KGM2}"/>
  <mimic joint="first" multiplier="-2" offset="{OFFSET}"/></joint>
<joint name="end" type="fixed"><parent link="fore"/><child link="tip"/><origin xyz="{FORE_M} 0 0"/></joint></robot>"""


def planar() -> ArmTable:
    return table_from(PLANAR, "planar.urdf", "tip", home=(0.3,))


def by_hand(q: float) -> tuple[float, float, float, Array, Array]:
    """M, its half derivative, g, tip and J of the two bars; the kinetic energy by their slopes q and 0.4 - q."""
    crossed = TWO_KG * LONG_M * FAR_M
    M = (
        ONE_KG * NEAR_M**2 + ONE_KGM2 + ROTOR_KGM2 + TWO_KG * (LONG_M**2 + FAR_M**2) + TWO_KGM2 + 4.0 * OWN_KGM2
        - 2.0 * crossed * math.cos(2.0 * q - OFFSET)
    )  # fmt: skip
    g = 9.81 * ((ONE_KG * NEAR_M + TWO_KG * LONG_M) * math.cos(q) - TWO_KG * FAR_M * math.cos(OFFSET - q))
    c, s, c2, s2 = math.cos(q), math.sin(q), math.cos(OFFSET - q), math.sin(OFFSET - q)
    tip = np.array([LONG_M * c + FORE_M * c2, 0.0, LONG_M * s + FORE_M * s2])
    J = np.array([-LONG_M * s + FORE_M * s2, 0.0, LONG_M * c - FORE_M * c2])
    return M, 2.0 * crossed * math.sin(2.0 * q - OFFSET), g, tip, J


def test_two_bars_are_those_of_a_lagrangian_by_hand() -> None:
    """M, C, g, tip and J, at 50 states, to rounding; damping 0.1 + 4 0.03, friction 0.02 + 2 0.05."""
    table = planar()
    chain, g = chain_of(table), [0.0]
    for q in np.linspace(-3.0, 3.0, 50):
        M, half, weight, tip, J = by_hand(float(q))
        matrices(chain, [q], [0.7])
        gravity(chain, [q], [q], g)
        difference(chain, chain.tip, [q], [q])
        assert chain.inertia[0][0] == pytest.approx(M, abs=1e-15)
        assert chain.coriolis[0][0] == pytest.approx(0.7 * half, abs=1e-15)
        assert g[0] == pytest.approx(weight, abs=1e-14)
        np.testing.assert_allclose(chain.tip.begin, tip, rtol=0.0, atol=1e-15)
        np.testing.assert_allclose(chain.tip.columns[0], J, rtol=0.0, atol=1e-15)
    M, _, _, _, J = by_hand(0.3)
    assert apparent_masses(table)[0] == pytest.approx(M / (J @ J))
    assert felt_damping(table) == pytest.approx(0.22 / (J @ J))
    (only,) = table.free
    assert (only.damping, only.friction) == pytest.approx((0.22, 0.12))


def test_both_joints_have_their_stops_and_speeds() -> None:
    """-2 q + 0.4 between -1.2 and 2 rad: q between -0.8 and 0.8, within -1.5 to 1; 6 rad/s of the second are 3."""
    (only,) = planar().free
    assert (only.lower, only.upper, only.speed) == pytest.approx((-0.8, 0.8, 3.0))
    assert only.effort == 30.0  # the first joint's motor moves both
    assert table_from(PLANAR, "planar.urdf", "tip").home == pytest.approx((0.0,), abs=1e-15)
    tighter = PLANAR.replace('lower="-1.5" upper="1"', 'lower="-0.1" upper="0.2"')
    (only,) = table_from(tighter, "planar.urdf", "tip").free
    assert (only.lower, only.upper) == (-0.1, 0.2)
    with pytest.raises(InvalidParameter, match=r"home of planar.urdf is \(0.1, 0.2\); allowed: 1 angles, one for each "
                                               r"of first"):  # fmt: skip
        chain_of(table_from(PLANAR, "planar.urdf", "tip", home=(0.1, 0.2)))


@pytest.mark.parametrize("ticks", mostly_slow([300, 500], 1))
def test_it_moves_as_the_lagrangian_says(ticks: int) -> None:
    """Pushed, damped, rubbing and heavy, beside scipy's DOP853 on the equation by hand; within 1e-5 rad, and
    16 times better with a quarter of the step."""
    push = np.array([-25.0, 0.0, 3.0])

    def slope(_: float, state: Array) -> list[float]:
        q, v = state
        M, half, g, _, J = by_hand(q)
        rub = 0.12 * v / math.hypot(v, SLIP_RADPS)
        return [v, (J @ push - g - half * v * v - 0.22 * v - rub) / M]

    ends = T * np.arange(1, ticks + 1)
    solved: Any = solve_ivp(slope, (0.0, T * ticks), [0.3, 0.0], "DOP853", ends, rtol=1e-11, atol=1e-12)
    far = with_joints(planar(), lower=-9.0, upper=9.0, speed=math.inf)
    errors = []
    for steps in (4, 16):
        arm = arm_of(far, NO_HAND, T, steps, compensated=False)
        arm.commanded[:3] = push.tolist()
        found = []
        for _ in range(ticks):
            motion.tick(arm, STILL, 0)
            found.append(arm.q[0])
        errors.append(float(np.abs(np.array(found) - solved.y[0]).max()))
    assert np.ptp(solved.y[0]) > 0.3 * (ticks / 500) ** 5
    assert errors[0] < 1e-5
    assert errors[1] < errors[0] / 10.0


def arms() -> list[ArmTable]:
    """Of 2 to 10 joints that turn or slide; leaders before and behind, several mimics of one, a hinge's slide."""
    rng = np.random.default_rng(9)
    return [
        led(random_arm(rng, 2, (), 0.01), (0, 1, 0.7, -0.3)),
        led(random_arm(rng, 4, (2,), 0.02), (2, 0, 0.15, 0.1), (3, 1, -2.0, 0.0)),
        led(random_arm(rng, 6, (1,), 0.01), (0, 3, -1.0, 0.5), (5, 3, 2.5, 0.0), (2, 1, 4.0, 1.0)),
        led(random_arm(rng, 10, (3, 8), 0.01), (8, 3, -1.0, 0.0), (4, 9, 0.5, -1.0)),
    ]


@pytest.mark.parametrize("table", arms(), ids=lambda table: table.name)
def test_all_joints_matrices_are_reduced(table: ArmTable) -> None:
    """With q of all joints G q + g0: G' M G, G' (C q' + g) and J G of MuJoCo's, 100 states; C is Christoffel's."""
    import mujoco

    rng, n, joints = np.random.default_rng(1), len(table.home), len(table.joints)
    chain, g = chain_of(table), [0.0] * n
    model, data = in_mujoco(table)
    free = [joint.name for joint in table.joints if not joint.leader]
    G, g0 = np.zeros((joints, n)), np.array([joint.offset for joint in table.joints])
    for i, joint in enumerate(table.joints):
        G[i, free.index(joint.leader or joint.name)] = joint.multiplier
    inertia, jacobian = np.zeros((joints, joints)), np.zeros((3, joints))
    for _ in range(100):
        q, v = rng.uniform(-1.5, 1.5, n), rng.normal(size=n)
        data.qpos[:], data.qvel[:] = G @ q + g0, G @ v
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, inertia)
        mujoco.mj_jacSite(model, data, jacobian, None, 0)
        matrices(chain, q.tolist(), v.tolist())
        M, C = (np.array(one)[:n, :n] for one in (chain.inertia, chain.coriolis))
        gravity(chain, q.tolist(), q.tolist(), g)
        difference(chain, chain.tip, q.tolist(), q.tolist())
        for ours, theirs in (
            (M, G.T @ inertia @ G),
            (C @ v + g, G.T @ data.qfrc_bias),
            (np.array(chain.tip.begin), data.site_xpos[0]),
            (np.array(chain.tip.columns)[:n].T, jacobian @ G),
        ):
            np.testing.assert_allclose(ours, theirs, rtol=0.0, atol=1e-9)
    expected = christoffel(chain, q, v)
    matrices(chain, q.tolist(), v.tolist())
    np.testing.assert_allclose(np.array(chain.coriolis)[:n, :n], expected, rtol=0.0, atol=1e-8)


@pytest.mark.parametrize("size", [3.0, 1e-6, 0.0])
def test_the_change_between_two_postures_is_exact(size: float) -> None:
    rng = np.random.default_rng(3)
    for table in arms():
        n, chain = len(table.home), chain_of(table)
        g = [0.0] * n
        for _ in range(20):
            q0 = rng.uniform(-2.0, 2.0, n)
            q1 = q0 + size * rng.normal(size=n)
            rise = height(chain, q1.tolist()) - height(chain, q0.tolist())
            gravity(chain, q0.tolist(), q1.tolist(), g)
            assert np.dot(g, q1 - q0) == pytest.approx(rise, abs=1e-12)
            difference(chain, chain.tip, q0.tolist(), q1.tolist())
            moved = np.array(chain.tip.end) - np.array(chain.tip.begin)
            np.testing.assert_allclose(np.array(chain.tip.columns)[:n].T @ (q1 - q0), moved, rtol=0.0, atol=1e-13)


@pytest.mark.parametrize("table", mostly_slow(arms()[:3], 2), ids=lambda table: table.name)
def test_free_motion_keeps_its_energy(table: ArmTable) -> None:
    """To 1e-12 J in 1 s at 1 ms with the weight."""
    arm = arm_of(loose(table), NO_HAND, T, 1, compensated=False)
    set_going(arm, np.full(arm.n, 0.3))
    start, worst = energy(arm), 0.0
    for _ in range(1000):
        motion.tick(arm, STILL, 0)
        worst = max(worst, abs(energy(arm) - start))
    assert motion.kinetic(arm) > 0.0
    assert worst <= 1e-12
    assert arm.unsettled == 0


def test_an_arm_against_its_mimics_stop_closes_its_account() -> None:
    """The hand presses the first bar on, the second's stop at -1.2 rad holds both at 0.8; with friction, damping and
    the drive's brake the hand's work, the force's and the losses close in every tick."""
    arm = arm_of(planar(), Impedance(0.2, 3.0, 60.0), T, 2, compensated=False)
    arm.commanded[:3] = [-30.0, 0.0, 0.0]
    worst = 0.0
    for k in range(1500):
        before, x, lost = energy(arm), list(arm.x[:3]), arm.lost
        work = motion.tick(arm, [(-2e-4 * k, 0.0, 0.0), (-2e-4 * (k + 1), 0.0, 0.0)], 0)
        done = sum(f * (new - old) for f, new, old in zip(arm.force[:3], arm.x[:3], x, strict=True))
        worst = max(worst, abs(work + done - (energy(arm) - before) - (arm.lost - lost)))
    assert worst <= 1e-13
    assert 0.8 < arm.q[0] < 0.83
    assert arm.lost > 0.0


def test_a_run_records_the_free_joints(tmp_path: Path) -> None:
    """Held at its tip a mimic has no column of its own; joint by joint no axis. The picture has all links, where
    MuJoCo has them."""
    import mujoco

    file = tmp_path / "planar.urdf"
    file.write_text(PLANAR)
    name = f"arm:{file}?tip=tip&home=0.3"
    given = {"hardware": name, "scene": "free", "operator": "sine", "duration_s": 0.3, "link.up": "4g",
             "link.down": "4g", "device.substeps": 1}  # fmt: skip
    result = Simulation(prepare(given).params, 1).run()
    assert result.summary["verdict"]["passive"] is True
    columns = [one for one in frames.table(result.recording) if one.startswith("joint_")]
    assert columns == ["joint_1_rad"]
    picture = ArmPicture.of(result.recording.meta)
    assert picture is not None
    model, data = in_mujoco(planar())
    data.qpos[:] = 0.5, OFFSET - 1.0
    mujoco.mj_forward(model, data)
    assert len(picture.parts) == 3
    home = by_hand(0.3)[3]
    np.testing.assert_allclose(picture.poses((0.5,))[:, :3], data.xpos[1:] - home, rtol=0.0, atol=1e-12)
    by_joints = prepare({**given, "hardware": name + "&axes=joints", "scene": "joints"}).params
    assert by_joints.dof == 1
    M = by_hand(0.3)[0]
    assert by_joints.device.mass == pytest.approx(M)
    heavier = table_of(name + "&armature=0.05")  # the first motor's; the second joint has none
    assert at_home(heavier)[1][0, 0] == pytest.approx(M + 0.05 - ROTOR_KGM2 - 4.0 * OWN_KGM2)
    assert [one.name for one in joints_of(planar(), "", in_servo=False)] == ["first"]


def test_slides_that_mimic_are_drawn() -> None:
    """The description says which of the angles are of slides, and which links slide with them."""
    import mujoco

    table = led(cylindrical(), (2, 1, 0.1, -0.05))
    found = described(table, False)
    assert "slides" not in found
    assert found["mimics"] == [[2, 1, 0.1, -0.05, True]]
    at = ArmPicture(found).poses((0.1, 0.9, 0.2))
    model, data = in_mujoco(table)
    data.qpos[:] = 0.1, 0.9, 0.1 * 0.9 - 0.05, 0.2
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(at[:, :3] - at[0, :3], data.xpos[1:] - data.xpos[1], rtol=0.0, atol=1e-12)
    leading = described(led(cylindrical(), (1, 2, 3.0, 0.5)), False)  # q: the waist, the slide, the elbow
    assert leading["slides"] == [1]
    assert ArmPicture(leading).poses((0.1, 0.1, 0.2)).shape == (4, 7)


def test_a_mimic_of_a_mimic_follows_the_first() -> None:
    """q3 = 3 q2 + 0.2 and q2 = -2 q1 + 0.4: q3 = -6 q1 + 1.4."""
    third = (
        PLANAR.replace('<joint name="end" type="fixed">', '<joint name="end" type="revolute"><axis xyz="0 0 1"/>'
                       '<limit lower="-9" upper="9" effort="1" velocity="1"/>'
                       '<mimic joint="second" multiplier="3" offset="0.2"/>')
        .replace('<link name="tip"/>', bar("tip", 0.1, 0.0, 1e-4))
    )  # fmt: skip
    last = table_from(third, "planar.urdf", "tip").joints[-1]
    assert (last.leader, last.multiplier, last.offset) == ("first", -6.0, pytest.approx(1.4))


def test_the_omni_is_as_before() -> None:
    """Without mimics each joint has its own coordinate, and `free` are all."""
    assert omni().free == omni().joints
    assert omni().coordinates == [(0, 1.0, 0.0), (1, 1.0, 0.0), (2, 1.0, 0.0)]
