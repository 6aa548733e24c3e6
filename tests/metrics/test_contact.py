from collections import Counter
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from hapnet.errors import InvalidParameter
from hapnet.plant.integrator import PassiveIntegrator
from hapnet.plant.worlds.walls import Contacts, Vector, Wall
from tests.conftest import mostly_slow, random_spd

Array = NDArray[np.float64]


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def wall_force(p0: Array, speed: Array, dt: Array, stiffness: Array, damping: Array) -> Array:
    """The law itself, for a wall and the `speed` into it: minus the discrete gradient, minus the part-time damper."""
    p1 = p0 + dt * speed
    moved = p1 != p0
    path = np.where(moved, p1 - p0, 1.0)
    d0, d1 = np.maximum(p0, 0.0), np.maximum(p1, 0.0)
    gradient = np.where(moved, stiffness * (d1 - d0) * (d1 + d0) / 2 / path, stiffness * d0)
    inside = np.where(moved, (d1 - d0) / path, p0 > 0.0)
    return -gradient - damping * inside * speed


def bisect(p0: Array, w: Array, a: Array, dt: Array, stiffness: Array, damping: Array, acts: Array) -> Array:
    """Velocity along the normal with ``a (v - w)`` equal to the two faces' force: columns are upper and lower face."""
    sides = np.array([1.0, -1.0])

    def excess(v: Array) -> Array:
        push = [
            s * acts[:, i] * wall_force(p0[:, i], s * v, dt, stiffness[:, i], damping[:, i])
            for i, s in enumerate(sides)
        ]
        return a * (v - w) - push[0] - push[1]

    # The forces never grow with v, so neither root can lie beyond |w| plus the speed that all springs' energy gives.
    stored = (stiffness * np.maximum(p0, 0.0)).sum(axis=1)
    reach = np.abs(w) + stored / a + 1e-300
    low, high = -reach, reach.copy()
    assert np.all(excess(low) <= 0.0)
    assert np.all(excess(high) >= 0.0)
    for _ in range(200):
        middle = low + (high - low) / 2
        above = excess(middle) > 0.0
        low, high = np.where(above, low, middle), np.where(above, middle, high)
    return low + (high - low) / 2


def reference(p0: Array, w: Array, a: Array, dt: Array, stiffness: Array, damping: Array) -> tuple[Array, list[str]]:
    """Velocity along the normal by bisection, with the faces that pull left out, and what kind of step it was."""
    acts = np.ones_like(p0)
    v = bisect(p0, w, a, dt, stiffness, damping, acts)
    slack = 1e-12 * a * (np.abs(w) + np.abs(v)) + 1e-300
    for i, s in enumerate((1.0, -1.0)):
        acts[:, i] = wall_force(p0[:, i], s * v, dt, stiffness[:, i], damping[:, i]) <= slack
    v = bisect(p0, w, a, dt, stiffness, damping, acts)
    p1 = p0 + dt[:, None] * v[:, None] * np.array([1.0, -1.0])
    kinds = []
    for start, end, act in zip(p0 > 0, p1 > 0, acts, strict=True):
        if not act.all():
            kinds.append("pull, crossing" if end.any() and not (start & end).any() else "pull")
        elif not start.any():
            kinds.append("entering" if end.any() else "free")
        elif not end.any():
            kinds.append("leaving")
        else:
            kinds.append("inside" if (start & end).any() else "crossing")
    return v, kinds


def run(
    integrator: PassiveIntegrator, contacts: Contacts, dts: list[float], targets: list[list[float]]
) -> tuple[Array, Array, Array, Array]:
    """Positions and velocities (one more than steps), forces and mean velocities."""
    x, v, f, vhat = [integrator.position], [integrator.velocity], [], []
    for dt, target in zip(dts, targets, strict=True):
        step = integrator.step(dt, tuple(target), contacts)
        x.append(step.position)
        v.append(integrator.velocity)
        f.append(step.force)
        vhat.append(step.velocity)
    return np.array(x), np.array(v), np.array(f), np.array(vhat)


