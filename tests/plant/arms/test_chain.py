"""M, C, g and J of a chain, beside MuJoCo, and C beside Christoffel's symbols."""

import math
from typing import Any

import numpy as np
import pytest

from hapnet.checks import Array
from hapnet.errors import InvalidParameter
from hapnet.ext.arms.chain import Chain, difference, gravity, height, matrices
from hapnet.ext.arms.table import ArmTable, Joint, apparent_masses, chain_of, felt_damping, omni
from tests.conftest import mostly_slow
from tests.plant.arms.references import in_mujoco, random_arm

NONE = (0.0, 0.0, 0.0)


def arms() -> list[ArmTable]:
    rng = np.random.default_rng(32)
    hinges = [random_arm(rng, n) for n in (1, 2, 3, 6, 7)]
    kinds: tuple[tuple[int, tuple[int, ...]], ...] = ((3, (0, 1, 2)), (3, (1,)), (5, (0, 3)), (10, (2, 9)))
    return [omni(), *hinges, *(random_arm(rng, n, slides, 0.01) for n, slides in kinds)]


def of(matrix: Any, n: int) -> Array:
    return np.array(matrix)[:n, :n]


@pytest.mark.parametrize("states", mostly_slow([100, 1000], 1))
@pytest.mark.parametrize("table", arms(), ids=lambda table: table.name)
@pytest.mark.long
def test_states_are_mujocos(table: ArmTable, states: int) -> None:
    """M, ``C q' + g``, tip and Jacobian agree within 1e-9 (kg m^2, Nm, m); with a mass at the tip too."""
    import mujoco

    rng, n = np.random.default_rng(1), len(table.joints)
    chain = chain_of(table)
    model, data = in_mujoco(table)
    inertia, jacobian, g = np.zeros((n, n)), np.zeros((3, n)), [0.0] * n
    for _ in range(states):
        q, v = rng.uniform(-3.0, 3.0, n), 3.0 * rng.normal(size=n)
        data.qpos[:], data.qvel[:] = q, v
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, inertia)
        mujoco.mj_jacSite(model, data, jacobian, None, 0)
        matrices(chain, q.tolist(), v.tolist())
        gravity(chain, q.tolist(), q.tolist(), g)
        difference(chain, chain.tip, q.tolist(), q.tolist())
        bias = of(chain.coriolis, n) @ v + np.array(g)
        for ours, theirs in (
            (of(chain.inertia, n), inertia),
            (bias, data.qfrc_bias),
            (np.array(chain.tip.begin), data.site_xpos[0]),
            (np.array(chain.tip.columns)[:n].T, jacobian),
        ):
            np.testing.assert_allclose(ours, theirs, rtol=0.0, atol=1e-9)
        chain.tip_mass = 0.3
        matrices(chain, q.tolist(), v.tolist())
        held = inertia + 0.3 * jacobian.T @ jacobian
        np.testing.assert_allclose(of(chain.inertia, n), held, rtol=0.0, atol=1e-9)
        chain.tip_mass = 0.0


def christoffel(chain: Chain, q: Array, v: Array) -> Array:
    """C from M's derivatives, by differences of fourth order."""
    n, h = len(q), 1e-3

    def inertia(k: int, steps: int) -> Array:
        moved = q.copy()
        moved[k] += steps * h
        matrices(chain, moved.tolist(), [0.0] * n)
        return of(chain.inertia, n)

    slopes = np.array(
        [(8.0 * (inertia(k, 1) - inertia(k, -1)) - (inertia(k, 2) - inertia(k, -2))) / (12.0 * h) for k in range(n)]
    )
    turned = np.einsum("kij,k->ij", slopes, v)
    return 0.5 * (turned + np.einsum("jik,k->ij", slopes, v) - np.einsum("ijk,k->ij", slopes, v))


@pytest.mark.parametrize("table", arms(), ids=lambda table: table.name)
@pytest.mark.long
def test_c_is_christoffels(table: ArmTable) -> None:
    """Element by element, from M alone; so M' - 2C is skew. With a mass at the tip."""
    rng, n = np.random.default_rng(2), len(table.joints)
    chain = chain_of(table, 0.2)
    for _ in range(20):
        q, v = rng.uniform(-3.0, 3.0, n), rng.normal(size=n)
        expected = christoffel(chain, q, v)
        matrices(chain, q.tolist(), v.tolist())
        np.testing.assert_allclose(of(chain.coriolis, n), expected, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("size", [3.0, 1e-2, 1e-6, 1e-12, 0.0])
def test_the_change_between_two_postures_is_exact(size: float) -> None:
    """``J_d (q1 - q0) = x1 - x0``, for the tip and for the potential of gravity, to rounding."""
    rng = np.random.default_rng(3)
    for table in arms():
        n, chain, g = len(table.joints), chain_of(table), [0.0] * len(table.joints)
        larger = 20.0 if any(joint.slides for joint in table.joints) else 1.0  # slides move the arm by metres
        for _ in range(20):
            q0 = rng.uniform(-3.0, 3.0, n)
            q1 = q0 + size * rng.normal(size=n)
            rise = height(chain, q1.tolist()) - height(chain, q0.tolist())
            gravity(chain, q0.tolist(), q1.tolist(), g)
            assert np.dot(g, q1 - q0) == pytest.approx(rise, abs=1e-14 * larger)
            difference(chain, chain.tip, q0.tolist(), q1.tolist())
            moved = np.array(chain.tip.end) - np.array(chain.tip.begin)
            turned = np.array(chain.tip.columns)[:n].T @ (q1 - q0)
            np.testing.assert_allclose(turned, moved, rtol=0.0, atol=2e-15 * larger)


def test_the_omni_feels_as_its_data_sheet_says() -> None:
    """45 g in every direction at home; the simulated point mass's 0.3 Ns/m at least."""
    np.testing.assert_allclose(apparent_masses(omni()), 0.045, rtol=1e-3)
    assert felt_damping(omni()) == pytest.approx(0.3, rel=1e-3)


def test_felt_damping_by_hand() -> None:
    """One joint of 0.02 Nms/rad at 0.1 m: 2 Ns/m; with a joint that damps nothing: 0."""
    joint = Joint("a", NONE, mass=1.0, centre=(0.1, 0.0, 0.0), damping=0.02)
    assert felt_damping(ArmTable("one", (joint,), (0.1, 0.0, 0.0), (0.0,))) == pytest.approx(2.0)
    free = Joint("b", (0.1, 0.0, 0.0), mass=1.0)
    assert felt_damping(ArmTable("two", (joint, free), (0.1, 0.0, 0.0), (0.0, 0.0))) == 0.0


@pytest.mark.parametrize(
    ("joint", "message"),
    [
        (Joint("a", NONE, axis=NONE), "the axis of bad's joint a"),
        (Joint("a", NONE, mass=-1.0), "the link that joint a moves has -1 kg"),
        (Joint("a", NONE, mass=math.nan), "the link that joint a moves has nan kg"),
    ],
)
def test_impossible_links_are_refused(joint: Joint, message: str) -> None:
    with pytest.raises(InvalidParameter, match=message):
        chain_of(ArmTable("bad", (joint,), NONE, (0.0,)))


def test_too_many_joints_are_refused() -> None:
    with pytest.raises(InvalidParameter, match="1 to 10"):
        chain_of(ArmTable("long", (Joint("a", NONE, mass=1.0),) * 11, NONE, (0.0,) * 11))
