from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, strategies as st
from numpy.typing import NDArray
from scipy.linalg import expm

from hapnet.errors import InvalidParameter
from hapnet.plant.integrator import PassiveIntegrator
from hapnet.plant.worlds.walls import Contacts, Wall
from tests.conftest import mostly_slow, random_spd

Array = NDArray[np.float64]


def stored_energy(M: Array, K: Array, x: Array, v: Array, ybar: Array) -> Array:
    """kappa + phi of a batch of states."""
    e = x - ybar
    return 0.5 * np.einsum("ki,ij,kj->k", v, M, v) + 0.5 * np.einsum("ki,ij,kj->k", e, K, e)


@pytest.mark.parametrize("n", mostly_slow([1, 2, 3], 1))
@pytest.mark.parametrize("walled", [False, True])
@pytest.mark.long
def test_identity_13_over_random_steps(n: int, walled: bool) -> None:
    # 1e5 steps in all. Relative to the energies that the identity adds up, the external work among them.
    rng = np.random.default_rng([n, walled])
    for _ in range(10):
        M, B, K = random_spd(rng, n, 1e-3, 1.0), random_spd(rng, n, 0.1, 50.0), random_spd(rng, n, 10.0, 5e3)
        integrator = PassiveIntegrator(M, B, K, np.zeros(n), rng.normal(size=n))
        contacts = Contacts([Wall(tuple(rng.normal(size=n)), 0.01, 3000.0, 10.0)]) if walled else None
        count = 1700
        dts = np.exp(rng.uniform(np.log(1e-4), np.log(0.1), count))
        ybar, force = rng.normal(0.0, 0.05, (count, n)), rng.normal(0.0, 5.0, (count, n))
        states, steps = [(integrator.position, integrator.velocity)], []
        for dt, y, f in zip(dts.tolist(), ybar.tolist(), force.tolist(), strict=True):
            steps.append(integrator.step(dt, tuple(y), contacts, tuple(f)))
            states.append((integrator.position, integrator.velocity))
        x, v = (np.array([s[i] for s in states]) for i in (0, 1))
        f, vhat = np.array([s.force for s in steps]), np.array([s.velocity for s in steps])
        before, after = stored_energy(M, K, x[:-1], v[:-1], ybar), stored_energy(M, K, x[1:], v[1:], ybar)
        dissipated = np.einsum("ki,ij,kj->k", vhat, B, vhat) * dts
        work = np.einsum("ki,ki->k", f, vhat) * dts
        scale = before + after + dissipated + np.abs(work)
        assert np.all(np.abs(work - (after - before + dissipated)) <= 1e-12 * scale)
        np.testing.assert_allclose([s.work_J for s in steps], work, rtol=1e-12, atol=1e-15 * scale.max())
        np.testing.assert_allclose([s.dissipated_J for s in steps], dissipated, rtol=1e-12)
        if walled:
            assert np.any(np.array([s.penetration_m for s in steps]) > 0.0)
        else:
            np.testing.assert_array_equal(f, force)


def test_step_obeys_its_equations() -> None:
    rng = np.random.default_rng(3)
    for n in (1, 2, 3, 5):
        M, B, K = random_spd(rng, n, 1e-2, 1.0), random_spd(rng, n, 1.0, 50.0), random_spd(rng, n, 10.0, 5e3)
        integrator = PassiveIntegrator(M, B, K, rng.normal(size=n), rng.normal(size=n))
        for dt in (0.001, 0.03, 0.03, 0.2):
            x, v = np.array(integrator.position), np.array(integrator.velocity)
            y, f = rng.normal(size=n), rng.normal(size=n)
            step = integrator.step(dt, y, force=f)
            x1, v1, tau = np.array(integrator.position), np.array(integrator.velocity), np.array(step.coupling_force)
            np.testing.assert_allclose(step.velocity, (v + v1) / 2, rtol=1e-12, atol=1e-13)
            np.testing.assert_allclose(x1 - x, dt * np.array(step.velocity), rtol=1e-12, atol=1e-14)
            np.testing.assert_allclose(tau, -B @ step.velocity - K @ ((x + x1) / 2 - y), rtol=1e-9, atol=1e-9)
            np.testing.assert_allclose(M @ (v1 - v) / dt, tau + f, rtol=1e-9, atol=1e-8)
            assert step.position == integrator.position
            assert step.force == tuple(f)
            assert step.penetration_m == 0.0


