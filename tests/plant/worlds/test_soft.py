"""A soft body: exact accounts at any tolerance and step, forces that do not depend on the step, and bad input."""

import subprocess
import sys
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest

from hapnet.checks import Array
from hapnet.errors import InvalidParameter, MissingLibrary
from hapnet.ext.soft import soft_mesh
from hapnet.ext.soft.soft_body import Body, Material
from hapnet.ext.soft.soft_contacts import RESERVOIR_J, Skin, SoftContacts
from hapnet.ext.soft.soft_linear import conjugate_gradients
from hapnet.ext.soft.soft_touch import ContactEquations
from hapnet.plant.integrator import PassiveIntegrator
from hapnet.plant.worlds.account import EnvironmentAccount
from hapnet.plant.worlds.picture import SOFT
from hapnet.plant.worlds.registry import make_scene
from tests.conftest import mostly_slow
from tests.support.soft_elements import strain_rates, strains_of, without_locking

Draw = Callable[[np.random.Generator], float]
MILLISECOND: Draw = lambda rng: 0.001  # noqa: E731
VARIABLE: Draw = lambda rng: float(rng.uniform(0.01, 0.05))  # noqa: E731
TENTH: Draw = lambda rng: 0.1  # noqa: E731
FRONT_M = 0.02
MASS, DAMPING, STIFFNESS = 0.02, 14.0, 500.0


def block(nodes: int = 216, tolerance: float = 0.01, dof: int = 3, **given: float) -> SoftContacts:
    """A block whose face is 20 mm in front of a ball of 10 mm, its far side held, without weight if none is given."""
    skin = Skin(friction=given.pop("friction", 0.3), stiffness=given.pop("contact", 500.0))
    weight = given.pop("weight", 0.0)
    places, tets = soft_mesh.block((0.06, 0.06, 0.06), nodes)
    places[:, 0] += FRONT_M + skin.radius + 0.03
    pinned = places[:, 0] > places[:, 0].max() - 1e-9
    return SoftContacts(Body(places, tets, pinned, Material(gravity=(0.0, 0.0, weight), **given)), skin, dof, tolerance)


class Run(NamedTuple):
    """What a motion did: the last force [N], the worst error of one step's account [J], the least env_slack [J], the
    least s, the contacts at the end, and the rounds of conjugate gradients a step."""

    force: Array
    closure_J: float
    slack_J: float
    scale: float
    touching: int
    rounds: float


def moved(contacts: SoftContacts, draw: Draw, path: Callable[[float], tuple[float, ...]], seconds: float) -> Run:
    """The ball on its spring, whose end follows `path`."""
    mass = PassiveIntegrator(MASS, DAMPING, STIFFNESS, (0.0,) * contacts.dof)
    account = EnvironmentAccount(contacts, mass.position)
    rng = np.random.default_rng(1)
    time = work = worst = rounds = 0.0
    steps = 0
    least, stored, discarded = 1.0, contacts.stored_J(()), 0.0
    force = np.zeros(contacts.dof)
    while time < seconds:
        dt = draw(rng)
        time += dt
        step = mass.step(dt, path(time), contacts)
        work += step.work_J
        account.observe(work, step.position)
        lost = contacts.discarded_J - discarded
        worst = max(worst, abs(-step.work_J - (contacts.stored_J(()) - stored) - lost))
        stored, discarded = contacts.stored_J(()), contacts.discarded_J
        least, force = min(least, contacts.scale), np.array(step.force)
        steps, rounds = steps + 1, rounds + contacts.rounds
        assert 0.0 <= contacts.reservoir_J <= RESERVOIR_J
    return Run(force, worst, account.slack_min, least, int(contacts.forces.any(axis=1).sum()), rounds / steps)


def press(depth: float, speed: float = 0.05, aside: float = 0.0) -> Callable[[float], tuple[float, ...]]:
    return lambda time: (min(depth, speed * time), aside * min(depth, speed * time), 0.0)


def shaken(time: float) -> tuple[float, ...]:
    """Violent: in, out and along at some 0.4 m/s."""
    return (0.02 + 0.02 * np.sin(17.0 * time), 0.015 * np.sin(11.0 * time), 0.01 * np.cos(13.0 * time))


