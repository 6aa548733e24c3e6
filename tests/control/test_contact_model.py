"""The device's local contact model against an independent equilibrium, and what happens when the world changes."""

import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.optimize import minimize

from hapnet.checks import Array, Vector
from hapnet.control.added_damping import AddedDamping, damp_swings
from hapnet.control.contact_equations import SETTLED_MPS, share
from hapnet.control.contact_model import ContactModel
from hapnet.control.coupling import ProxySample
from hapnet.control.self_motion import SelfMotion
from hapnet.mechanics.plane import Plane
from hapnet.mechanics.spring import Spring

K_WORLD, K_WALL, K, B, TICK = 500.0, 3000.0, 100.0, 1.0, 1e-3
SOFT = K_WALL / (K_WORLD + K_WALL)
"""The proxy of a device at depth p rests at depth p (1 - SOFT): springs in series."""


def model(x: Vector, lead: float = 0.0) -> ContactModel:
    n = len(x)
    eye = np.eye(n)
    return ContactModel(
        x,
        compliance=(eye / K_WORLD).tolist(),
        lead=(eye * lead * B / K).tolist(),
        self_motion=SelfMotion(),
        added=AddedDamping((eye * K).tolist(), (eye / K).tolist(), 0.0, 5.0),
    )


def reported(planes: tuple[Plane, ...] | None, x: Vector = (0.0,), force: Vector = ()) -> ProxySample:
    return ProxySample(x, 1.0, force or (0.0,) * len(x), planes)


def wall(offset: float = 0.0, stiffness: float = K_WALL) -> Plane:
    return Plane((1.0,), offset, stiffness, 10.0)


def after(m: ContactModel, x: Vector, seconds: float) -> Vector:
    y = x
    for _ in range(round(seconds / TICK)):
        y = m.step(TICK, x)
    return y


@st.composite
def places(draw: st.DrawFn) -> tuple[Vector, tuple[Plane, ...]]:
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    n = draw(st.integers(1, 3))
    planes = []
    for _ in range(draw(st.integers(1, n))):
        normal = rng.standard_normal(n)
        normal /= np.linalg.norm(normal)
        planes.append(Plane(tuple(normal.tolist()), rng.uniform(-0.01, 0.01), 10 ** rng.uniform(2, 4), 0.0))
    return tuple(rng.uniform(-0.03, 0.03, n).tolist()), tuple(planes)


@settings(max_examples=40, deadline=None)
@given(places())
@pytest.mark.long
def test_the_proxy_rests_where_the_energy_is_least(place: tuple[Vector, tuple[Plane, ...]]) -> None:
    """Independent: minimise the energy of all springs over the proxy's position, with scipy."""
    x, planes = place
    m = model(x)
    normals, offsets = np.array([p.normal for p in planes]), np.array([p.offset_m for p in planes])
    outside = np.linalg.lstsq(normals, offsets - 1e-3, rcond=None)[0]  # a proxy that touches nothing shifts nothing
    m.receive(reported(planes, tuple(outside.tolist())), 0.0, 0.0)
    y = after(m, x, 0.2)

    def energy(s: np.ndarray) -> float:
        depths = [max(0.0, float(np.dot(p.normal, s)) - p.offset_m) for p in planes]
        walls = sum(0.5 * p.stiffness * d * d for p, d in zip(planes, depths, strict=True))
        return 1e3 * (0.5 * K_WORLD * float(np.sum((s - np.array(x)) ** 2)) + walls)

    minimum = minimize(
        energy, np.array(x), method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-13, "maxiter": 4000}
    )
    assert energy(np.array(y)) <= minimum.fun * 1.02 + 1e-9


def test_a_wall_is_felt_as_the_springs_in_series() -> None:
    m = model((0.01,))
    m.receive(reported((wall(),)), 0.0, 0.0)
    assert after(m, (0.01,), 0.1)[0] == pytest.approx(0.01 * (1.0 - SOFT), rel=1e-6)


def shares(m: ContactModel) -> tuple[float, float]:
    """The parts of the last y - x, of one axis, that planes and added damping make [m]: of the force, by the spring."""
    of_planes, added = [0.0], [0.0]
    share(m, Spring([[K]], 1), (0.0,), (0.0,), of_planes, added)
    return of_planes[0] / K, added[0] / K