@pytest.mark.parametrize("faces", [1, 2])
@pytest.mark.parametrize("trajectories", mostly_slow([100, 400], 1))
@pytest.mark.long
def test_against_bisection(faces: int, trajectories: int) -> None:
    # 50 random steps in each trajectory, with general SPD M, B', K', every step met in its own trajectory.
    rng = np.random.default_rng([11, faces])
    count = 50
    kinds: Counter[str] = Counter()
    rows = []
    for _ in range(trajectories):
        n = int(rng.integers(1, 4))
        scale = log_uniform(rng, 1e-3, 1.0)
        M, B = random_spd(rng, n, scale, 10 * scale), random_spd(rng, n, 0.1, 20.0)
        K = random_spd(rng, n, 50.0, 2000.0)
        normal = rng.normal(size=n)
        normal /= np.linalg.norm(normal)
        upper, lower = (0.01, -0.002) if faces == 2 else (0.01, -1e3)  # out of reach
        # Two soft faces: a mass that crosses the gap between them in a step must be deep or fast.
        K_w = [log_uniform(rng, 100.0, 5e4 if faces == 1 else 5e3) for _ in range(2)]
        B_w = [float(rng.choice([0.0, log_uniform(rng, 0.1, 300.0)])) for _ in range(2)]
        walls = [Wall(tuple(normal), upper, K_w[0], B_w[0])]
        if faces == 2:
            walls.append(Wall(tuple(-normal), -lower, K_w[1], B_w[1]))
        integrator = PassiveIntegrator(M, B, K, np.zeros(n))
        dts = np.exp(rng.uniform(np.log(1e-3), np.log(0.03), count))
        targets = rng.normal(0.0, log_uniform(rng, 0.01, 0.5), (count, n))
        x, v, f, _ = run(integrator, Contacts(walls), dts.tolist(), targets.tolist())
        for k, dt in enumerate(dts):
            A = 2 * M / dt + B + K * dt / 2
            c = 2 * M @ v[k] / dt - K @ (x[k] - targets[k])
            response = np.linalg.solve(A, normal)
            a, w = 1 / (normal @ response), response @ c
            q = normal @ x[k]
            rows.append((q - upper, lower - q, w, a, dt, *K_w, *B_w, f[k] @ normal))
            assert np.linalg.norm(f[k] - normal * (f[k] @ normal)) <= 1e-12 * np.linalg.norm(f[k])
    table = np.array(rows)
    p0, (w, a, dt) = table[:, :2], table[:, 2:5].T
    stiffness, damping, force = table[:, 5:7], table[:, 7:9], table[:, 9]
    expected, kind = reference(p0, w, a, dt, stiffness, damping)
    kinds.update(kind)
    got = w + force / a
    # To rounding in w (whose solve here is numpy's) and in the penetration, a difference of coordinates near 1 m.
    tolerance = 1e-12 * (np.abs(w) + np.abs(expected)) + 1e-15 * stiffness.max(axis=1) / a
    np.testing.assert_array_less(np.abs(got - expected), tolerance)
    wanted = ["free", "entering", "inside", "leaving", "pull"] + (["crossing", "pull, crossing"] if faces == 2 else [])
    assert all(kinds[k] >= trajectories / 4 for k in wanted), kinds


@pytest.mark.parametrize("faces", mostly_slow([1, 2], 1))
@pytest.mark.long
def test_work_is_never_positive_over_a_closed_visit(faces: int) -> None:
    rng = np.random.default_rng([12, faces])
    visits = 0
    for _ in range(150):
        n = int(rng.integers(1, 4))
        normal = rng.normal(size=n)
        normal /= np.linalg.norm(normal)
        at = 0.02
        walls = [
            Wall(tuple(s * normal), at, log_uniform(rng, 100.0, 5e4), float(rng.choice([0.0, 10.0, 100.0])))
            for s in (1.0, -1.0)[:faces]
        ]
        contacts = Contacts(walls)
        integrator = PassiveIntegrator(log_uniform(rng, 1e-3, 1.0), 1.0, 500.0, np.zeros(n))
        count = 200
        dts = rng.uniform(1e-3, 0.03, count)
        targets = 0.06 * np.sin(np.cumsum(dts) * rng.uniform(5.0, 50.0))[:, None] * normal + rng.normal(
            0.0, 0.005, (count, n)
        )
        x, _, f, vhat = run(integrator, contacts, dts.tolist(), targets.tolist())
        q = x @ normal
        depth = np.maximum(q - at, 0.0) if faces == 1 else np.maximum(np.abs(q) - at, 0.0)
        stiff = np.where(q > 0, walls[0].stiffness, walls[-1].stiffness)
        U = stiff * depth**2 / 2
        np.testing.assert_allclose([contacts.stored_J(p) for p in x], U, rtol=1e-10, atol=1e-25)
        np.testing.assert_allclose([contacts.penetration(p) for p in x], depth, rtol=0, atol=1e-15)
        work = np.einsum("ki,ki->k", f, vhat) * dts
        # A coordinate is known to a few units in its last place, so U to that times the spring's force.
        rounding = 4e-16 * (1 + np.abs(q).max()) * stiff.max() * depth.max() + 4e-16 * np.abs(work).max()
        assert np.all(work <= U[:-1] - U[1:] + rounding)  # every single step
        outside = np.flatnonzero(depth == 0.0)
        for start, end in pairwise(outside):
            if end > start + 1:
                visits += 1
                assert work[start:end].sum() <= (end - start) * rounding
    assert visits > 1000


