"""Surfaces that bend: where their tangent plane lies, what the device feels of them, and what becomes of lies."""

import math
from typing import Any

import msgpack
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from msgspec import structs
from scipy.optimize import minimize

from hapnet.checks import Vector
from hapnet.errors import InvalidParameter
from hapnet.ext.solids.rigid_contacts import RigidContacts, Solid
from hapnet.ext.solids.shapes import Cuboid, Cylinder, Sphere
from hapnet.mechanics.curvature import Curvature, across, tangent
from hapnet.mechanics.plane import FOLDED, Plane, checked
from hapnet.params import Params
from hapnet.simulation.simulation import Simulation
from hapnet.wire.messages import Proxy as ProxyMessage, decode
from hapnet.wire.stream import PositionStream
from tests.conftest import mostly_slow
from tests.control.test_contact_model import K_WALL, K_WORLD, SOFT, after, model, reported
from tests.measure.curved import error_N
from tests.measure.rubbing import check_no_energy, slack_of
from tests.wire.test_messages import A, rejected

seeds = st.integers(0, 2**32 - 1)


def frame(rng: np.random.Generator, n: int = 3) -> np.ndarray:
    """Orthonormal rows: a normal, then the directions across it."""
    return np.linalg.qr(rng.standard_normal((n, n)))[0]


def bends(axes: np.ndarray, *per_m: float) -> tuple[Curvature, ...]:
    return tuple(Curvature(tuple(e.tolist()), k) for e, k in zip(axes[1:], per_m, strict=False))


# -- geometry ----------------------------------------------------------------------------------------------------------


@settings(max_examples=60, deadline=None)
@given(seeds, st.sampled_from(("ball", "cylinder", "bowl", "pipe")))
def test_round_surfaces_are_exact(seed: int, kind: str) -> None:
    """By the distance from a centre or an axis."""
    rng = np.random.default_rng(seed)
    axes, foot, radius = frame(rng), rng.uniform(-0.1, 0.1, 3), rng.uniform(0.01, 0.1)
    hollow, along = kind in ("bowl", "pipe"), kind in ("cylinder", "pipe")
    side = -1.0 if hollow else 1.0
    centre = foot + side * radius * axes[0]
    place = foot + rng.uniform(-0.28, 0.28, 3) * radius  # less deep than half the radius
    away = place - centre
    if along:
        away = away - (away @ axes[2]) * axes[2]
    distance = float(np.linalg.norm(away))
    curvatures = bends(axes, side / radius, *(() if along else (side / radius,)))
    normal, depth = tangent(tuple(axes[0].tolist()), tuple(foot.tolist()), curvatures, tuple(place.tolist()))
    assert depth == pytest.approx(side * (radius - distance), abs=1e-14)
    assert normal == pytest.approx(tuple((-side * away / distance).tolist()), abs=1e-12)


def test_two_curvatures_make_a_torus() -> None:
    """The nearest point of a ring by its own parameters, searched for by scipy; and as seen from a saddle of it."""
    ring, tube = 0.05, 0.02
    for inside in (False, True):
        foot = np.array((ring - tube if inside else ring + tube, 0.0, 0.0))
        normal = (1.0, 0.0, 0.0) if inside else (-1.0, 0.0, 0.0)
        around = -1.0 / (ring - tube) if inside else 1.0 / (ring + tube)
        curvatures = (Curvature((0.0, 1.0, 0.0), around), Curvature((0.0, 0.0, 1.0), 1.0 / tube))
        for place in foot + np.array(((-0.004, 0.008, 0.005), (0.004, -0.01, 0.006), (0.0, 0.002, -0.01))):

            def surface(a: np.ndarray) -> np.ndarray:
                out = ring + tube * math.cos(a[1])
                return np.array((out * math.cos(a[0]), out * math.sin(a[0]), tube * math.sin(a[1])))

            def far(a: np.ndarray, place: np.ndarray = place) -> float:
                return 1e4 * float(np.sum((surface(a) - place) ** 2))

            start = np.array((0.0, math.pi if inside else 0.0))
            nearest = surface(minimize(far, start, tol=1e-14, method="Nelder-Mead").x)
            found, depth = tangent(normal, tuple(foot.tolist()), curvatures, tuple(place.tolist()))
            assert abs(depth) == pytest.approx(float(np.linalg.norm(nearest - place)), abs=1e-8)
            assert place - depth * np.array(found) == pytest.approx(nearest, abs=1e-6)