def test_the_shares_of_planes_and_damping_are_told() -> None:
    """In contact the planes make all of it; with an old answer, added damping makes the rest; before, nobody."""
    m, x, v = model((0.01,)), 0.01, 0.05
    assert shares(m) == (0.0, 0.0)
    m.receive(reported((wall(),)), 0.0, 0.0)
    y = after(m, (x,), 0.1)
    assert shares(m) == pytest.approx((-0.01 * SOFT, 0.0), rel=1e-6)
    assert shares(m)[0] == pytest.approx(y[0] - x, abs=1e-9)
    m.receive(reported((wall(),)), 0.1, 3.0)
    for _ in range(100):
        x += v * TICK
        y = m.step(TICK, (x,))
    assert shares(m)[1] == pytest.approx(-1.5 * v / K, rel=0.01)
    assert sum(shares(m)) == pytest.approx(y[0] - x, abs=1e-9)
    m.receive(reported(None, (0.0,)), 0.2, 0.0)
    after(m, (x,), 0.5)
    assert shares(m)[0] == 0.0  # the world's answer makes it
    m.reset((x,))
    assert shares(m) == (0.0, 0.0)


def test_free_motion_cancels_its_share_of_the_drag() -> None:
    """Force K (y - x) at a steady velocity: the lead's share of B v."""
    m, v = model((0.0,), lead=0.5), 0.067
    for k in range(450):  # an older answer would drag
        x = (v * TICK * k,)
        y = m.step(TICK, x)
    assert K * (y[0] - x[0]) == pytest.approx(0.5 * B * v, rel=0.03)


@pytest.mark.parametrize(("before", "now"), [
    ((wall(),), ()),
    ((), (wall(),)),
    ((wall(),), (wall(0.003),)),
    ((wall(),), (wall(0.0, K_WALL / 3.0),)),
    ((wall(),), (wall(0.0, K_WALL * 3.0),)),
    ((wall(),), None),
])  # fmt: skip
def test_a_change_takes_effect_without_a_jump_and_is_over_after_100_ms(
    before: tuple[Plane, ...], now: tuple[Plane, ...] | None
) -> None:
    x = (0.01,)
    m = model(x)
    m.receive(reported(before), 0.0, 0.0)
    y = after(m, x, 0.5)
    m.receive(reported(now, (-0.001,)), 0.5, 0.0)
    steps = []
    for _ in range(100):
        later = m.step(TICK, x)
        steps.append(abs(later[0] - y[0]))
        y = later
    whole = 0.01  # the farthest that anything moves here
    assert max(steps) <= whole * TICK / (0.005 + TICK) * 1.01
    if now is not None:
        alone = model(x)
        alone.receive(reported(now, (-0.001,)), 0.0, 0.0)
        assert y[0] == pytest.approx(after(alone, x, 0.5)[0], abs=1e-6)


@settings(max_examples=30, deadline=None)
@given(st.floats(-0.003, 0.003), st.floats(0.3, 3.0), st.floats(0.005, 0.02))
@pytest.mark.long
def test_a_wrong_plane_is_corrected_by_what_the_proxy_feels(error: float, factor: float, x: float) -> None:
    """The world says a plane that is shifted and of another stiffness, and where its proxy is and what it feels."""
    proxy = x * (1.0 - SOFT)  # of the true wall, at 0
    force = K_WALL * proxy
    m = model((x,))
    for _ in range(20):
        m.receive(reported((wall(error, factor * K_WALL),), (proxy,), (-force,)), 0.0, 0.0)
        y = after(m, (x,), 0.03)
    assert K * (x - y[0]) == pytest.approx(K * (x - proxy), rel=0.01)


@pytest.mark.parametrize(
    ("velocity", "shift"),
    [((0.0, 0.3), -0.003), ((0.9 * SETTLED_MPS, 0.3), -0.003), ((1.1 * SETTLED_MPS, 0.0), 0.0), ((-0.1, 0.3), 0.0)],
)
def test_only_a_proxy_that_does_not_move_along_a_normal_corrects_its_plane(velocity: Vector, shift: float) -> None:
    """The plane is really 3 mm nearer than is said; the force is the mean that the true one exerts during each step."""
    m = model((0.05, 0.0))
    for k in range(20):
        x = (0.05 + velocity[0] * 0.02 * k, velocity[1] * 0.02 * k)
        mean_N = K_WALL * (x[0] - (0.01 * velocity[0] if k else 0.0))
        m.receive(reported((Plane((1.0, 0.0), 0.003, K_WALL, 10.0),), x, (-mean_N, 0.0)), 0.02 * k, 0.0)
        after(m, x, 0.02)
    assert m.shift == pytest.approx((shift, 0.0), abs=2e-6)