def test_undamped_wall_gives_back_what_it_took() -> None:
    # With B_w = 0 the discrete gradient is conservative: every closed visit does zero work, not just none.
    rng = np.random.default_rng(13)
    integrator = PassiveIntegrator(0.02, 1.0, 500.0, (0.0,))
    contacts = Contacts([Wall((1.0,), 0.01, 3000.0), Wall((-1.0,), 0.01, 5000.0)])
    crossings = 0
    for dt, y in zip(rng.uniform(1e-3, 0.03, 2000).tolist(), rng.normal(0.0, 0.2, 2000).tolist(), strict=True):
        before, x = contacts.stored_J(integrator.position), integrator.position[0]
        step = integrator.step(dt, (y,), contacts)
        after = contacts.stored_J(step.position)
        assert step.work_J == pytest.approx(before - after, rel=1e-10, abs=1e-14 * (1 + before + after))
        crossings += x * step.position[0] < 0.0 and before > 0.0 and after > 0.0
    assert crossings > 20


def test_limits_of_the_numbers() -> None:
    # Starts on the surface, tiny steps, hard walls: no division by zero, never a pull, never work gained.
    for stiffness in (1e-3, 3e3, 1e12):
        for damping in (0.0, 10.0, 1e9):
            for target in (0.0, 5e-324, 1e-160, 1e-9, 0.05, -0.05):
                contacts = Contacts([Wall((1.0,), 0.0, stiffness, damping), Wall((-1.0,), 1e-3, stiffness, damping)])
                integrator = PassiveIntegrator(1e-3, 1e-3, 500.0, (0.0,))
                for dt in (1e-9, 1e-3, 0.05, 1e-9, 0.03) * 3:
                    x = integrator.position
                    before = contacts.stored_J(x)
                    step = integrator.step(dt, (target,), contacts)
                    target = -target
                    after = contacts.stored_J(step.position)
                    depth = max(contacts.penetration(x), step.penetration_m)
                    # The end is where free flight (to 0.2 m here) and the wall's push cancel: known to that's rounding.
                    rounding = 2e-16 * 0.2 * 4 * stiffness * depth + 1e-12 * (before + after + abs(step.work_J))
                    assert step.work_J <= before - after + rounding
                    assert np.isfinite([step.work_J, *step.position, *step.force, *integrator.velocity]).all()
                    if x[0] > 0.0 and step.position[0] > -1e-3:
                        assert step.force[0] <= 0.0