@settings(max_examples=60, deadline=None)
@given(seeds, st.floats(-1e4, 1e4), st.floats(-1e4, 1e4), st.floats(-8.0, 3.0))
def test_no_surface_folds(seed: int, one: float, other: float, far: float) -> None:
    """Whatever is sent, and wherever the device is: a unit normal, and no jump of the tangent plane's depth."""
    rng = np.random.default_rng(seed)
    axes, way = frame(rng), 10.0**far * rng.standard_normal(3)
    before = None
    for share in np.linspace(-1.0, 1.0, 41):
        place = tuple((share * way).tolist())
        normal, depth = tangent(tuple(axes[0].tolist()), (0.0, 0.0, 0.0), bends(axes, one, other), place)
        assert math.hypot(*normal) == pytest.approx(1.0, abs=1e-9)
        assert math.isfinite(depth)
        if before is not None:
            assert abs(depth - before) <= 10.0 * 0.05 * float(np.linalg.norm(way)) + 1e-12
        before = depth


@pytest.mark.parametrize("deep", [0.5, 0.9, 1.0, 1.1, 5.0])
def test_beyond_the_centre_it_is_still_the_side_that_was_told(deep: float) -> None:
    """Straight in, as deep as sent; beside that the normal turns by no more than the path is of twice the depth."""
    radius, beside = 0.01, 1e-5
    curvatures = tuple(Curvature(e, 1.0 / radius) for e in across((1.0, 0.0, 0.0)))
    for way in (0.0, beside):
        normal, depth = tangent((1.0, 0.0, 0.0), (0.0, 0.0, 0.0), curvatures, (deep * radius, way, 0.0))
        assert depth == pytest.approx(deep * radius, abs=2e-3 * beside)
        assert math.hypot(*normal[1:]) <= way / (deep * radius) * 1.001
        assert normal[0] > 0.99


@settings(max_examples=30, deadline=None)
@given(seeds, st.integers(1, 3))
def test_directions_across_a_normal(seed: int, n: int) -> None:
    normal = np.random.default_rng(seed).standard_normal(n)
    normal /= np.linalg.norm(normal)
    rows = np.array([tuple(normal.tolist()), *across(tuple(normal.tolist()))])
    assert rows @ rows.T == pytest.approx(np.eye(n), abs=1e-12)


# -- what the device makes of it ---------------------------------------------------------------------------------------


@settings(max_examples=25, deadline=None)
@given(seeds, st.integers(1, 2))
def test_the_proxy_rests_where_the_energy_is_least_among_balls(seed: int, count: int) -> None:
    """Independent: minimise the energy of all springs, with each ball's depth from its centre, with scipy."""
    rng = np.random.default_rng(seed)
    x, start = rng.uniform(-0.004, 0.004, 3), np.array((-0.02, 0.001, 0.0))
    m, balls = model(tuple(x.tolist())), []
    for way in ((1.0, 0.3, 0.1), (0.2, 1.0, -0.3))[:count]:
        radius = rng.uniform(0.03, 0.1)
        balls.append((radius * np.array(way) / np.linalg.norm(way), radius))  # through the origin
    start = start - 0.02 * (count - 1) * np.array((0.0, 1.0, 0.0))
    planes = tuple(Plane.of_ball(start.tolist(), centre.tolist(), radius, K_WALL) for centre, radius in balls)
    m.receive(reported(planes, tuple(start.tolist())), 0.0, 0.0)
    y = after(m, tuple(x.tolist()), 0.2)

    def energy(s: np.ndarray) -> float:
        depths = [max(0.0, radius - float(np.linalg.norm(s - centre))) for centre, radius in balls]
        springs = 0.5 * K_WORLD * float(np.sum((s - x) ** 2))
        return 1e3 * (springs + sum(0.5 * K_WALL * depth * depth for depth in depths))

    minimum = minimize(energy, x, method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-13, "maxiter": 4000})
    assert energy(np.array(y)) <= minimum.fun * (1.0 + 1e-5) + 1e-7  # some micrometres: two rounds a tick


