"""Friction in the device's local contact model: Coulomb's law, what sticks, what is sent, and what false planes do."""

import math
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from msgspec import structs

from hapnet.checks import Array, Vector
from hapnet.control.added_damping import AddedDamping
from hapnet.control.contact_model import ContactModel
from hapnet.control.friction_cone import RubbingProxy, agree
from hapnet.control.self_motion import SelfMotion
from hapnet.errors import InvalidParameter
from hapnet.ext.solids.friction import FrictionTexture
from hapnet.ext.solids.rigid_contacts import RigidContacts, Solid
from hapnet.ext.solids.shapes import Sphere
from hapnet.mechanics.plane import Plane, checked
from hapnet.wire.messages import Proxy as ProxyMessage, decode
from hapnet.wire.stream import PositionStream
from tests.conftest import mostly_slow
from tests.control.test_contact_model import K_WALL, K_WORLD, SOFT, TICK, after, model, reported
from tests.measure.rubbing import LINKS, K, check_no_energy, lied_to, rubbed, run, slack_of
from tests.wire.test_messages import A, rejected

seeds = st.integers(0, 2**32 - 1)
DEEP = 0.01
PUSH_N = SOFT * DEEP * K_WORLD
"""Of a plane on the proxy of a device that is so deep: springs in series."""


def face(mu: float, **more: Any) -> Plane:
    return Plane((1.0, 0.0, 0.0), 0.0, K_WALL, 10.0, friction=mu, **more)


def touching(mu: float, *planes: Plane) -> ContactModel:
    """A model whose device came in along x, to `DEEP` at the origin of the surface."""
    m = model((-0.001, 0.0, 0.0))
    m.receive(reported((face(mu), *planes), (-0.001, 0.0, 0.0)), 0.0, 0.0)
    for x in np.linspace(-0.001, DEEP, 20):
        m.step(TICK, (float(x), 0.0, 0.0))
    return m


def moved(m: ContactModel, *way: tuple[float, float], speed: float = 0.05) -> list[tuple[Vector, Vector]]:
    """x and y at each tick of a way across the surface, corner by corner, and 0.1 s at its end."""
    done, at = list[tuple[Vector, Vector]](), np.array(way[0])
    for goal in (*way[1:], way[-1]):
        count = max(1, round(float(np.linalg.norm(goal - at)) / speed / TICK)) if any(goal - at) else 100
        for share in np.arange(1, count + 1) / count:
            x = (DEEP, *(at + share * (goal - at)).tolist())
            done.append((x, m.step(TICK, x)))
        at = np.array(goal)
    return done


# -- Coulomb's law -----------------------------------------------------------------------------------------------------


@settings(max_examples=10, deadline=None)
@given(st.floats(0.05, 2.0), st.floats(-math.pi, math.pi))
def test_what_slides_is_held_back_by_mu_times_the_push(mu: float, angle: float) -> None:
    way = np.array((math.cos(angle), math.sin(angle)))
    *_, (x, y) = moved(touching(mu), (0.0, 0.0), tuple((0.05 * way).tolist()))
    spring = K_WORLD * (np.array(y) - x)
    assert spring[0] == pytest.approx(-PUSH_N, rel=1e-6)
    assert spring[1:] == pytest.approx(-mu * PUSH_N * way, abs=1e-6)


def test_what_sticks_is_a_spring_that_gives_all_back() -> None:
    """Below the cone y stays where it was, whatever the way there: no work is lost on any closed way."""
    radius = 0.9 * 0.5 * PUSH_N / K_WORLD
    done = moved(touching(0.5), (0.0, 0.0), (radius, 0.0), (0.0, -radius), (-radius / 2, radius / 2), (0.0, 0.0))
    for _, y in done:
        assert y[1:] == pytest.approx((0.0, 0.0), abs=1e-9)
    done = [((DEEP, 0.0, 0.0), done[-1][1]), *done]
    xs, force = np.array([x for x, _ in done]), np.array([K * (np.array(y) - x) for x, y in done])
    work = np.sum(0.5 * (force[1:] + force[:-1]) * np.diff(xs, axis=0))
    assert abs(work) <= 1e-9


