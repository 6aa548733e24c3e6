"""A soft body among rigid solids: exact accounts, weight and sag as statics has them, friction, and bad words."""

from functools import partial

import numpy as np
import pytest

from hapnet.checks import Array
from hapnet.errors import InvalidParameter
from hapnet.ext.soft import soft_mesh
from hapnet.ext.soft.soft_body import Body, Material
from hapnet.ext.soft.soft_contacts import Skin, SoftContacts
from hapnet.ext.soft.soft_picture import strains_shown
from hapnet.ext.solids.field import DistanceFunction
from hapnet.ext.solids.mesh import Mesh
from hapnet.ext.solids.rigid_contacts import Solid
from hapnet.ext.solids.shapes import Cuboid, Cylinder, HalfSpace, Shape, Sphere
from hapnet.plant.integrator import PassiveIntegrator
from hapnet.plant.worlds.picture import RESTS
from hapnet.plant.worlds.registry import make_scene
from tests.conftest import mostly_slow
from tests.plant.worlds.test_soft import FRONT_M, TENTH, VARIABLE, moved, shaken
from tests.support.mesh_runs import boxes
from tests.support.soft_elements import without_locking

BELOW = HalfSpace((0.0, 0.0, -1.0), 0.03)
G = 9.81
WEIGHT_N = 0.06**3 * 1000.0 * G
STILL = lambda time: (0.0, 0.0, 0.0)  # noqa: E731


def lying(
    *shapes: Shape, nodes: int = 64, friction: float = 0.3, gravity: tuple[float, float, float] = (0.0, 0.0, -G),
    young: float = 20e3, is_settled: bool = True,
) -> SoftContacts:  # fmt: skip
    """A block of 60 mm that nothing pins, 20 mm in front of the ball."""
    places, tets = soft_mesh.block((0.06, 0.06, 0.06), nodes)
    places[:, 0] += FRONT_M + 0.01 + 0.03
    free = np.zeros(len(places), dtype=bool)
    solids = [Solid(shape, 1000.0, 2.0, friction) for shape in shapes or (BELOW,)]
    body = Body(places, tets, free, Material(young=young, gravity=gravity))
    contacts = SoftContacts(body, Skin(friction=friction), 3, solids=solids)
    if is_settled:
        contacts.settle()
    return contacts


def on_solids(contacts: SoftContacts) -> Array:
    """The solids' force on the body (3,) [N]."""
    return contacts.forces[contacts.by_ball == 0.0].sum(axis=0)


def test_a_block_weighs_on_a_plane_what_it_weighs() -> None:
    contacts = lying()
    moved(contacts, VARIABLE, STILL, 1.5)
    assert on_solids(contacts) == pytest.approx((0.0, 0.0, WEIGHT_N), abs=0.002 * WEIGHT_N)


def test_its_sag_agrees_with_an_independent_solver() -> None:
    """The same mesh in scikit-fem, with springs below its lower nodes and no friction, at small strains."""
    skfem = pytest.importorskip("skfem")
    contacts = lying(nodes=216, friction=0.0, young=60e3, is_settled=False)
    rest = contacts.body.x.copy()
    contacts.settle()
    moved(contacts, VARIABLE, STILL, 1.0)
    basis, stiffness = without_locking(contacts.body, rest, 60e3, 0.4)
    stiffness = stiffness.tolil()
    low = np.flatnonzero(rest[:, 2] < rest[:, 2].min() + 1e-9)
    for node in low:  # 500 N/m a node; and what keeps it from sliding, which does nothing else
        x, y, z = basis.nodal_dofs[:, node]
        stiffness[z, z] += 500.0
        stiffness[x, x] += 1e-3
        stiffness[y, y] += 1e-3
    load = np.zeros(basis.N)
    load[basis.nodal_dofs[2]] = -G * contacts.body.mass
    moves = skfem.solve(stiffness.tocsr(), load)[basis.nodal_dofs].T
    sag, expected = (contacts.body.x - rest)[:, 2], moves[:, 2]
    assert expected.min() < -2e-4
    assert sag.min() == pytest.approx(expected.min(), rel=0.02)
    assert sag[low].mean() == pytest.approx(-WEIGHT_N / (500.0 * len(low)), rel=0.02)


@pytest.mark.parametrize("draw", mostly_slow([(one,) for one in [VARIABLE, TENTH]], 1), ids=["variable", "tenth"])
@pytest.mark.parametrize(
    "shapes", [(BELOW,), (BELOW, Sphere((0.06, 0.0, -0.03), 0.012), HalfSpace((1.0, 0.0, 0.0), 0.1))]
)
def test_every_step_closes_among_solids(shapes: tuple[Shape, ...], draw: object) -> None:
    run = moved(lying(*shapes), draw, shaken, 1.0)  # type: ignore[arg-type]
    assert run.closure_J <= 1e-12
    assert run.slack_J >= -1e-12


