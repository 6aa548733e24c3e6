"""The walk over a mesh, how its patches bend, and the forces that come of it."""

from collections.abc import Sequence

import numpy as np
import pytest

from hapnet.checks import Array
from hapnet.ext.solids.friction import Friction
from hapnet.ext.solids.mesh import Mesh
from hapnet.ext.solids.mesh_walk import follow, principal
from hapnet.ext.solids.rigid_contacts import RigidContacts, Solid
from hapnet.ext.solids.shapes import HalfSpace, Shape
from hapnet.plant.integrator import PassiveIntegrator
from tests.metrics.test_contact import random_spd
from tests.support.mesh_runs import ball, boxes
from tests.support.solids import torus


def test_a_foot_that_walks_finds_what_a_search_finds() -> None:
    """Outside of a convex solid there is one nearest place, wherever the walk begins."""
    vertices, triangles = ball(2, 0.03, (0.05, 0.0, 0.0))
    mesh, rng = Mesh(vertices, triangles), np.random.default_rng(2)
    for x in rng.normal(size=(100, 3)):
        place = tuple((np.array((0.05, 0.0, 0.0)) + 0.04 * x / np.linalg.norm(x)).tolist())
        walked = mesh.foot(place, int(rng.integers(len(triangles))))
        assert walked.near.distance_m == pytest.approx(mesh.near(place).distance_m, abs=1e-9)
        assert walked.near.gradient == pytest.approx(mesh.near(place).gradient, abs=1e-6)


def test_compiled_or_not_a_walk_is_the_same() -> None:
    pytest.importorskip("numba")
    mesh, rng = Mesh(*torus(40, 20)), np.random.default_rng(3)
    lists = [part.tolist() for part in mesh._parts]
    for x in rng.uniform((0.0, -0.05, -0.03), (0.13, 0.05, 0.03), (200, 3)):
        face = int(rng.integers(len(mesh.triangles)))
        assert mesh._follow(*mesh._parts, face, *x.tolist()) == follow(*lists, face, *x.tolist())
        normal = mesh.facet(face)
        assert mesh._principal(mesh._bends, face, *normal) == principal(mesh._bends.tolist(), face, *normal)


def test_a_patch_bends_along_the_eigenvectors_across_its_normal() -> None:
    """As numpy finds them; where it bends alike in all directions, any two across one another will do."""
    rng = np.random.default_rng(7)
    for k in range(50):
        normal, turn = (np.linalg.qr(rng.normal(size=(3, 3)))[0] for _ in range(2))
        values = np.array([30.0, 30.0, 30.0]) if k == 0 else rng.normal(size=3) * 40.0
        bend, out, beside = turn @ np.diag(values) @ turn.T, normal[:, 0], normal[:, 1:]
        one, *first, other = (found := principal([bend.tolist()], 0, *out.tolist()))[:5]
        second = found[5:]
        assert sorted((one, other)) == pytest.approx(np.linalg.eigvalsh(beside.T @ bend @ beside), abs=1e-9)
        assert np.array([first, second, out]) @ np.array([first, second, out]).T == pytest.approx(np.eye(3), abs=1e-12)
        for per_m, direction in ((one, np.array(first)), (other, np.array(second))):
            across = bend @ direction
            assert across - out * (out @ across) == pytest.approx(per_m * direction, abs=1e-9)


def cave() -> Mesh:
    """Solid beyond x = 20 mm, y = 10 mm and z = 15 mm: a block with a hollow whose other sides are far away."""
    vertices, triangles = boxes(((0.0, 0.0, 0.0), (0.6, 0.6, 0.6)), ((-0.04, -0.045, -0.0425), (0.12, 0.11, 0.115)))
    return Mesh(vertices, np.concatenate([triangles[:12], triangles[12:, ::-1]]))


def wandered(shapes: Sequence[Shape], friction: float | Friction, seed: int) -> Array:
    """The forces on a proxy with a general A, whose goals are anywhere in and in front of a corner."""
    rng = np.random.default_rng(seed)
    M, B, K = random_spd(rng, 3, 0.005, 0.2), random_spd(rng, 3, 3.0, 30.0), random_spd(rng, 3, 200.0, 2000.0)
    contacts = RigidContacts([Solid(shape, 3000.0, 10.0, friction) for shape in shapes], 3)
    mass, goal, forces = PassiveIntegrator(M, B, K, (0.0, 0.0, 0.0)), (0.03, 0.012, 0.0), []
    for _ in range(150):
        if rng.random() < 0.2:
            goal = tuple(rng.uniform((-0.02, -0.03, -0.02), (0.028, 0.018, 0.023)).tolist())
        forces.append(mass.step(float(rng.choice([0.001, rng.uniform(0.005, 0.06)])), goal, contacts).force)
    return np.array(forces)


VARIED: Friction = lambda x: 0.3 + 5.0 * x[2]  # noqa: E731


@pytest.mark.parametrize(
    ("friction", "seed"),
    [(0.0, 0), (0.0, 2), (0.4, 1), (0.4, 2), (VARIED, 1), (VARIED, 2)],
    ids=["smooth", "smooth 2", "rough", "rough 2", "varied", "varied 2"],
)
def test_whatever_the_hand_does_a_corner_is_its_walls(friction: float | Friction, seed: int) -> None:
    """Forces of triangles and of half-spaces."""
    walls = [HalfSpace(tuple(row), at) for row, at in zip(np.eye(3).tolist(), (0.02, 0.01, 0.015), strict=True)]
    found, wanted = wandered([cave()], friction, seed), wandered(walls, friction, seed)
    assert np.linalg.norm(wanted, axis=1).max() > 20.0
    assert found == pytest.approx(wanted, abs=1e-9)