def test_beyond_the_cone_it_follows_and_sticks_again() -> None:
    """To and fro over 20 mm: the force is Coulomb's at both ends, and a spring of K between, over twice the cone."""
    mu, radius = 0.5, 0.5 * PUSH_N / K_WORLD
    m = touching(mu)
    moved(m, (0.0, 0.0), (0.02, 0.0))
    for x, y in moved(m, (0.02, 0.0), (0.0, 0.0))[:-100]:
        expected = min(radius, -radius + (0.02 - x[1]))
        assert y[1] - x[1] == pytest.approx(expected, abs=1e-6)


def test_contact_that_is_lost_and_found_begins_without_strain() -> None:
    m = touching(0.8)
    moved(m, (0.0, 0.0), (0.0, 0.003))
    for x in np.linspace(DEEP, -0.002, 20):
        m.step(TICK, (float(x), 0.0, 0.003))
    assert after(m, (-0.002, 0.0, 0.01), 0.3) == pytest.approx((-0.002, 0.0, 0.01), abs=1e-6)
    for x in np.linspace(-0.002, DEEP, 20):
        y = m.step(TICK, (float(x), 0.0, 0.01))
    assert y[1:] == pytest.approx((0.0, 0.01), abs=1e-6)


def test_a_plane_that_is_told_a_little_otherwise_moves_nothing_along_it() -> None:
    """Messages whose plane trembles by 20 um and 1 mrad, for 5 s at rest below the cone: the anchor moves < 10 um."""
    rng, m = np.random.default_rng(3), touching(0.5)
    moved(m, (0.0, 0.0), (0.001, 0.0))
    x, ys = (DEEP, 0.001, 0.0), []
    proxy = (DEEP * (1.0 - SOFT), 0.0, 0.0)
    for k in range(250):
        lean = rng.uniform(-1e-3, 1e-3, 2)
        normal = np.array((1.0, *lean)) / math.hypot(1.0, *lean)
        plane = Plane(tuple(normal.tolist()), rng.uniform(-2e-5, 2e-5), K_WALL, 10.0, friction=0.5)
        force = (-PUSH_N, -K_WORLD * 0.001, 0.0)
        m.receive(reported((plane,), proxy, force), 0.02 * k, 0.03)
        ys += [m.step(TICK, x) for _ in range(20)]
    assert np.abs(np.array(ys)[-1, 1:]).max() <= 2e-5  # of its lean: 10 mm times 1 mrad
    assert np.ptp(np.array(ys)[2000:, 1:].reshape(-1, 20, 2).mean(axis=1), axis=0).max() <= 3e-5


def test_in_a_corner_both_faces_hold() -> None:
    """Along the edge each rubs with its own push; away from one face, the other one's friction holds, then slides."""
    wall = Plane((0.0, 1.0, 0.0), 0.0, K_WALL, 10.0, friction=0.2)
    m = model((-0.001, -0.001, 0.0))
    m.receive(reported((face(0.5), wall), (-0.001, -0.001, 0.0)), 0.0, 0.0)
    for share in np.linspace(0.0, 1.0, 40):
        m.step(TICK, (DEEP * share, DEEP * share, 0.0))
    for z in np.linspace(0.0, 0.05, 1000):
        y = m.step(TICK, (DEEP, DEEP, float(z)))
    pushes = [K_WORLD * (DEEP - y[0]), K_WORLD * (DEEP - y[1])]
    assert pushes == pytest.approx([PUSH_N, PUSH_N], rel=0.02)  # what holds along z holds no longer against x and y
    assert K_WORLD * (0.05 - y[2]) == pytest.approx(0.7 * PUSH_N, rel=0.02)


def pressed(stiff: Array) -> ContactModel:
    """A model whose proxy hangs on this spring, pressed in like `touching`, without what it does besides."""
    eye = np.eye(3)
    m = ContactModel(
        (-0.001, 0.0, 0.0), compliance=np.linalg.inv(stiff).tolist(), lead=(0.0 * eye).tolist(),
        self_motion=SelfMotion(), added=AddedDamping((eye * K).tolist(), (eye / K).tolist(), 0.0, 5.0),
    )  # fmt: skip
    m.receive(reported((face(0.5),), (-0.001, 0.0, 0.0)), 0.0, 0.0)
    for x in np.linspace(-0.001, DEEP, 100):
        m.step(TICK, (float(x), 0.0, 0.0))
    return m