@pytest.mark.parametrize("speed", [0.2 * SETTLED_MPS, 0.9 * SETTLED_MPS])
def test_brief_touches_do_not_shift_a_plane_that_is_right(speed: float) -> None:
    """To and fro through the surface at a constant speed, in steps of 30 ms; the force is the mean of each step."""
    m, deepest, edge = model((0.01,)), 2.6 * speed * 0.03, 5.0 * speed * 0.03  # in and out within steps

    def force(at_s: Array) -> Array:
        depth: Array = deepest - np.abs((speed * at_s) % (2.0 * edge) - edge)
        return K_WALL * np.maximum(0.0, depth)

    for k in range(1, 200):
        during = (k - 1 + (np.arange(300) + 0.5) / 300.0) * 0.03
        x = float(deepest - np.abs((speed * 0.03 * k) % (2.0 * edge) - edge))
        m.receive(reported((wall(),), (x,), (-float(np.mean(force(during))),)), 0.03 * k, 0.0)
        after(m, (0.01,), 0.03)
        assert abs(m.shift[0]) < 1e-9


def test_a_plane_in_front_of_which_the_proxy_does_not_stop_gives_way() -> None:
    m = model((0.01,))
    for _ in range(20):
        m.receive(reported((wall(),), (0.01,)), 0.0, 0.0)  # 10 mm behind the plane, and feels nothing
        y = after(m, (0.01,), 0.03)
    assert y[0] == pytest.approx(0.01, abs=1e-5)


@pytest.mark.parametrize("depth", [0.004, 0.012])
@pytest.mark.parametrize("wrong", [0.0, 0.002])
def test_planes_side_by_side_share_the_proxys_force(depth: float, wrong: float) -> None:
    """As of a soft body: 200 N/m, and 300 more from 6 mm on, which the proxy touches or not; told too deep, or not."""
    m, device = model((0.01,)), depth + (200.0 * depth + 300.0 * max(0.0, depth - 0.006)) / K_WORLD
    force = -K_WORLD * (device - depth)
    for k in range(30):
        m.receive(reported((wall(wrong, 200.0), wall(wrong + 0.006, 300.0)), (depth,), (force,)), 0.02 * k, 0.0)
        y = after(m, (device,), 0.02)
    assert m.shift[0] == pytest.approx(-wrong, abs=2e-5)
    assert y[0] == pytest.approx(depth, abs=2e-5)


@pytest.mark.parametrize("angle", [15.0, 60.0, 90.0, 120.0, 165.0])
@pytest.mark.parametrize("behind", [0.002, -0.002, -0.03])
def test_planes_at_an_angle_are_not_shifted_by_one_anothers_force(angle: float, behind: float) -> None:
    """The first plane is touched, the second too or not; both are right, so the force agrees with them."""
    normals = [(1.0, 0.0), (math.cos(math.radians(angle)), math.sin(math.radians(angle)))]
    m, proxy, depths = model((0.01, 0.0)), (0.004, 0.0), (0.004, behind)
    pushes = [K_WALL * max(0.0, depth) for depth in depths]
    force = tuple([-sum(push * n[i] for push, n in zip(pushes, normals, strict=True)) for i in range(2)])
    planes = tuple(
        [Plane(n, 0.004 * n[0] - depth, K_WALL, 10.0) for n, depth in zip(normals, depths, strict=True)]
    )  # fmt: skip
    for k in range(5):
        m.receive(reported(planes, proxy, force), 0.02 * k, 0.0)
        after(m, (0.01, 0.0), 0.02)
    assert m.shift == pytest.approx((0.0, 0.0), abs=1e-12)


def test_a_shift_is_forgotten_out_of_contact() -> None:
    m = model((0.01,))
    for _ in range(2):  # what a plane says in its first message proves nothing
        m.receive(reported((wall(0.003),), (0.01 * (1 - SOFT),), (-K_WALL * 0.01 * (1 - SOFT),)), 0.0, 0.0)
        after(m, (0.01,), 0.01)
    after(m, (0.01,), 0.3)
    assert m.shift[0] == pytest.approx(-0.003, rel=0.02)
    m.receive(reported((wall(0.003),), (-0.01,)), 0.0, 0.0)
    after(m, (-0.01,), 3.0)
    assert abs(m.shift[0]) < 1e-5