VIOLENT: dict[str, Callable[[float], tuple[float, ...]]] = {
    "shaken": shaken,
    "in and out": lambda t: (0.02 + 0.025 * np.sin(16.0 * t), 0.0, 0.0),
    "to and fro": lambda t: (min(0.034, 0.1 * t), 0.025 * np.sin(16.0 * t), 0.0),
    "round": lambda t: (min(0.034, 0.1 * t), 0.02 * np.sin(18.0 * t), 0.02 * np.cos(18.0 * t) - 0.02),
    "askew": lambda t: (0.02 + 0.02 * np.sin(10.0 * t), 0.02 * np.sin(14.0 * t + 1.0), 0.02 * np.sin(12.0 * t + 2.0)),
    "deep": lambda t: (0.045 * (0.5 - 0.5 * np.cos(8.0 * t)), 0.01 * np.sin(8.0 * t), -0.01 * np.sin(8.0 * t)),
}
"""At up to 0.4 m/s."""


@pytest.mark.parametrize("tolerance", [0.1, 1e-3])
@pytest.mark.parametrize("draw", mostly_slow([TENTH, VARIABLE], 1), ids=["tenth", "variable"])
def test_every_step_closes_whatever_the_tolerance(tolerance: float, draw: Draw) -> None:
    run = moved(block(tolerance=tolerance, weight=-9.81), draw, shaken, 1.5)
    assert run.closure_J <= 1e-12
    assert run.slack_J >= -1e-12


def test_the_ball_moves_as_its_own_equation_says() -> None:
    contacts, mass = block(tolerance=0.1), PassiveIntegrator(MASS, DAMPING, STIFFNESS, (0.0,) * 3)
    for k in range(40):
        x, v, dt = np.array(mass.position), np.array(mass.velocity), 0.03
        step = mass.step(dt, (0.001 * k, 0.0, 0.0), contacts)
        a = 2.0 * MASS / dt + DAMPING + 0.5 * STIFFNESS * dt
        c = 2.0 * MASS / dt * v - STIFFNESS * (x - (0.001 * k, 0.0, 0.0))
        assert a * np.array(step.velocity) == pytest.approx(c + step.force, abs=1e-12)
    assert np.linalg.norm(step.force) > 0.5


def test_without_the_elimination_energy_would_leak(monkeypatch: pytest.MonkeyPatch) -> None:
    """The ball is then as it was guessed, and the body is solved against that."""
    whole = ContactEquations._eliminate

    def eliminate(touch: ContactEquations) -> None:
        true, touch._compliance = touch._compliance, np.zeros((3, 3))
        whole(touch)
        touch._compliance = true

    monkeypatch.setattr(ContactEquations, "_eliminate", eliminate)
    contacts, mass = block(tolerance=0.1), PassiveIntegrator(MASS, DAMPING, STIFFNESS, (0.0,) * 3)
    errors = []
    for k in range(40):
        x, v, dt = np.array(mass.position), np.array(mass.velocity), 0.03
        step = mass.step(dt, (0.001 * k, 0.0, 0.0), contacts)
        a = 2.0 * MASS / dt + DAMPING + 0.5 * STIFFNESS * dt
        lost = a * np.array(step.velocity) - 2.0 * MASS / dt * v + STIFFNESS * (x - (0.001 * k, 0.0, 0.0)) - step.force
        errors.append(abs(float(lost @ step.velocity) * dt))
    assert max(errors) > 1e-7


def test_strains_that_are_not_anchored_are_energy_from_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    def unpaid(contacts: SoftContacts, depths: Array) -> None:
        contacts.body.strains[:] = contacts.body.true_strains()
        contacts.q = np.maximum(depths, 0.0)

    monkeypatch.setattr(SoftContacts, "_anchor", unpaid)
    assert moved(block(), TENTH, shaken, 1.5).closure_J > 1e-4


@pytest.mark.parametrize("nodes", mostly_slow([216, 343], 0, 1))
def test_a_held_force_does_not_depend_on_the_step(nodes: int) -> None:
    def held(draw: Draw) -> float:
        return float(np.linalg.norm(moved(block(nodes), draw, press(0.04), 1.8).force))

    exact = held(MILLISECOND)
    assert exact > 3.0
    assert held(VARIABLE) == pytest.approx(exact, rel=0.03)
    assert held(TENTH) == pytest.approx(exact, rel=0.06)