@given(st.lists(st.tuples(st.floats(1e-4, 0.05), *[st.floats(-0.03, 0.03)] * 3), min_size=1, max_size=30),
       st.booleans(), st.sampled_from([1, 3]))  # fmt: skip
@pytest.mark.long
def test_one_and_three_dimensions_are_computed_as_any_are(
    steps: list[tuple[float, float, float, float]], walled: bool, n: int
) -> None:
    """A force of zero takes the path of any number of dimensions: the same values to the last bit."""
    normal, back = (1.0, 0.0, 0.0)[:n], (-1.0, 0.0, 0.0)[:n]
    contacts = Contacts([Wall(normal, 0.01, 3000.0, 10.0), Wall(back, 0.02, 2000.0, 5.0)]) if walled else None
    M, B, K = [0.02, 0.05, 0.1][:n], [14.0, 3.0, 1.0][:n], [500.0, 300.0, 900.0][:n]
    one, any_number = (PassiveIntegrator(M, B, K, (0.0,) * n) for _ in range(2))
    for dt, *ys in steps:
        y = tuple(ys[:n])
        assert one.step(dt, y, contacts) == any_number.step(dt, y, contacts, force=(0.0,) * n)
        assert (one.position, one.velocity) == (any_number.position, any_number.velocity)


def test_energies_are_those_of_the_state() -> None:
    integrator = PassiveIntegrator([2.0, 4.0], 1.0, [[3.0, 1.0], [1.0, 5.0]], (1.0, 2.0), (3.0, -1.0))
    assert integrator.kinetic_J == pytest.approx(0.5 * (2 * 9 + 4 * 1))
    assert integrator.potential_J((0.0, 1.0)) == pytest.approx(0.5 * (3 + 2 + 5))  # e = (1, 1)


def test_order_of_convergence_is_two() -> None:
    rng = np.random.default_rng(5)
    n = 3
    M, B, K = random_spd(rng, n, 0.05, 0.5), random_spd(rng, n, 0.2, 2.0), random_spd(rng, n, 20.0, 200.0)
    x0, v0, y, f = (rng.normal(size=n) for _ in range(4))
    inverse = np.linalg.inv(M)
    flow = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ K, -inverse @ B]])
    rest = np.concatenate([y + np.linalg.solve(K, f), np.zeros(n)])
    exact = rest + expm(flow * 0.5) @ (np.concatenate([x0, v0]) - rest)
    errors = []
    for count in (200, 400, 800, 1600):
        integrator = PassiveIntegrator(M, B, K, x0, v0)
        for _ in range(count):
            integrator.step(0.5 / count, y, force=f)
        errors.append(float(np.linalg.norm(np.concatenate([integrator.position, integrator.velocity]) - exact)))
    orders = [np.log2(a / b) for a, b in pairwise(errors)]
    assert all(1.98 < order < 2.02 for order in orders)


def test_scalar_diagonal_and_matrix_are_the_same_thing() -> None:
    results = []
    for kind in (lambda s: s, lambda s: [s, s], lambda s: s * np.eye(2)):
        integrator = PassiveIntegrator(kind(0.02), kind(14.0), kind(500.0), (0.0, 0.0))
        results.append([integrator.step(dt, np.array([0.02, -0.01])) for dt in (0.01, 0.05, 0.03)])
    assert results[0] == results[1] == results[2]


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"mass": 0.0}, "mass"),
        ({"mass": "heavy"}, "mass"),
        ({"mass": float("nan")}, "mass"),
        ({"mass": [1.2e12, 1.0]}, "mass"),
        ({"damping": [1.0, -1.0]}, "damping"),
        ({"damping": [1.0, 1.0, 1.0]}, "damping"),
        ({"stiffness": [[1.0, 2.0], [2.0, 1.0]]}, "stiffness"),
        ({"stiffness": [[2.0, 1.0], [0.0, 2.0]]}, "stiffness"),
        ({"stiffness": np.eye(3)}, "stiffness"),
        ({"stiffness": [[1.0, 1.0], [1.0, 1.0]]}, "stiffness"),
        ({"position": []}, "position"),
        ({"position": [[0.0, 0.0]]}, "position"),
        ({"position": [0.0, float("inf")]}, "position"),
        ({"velocity": [0.0]}, "velocity"),
    ],
)
def test_bad_parameters_are_named(change: dict[str, object], named: str) -> None:
    good: dict[str, object] = {"mass": [9e11, 1.0], "damping": 1.0, "stiffness": 1.0, "position": [0.0, 0.0]}
    PassiveIntegrator(**good)  # type: ignore[arg-type]
    with pytest.raises(InvalidParameter) as caught:
        PassiveIntegrator(**{**good, **change})  # type: ignore[arg-type]  # wrong types are among the cases
    assert caught.value.name == named