def test_what_sticks_is_held_within_one_tick() -> None:
    """A spring that is twice as stiff along y: each of 8 sweeps halves what is missing there, and none the push."""
    y = pressed(np.diag([500.0, 1000.0, 500.0])).step(TICK, (DEEP, 2e-4, 0.0))
    assert 0.0 < y[1] <= 1.01 * 2e-4 / 2**8


@settings(max_examples=12, deadline=None)
@given(seeds)
def test_unlike_springs_along_the_axes_obey_the_cone(seed: int) -> None:
    """K' is any matrix: in sliding the force across the normal is mu times that along it, against the slip of s."""
    rng = np.random.default_rng(seed)
    axes = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    stiff = axes @ np.diag(rng.uniform(200.0, 800.0, 3)) @ axes.T
    m = pressed(stiff)
    y = m.step(TICK, (DEEP, 0.0, 0.0))
    for along in np.linspace(0.0, 0.025, 500):  # planes that are older than a second would drag
        place = (DEEP, float(along), 0.0)
        before, y = y, m.step(TICK, place)
    force = stiff @ (np.array(place) - y)  # of the spring on the proxy
    assert force[0] == pytest.approx(K_WALL * y[0], abs=2e-3)
    assert math.hypot(*force[1:]) == pytest.approx(0.5 * force[0], rel=1e-6)
    slip = np.array(y) - before
    assert force[1:] @ slip[1:] >= 0.99 * math.hypot(*force[1:]) * math.hypot(*slip[1:])


def test_it_follows_the_worlds_proxy_if_that_is_carried_away() -> None:
    """A surface that moves along itself carries the world's proxy off: the place here follows, to within 2 mm."""
    m = touching(0.5)
    x, proxy = (DEEP, 0.0, 0.0), 0.0
    for k in range(100):
        proxy = min(0.004, 0.0001 * k)
        m.receive(reported((face(0.5),), (DEEP * (1.0 - SOFT), proxy, 0.0), (-PUSH_N, 0.0, 0.0)), 0.02 * k, 0.03)
        y = after(m, x, 0.02)
    assert 0.0018 <= y[1] <= 0.002


def test_it_does_not_follow_a_proxy_that_shot_beyond_the_hand() -> None:
    """The hand came fast and stopped: the world's proxy goes on by 6 mm and comes back, and is 60 ms old."""
    m, x = touching(0.5), (DEEP, 0.0, 0.0)
    for k, proxy in enumerate((0.001, 0.003, 0.005, 0.006, 0.005, 0.003, 0.0015)):
        m.receive(reported((face(0.5),), (DEEP * (1.0 - SOFT), proxy, 0.0), (-PUSH_N, 0.0, 0.0)), 0.02 * k, 0.06)
        y = after(m, x, 0.02)
    assert abs(y[1]) < 1e-4


def test_friction_of_one_plane_is_no_push_of_another() -> None:
    """A wall 15 mm before a proxy that slides towards it: what holds that back says nothing of the wall."""
    wall = Plane((0.0, 1.0, 0.0), 0.015, K_WALL, 10.0, friction=0.5)
    m = touching(0.5, wall)
    for k in range(1, 20):
        m.receive(reported((face(0.5), wall), (DEEP * (1 - SOFT), 0.0, 0.0), (-PUSH_N, -2.0, 0.0)), 0.02 * k, 0.03)
        after(m, (DEEP, 0.0, 0.0), 0.02)
    assert m.shift == pytest.approx((0.0, 0.0, 0.0), abs=1e-4)


@pytest.mark.parametrize("mu", [0.1, 0.5])
def test_what_slips_off_a_small_ball_does_so_without_a_jump(mu: float) -> None:
    """Pressed 20 mm deep beside the middle of a ball of 10 mm, and moved aside until it slips."""
    at, force = (-0.002, 0.0005, 0.0), None
    m = model(at)
    m.receive(reported((Plane.of_ball(at, (0.01, 0.0, 0.0), 0.01, K_WALL)._replace(friction=mu),), at), 0.0, 0.0)
    steps = []
    for x, aside in [(-0.002 + 1e-4 * k, 0.0) for k in range(220)] + [(0.02, 1e-4 * k) for k in range(200)]:
        place = np.array((x, 0.0005 + aside, 0.0))
        before, force = force, K * (np.array(m.step(TICK, tuple(place.tolist()))) - place)
        steps.append(0.0 if before is None else float(np.linalg.norm(force - before)))
    assert max(steps) <= 0.25  # of 2 N that turn around; without the limit 0.7