@pytest.mark.slow
def test_the_tolerance_is_not_felt() -> None:
    rough, fine = (moved(block(1000, tolerance), VARIABLE, press(0.04), 1.8).force for tolerance in (0.1, 1e-3))
    assert np.linalg.norm(rough) == pytest.approx(np.linalg.norm(fine), rel=0.01)


@pytest.mark.parametrize("draw", mostly_slow([lambda rng: 0.05, VARIABLE], 1), ids=["50 ms", "variable"])
@pytest.mark.parametrize("name", mostly_slow([(one,) for one in VIOLENT], 1))
def test_violent_motion_keeps_its_strains(name: str, draw: Draw) -> None:
    """Up to 50 ms, with a damping of 10 ms: what the linear step misses is small, and no point is forgotten."""
    run = moved(block(343), draw, VIOLENT[name], 2.0)
    assert run.scale >= 0.99
    assert run.rounds <= 10.0
    assert run.closure_J <= 1e-12
    assert run.slack_J >= -1e-12


@pytest.mark.parametrize(
    ("name", "mu"), mostly_slow([("round", 0.5), ("askew", 0.5), ("to and fro", 0.3), ("to and fro", 0.0)], 0, 1)
)
def test_a_fine_body_keeps_its_strains_too(name: str, mu: float) -> None:
    """Of a thousand nodes a hundred points may come to touch within 50 ms. With less friction the ball that goes round
    slips over an edge within a step, and strains are lost, without friction too (soft.md)."""
    run = moved(block(1000, friction=mu), lambda rng: 0.05, VIOLENT[name], 2.0)
    assert run.scale >= 0.99
    assert run.closure_J <= 1e-12


@pytest.mark.parametrize("nodes", mostly_slow([216, 512], 1))
def test_indentation_agrees_with_an_independent_solver(nodes: int) -> None:
    """The same mesh, pins and forces in scikit-fem, at small strains."""
    skfem = pytest.importorskip("skfem")
    contacts = block(nodes, 1e-4, friction=0.0, beta_s=0.05)
    body, rest = contacts.body, contacts.body.x.copy()
    moved(contacts, VARIABLE, press(FRONT_M + 4e-4), 4.0)
    assert np.abs(body.v).max() < 2e-3
    basis, stiffness = without_locking(body, rest, 20e3, 0.4)
    load = np.zeros(basis.N)
    forces = np.zeros_like(rest)
    np.add.at(forces, contacts.nodes, contacts.weights[:, :, None] * contacts.forces[:, None, :])
    load[basis.nodal_dofs] = forces.T
    held = basis.nodal_dofs[:, body.free :].ravel()
    moves = skfem.solve(*skfem.condense(stiffness, load, D=held))[basis.nodal_dofs].T
    deepest = int(np.argmax(np.linalg.norm(moves, axis=1)))
    assert np.linalg.norm(moves[deepest]) > 1e-4
    assert np.linalg.norm((body.x - rest)[deepest]) == pytest.approx(np.linalg.norm(moves[deepest]), rel=0.02)


def nearest_rotations(gradients: Array) -> Array:
    """By singular values, of (E, 3, 3)."""
    u, _, vt = np.linalg.svd(gradients)
    return u @ vt