def table(kind: str) -> Shape:
    """What a block of 60 mm lies on, its top at -30 mm."""
    middle = (0.06, 0.0, -0.05)
    if kind == "cuboid":
        return Cuboid(middle, (0.12, 0.12, 0.04))
    if kind == "cylinder":
        return Cylinder(middle, 0.06, 0.04)
    if kind == "mesh":
        return Mesh(*boxes((middle, (0.12, 0.12, 0.04))))
    return DistanceFunction(partial(_in_slab, middle), "slab")


def _in_slab(middle: tuple[float, ...], place: tuple[float, ...]) -> float:
    """Of a slab with round edges."""
    away = [abs(a - b) - half for a, b, half in zip(place, middle, (0.05, 0.05, 0.01), strict=True)]
    return float(np.hypot.reduce([max(0.0, part) for part in away]) + min(0.0, max(away)) - 0.01)


@pytest.mark.parametrize("kind", mostly_slow(["cuboid", "cylinder", "mesh", "function"], 1))
def test_solids_of_all_kinds_carry_a_block_that_is_shaken(kind: str) -> None:
    """Its weight and sag are those on a plane, and every step closes while the ball presses it and slides along it."""
    contacts, on_plane = lying(table(kind), nodes=64), lying()
    assert contacts.body.x == pytest.approx(on_plane.body.x, abs=2e-5)
    assert on_solids(contacts)[2] == pytest.approx(WEIGHT_N, rel=0.01)
    run = moved(contacts, VARIABLE, shaken, 1.0)
    assert contacts.body.x[:, 0].min() > 0.035  # it was pushed along
    assert run.closure_J <= 1e-12
    assert run.slack_J >= -1e-12


@pytest.mark.parametrize("kind", mostly_slow(["cuboid", "mesh"], 1))
def test_a_block_hangs_over_an_edge(kind: str) -> None:
    """A third of it is beyond the edge, and sags there, but the edge is not in it."""
    middle, size = (0.028, 0.0, -0.05), (0.08, 0.12, 0.04)
    shape = Cuboid(middle, size) if kind == "cuboid" else Mesh(*boxes((middle, size)))
    contacts = lying(shape, nodes=216, friction=0.2)
    run = moved(contacts, VARIABLE, STILL, 1.0)
    assert run.closure_J <= 1e-12
    assert run.slack_J >= -1e-12
    assert on_solids(contacts)[2] == pytest.approx(WEIGHT_N, rel=0.01)
    x, _, z = contacts.body.x.T
    assert z[x > 0.085].min() < z[x < 0.06].min() - 1e-3
    assert max(-shape.near(tuple(place)).distance_m for place in contacts.body.x.tolist()) < 2e-3


def sliding(slope: float, seconds: float) -> float:
    """How fast a block slides down a slope after that time [m/s], with mu 0.3."""
    down = (0.0, G * np.sin(slope), -G * np.cos(slope))
    contacts = lying(gravity=down, young=60e3, is_settled=False)
    moved(contacts, lambda rng: 0.01, STILL, seconds)
    body = contacts.body
    return float((body.mass @ body.v)[1] / body.mass.sum())


def test_friction_holds_a_block_on_a_slope_up_to_its_limit() -> None:
    below, above = np.arctan(0.2), np.arctan(0.45)
    assert sliding(below, 0.6) < 0.01
    expected = 0.4 * G * (np.sin(above) - 0.3 * np.cos(above))  # Coulomb
    assert sliding(above, 0.6) - sliding(above, 0.2) == pytest.approx(expected, rel=0.1)


def test_a_block_that_falls_stays_above_the_plane() -> None:
    """From 50 mm, with a step that is longer than the bounce."""
    contacts = lying(HalfSpace((0.0, 0.0, -1.0), 0.08), is_settled=False)
    run = moved(contacts, TENTH, STILL, 5.0)
    assert run.slack_J >= -1e-12
    assert contacts.body.x[:, 2].min() == pytest.approx(-0.08, abs=2e-3)
    assert on_solids(contacts)[2] == pytest.approx(WEIGHT_N, rel=0.02)


def test_the_ball_feels_a_solid_at_its_own_surface() -> None:
    """As a wall of 1000 N/m, by the coupling's 500 N/m: the force of two springs in series."""
    contacts = lying(BELOW, HalfSpace((0.0, 1.0, 0.0), 0.03))
    run = moved(contacts, VARIABLE, lambda time: (0.0, min(0.04, 0.1 * time), 0.0), 1.5)
    assert run.force == pytest.approx((0.0, -0.02 / (1.0 / 500.0 + 1.0 / 1000.0), 0.0), abs=0.02)
    (plane,) = contacts.planes((0.0, 0.015, 0.0), 0.01)
    assert plane.normal == pytest.approx((0.0, 1.0, 0.0))
    assert (plane.offset_m, plane.stiffness, plane.friction) == pytest.approx((0.02, 1000.0, 0.3))