# -- whole runs --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("mu", "link"),
    [(0.5, "5 ms"), *[pytest.param(mu, link, marks=pytest.mark.slow) for mu in (0.2, 0.5, 0.8) for link in LINKS]],
)
def test_a_hand_that_slides_feels_coulombs_friction(mu: float, link: str) -> None:
    """At the device, in sliding: mu times the force along the normal within 5 %, against the motion."""
    for steps in ((0.001, 0.001), (0.01, 0.05)):
        felt = run(f"plane?friction={mu}", link, steps_s=steps)
        on = felt.sliding()
        assert on.sum() > 500
        assert felt.push()[on].mean() == pytest.approx(K / K_WORLD * PUSH_N, rel=0.05)
        _, minimum, most = rubbed(felt, mu)
        assert 0.95 <= minimum <= most <= 1.05
        assert np.percentile(felt.steps(), 95) <= 0.02
        assert slack_of(felt.summary) >= -1e-12


@pytest.mark.parametrize("link", ["40 ms", pytest.param("5 ms", marks=pytest.mark.slow)])
def test_a_hand_at_rest_below_the_cone_stays(link: str) -> None:
    """1.5 mm aside, gently: a spring of K to where it touched. That drifts by < 10 um in 5 s, with no buzz."""
    felt = run("plane?friction=0.5", link, aside_m=0.0015, speed_mps=0.003, seconds=7.0)
    anchor = (felt.x[:, 1] + felt.rub() / K)[1800:6800]
    assert np.ptp(anchor) <= 1e-5
    assert np.abs(anchor).max() <= 2e-5
    assert felt.rub()[1800:6800].mean() == pytest.approx(-K * 0.0015, rel=0.1)
    assert np.ptp(felt.force[3000:6800], axis=0).max() <= 5e-3


@pytest.mark.parametrize("link", [pytest.param("5 ms", marks=pytest.mark.slow), "40±10 ms, 2 %"])
@pytest.mark.parametrize("steps", [(0.001, 0.001), (0.01, 0.05)])
@pytest.mark.parametrize("shape", ["sphere", pytest.param("mesh", marks=pytest.mark.slow)])
def test_the_force_has_no_steps_on_what_is_round(
    shape: str, link: str, steps: tuple[float, float], tmp_path: Path
) -> None:
    scene = shape
    if shape == "mesh":  # a ball of 5120 triangles
        trimesh = pytest.importorskip("trimesh")
        ball = trimesh.creation.icosphere(subdivisions=4, radius=0.04)
        ball.apply_translation((0.06, 0.0, 0.0))
        ball.export(tmp_path / "ball.stl")
        scene = f"mesh:{tmp_path}/ball.stl?unit=m"
    felt = run(f"{scene}{'&' if '?' in scene else '?'}friction=0.5", link, steps_s=steps, seconds=2.0)
    assert np.abs(felt.rub()).max() > 0.3
    assert np.percentile(felt.steps(), 95) <= 0.2


# -- what is sent ------------------------------------------------------------------------------------------------------


def test_solids_tell_the_friction_at_the_place() -> None:
    varies = FrictionTexture(0.5, 0.8, 0.004)
    for friction, expected in ((0.3, 0.3), (varies, varies((0.001, 0.002, 0.0))), (20.0, 10.0), (lambda x: -1.0, 0.0)):
        contacts = RigidContacts([Solid(Sphere((0.05, 0.0, 0.0), 0.03), friction=friction)], 3)  # type: ignore[arg-type]
        (plane,) = contacts.planes((0.001, 0.002, 0.0), 0.1)
        assert plane.friction == pytest.approx(expected)