@pytest.mark.slow
def test_a_body_that_is_shaken_moves_as_its_tetrahedra_and_its_contacts_say() -> None:
    """Each node's momentum by stresses, with numpy's singular values and differences; and the springs, dampers and
    friction of the points that touch during a whole step, from the places at its ends."""
    young, poisson, beta_s, dt, mu = 20e3, 0.4, 0.02, 0.01, 0.3
    contacts = block(125, 1e-6, young=young, poisson=poisson, beta_s=beta_s, weight=-9.81, friction=mu)
    body, skin, mass = contacts.body, contacts.skin, PassiveIntegrator(MASS, DAMPING, STIFFNESS, (0.0,) * 3)
    corners = np.concatenate([np.ones((len(body.tets), 4, 1)), body.x[body.tets]], axis=2)
    g, volume = np.linalg.inv(corners)[:, 1:], np.linalg.det(corners) / 6.0
    masses = np.bincount(body.tets.ravel(), np.repeat(250.0 * volume, 4))[:, None]
    pushes, drags = [], []
    for k in range(30):
        x, v, centre = body.x.copy(), body.v.copy(), np.array(mass.position)
        step = mass.step(dt, shaken(dt * k), contacts)
        before, rates = (np.einsum("eai,eja->eij", one[body.tets], g) for one in (x, (body.x - x) / dt))
        turned = body.middle.copy()  # as half way, but for what a guess of the way misses
        assert turned == pytest.approx(nearest_rotations(before + 0.5 * dt * rates), abs=0.03)
        half = body._stretch @ turned  # the expected gradients half way
        assert half == pytest.approx(before + 0.5 * dt * rates, abs=0.05)
        strains = strains_of(before) + (0.5 * dt + beta_s) * strain_rates(half, rates)
        means = np.add.reduceat(volume * np.trace(strains, axis1=1, axis2=2), body.patches[:-1])
        means = np.repeat(means / np.add.reduceat(volume, body.patches[:-1]), np.diff(body.patches))
        traces = means[:, None, None] * np.eye(3)
        stresses = young / (1.0 + poisson) * (poisson / (1.0 - 2.0 * poisson) * traces + strains)
        each = [strain_rates(half, np.tile(one.reshape(3, 3), (len(half), 1, 1))) for one in np.eye(9)]
        piola = np.stack([(stresses * one).sum(axis=(1, 2)) for one in each], axis=1).reshape(-1, 3, 3)
        force = masses * (0.0, 0.0, -9.81)
        np.add.at(force, body.tets, -(volume[:, None, None] * piola @ g).transpose(0, 2, 1))
        np.add.at(force, contacts.nodes, contacts.weights[:, :, None] * contacts.forces[:, None, :])
        moved_by = masses * (body.v - v) / dt
        assert moved_by[: body.free] == pytest.approx(force[: body.free], abs=1e-4)

        assert -contacts.forces.sum(axis=0) == pytest.approx(step.force, abs=1e-9)
        apart = contacts.places(x) - centre, contacts.places(body.x) - step.position
        depths, deeper = (skin.radius - np.linalg.norm(one, axis=1) for one in apart)
        inside = (depths > 0.0) & (deeper > 0.0)
        n = (apart[0] + apart[1])[inside]
        n /= np.linalg.norm(n, axis=1)[:, None]
        push = (contacts.forces[inside] * n).sum(axis=1)
        law = 0.5 * skin.stiffness * (depths + deeper) + skin.damping * (deeper - depths) / dt
        assert push == pytest.approx(law[inside], abs=0.01)
        slip = (apart[0] - apart[1])[inside] / dt  # the ball's velocity less the point's
        slip -= (slip * n).sum(axis=1)[:, None] * n
        rub, speed = contacts.forces[inside] - push[:, None] * n, np.linalg.norm(slip, axis=1)
        fast = (push > 0.05) & (speed > 0.02)
        drags += ((rub * slip).sum(axis=1) / speed / push)[fast].tolist()
        pushes += push.tolist()
    assert min(len(pushes) / 40, len(drags) / 20, max(pushes)) > 1.0
    assert drags == pytest.approx([mu] * len(drags), rel=0.25)
    assert np.mean(drags) == pytest.approx(mu, rel=0.1)


def twisted(degrees: float) -> SoftContacts:
    """A block of 1,000 nodes, its front turned about the axis to its back."""
    contacts = block(1000)
    x, y, z = contacts.body.x.T
    turn = np.radians(degrees) * (x.max() - x) / np.ptp(x)
    contacts.body.x = np.stack([x, np.cos(turn) * y - np.sin(turn) * z, np.sin(turn) * y + np.cos(turn) * z], axis=1)
    contacts.body.true_strains()
    return contacts


def rounds_with(turned: Callable[[Array], Array]) -> int:
    body, dt = twisted(50.0).body, 0.03
    body.push(dt, body.mean)
    body.nodal[:] = turned(body.nodal)
    b = np.random.default_rng(3).normal(size=body.x.shape)
    b[body.free :] = 0.0
    _, rounds = conjugate_gradients(
        lambda v: body.response(dt, v), lambda r: body.to_world(body.factor.solve(dt, body.to_local(r))), b,
        np.zeros_like(b), 1e-3,
    )  # fmt: skip
    return rounds