def test_box_axes_act_as_if_alone() -> None:
    rng = np.random.default_rng(14)
    mass, damping, stiffness = (0.02, 0.05, 0.1), (14.0, 3.0, 1.0), (500.0, 300.0, 900.0)
    faces = [(1e3, 1.0), (2e3, 10.0), (3e3, 0.0), (4e3, 5.0), (5e3, 2.0), (6e3, 30.0)]
    walls = [
        Wall(tuple(s if j == i else 0.0 for j in range(3)), 0.01, *faces[2 * i + (s < 0)])
        for i in range(3)
        for s in (1.0, -1.0)
    ]
    whole, box = PassiveIntegrator(mass, damping, stiffness, (0.0,) * 3), Contacts(walls)
    alone = [PassiveIntegrator(mass[i], damping[i], stiffness[i], (0.0,)) for i in range(3)]
    pairs = [Contacts([Wall((1.0,), 0.01, *faces[2 * i]), Wall((-1.0,), 0.01, *faces[2 * i + 1])]) for i in range(3)]
    deep = 0
    for _ in range(500):
        dt, y = rng.uniform(0.001, 0.05), rng.normal(0.0, 0.05, 3).tolist()
        step = whole.step(dt, tuple(y), box)
        single = [one.step(dt, (t,), pair) for one, t, pair in zip(alone, y, pairs, strict=True)]
        np.testing.assert_allclose(step.position, [s.position[0] for s in single], rtol=1e-9, atol=1e-14)
        np.testing.assert_allclose(step.force, [s.force[0] for s in single], rtol=1e-9, atol=1e-10)
        assert step.penetration_m == pytest.approx(max(s.penetration_m for s in single), abs=1e-14)
        deep += sum(s.penetration_m > 0.0 for s in single) > 1
    assert deep > 50


def test_rotated_box_on_common_eigenvectors() -> None:
    # Oblique walls on the eigenvectors of M, B', K' are separate, and must not be refused for rounding.
    rng = np.random.default_rng(15)
    Q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    M, B, K = (Q @ np.diag(d) @ Q.T for d in ((0.01, 0.1, 1.0), (14.0, 1.0, 5.0), (100.0, 500.0, 2000.0)))
    contacts = Contacts([Wall(tuple(s * Q[:, i]), 0.02, 3000.0, 10.0) for i in range(3) for s in (1.0, -1.0)])
    integrator = PassiveIntegrator(M, B, K, np.zeros(3))
    stored = 0.0
    for y in rng.normal(0.0, 0.05, (300, 3)).tolist():
        step = integrator.step(0.02, tuple(y), contacts)
        after = contacts.stored_J(step.position)
        assert step.work_J <= stored - after + 1e-12 * (1 + stored + after)
        stored = after


def oblique_walls(rng: np.random.Generator, n: int) -> list[Wall]:
    """Up to six, in any direction but around the origin, and perhaps one opposite to the first."""
    normals = [rng.normal(size=n) for _ in range(int(rng.integers(2, 6)))]
    if rng.random() < 0.5:
        normals.append(-normals[0])
    faces = [(log_uniform(rng, 10.0, 1e5), rng.choice([0.0, log_uniform(rng, 0.1, 100.0)])) for _ in normals]
    return [
        Wall(tuple(v.tolist()), rng.uniform(0.0, 0.02) + 1e-4, *face) for v, face in zip(normals, faces, strict=True)
    ]


@pytest.mark.parametrize("n", mostly_slow([2, 3], 1))
@pytest.mark.long
def test_walls_that_act_on_one_another_are_solved_together(n: int) -> None:
    """Each wall's own law holds at the velocity that all of them give, and they store no more than they get."""
    rng = np.random.default_rng(27 + n)
    together = 0
    for _ in range(40):
        walls = oblique_walls(rng, n)
        contacts = Contacts(walls)
        M, B, K = random_spd(rng, n, 5e-3, 0.5), random_spd(rng, n, 1.0, 30.0), random_spd(rng, n, 50.0, 2000.0)
        integrator = PassiveIntegrator(M, B, K, np.zeros(n))
        stiffness, damping = (np.array([getattr(wall, name) for wall in walls]) for name in ("stiffness", "damping"))
        normals = np.array([wall.normal for wall in walls])
        stored = 0.0
        for _ in range(60):
            dt, before = log_uniform(rng, 1e-3, 0.1), np.array(integrator.position)
            step = integrator.step(dt, tuple(rng.normal(0.0, 0.04, n).tolist()), contacts)
            p0 = normals @ before - [wall.offset for wall in walls]
            pushes = np.minimum(
                wall_force(p0, normals @ np.array(step.velocity), np.full(len(p0), dt), stiffness, damping), 0.0
            )
            assert np.array(step.force) == pytest.approx(pushes @ normals, rel=1e-8, abs=1e-9)
            after = contacts.stored_J(step.position)
            assert step.work_J <= stored - after + 1e-12 * (1.0 + stored + after)
            stored = after
            together += int((pushes < 0.0).sum() > 1)
        assert not contacts.separate
    assert together > 200