def test_a_ball_near_a_ball_gets_its_curvature() -> None:
    contacts = lying(BELOW, Sphere((0.0, 0.05, 0.0), 0.02))
    (plane,) = contacts.planes((0.0, 0.015, 0.0), 0.01)
    assert [bend.per_m for bend in plane.curvatures] == pytest.approx([1.0 / 0.03] * 2)


def test_a_body_on_a_plane_is_as_stiff_as_its_planes_say() -> None:
    """It is pressed from above, deeper and deeper, each time until it rests. What carries it is in its compliance: a
    body that only its mass held would be softer by far."""
    contacts = lying(nodes=216, friction=0.1)  # of which planes know nothing, and which lifts a ball that has sunk in
    mass = PassiveIntegrator(0.02, 14.0, 500.0, (0.06, 0.0, 0.045))
    contacts.require_outside(mass.position)
    expected = None
    for height in (0.03, 0.028, 0.026):
        for _ in range(40):
            step = mass.step(0.02, (0.06, 0.0, height), contacts)
        if expected is not None:
            said = sum(one.stiffness * max(0.0, one.depth(step.position)) for one in expected)
            assert said == pytest.approx(step.force[2], rel=0.15)
        expected = contacts.planes(step.position, 0.02)
    assert step.force[2] > 1.0


@pytest.mark.parametrize("dof", [1, 2])
def test_with_fewer_axes_solids_are_cut(dof: int) -> None:
    contacts = SoftContacts(lying().body, Skin(), dof, solids=[Solid(HalfSpace((3.0, 0.0, -4.0), 0.012), 1000.0)])
    (plane,) = contacts.planes((0.0,) * dof, 0.011)
    assert plane.normal == (1.0,) + (0.0,) * (dof - 1)
    assert plane.offset_m == pytest.approx((0.012 - 0.01) / 0.6)
    assert plane.stiffness == pytest.approx(1000.0 * 0.36)


def test_it_is_a_scene_with_a_picture() -> None:
    world = make_scene(
        "soft?nodes=64&pin=none + plane?normal=0,0,-1&at=0,0,-30mm&friction=0.4 + sphere?radius=5mm&at=0,-60mm,0"
    )
    assert world.stiffnesses == (3000.0, 3000.0)
    picture = world.picture()
    assert sum(part.body == RESTS for part in picture.parts) == 2
    contacts, mass = world.contacts, PassiveIntegrator(0.02, 14.0, 500.0, (0.0, 0.0, 0.0))
    for _ in range(80):
        step = mass.step(0.02, (0.035, 0.0, -0.025), contacts)
    touches = picture.touches(step.position, step.force)
    assert np.sum([touch.force_N for touch in touches], axis=0) == pytest.approx(step.force)
    assert any(touch.point[2] == pytest.approx(-0.03, abs=1e-3) and touch.normal[2] == 1.0 for touch in touches)
    shown = strains_shown(picture.soft().reshape(4, -1, 3), picture.parts[0].triangles.astype(int))
    true = contacts.body.nodal_strains()[np.unique(contacts.body.surface)]
    assert true.max() > 0.02
    assert np.minimum(shown, 0.2) == pytest.approx(np.minimum(true, 0.2), rel=0.01)
    assert world.towards((0.0, -0.08, 0.0))[1] == pytest.approx(-0.045, abs=6e-4)


@pytest.mark.parametrize(
    ("words", "what"),
    [
        ("plane + soft", "first"), ("soft + cube", "cube"), ("soft + plane?mu=1", "mu"),
        ("soft?nodes=27&pin=none", "lies on a solid"), ("soft?nodes=27 + sphere?radius=30mm&at=0,0,0", "start"),
    ],
)  # fmt: skip
def test_bad_words_are_one_clear_line(words: str, what: str) -> None:
    with pytest.raises(InvalidParameter, match=what) as raised:
        make_scene(words)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("apart", [False, True], ids=["same nodes", "nodes at the same places"])
def test_tetrahedra_that_overlap_are_refused(apart: bool) -> None:
    """Twice the same body has no surface: each face lies between two tetrahedra."""
    places, tets = soft_mesh.block((0.06, 0.05, 0.04), 64)
    more = np.concatenate([places, places]) if apart else places
    doubled = np.concatenate([tets, tets + len(places) if apart else tets])
    with pytest.raises(InvalidParameter, match=r"soft twice.msh: 236 faces belong to three tetrahedra or more"):
        soft_mesh.checked("twice.msh", more, doubled)
    checked, found = soft_mesh.checked("once.msh", places, tets)
    assert len(found) == len(tets)
    assert checked == pytest.approx(places)


def test_a_flat_body_is_refused() -> None:
    places, tets = soft_mesh.block((0.06, 0.05, 0.04), 64)
    places[:, 2] = 0.1 * places[:, 0]
    with pytest.raises(InvalidParameter, match="its tetrahedra have no volume"):
        soft_mesh.checked("flat.msh", places, tets)