def test_a_factor_that_turns_with_the_body_saves_rounds() -> None:
    """Any rotation gives the same result; the wrong one only takes longer."""
    right = rounds_with(lambda turns: turns)
    assert right <= 12
    assert rounds_with(lambda turns: np.broadcast_to(np.eye(3), turns.shape).copy()) > 1.5 * right
    assert rounds_with(lambda turns: turns.transpose(0, 2, 1).copy()) > 1.5 * right


@pytest.mark.parametrize("dt", [0.01, 0.05, 0.2])
def test_a_free_body_answers_a_push_along_a_rigid_motion_exactly(dt: float) -> None:
    """K r = 0, so ``S^-1 M r = (2/T)^-1 r`` for a translation or a rotation r, whatever step S was factored for."""
    places, tets = soft_mesh.block((0.06, 0.05, 0.04), 64)
    body = Body(places, tets, np.zeros(len(places), dtype=bool), Material())
    centre = body.mass @ body.x / body.mass.sum()
    nodes = np.arange(len(body.x))
    for motion in (np.tile((0.3, -1.0, 2.0), (len(body.x), 1)), np.cross((1.0, 2.0, -0.5), body.x - centre)):
        push = (body.mass[:, None] * motion).ravel()
        assert body.factor.solve(dt, push) == pytest.approx(0.5 * dt * motion.ravel(), rel=1e-6, abs=1e-9)
        assert body.factor.responses(dt, nodes) @ push == pytest.approx(0.5 * dt * motion.ravel(), rel=1e-6, abs=1e-9)


def test_friction_holds_up_to_its_limit() -> None:
    """A ball that is dragged along pulls with mu times its push."""
    contacts = block(343, friction=0.3)
    run = moved(contacts, lambda rng: 0.01, lambda t: (min(0.04, 0.05 * t), max(0.0, 0.02 * (t - 1.0)), 0.0), 1.8)
    _, normals = contacts.gaps(contacts.places(contacts.body.x), contacts.centre)
    push = (contacts.forces * normals).sum(axis=1)
    across = np.linalg.norm(contacts.forces - push[:, None] * normals, axis=1)
    assert run.touching >= 3
    assert across.sum() / push.sum() == pytest.approx(0.3, rel=0.15)


@pytest.mark.parametrize("nodes", mostly_slow([125, 343], 1))
def test_the_planes_are_as_stiff_as_the_body(nodes: int) -> None:
    """Of a ball that is held deeper and deeper, each time until it rests: the force that the planes of the place before
    have said."""
    contacts = block(nodes, friction=0.0, beta_s=0.05)
    mass = PassiveIntegrator(MASS, DAMPING, STIFFNESS, (0.0, 0.0, 0.0))
    expected = None
    for depth in (0.024, 0.028, 0.032):
        for _ in range(40):
            step = mass.step(0.025, (depth, 0.0, 0.0), contacts)
        if expected is not None:
            said = sum(one.stiffness * max(0.0, one.depth(step.position)) for one in expected)
            assert said == pytest.approx(-step.force[0], rel=0.1)
        expected = contacts.planes(step.position, 0.02)
        said = sum(one.stiffness * max(0.0, one.depth(step.position)) for one in expected)
        assert said == pytest.approx(-step.force[0], rel=0.03)
    assert contacts.planes((-0.1, 0.0, 0.0), 0.02) == ()


@pytest.mark.slow
def test_planes_that_are_told_from_afar_are_right() -> None:
    """A hand may press deep before it hears again; and the rim of a flat face says nothing of how that bends."""
    contacts = block(512, friction=0.0, beta_s=0.05)
    assert contacts.planes((0.0, 0.017, 0.012), 0.05)[0].curvatures == ()
    told = contacts.planes((-0.02, 0.003, 0.0), 0.05)
    mass = PassiveIntegrator(MASS, DAMPING, STIFFNESS, (0.0, 0.0, 0.0))
    for depth in (0.026, 0.032, 0.04):
        for _ in range(40):
            step = mass.step(0.025, (depth, 0.0, 0.0), contacts)
        said = sum(one.stiffness * max(0.0, one.depth(step.position)) for one in told)
        assert said == pytest.approx(-step.force[0], rel=0.1)