@pytest.mark.long
def test_separate_walls_have_the_same_step_when_they_are_solved_together() -> None:
    rng = np.random.default_rng(28)
    walls = [Wall((s * (i == 0), s * (i == 1)), 0.02, 3000.0, 10.0) for i in range(2) for s in (1.0, -1.0)]
    closed, newton = Contacts(walls), Contacts(walls)
    for y in rng.normal(0.0, 0.06, (300, 2)).tolist():
        dt = rng.uniform(0.001, 0.1)
        one, other = (PassiveIntegrator(0.02, 14.0, 500.0, (0.01, -0.01), (0.5, -2.0)) for _ in range(2))
        other.set_contacts(newton)
        newton.separate = False
        for goal in (y, [-part for part in y], y):
            a, b = one.step(dt, tuple(goal), closed), other.step(dt, tuple(goal), newton)
            assert b.force == pytest.approx(a.force, rel=1e-9, abs=1e-9)
    assert closed.separate


def test_what_makes_walls_act_on_one_another() -> None:
    floor, oblique = Wall((0.0, 1.0), 0.02, 3000.0), Wall((1.0, 1.0), 0.02, 3000.0)
    side = Wall((1.0, 0.0), 0.02, 3000.0)
    good, skew = np.eye(2), np.array([[2.0, 0.5], [0.5, 1.0]])
    # M and K' couple with opposite signs, which cancel at the one T where 2M/T + K' T/2 is diagonal.
    cancelling = (np.array([[1.0, 0.1], [0.1, 1.0]]), 1.0, np.array([[400.0, -40.0], [-40.0, 400.0]]))
    cases = [((good, good, good), [floor, side, oblique]), (cancelling, [floor, side])]
    cases += [((M, B, K), [floor, side]) for M, B, K in ((skew, good, good), (good, skew, good), (good, good, skew))]
    for matrices, walls in cases:
        contacts = Contacts(walls)
        PassiveIntegrator(*matrices, (0.0, 0.0)).set_contacts(contacts)
        assert not contacts.separate
    for matrices, walls in (((good, good, good), [floor, side]), ((skew, skew, skew), [floor])):
        contacts = Contacts(walls)
        PassiveIntegrator(*matrices, (0.0, 0.0)).set_contacts(contacts)
        assert contacts.separate


def test_normal_is_made_a_unit_vector() -> None:
    wall = Wall((0.0, 3.0, 4.0), 0.1, 10.0)
    assert wall.normal == (0.0, 0.6, 0.8)
    assert wall.penetration((5.0, 1.0, 1.0)) == pytest.approx(1.3)


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (((0.0, 0.0), 0.0, 1.0), "normal"),
        (((), 0.0, 1.0), "normal"),
        (((1.0, float("nan")), 0.0, 1.0), "normal"),
        (("up", 0.0, 1.0), "normal"),
        (((1.0,), float("inf"), 1.0), "offset"),
        (((1.0,), 0.0, 0.0), "stiffness"),
        (((1.0,), 0.0, "3 kN/m"), "stiffness"),
        (((1.0,), 0.0, 1.0, -1.0), "damping"),
        (((1.0,), 0.0, 1.0, float("nan")), "damping"),
    ],
)
def test_bad_walls(arguments: tuple[Vector, float, float], named: str) -> None:
    with pytest.raises(InvalidParameter) as caught:
        Wall(*arguments)
    assert caught.value.name == named


def test_bad_collections() -> None:
    right, left = Wall((1.0, 0.0), 0.02, 1.0), Wall((-1.0, 0.0), -0.02, 1.0)
    with pytest.raises(InvalidParameter, match="one wall a direction"):
        Contacts([right, Wall((2.0, 0.0), 0.05, 1.0)])
    with pytest.raises(InvalidParameter, match="one wall a direction"):
        Contacts([right, Wall((-1.0, 0.0), 0.0, 1.0), Wall((-1.0, 0.0), 0.01, 1.0)])
    with pytest.raises(InvalidParameter, match=r"walls\[0\] and walls\[1\].*gap"):
        Contacts([right, left])
    with pytest.raises(InvalidParameter, match=r"walls\[1\].normal"):
        Contacts([right, Wall((1.0,), 0.02, 1.0)])
    with pytest.raises(InvalidParameter, match="dof"):
        Contacts([])
    assert Contacts([], 2).penetration((1.0, 1.0)) == 0.0