def test_a_peer_of_before_feels_smooth_planes() -> None:
    still = (0.0, 0.0, 0.0)
    rough, smooth = (PositionStream(1).proxy(3, still, 4, still, (face(mu),)) for mu in (0.5, 0.0))
    new, old = decode(rough), decode(smooth)
    assert isinstance(new, ProxyMessage)
    assert new.more == {"friction": (0.5,)}
    assert structs.replace(new, more=None) == old
    assert Plane.all_of(new.planes, None, new.more["friction"]) == (face(0.5),)
    assert rough[1:].startswith(smooth[1:])  # but for the number of elements
    both = decode(
        PositionStream(1).proxy(3, still, 4, still, (face(0.5), Plane.of_ball(still, (0.05, 0.0, 0.0), 0.03, 1.0)))
    )
    assert isinstance(both, ProxyMessage)
    assert set(both.more) == {"curvatures", "friction"}
    assert both.more["friction"] == (0.5, 0.0)


@pytest.mark.parametrize("wrong", [-0.1, 10.1, math.nan, math.inf])
def test_a_friction_that_a_device_would_drop_is_refused(wrong: float) -> None:
    with pytest.raises(InvalidParameter, match="friction"):
        checked([face(wrong)], 3)


def rubs(friction: object, planes: int | None = 1) -> list[object]:
    plane = [[1.0, 0.0], 0.02, 3000.0, 10.0, 0.0]
    reported = None if planes is None else [plane] * planes
    return [2, 10, A, 0, 0, [0.04, 0.0], 0, [0.0, 0.0], reported, 0, 0, {"friction": friction}]


@pytest.mark.parametrize(
    ("kind", "frame"),
    [
        ("type", rubs([0.5, 0.5])),
        ("type", rubs([])),
        ("type", rubs([0.5], None)),
        ("type", rubs(0.5)),
        ("type", rubs([1])),
        ("type", rubs([None])),
        ("range", rubs([-0.1])),
        ("range", rubs([10.1])),
        ("range", rubs([math.nan])),
        ("range", rubs([math.inf])),
    ],
)
def test_what_no_surface_has_is_dropped(kind: str, frame: object) -> None:
    assert rejected(frame).kind == kind
    assert isinstance(decode(msgpack.packb(rubs([10.0]))), ProxyMessage)


# -- lies --------------------------------------------------------------------------------------------------------------


def friction_lied(seed: int, coupling: str) -> Any:
    """Up to four planes anywhere near, with any friction, sent anew at each step."""
    rng = np.random.default_rng(seed)

    def planes(position: Vector, reach_m: float) -> tuple[Plane, ...]:
        found = []
        for _ in range(rng.integers(0, 5)):
            normal = rng.standard_normal(len(position))
            normal /= np.linalg.norm(normal)
            offset = float(normal @ np.array(position)) + rng.uniform(-0.02, 0.02)
            stiffness, mu = 10 ** rng.uniform(2.0, 4.5), 10 ** rng.uniform(-2.0, 1.0)
            found.append(
                Plane(tuple(normal.tolist()), offset, stiffness, 10.0, rng.uniform(-0.3, 0.3), friction=float(mu))
            )
        return tuple(found)

    return lied_to(planes, "40±10 ms, 2 %", seed=seed, dof=2 + seed % 2, coupling=coupling)


@pytest.mark.parametrize("seed", mostly_slow(range(20), 2, 8))
def test_no_lie_about_friction_creates_energy(seed: int) -> None:
    check_no_energy(friction_lied(seed, "pspm"))


def test_without_pspm_the_same_lies_do() -> None:
    assert slack_of(friction_lied(1, "zoh")) < -0.01


@pytest.mark.parametrize("dt", [0.15, 0.3, 30.0])
def test_a_proxy_far_from_the_worlds_goes_on_to_two_millimetres_with_its_time_constant(dt: float) -> None:
    """The rest of the way is divided by 1 + dt/0.3 s in a step: backward Euler, which never goes too far."""
    proxy = RubbingProxy([[1.0 / K_WORLD, 0.0], [0.0, 1.0 / K_WORLD]], (0.0, 0.05))
    proxy.has_friction = proxy.has_worlds = 1
    proxy.worlds = [0.012, 0.05]
    for k in range(1, 4):
        agree(proxy, (), 2, dt)
        assert proxy.place == pytest.approx([0.01 - 0.01 / (1.0 + dt / 0.3) ** k, 0.05])