@pytest.mark.parametrize("dt", mostly_slow([0.05, 0.02], 1))
def test_the_shape_without_the_ball_is_that_of_rest(dt: float) -> None:
    """However the ball moves: what the device is told must not follow the body's own swinging."""
    contacts = block(343, friction=0.0)
    moved(contacts, lambda rng: dt, shaken, 1.2)
    assert np.linalg.norm(contacts.places(contacts.body.x) - contacts.rest, axis=1).max() > 1e-2
    assert np.linalg.norm(contacts.still - contacts.rest, axis=1).max() < 1e-3


def test_an_organ_has_planes_that_bend_and_a_picture() -> None:
    world = make_scene("soft:organ?nodes=300&lump=5&lump_at=-15mm,0mm,0mm")
    bend = max(world.contacts.planes((0.01, 0.01, 0.0), 0.03)[0].curvatures, key=lambda bend: bend.per_m)
    assert abs(bend.direction[2]) > 0.95  # it bulges towards the hand; along y a bean is nearly straight
    assert 8.0 < bend.per_m < 25.0
    parts = world.picture().parts
    soft = [part for part in parts if part.body == SOFT]
    assert len(world.picture().soft()) == sum(len(part.vertices) for part in soft)
    assert world.picture().poses().shape == (1, 7)
    young = world.contacts.body.mu / world.contacts.body.mu.min()
    assert young.max() > 2.0


@pytest.mark.parametrize("dof", [1, 2])
def test_with_fewer_axes_the_ball_stays_on_them(dof: int) -> None:
    contacts = block(dof=dof)
    run = moved(contacts, VARIABLE, lambda time: press(0.03)(time)[:dof], 1.5)
    assert run.closure_J <= 1e-12
    assert run.force[0] < -1.0
    plane = contacts.planes((0.022,) + (0.0,) * (dof - 1), 0.02)[0]
    assert plane.normal[0] > 0.9


@pytest.mark.parametrize(
    ("words", "what"),
    [
        ("soft?young=-1", "young"), ("soft?poisson=0.6", "poisson"), ("soft?colour=red", "colour"),
        ("soft?nodes=3", "nodes"), ("soft?pin=up", "pin"), ("soft?size=1mm", "size"), ("soft?at=1", "at"),
        ("soft:nowhere.msh?unit=mm", "nowhere"), ("soft:organs", "organs"),
    ],
)  # fmt: skip
def test_bad_words_are_one_clear_line(words: str, what: str) -> None:
    with pytest.raises(InvalidParameter, match=what) as raised:
        make_scene(words)
    assert "\n" not in str(raised.value)


def test_a_file_of_tetrahedra_and_a_surface(tmp_path: str) -> None:
    meshio = pytest.importorskip("meshio")
    places, tets = soft_mesh.block((60.0, 40.0, 50.0), 64)
    meshio.write(f"{tmp_path}/body.vtk", meshio.Mesh(places, [("tetra", tets)]), binary=False)
    world = make_scene(f"soft:{tmp_path}/body.vtk?unit=mm")
    assert np.ptp(world.contacts.rest, axis=0) == pytest.approx((0.06, 0.04, 0.05), rel=0.2)
    with pytest.raises(InvalidParameter, match="unit"):
        make_scene(f"soft:{tmp_path}/body.vtk")
    body = world.contacts.body
    meshio.write(f"{tmp_path}/skin.ply", meshio.Mesh(1e3 * body.x, [("triangle", body.surface)]))
    try:
        import wildmeshing  # noqa: F401
    except ImportError:
        with pytest.raises(MissingLibrary, match="wildmeshing"):
            make_scene(f"soft:{tmp_path}/skin.ply?unit=mm")


def test_the_worlds_are_known_without_loading_the_compiler() -> None:
    """Each command knows all worlds at its start; only a soft body needs numba, when it is made."""
    code = "import sys, hapnet.plant.worlds.registry; print(sorted({'numba', 'scipy', 'meshio'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"