def test_a_moving_ball_goes_on_as_a_ball() -> None:
    m, x = model((0.0, 0.01)), (0.0, 0.01)
    ball = Plane.of_ball((-0.02, 0.0), (0.025, 0.0), 0.03, K_WALL, velocity_mps=0.02)
    m.receive(reported((ball,), (-0.02, 0.0)), 0.0, 0.05)
    y = after(m, x, 0.1)
    centre = np.array((0.025 + 0.02 * 0.15, 0.0))
    away = np.array(x) - centre
    distance = float(np.linalg.norm(away))
    assert np.array(y) == pytest.approx(x + SOFT * (0.03 - distance) * away / distance, abs=2e-5)


def test_a_ball_that_the_proxy_slides_over_is_one_surface() -> None:
    """So what the proxy feels corrects it: each message has the ball 1 mm too near, 0.02 rad farther on."""
    centre, radius, error, deep = np.array((0.0, 0.0)), 0.02, 1e-3, 2e-3
    m = model((-0.03, 0.0))
    for k in range(60):
        out = np.array((-math.cos(0.02 * k), math.sin(0.02 * k)))
        x = (centre + (radius - deep) * out).tolist()
        force = K_WALL * (deep - error) * out
        ball = Plane.of_ball(x, centre.tolist(), radius, K_WALL)
        m.receive(reported((ball,), tuple(x), tuple(force.tolist())), 0.3 * k, 0.0)
        after(m, (-0.03, 0.0), 0.3)
        if k:
            assert m.shift == pytest.approx(tuple((-error * out).tolist()), abs=5e-5)


def test_what_folds_is_told_as_flat() -> None:
    ball = Plane.of_ball((0.03, 0.0), (0.05, 0.0), 0.03, K_WALL)
    assert ball.unfolded((0.03, 0.0)) is ball
    assert ball.unfolded((0.02 + 0.03 * FOLDED + 1e-6, 0.0)).curvatures == ()
    hollow = ball._replace(curvatures=(Curvature((0.0, 1.0), -1000.0),))
    assert hollow.unfolded((0.04, 0.0)) is hollow


@pytest.mark.parametrize(
    ("speed_mps", "flat_share"),
    [(0.05, (0.06, 0.13)), pytest.param(0.02, (0.03, 0.07), marks=pytest.mark.slow),
     pytest.param(0.1, (0.14, 0.27), marks=pytest.mark.slow)],
)  # fmt: skip
def test_sliding_over_a_ball(speed_mps: float, flat_share: tuple[float, float]) -> None:
    """In whole runs over the default delay, steps of 10 to 50 ms. A flat plane's error grows with the speed: as far as
    the hand goes in the plane's age, over the radius. With the ball's curvature nothing is left that can be felt."""
    flat, own = error_N(speed_mps, (0.01, 0.05), flat=True)
    bent, _ = error_N(speed_mps, (0.01, 0.05))
    assert flat_share[0] < flat / own < flat_share[1]
    assert bent <= 0.006


def test_sliding_over_a_disc_and_a_cylinder() -> None:
    for scene, dof in (("sphere", 2), ("cylinder?length=200mm", 3)):
        assert error_N(0.05, (0.01, 0.05), scene=scene, dof=dof, seconds=2.0)[0] <= 0.006