def test_a_moving_plane_goes_on_for_a_fifth_of_a_second() -> None:
    m = model((0.01,))
    m.receive(reported((Plane((1.0,), 0.0, K_WALL, 0.0, 0.02),)), 0.0, 0.05)
    assert after(m, (0.01,), 0.1)[0] == pytest.approx(0.01 - (0.01 - 0.02 * 0.15) * SOFT, rel=0.01)
    assert after(m, (0.01,), 1.0)[0] == pytest.approx(0.01 - (0.01 - 0.02 * 0.2) * SOFT, abs=2e-4)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
@pytest.mark.long
def test_random_planes_in_every_message_move_y_smoothly(seed: int) -> None:
    rng = np.random.default_rng(seed)
    m, x = model((0.0, 0.0)), (0.0, 0.0)
    y = m.step(TICK, x)
    for k in range(600):
        x = (0.01 * math.sin(0.01 * k), 0.01 * math.cos(0.01 * k) - 0.01)
        if k % 30 == 0:
            normal = rng.standard_normal(2)
            normal /= np.linalg.norm(normal)
            plane = Plane(tuple(normal.tolist()), rng.uniform(-0.02, 0.02), 10 ** rng.uniform(2, 4), 0.0)
            m.receive(reported((plane,), tuple(rng.uniform(-0.02, 0.02, 2).tolist())), 0.0, 0.1)
        later = m.step(TICK, x)
        assert math.dist(later, y) < 0.06 * TICK / (0.005 + TICK)
        y = later


def test_without_planes_free_motion_follows_the_own_motion_and_contact_the_answer() -> None:
    m, delay, v = model((0.0,)), 0.1, 0.067
    for k in range(1000):
        t = TICK * k
        if k % 30 == 0:
            m.receive(
                reported(None, (v * max(0.0, t - delay),)), 0.0, delay
            )  # the proxy was exactly where the device was
        y = m.step(TICK, (v * t,))
    assert y[0] == pytest.approx(v * t, abs=5e-4)  # a half of a tick and the settling of sigma
    for _ in range(20):
        m.receive(
            reported(None, (v * t - 0.02,)), 0.0, delay
        )  # the hand holds still, the proxy is held 20 mm before it
        y = after(m, (v * t,), 0.03)
    assert y[0] == pytest.approx(v * t - 0.02, abs=1e-4)


def test_a_new_world_is_waited_for_where_y_was() -> None:
    m, x = model((0.01,)), (0.01,)
    m.receive(reported((wall(),)), 0.0, 0.0)
    y = after(m, x, 0.2)
    m.reset(y)
    first = m.step(TICK, x)
    assert abs(first[0] - y[0]) < 0.01 * TICK / 0.005
    assert after(m, x, 0.1) == pytest.approx(x, abs=1e-6)


def test_an_old_answer_drags_and_a_fresh_one_does_not() -> None:
    """1.5 Ns/m at an age of 2 s, which is 0.1 N at 67 mm/s; none below 1 s."""
    for age, wanted in ((0.0, 0.0), (0.7, 0.0), (1.5, 0.75), (4.0, 1.5)):
        m, v = model((0.0,)), 0.05
        for k in range(200):
            m.receive(reported(()), 0.0, age)
            y = m.step(TICK, (v * TICK * k,))
        assert K * (v * TICK * 199 - y[0]) == pytest.approx(wanted * v, rel=0.01, abs=1e-9)


def test_a_swing_without_planes_is_damped_and_the_damping_goes() -> None:
    added = AddedDamping(((K,),), ((1.0 / K,),), 0.0, 5.0)
    velocity = [0.0]
    for k in range(3000):
        t = TICK * k
        x, v = 0.002 * math.sin(38.0 * t), 0.002 * 38.0 * math.cos(38.0 * t)
        damp_swings(added, 1, TICK, (x,), y := [x - 0.3 / K * math.sin(38.0 * t + 1.0)], 0.0)
        damper = K * (y[0] - (x - 0.3 / K * math.sin(38.0 * t + 1.0)))
        velocity.append(-damper * v)
    assert sum(velocity[1000:]) * TICK > 0.8 * 5.0 * (0.002 * 38.0) ** 2 / 2.0 * 2.0  # most of b v^2, on average
    for _ in range(12_000):
        damp_swings(added, 1, TICK, (0.0,), y := [0.01], 0.0)
    assert y == [0.01]