@pytest.mark.parametrize("dt", [0.0, -0.01, float("nan"), float("inf"), 1e-320])
def test_bad_step_leaves_the_state_alone(dt: float) -> None:
    integrator = PassiveIntegrator(0.02, 14.0, 500.0, (0.01,), (0.3,))
    twin = PassiveIntegrator(0.02, 14.0, 500.0, (0.01,), (0.3,))
    for each in (integrator, twin):
        each.step(0.02, (0.0,))
    with pytest.raises(InvalidParameter) as caught:
        integrator.step(dt, (0.0,))
    assert caught.value.name == "dt"
    assert integrator.step(0.02, (0.0,)) == twin.step(0.02, (0.0,))


@pytest.mark.parametrize("bad", [(0.0,), (0.0, float("nan")), (0.0, float("-inf")), "ab", (0.0, "b"), None])
@pytest.mark.parametrize("argument", ["set_position", "force"])
def test_bad_vectors_in_a_step(bad: object, argument: str) -> None:
    if argument == "force" and bad is None:
        return
    integrator = PassiveIntegrator(0.02, 14.0, 500.0, (0.0, 0.0))
    with pytest.raises(InvalidParameter) as caught:
        integrator.step(0.01, **{"set_position": (0.0, 0.0), argument: bad})  # type: ignore[arg-type]
    assert caught.value.name == argument
    assert integrator.position == (0.0, 0.0)


def test_contacts_must_fit() -> None:
    integrator = PassiveIntegrator(0.02, 14.0, 500.0, (0.0, 0.0))
    with pytest.raises(InvalidParameter, match=r"contacts.dof is 1"):
        integrator.set_contacts(Contacts([Wall((1.0,), 0.02, 3000.0)]))
    with pytest.raises(InvalidParameter, match=r"outside walls\[1\]"):
        integrator.step(0.01, (0.0, 0.0), Contacts([Wall((1.0, 0.0), 0.02, 3e3), Wall((0.0, 1.0), -1e-9, 3e3)]))


def test_walls_that_appear_around_the_mass_are_refused() -> None:
    # The same walls, let go of and taken up again while the mass is inside: their energy would come from nothing.
    contacts = Contacts([Wall((1.0,), 0.02, 3000.0)])
    integrator = PassiveIntegrator(0.02, 14.0, 500.0, (0.0,))
    integrator.step(0.03, (0.0,), contacts)
    for _ in range(20):
        integrator.step(0.03, (0.05,))
    with pytest.raises(InvalidParameter, match="outside"):
        integrator.step(0.03, (0.05,), contacts)


# -- a push: a coupling of another kind -------------------------------------------------------------------------------


def diagonal_or_full(rng: np.random.Generator, n: int, full: bool) -> Array:
    return random_spd(rng, n, 1e-2, 1.0) if full else np.diag(np.exp(rng.uniform(-4.0, 0.0, n)))