def test_a_peer_of_before_feels_flat_planes() -> None:
    """It ignores the entry: the message without it is the one that it knows."""
    plane = Plane.of_ball((0.0, 0.0), (0.05, 0.0), 0.03, K_WALL, 7.0)
    still = (0.0, 0.0)
    bent, flat = (PositionStream(1).proxy(3, still, 4, still, (one,)) for one in (plane, plane._replace(curvatures=())))
    new, old = decode(bent), decode(flat)
    assert isinstance(new, ProxyMessage)
    assert structs.replace(new, more=None) == old
    assert Plane.all_of(new.planes, new.more["curvatures"]) == (plane,)
    assert bent[1:].startswith(flat[1:])  # but for the number of elements


# -- what worlds send --------------------------------------------------------------------------------------------------


def test_solids_tell_how_they_bend() -> None:
    ball, rod, block = (
        Sphere((0.05, 0.0, 0.0), 0.03),
        Cylinder((0.0, 0.1, 0.0), 0.02, 0.06),
        Cuboid((0.0, -0.1, 0.0), (0.04,) * 3),
    )
    contacts = RigidContacts([Solid(ball), Solid(rod), Solid(block)], 3)
    planes = {plane.normal: plane.curvatures for plane in contacts.planes((0.0, 0.0, 0.0), 0.2)}
    (one, other), (around,), flat = planes[1.0, 0.0, 0.0], planes[0.0, 1.0, 0.0], planes[0.0, -1.0, 0.0]
    assert one.per_m == other.per_m == pytest.approx(1.0 / 0.03)
    assert around.per_m == pytest.approx(50.0)
    assert np.abs(around.direction) == pytest.approx((1.0, 0.0, 0.0))
    assert flat == ()
    above = RigidContacts([Solid(rod)], 3).planes((0.001, 0.1, 0.04), 0.2)  # over its flat end
    assert above[0].curvatures == ()


def test_a_cut_solid_bends_as_its_cut() -> None:
    (disc,) = RigidContacts([Solid(Sphere((0.05, 0.0, 0.0), 0.03))], 2).planes((0.0, 0.0), 0.2)
    assert [bend.per_m for bend in disc.curvatures] == [pytest.approx(1.0 / 0.03)]
    (lying,) = RigidContacts([Solid(Cylinder((0.05, 0.0, 0.0), 0.03, 0.2, axis=1))], 2).planes((0.0, 0.0), 0.2)
    assert [bend.per_m for bend in lying.curvatures] == [0.0]
    (oblique,) = RigidContacts([Solid(Sphere((0.05, 0.0, 0.02), 0.03))], 2).planes((0.0, 0.0), 0.2)
    assert oblique.curvatures == ()
    (line,) = RigidContacts([Solid(Sphere((0.05, 0.0, 0.0), 0.03))], 1).planes((0.0,), 0.2)
    assert line.curvatures == ()


@pytest.mark.parametrize(
    "wrong",
    [
        5.0,
        ((0.0, 1.0, 0.0), 10.0),  # one bend in place of a sequence
        (((1.0, 0.0, 0.0), 10.0),),  # along the normal
        (((0.0, 2.0, 0.0), 10.0),),
        (((0.0, 1.0, 0.0), math.nan),),
        (((0.0, 1.0, 0.0), math.inf),),
        (((0.0, 1.0, 0.0), 1.1e4),),
        (((0.0, 1.0), 10.0),),
        (((0.0, 1.0, 0.0), 10.0), ((0.0, 1.0, 0.0), 10.0)),
        (((0.0, 1.0, 0.0), 10.0), ((0.0, 0.0, 1.0), 10.0), ((0.0, 0.0, 1.0), 0.0)),
    ],
)
def test_what_a_device_would_drop_is_refused_where_it_is_made(wrong: Any) -> None:
    with pytest.raises(InvalidParameter, match="curvature"):
        checked([Plane((1.0, 0.0, 0.0), 0.0, 1.0, 0.0, 0.0, wrong)], 3)


def bent(*curvatures: object) -> list[object]:
    """A proxy 20 mm behind a plane of two axes, which bends so."""
    planes = [[[1.0, 0.0], 0.02, 3000.0, 10.0, 0.0]]
    return [2, 10, A, 0, 0, [0.04, 0.0], 0, [0.0, 0.0], planes, 0, 0, {"curvatures": list(curvatures)}]