@pytest.mark.parametrize("n", [1, 2, 3])
@pytest.mark.parametrize("full", [False, True])
@pytest.mark.parametrize("K", [None, 300.0], ids=["K full", "K scalar"])
@pytest.mark.long
def test_a_push_is_the_dense_solution_and_keeps_its_energy(n: int, full: bool, K: float | None) -> None:
    """M (v1 - v)/T = p - g (v + v1)/2 solved for v1 as it stands, by numpy; the work of tau becomes kinetic energy.

    The coupling's own B' and K' have no part in it.
    """
    rng = np.random.default_rng([n, full])
    M = diagonal_or_full(rng, n, full)
    stiffness = random_spd(rng, n, 10.0, 5e3) if K is None else K
    integrator = PassiveIntegrator(M, 7.0, stiffness, rng.normal(size=n), rng.normal(size=n))
    for _ in range(200):
        dt, drag = float(np.exp(rng.uniform(np.log(1e-4), np.log(0.1)))), float(rng.choice([0.0, 0.3, 50.0]))
        p = rng.normal(0.0, 5.0, n)
        x, v, kinetic = np.array(integrator.position), np.array(integrator.velocity), integrator.kinetic_J
        step = integrator.push(dt, drag, tuple(p.tolist()))
        v1 = np.linalg.solve(M / dt + drag / 2 * np.eye(n), p + (M / dt - drag / 2 * np.eye(n)) @ v)
        np.testing.assert_allclose(integrator.velocity, v1, rtol=1e-9, atol=1e-9 * np.abs(v).max())
        np.testing.assert_allclose(step.velocity, (v + integrator.velocity) / 2, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(step.position, x + dt * np.array(step.velocity), rtol=1e-12, atol=1e-14)
        np.testing.assert_allclose(step.coupling_force, p - drag * np.array(step.velocity), rtol=1e-12)
        work = dt * float(np.dot(step.coupling_force, step.velocity))
        assert integrator.kinetic_J - kinetic == pytest.approx(work, rel=1e-9, abs=1e-11 * (kinetic + abs(work)))
        assert (step.force, step.work_J, step.dissipated_J, step.penetration_m) == ((0.0,) * n, 0.0, 0.0, 0.0)
        assert step.position == integrator.position


@pytest.mark.parametrize("n", [1, 2, 3])
def test_a_push_into_a_wall_feels_the_walls_own_potential(n: int) -> None:
    """Without damping it is the discrete gradient of the potential: its work is what leaves the wall."""
    rng = np.random.default_rng(n)
    M = diagonal_or_full(rng, n, True)
    normal = rng.normal(size=n)
    normal /= np.linalg.norm(normal)
    contacts = Contacts([Wall(tuple(normal.tolist()), 0.01, 3000.0)])
    integrator = PassiveIntegrator(M, 1.0, 1.0, np.zeros(n))
    deepest, inside = 0.0, 0
    for _ in range(400):
        dt, drag = float(rng.uniform(1e-3, 0.02)), float(rng.choice([0.0, 10.0]))
        x, v, kinetic = np.array(integrator.position), np.array(integrator.velocity), integrator.kinetic_J
        p = 4.0 * normal - 50.0 * x - 2.0 * v + rng.normal(0.0, 0.3, n)
        step = integrator.push(dt, drag, tuple(p.tolist()), contacts)
        depths = [float(normal @ at) - 0.01 for at in (x, np.array(step.position))]
        energies = [1500.0 * max(0.0, depth) ** 2 for depth in depths]
        along = float(normal @ np.array(step.force))
        np.testing.assert_allclose(np.array(step.force), along * normal, atol=1e-9)
        assert along <= 0.0
        if along < 0.0:
            inside += 1
            assert along * (depths[1] - depths[0]) == pytest.approx(energies[0] - energies[1], rel=1e-6, abs=1e-9)
        scale = energies[0] + energies[1] + kinetic
        assert step.work_J <= energies[0] - energies[1] + 1e-9 * scale
        work = step.work_J + dt * float(np.dot(step.coupling_force, step.velocity))
        assert integrator.kinetic_J - kinetic == pytest.approx(work, rel=1e-9, abs=1e-9 * scale)
        momentum = M @ (np.array(integrator.velocity) - v) / dt
        np.testing.assert_allclose(momentum, p - drag * np.array(step.velocity) + step.force, rtol=1e-6, atol=1e-7)
        assert step.penetration_m == pytest.approx(max(0.0, depths[1]), abs=1e-15)
        deepest = max(deepest, depths[1])
    assert inside > 50
    assert deepest > 1e-3


def test_a_step_after_a_push_of_the_same_length_is_what_it_was() -> None:
    for stiffness in (500.0, [[500.0, 100.0], [100.0, 400.0]]):
        pushed, twin = (PassiveIntegrator(0.02, 14.0, stiffness, (0.0, 0.0)) for _ in range(2))
        for dt in (0.02, 0.02, 0.05):
            pushed.push(dt, 14.0, (0.3, -0.1))
            twin.place(pushed.position)
            pushed.place(pushed.position)
            assert pushed.step(dt, (0.01, 0.0)) == twin.step(dt, (0.01, 0.0))
            assert pushed.push(dt, 0.0, (1.0, 0.0)).velocity == twin.push(dt, 0.0, (1.0, 0.0)).velocity


@pytest.mark.parametrize(
    ("dt", "drag", "push", "named"),
    [
        (0.01, -1.0, (0.0, 0.0), "drag"),
        (0.01, float("nan"), (0.0, 0.0), "drag"),
        (0.01, float("inf"), (0.0, 0.0), "drag"),
        (0.0, 1.0, (0.0, 0.0), "dt"),
        (float("nan"), 1.0, (0.0, 0.0), "dt"),
        (0.01, 1.0, (0.0,), "push"),
        (0.01, 1.0, (0.0, float("nan")), "push"),
        (0.01, 1.0, (0.0, "b"), "push"),
        (0.01, 1.0, None, "push"),
    ],
)
def test_a_bad_push_leaves_the_state_alone(dt: float, drag: float, push: object, named: str) -> None:
    integrator, twin = (PassiveIntegrator(0.02, 14.0, 500.0, (0.0, 0.0), (0.1, 0.2)) for _ in range(2))
    with pytest.raises(InvalidParameter) as caught:
        integrator.push(dt, drag, push)  # type: ignore[arg-type]  # wrong types are among the cases
    assert caught.value.name == named
    assert integrator.push(0.01, 1.0, (1.0, 0.0)) == twin.push(0.01, 1.0, (1.0, 0.0))


def test_walls_that_are_apart_in_a_step_and_not_in_a_push_are_solved_together_then() -> None:
    """With B' and K' multiples of M walls are apart if n1' M^-1 n2 = 0; with a drag they must be apart in M + s too."""
    M = np.array([[2.0, 1.0], [1.0, 2.0]])
    contacts = Contacts([Wall((1.0, 0.0), 0.02, 3e3, 90.0), Wall((5**-0.5, 2 * 5**-0.5), 0.02, 3e3, 90.0)])
    assert np.array([1.0, 0.0]) @ np.linalg.inv(M) @ np.array([1.0, 2.0]) == pytest.approx(0.0)
    integrator = PassiveIntegrator(M, 10.0 * M, 100.0 * M, (0.0, 0.0))
    integrator.step(0.01, (0.0, 0.0), contacts)
    assert contacts.separate
    push = np.array([60.0, 60.0])
    for _ in range(100):
        v, stored = np.array(integrator.velocity), contacts.stored_J(integrator.position)
        done = integrator.push(0.01, 1.0, tuple(push), contacts)
        mean, force = np.array(done.velocity), np.array(done.force)
        assert (2.0 * M / 0.01 + np.eye(2)) @ mean == pytest.approx(2.0 * M / 0.01 @ v + push + force, abs=1e-9)
        assert -done.work_J >= contacts.stored_J(done.position) - stored - 1e-15
    assert not contacts.separate
    assert min(wall.penetration(integrator.position) for wall in contacts.walls) > 0.0  # both act


def test_a_mass_is_placed_at_rest_and_not_inside_a_wall() -> None:
    """There it would have the wall's potential from nothing; the surface itself is outside."""
    contacts = Contacts([Wall((1.0, 0.0), 0.02, 3e3)])
    integrator = PassiveIntegrator(0.02, 14.0, 500.0, (0.0, 0.0), (0.1, 0.0))
    integrator.set_contacts(contacts)
    with pytest.raises(InvalidParameter, match=r"0\.021"):
        integrator.place((0.021, 0.0))
    assert (integrator.position, integrator.velocity) == ((0.0, 0.0), (0.1, 0.0))
    integrator.place((0.02, 5.0))
    assert (integrator.position, integrator.velocity, integrator.kinetic_J) == ((0.02, 5.0), (0.0, 0.0), 0.0)