def test_a_surface_may_bend_either_way_or_not_at_all() -> None:
    for curvatures in ([], [[[0.0, 1.0], 49.0]], [[[0.0, -1.0], -1e4]], [[[0.0, 1.0], 0.0]]):
        message = decode(msgpack.packb(bent(curvatures)))
        assert isinstance(message, ProxyMessage)
        assert message.more == {"curvatures": (tuple(((a, b), k) for (a, b), k in curvatures),)}


@pytest.mark.parametrize(
    ("kind", "frame"),
    [
        ("type", bent([[[0.0, 1.0], 25.0]], None)),
        ("type", bent(*[[]] * 2)),
        ("type", bent(25.0)),
        ("type", bent([[[0.0, 1.0], 25]])),
        ("type", bent([[[0, 1], 25.0]])),
        ("type", bent([[[0.0, 1.0]]])),
        ("range", bent([[[0.0, 1.0], math.nan]])),
        ("range", bent([[[0.0, 1.0], math.inf]])),
        ("range", bent([[[0.0, 1.0], -1.1e4]])),
        ("range", bent([[[0.0, math.nan], 1.0]])),
        ("range", bent([[[0.0, 2.0], 1.0]])),
        ("range", bent([[[1.0, 0.0], 1.0]])),
        ("range", bent([[[0.0, 1.0, 0.0], 1.0]])),
        ("range", bent([[[0.0, 1.0], 1.0], [[0.0, -1.0], 1.0]])),
        ("range", bent([[[0.0, 1.0], 51.0]])),  # 20 mm in, and the centre is nearer
    ],
)
def test_what_no_surface_does_is_dropped(kind: str, frame: object) -> None:
    assert rejected(frame).kind == kind


# -- lies --------------------------------------------------------------------------------------------------------------


def lying(rng: np.random.Generator) -> Any:
    """A world's `planes`: up to four surfaces, bent by anything that a message may say."""

    def planes(position: Vector, reach_m: float) -> tuple[Plane, ...]:
        found = []
        for _ in range(rng.integers(0, 5)):
            axes = frame(rng, len(position))
            normal = tuple(axes[0].tolist())
            offset = float(axes[0] @ np.array(position)) + rng.uniform(-0.02, 0.02)
            signs = rng.choice((-1.0, 1.0), 2)
            per_m = (signs * 10 ** rng.uniform(0.0, 4.0, 2))[: len(position) - 1]
            stiffness, speed = 10 ** rng.uniform(2.0, 4.5), rng.uniform(-0.3, 0.3)
            found.append(Plane(normal, offset, stiffness, 10.0, speed, bends(axes, *per_m.tolist())))
        return tuple(found)

    return planes


def lied_to(seed: int, coupling: str, monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.setattr(Plane, "unfolded", lambda plane, position: plane)  # not even the sender is honest
    hand = {"operator_model.mass": 0.1, "operator_model.damping": 0.5, "operator_model.stiffness": 40.0}
    params = Params().set({
        "scene": "sphere", "dof": 2 + seed % 2, "coupling": coupling, "operator": "press", "duration_s": 2.0,
        "link.up": LINK, "link.down": LINK, **hand,
    })  # fmt: skip
    run = Simulation(params, seed, kernel=False)
    contacts: Any = run.world.scene.contacts
    contacts.planes = lying(np.random.default_rng(seed))
    return run.run().summary


LINK = "delay 40ms 10ms loss 2%"


@pytest.mark.parametrize("seed", mostly_slow(range(20), 2, 5))
def test_no_lie_about_curvature_creates_energy(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    check_no_energy(lied_to(seed, "pspm", monkeypatch))


def test_without_pspm_the_same_lies_do(monkeypatch: pytest.MonkeyPatch) -> None:
    assert slack_of(lied_to(1, "zoh", monkeypatch)) < -0.01
