"""Rigid solids: what contact, friction and the anchored energy owe, from the equations; over bad links too."""

import math
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from hapnet.checks import Array, Vector
from hapnet.errors import InvalidParameter
from hapnet.ext.solids.friction import Friction, FrictionTexture
from hapnet.ext.solids.mesh import Mesh
from hapnet.ext.solids.rigid import RigidScene
from hapnet.ext.solids.rigid_contacts import RigidContacts, Solid
from hapnet.ext.solids.rigid_step import ANCHOR_CEILING_J
from hapnet.ext.solids.secant import Secant
from hapnet.ext.solids.shapes import Cuboid, HalfSpace, Near, Shape, Sphere
from hapnet.params import Params
from hapnet.plant.integrator import PassiveIntegrator
from hapnet.plant.worlds.registry import make_scene
from hapnet.simulation.simulation import Simulation
from tests.conftest import mostly_slow
from tests.metrics.test_contact import random_spd
from tests.support.solids import CENTRE, SHAPES, Account, stair, torus

STEPS_S = [(0.001, 0.001), (0.010, 0.050), (0.100, 0.100)]
MESHES = {"mesh": torus(), "coarse mesh": torus(12, 8), "stair": stair((0.02, -0.01, -0.01))}
BAD_LINKS = [
    "delay 40ms 10ms loss 2%",
    "delay 60ms 20ms distribution normal loss gemodel 1% 20%",
    "delay 20ms loss 20%",
]


def shape_of(name: str) -> Shape:
    return SHAPES[name] if name in SHAPES else Mesh(*MESHES[name])


def pressed(
    shapes: Sequence[Shape],
    friction: float | Friction,
    steps_s: tuple[float, float],
    seed: int,
    *,
    general: bool,
    seconds: float = 2.0,
) -> Account:
    """A proxy that is drawn into the solids and along them, in steps of random lengths; at the end it is drawn out."""
    rng = np.random.default_rng(seed)
    M, B, K = (scale * np.eye(3) for scale in (0.02, 14.0, 500.0))
    if general:
        M, B, K = random_spd(rng, 3, 0.005, 0.2), random_spd(rng, 3, 3.0, 30.0), random_spd(rng, 3, 200.0, 2000.0)
    contacts = RigidContacts([Solid(shape, 3000.0, 10.0, friction) for shape in shapes], 3)
    account = Account(contacts, M, B, K)
    mass = PassiveIntegrator(M, B, K, (0.0, 0.0, 0.0))
    wander = rng.uniform(1.0, 4.0, 2)
    t, force = 0.0, (0.0, 0.0, 0.0)
    while t < seconds:
        dt = rng.uniform(*steps_s)
        t += dt
        goal = (0.033 if t < 0.8 * seconds else -0.01, 0.008 * math.sin(wander[0] * t), 0.008 * math.cos(wander[1] * t))
        before, v0 = np.array(mass.position), np.array(mass.velocity)
        step = mass.step(dt, goal, contacts)
        after, v1, ybar = np.array(step.position), np.array(mass.velocity), np.array(goal)
        kinetic = 0.5 * (v1 @ M @ v1 - v0 @ M @ v0)
        potential = 0.5 * ((after - ybar) @ K @ (after - ybar) - (before - ybar) @ K @ (before - ybar))
        vhat = np.array(step.velocity)
        assert step.work_J == pytest.approx(kinetic + potential + dt * vhat @ B @ vhat, abs=1e-14)  # (13)
        force = step.force
    account.close()
    assert math.hypot(*force) <= 1e-12  # it has been drawn out
    return account


@pytest.mark.parametrize("steps_s", mostly_slow([(one,) for one in STEPS_S], 8), ids=["1 ms", "10 to 50 ms", "100 ms"])
@pytest.mark.parametrize("name", [*SHAPES, *MESHES])
def test_solids_give_no_more_than_they_have(name: str, steps_s: tuple[float, float]) -> None:
    fast = steps_s[0] == 0.001
    for friction, general in [(0.5, False), (0.0, True)] if fast else [(0.0, False), (0.5, False), (0.5, True)]:
        pressed([shape_of(name)], friction, steps_s, int(general), general=general, seconds=0.6 if fast else 2.0)


@pytest.mark.parametrize("examples", mostly_slow([3, 12], 1))
def test_several_solids_at_once(examples: int) -> None:
    @settings(max_examples=examples, deadline=None)
    @given(st.lists(st.sampled_from(sorted(SHAPES)), min_size=2, max_size=4, unique=True), st.integers(0, 2**32 - 1),
           st.sampled_from([0.0, 0.2, 1.5]), st.booleans())  # fmt: skip
    def any_solids(names: list[str], seed: int, friction: float, general: bool) -> None:
        pressed([SHAPES[name] for name in names], friction, (0.005, 0.06), seed, general=general)

    any_solids()


def test_the_force_of_several_solids_is_the_sum_of_what_each_pushes_to_the_last_bit() -> None:
    """So it is one that pushes alone can be, whatever is left of the equations when they count as solved."""
    rng = np.random.default_rng(3)
    corner = [
        Solid(HalfSpace(normal, 0.005), 3000.0, 10.0) for normal in ((1.0, 0.0, 0.0), (0.6, 0.8, 0.0), (0.6, 0.0, 0.8))
    ]
    contacts = RigidContacts(corner, 3)
    M, B, K = random_spd(rng, 3, 0.005, 0.2), random_spd(rng, 3, 3.0, 30.0), random_spd(rng, 3, 200.0, 2000.0)
    mass, several = PassiveIntegrator(M, B, K, (0.0, 0.0, 0.0)), 0
    for _ in range(300):
        step = mass.step(rng.uniform(0.001, 0.05), tuple(rng.uniform(-0.02, 0.05, 3).tolist()), contacts)
        if contacts.touching > 1:
            several += 1
            each = contacts.together
            total = [0.0, 0.0, 0.0]
            for push, normal in zip(each.pushes[: each.count], each.normals, strict=False):
                total = [part + push * along for part, along in zip(total, normal, strict=True)]
            assert list(step.force) == total
    assert several > 100


@pytest.mark.parametrize("steps_s", [(0.010, 0.050), (0.100, 0.100)], ids=["10 to 50 ms", "100 ms"])
def test_a_ripple_is_not_soft_in_long_steps(steps_s: tuple[float, float]) -> None:
    """The hand's spring and the surface's in series: 500 N/m and 3000 N/m over 13 mm; the ripple only adds to it."""
    for friction in (0.0, 0.5):
        account = pressed([SHAPES["ripple"]], friction, steps_s, 0, general=False, seconds=5.0)
        pushes = -np.array(account.forces)[:, 0]
        assert np.mean(pushes[: int(0.7 * len(pushes))]) >= 0.9 * 0.013 / (1.0 / 500.0 + 1.0 / 3000.0)


def test_ripple_and_mesh_do_not_chatter_at_1_ms() -> None:
    """The 95th percentile of the force's steps while it is touched, with friction."""
    for name in ("ripple", "mesh"):
        forces = np.array(pressed([shape_of(name)], 0.5, (0.001, 0.001), 0, general=False).forces)
        jumps = np.linalg.norm(np.diff(forces, axis=0), axis=1)[np.any(forces[1:] != 0.0, axis=1)]
        assert len(jumps) > 1000
        assert np.percentile(jumps, 95) <= 0.2


# -- over bad links, with PSPM ------------------------------------------------------------------------------------


def run_pressed(scene: str, link: str, steps_s: tuple[float, float], seconds: float, **more: object) -> Array:
    """The depths in a simulated run over a bad link, whose account is checked."""
    params = Params().set({
        "scene": scene, "operator": "press", "link.up": link, "link.down": link, "duration_s": seconds,
        "operator_model.goal_m": 0.033, "operator_model.reach_s": 1.5, "operator_model.hold_s": 0.3,
        "device.stiffness": 100.0,
        "world.step_min_s": steps_s[0], "world.step_max_s": steps_s[1], **more,
    })  # fmt: skip
    simulation = Simulation(params, seed=3, kernel=False)
    n = simulation.setup.dof
    account = Account(simulation.setup.scene.contacts, 0.02 * np.eye(n), 14.0 * np.eye(n), 500.0 * np.eye(n))
    result = simulation.run()
    assert result.summary["world"]["ledger"]["slack_J"] >= -1e-9
    assert result.summary["device"]["ledger"]["slack_J"] >= -1e-9
    account.close()
    world = result.recording.world
    assert np.linalg.norm(world["contact_force_N"][-1]) <= 1e-12
    return world["penetration_m"]


def links_for(steps_s: tuple[float, float]) -> list[str]:
    """Steps of 1 ms take long, so they have the worst link only."""
    return BAD_LINKS[1:2] if steps_s[0] < 0.01 else BAD_LINKS


def check_sphere(link: str, steps_s: tuple[float, float], rendering: str) -> None:
    """At rest the springs in series let the proxy 1.1 mm in; the flat wall of theory.md is entered as deep."""
    depth, flat = (run_pressed(scene, link, steps_s, 3.6, rendering=rendering) for scene in ("sphere", "plane"))
    assert 1e-3 < depth.max() <= 1.75e-3
    assert depth.max() == pytest.approx(flat.max(), rel=1e-6)


def test_a_sphere_over_a_bad_link() -> None:
    check_sphere(BAD_LINKS[1], (0.010, 0.050), "hapnet")


@pytest.mark.parametrize(
    ("link", "steps_s", "rendering"),
    mostly_slow(
        [
            (BAD_LINKS[0], STEPS_S[1], "hapnet"), (BAD_LINKS[1], STEPS_S[2], "hapnet"),
            (BAD_LINKS[2], STEPS_S[1], "paper"), (BAD_LINKS[1], STEPS_S[0], "paper"),
            *((link, steps_s, rendering) for steps_s in STEPS_S for link in links_for(steps_s)
              for rendering in ("paper", "hapnet")),
        ],
        0, 4,
    ),
)  # fmt: skip
def test_a_sphere_over_every_bad_link(link: str, steps_s: tuple[float, float], rendering: str) -> None:
    check_sphere(link, steps_s, rendering)


# -- friction, and the anchored energy --------------------------------------------------------------------------------


def dragged(friction: float, pull_N: float, steps: int = 400, dt: float = 0.002) -> tuple[PassiveIntegrator, Array]:
    """A proxy on a floor, pressed with 2 N and pulled along it; the last force of the floor."""
    contacts = RigidContacts([Solid(HalfSpace((0.0, 0.0, -1.0), 0.0), 3000.0, 10.0, friction)], 3)
    mass = PassiveIntegrator(0.02, 5.0, 1e-6, (0.0, 0.0, 0.0))
    for _ in range(steps):
        step = mass.step(dt, (0.0, 0.0, 0.0), contacts, (pull_N, 0.0, -2.0))
    return mass, np.array(step.force) - (pull_N, 0.0, -2.0)


def test_it_slides_against_mu_times_the_normal_force() -> None:
    mass, force = dragged(0.5, 1.6)
    assert force[2] == pytest.approx(2.0, rel=1e-6)
    assert force[0] == pytest.approx(-0.5 * 2.0, rel=1e-6)
    assert mass.velocity[0] == pytest.approx((1.6 - 1.0) / 5.0, rel=1e-4)  # the rest is the damper's


@pytest.mark.parametrize("shapes", [1, 2])
def test_the_floor_pushes_as_its_depth_says_while_a_coupled_mass_rubs(shapes: int) -> None:
    """Friction moves a coupled mass along the normal too: spring and damper of the floor answer where it ends."""
    rng, dt = np.random.default_rng(4), 0.002
    contacts = RigidContacts([Solid(HalfSpace((0.0, 0.0, -1.0), 0.0), 3000.0, 10.0, 0.5)] * shapes, 3)
    mass = PassiveIntegrator(random_spd(rng, 3, 0.01, 0.2), random_spd(rng, 3, 1.0, 30.0), 1e-6, (0.0, 0.0, 0.0))
    pull = np.array([5.0, 2.0, -6.0])
    for k in range(200):
        before = -mass.position[2]
        force = np.array(mass.step(dt, (0.0, 0.0, 0.0), contacts, tuple(pull)).force) - pull
        after = -mass.position[2]
        if k > 20:
            normal = 3000.0 * 0.5 * (before + after) + 10.0 * (after - before) / dt
            assert force[2] == pytest.approx(shapes * normal, rel=1e-6)
            assert math.hypot(*force[:2]) == pytest.approx(0.5 * force[2], rel=0.05)  # of a first solution


def test_friction_that_varies_is_that_of_the_place() -> None:
    """Sliding along x: mu N with mu = 0.5 (1 + 0.9/3 (sin kx + sin kz)); y is 0."""
    wave = 2.0 * math.pi / 0.008
    material = make_scene("plane?normal=0,0,-1&at=0,0,0&stiffness=1e6&friction=0.5&texture=0.9,8mm").contacts
    mass = PassiveIntegrator(0.02, 5.0, 1e-6, (0.0, 0.0, 0.0))
    felt, owed = [], []
    for k in range(2000):
        x, _, z = mass.position
        force = mass.step(0.001, (0.0, 0.0, 0.0), material, (1.7, 0.0, -2.0)).force
        if k > 100:
            felt.append(1.7 - force[0])
            owed.append((force[2] + 2.0) * 0.5 * (1.0 + 0.3 * (math.sin(wave * x) + math.sin(wave * z))))
    assert felt == pytest.approx(owed, rel=1e-9)
    assert min(felt) < 0.71
    assert max(felt) > 1.29


def mad(place: Vector) -> float:
    """A friction of no sense: negative, not a number or infinite from one place to the next."""
    return (-3.0, 0.6, math.nan, math.inf)[int(1e4 * abs(place[1])) % 4]


@pytest.mark.parametrize("steps_s", mostly_slow([(one,) for one in reversed(STEPS_S)], 2))
@pytest.mark.parametrize("friction", [FrictionTexture(0.5, 1.0, 0.003), mad], ids=["texture", "mad"])
def test_friction_that_varies_is_passive(friction: Friction, steps_s: tuple[float, float]) -> None:
    for general in (False, True):
        seconds = 0.6 if steps_s[0] == 0.001 else 2.0
        pressed([SHAPES["rough sphere"]], friction, steps_s, 5, general=general, seconds=seconds)
    pressed([SHAPES["sphere"], SHAPES["bar"]], friction, steps_s, 5, general=True, seconds=0.3)


def test_it_sticks_below_that() -> None:
    mass, force = dragged(0.5, 0.9)
    assert force[0] == pytest.approx(-0.9, rel=0.01)
    assert abs(mass.velocity[0]) < 2e-3 * 0.9 / 5.0  # it creeps by a thousandth of what it would slide


class Growing(Sphere):
    """A sphere that swells by 0.1 mm whenever it is asked about a new place, which no energy is paid for."""

    def near(self, position: Vector) -> Near:
        self.radius += 1e-4
        return super().near(position)


def test_what_the_energy_is_not_there_for_is_not_stored() -> None:
    """The surface comes nearer in every step, and nothing works on it: it must not throw the proxy out."""
    contacts = RigidContacts([Solid(Growing(CENTRE, 0.028), 3000.0, 10.0)], 3)
    account = Account(contacts, *(scale * np.eye(3) for scale in (0.02, 14.0, 500.0)))
    mass = PassiveIntegrator(0.02, 14.0, 500.0, (0.0, 0.0, 0.0))
    scales = []
    for _ in range(100):
        mass.step(0.01, (0.024, 0.0, 0.0), contacts)
        scales.append(contacts.scale)
    account.close()
    assert min(scales) < 0.9


def test_the_anchor_keeps_no_more_than_its_ceiling() -> None:
    account = pressed([SHAPES["plane"]], 0.5, (0.001, 0.001), 0, general=False)
    contacts = account.contacts
    assert account.work_J > 3.0 * ANCHOR_CEILING_J
    assert contacts.stored_J((0.0,) * 3) == pytest.approx(ANCHOR_CEILING_J)


# -- thin solids, and what is beyond the middle ------------------------------------------------------------------------


@pytest.mark.parametrize("dt", [0.001, 0.03, 0.1])
def test_a_thin_plate_is_not_pressed_through(dt: float) -> None:
    """1 mm thick, pressed 2.9 mm deep: the back is nearer then, but the front pushes."""
    contacts = RigidContacts([Solid(Cuboid((0.0205, 0.0, 0.0), (0.001, 0.1, 0.1)))], 3)
    mass = PassiveIntegrator(0.02, 14.0, 500.0, (0.0, 0.0, 0.0))
    for k in range(round(2.0 / dt)):
        step = mass.step(dt, (0.02 + 0.02 * min(1.0, k * dt), 0.005 * math.sin(3.0 * k * dt), 0.0), contacts)
    rings = 6e-4 if dt == 0.1 else 5e-5  # the midpoint rule lets a stiff spring ring in long steps
    assert step.position[0] == pytest.approx(0.02 + 500.0 * 0.02 / 3500.0, abs=rings)
    assert step.penetration_m == pytest.approx(step.position[0] - 0.02)
    for _ in range(round(1.0 / dt)):
        step = mass.step(dt, (0.0, 0.0, 0.0), contacts)
    assert step.force == (0.0, 0.0, 0.0)
    assert step.position[0] < 0.02


def test_a_long_step_does_not_jump_through() -> None:
    """The sphere's and the plate's far side is outside, too: 60 mm in one step."""
    for shape in (Sphere(CENTRE, 0.01), Cuboid(CENTRE, (0.001, 0.1, 0.1))):
        contacts = RigidContacts([Solid(shape)], 3)
        mass = PassiveIntegrator(0.02, 14.0, 500.0, (0.0, 0.0, 0.0))
        for _ in range(40):
            step = mass.step(0.1, (0.1, 0.0, 0.0), contacts)
        front = 0.04 if isinstance(shape, Sphere) else 0.0495
        assert step.position[0] == pytest.approx(front + 500.0 * (0.1 - front) / 3500.0, abs=2e-3)


# -- what the device receives ------------------------------------------------------------------------------------------


def test_the_plane_is_the_tangent_at_the_nearest_point() -> None:
    contacts = RigidContacts([Solid(Sphere(CENTRE, 0.03), 2000.0, 7.0), Solid(HalfSpace((0.0, 0.0, -1.0), 0.04))], 3)
    place = (0.05 - 0.035 * 0.6, 0.0, 0.035 * 0.8)
    plane, floor = contacts.planes(place, 0.1)
    assert plane.normal == pytest.approx((0.6, 0.0, -0.8))
    assert plane.offset_m == pytest.approx(0.6 * (0.05 - 0.03 * 0.6) - 0.8 * 0.03 * 0.8)
    assert plane[2:5] == (2000.0, 7.0, 0.0)
    assert floor.normal == (0.0, 0.0, -1.0)
    assert contacts.planes(place, 0.006) == (plane,)
    assert contacts.planes(place, 0.004) == ()
    assert contacts.plane(place) is None
    assert contacts.plane((0.022, 0.0, 0.0)) == contacts.planes((0.022, 0.0, 0.0), 0.0)[0]


def test_friction_that_varies_is_seen_as_it_is_at_that_place() -> None:
    varied, rubs = RigidContacts([Solid(Sphere(CENTRE, 0.03), friction=lambda x: 5.0 * x[2])], 3), []
    mass = PassiveIntegrator(0.02, 14.0, 500.0, (0.0, 0.0, 0.0))
    for height in (0.01, 0.02, -0.01):
        rubs += [plane.friction for plane in varied.planes((0.02, 0.0, height), 0.1)]
        mass.step(0.1, (0.04, 0.0, height), varied)
    assert rubs == pytest.approx([0.05, 0.1, 0.0])
    (plane,) = RigidContacts([Solid(Sphere(CENTRE, 0.03), friction=0.2)], 3).planes((0.02, 0.0, 0.01), 0.1)
    assert plane.friction == 0.2


def test_with_fewer_axes_a_solid_is_cut() -> None:
    """A disc in the plane: the same steps as a ball that is pressed in its equator."""
    steps = []
    for dof in (1, 2, 3):
        contacts = RigidContacts([Solid(Sphere(CENTRE, 0.03), friction=0.3)], dof)
        mass = PassiveIntegrator(0.02, 14.0, 500.0, (0.0,) * dof)
        for k in range(100):
            goal = (0.03, 0.01 * math.sin(0.1 * k) if dof > 1 else 0.0, 0.0)[:dof]
            step = mass.step(0.01, goal, contacts)
        steps.append(step)
    one, disc, ball = steps
    assert disc.position == pytest.approx(ball.position[:2], abs=1e-12)
    assert ball.position[2] == 0.0
    assert one.position[0] == pytest.approx(0.02 + 0.01 * 500.0 / 3500.0, rel=1e-3)


def test_a_scene_needs_a_free_start() -> None:
    with pytest.raises(InvalidParameter, match=r"outside all solids .* number 2"):
        RigidScene("two", 3, [Solid(SHAPES["plane"]), Solid(Sphere((0.0, 0.0, 0.01), 0.02))])
    with pytest.raises(InvalidParameter, match="solids"):
        RigidScene("none", 3, [])
    scene = make_scene("sphere + plane?at=40mm,0mm,0mm")
    assert scene.towards((0.01, 0.0, 0.0)) == (0.01, 0.0, 0.0)
    assert scene.towards((0.1, 0.0, 0.0)) == pytest.approx((0.02, 0.0, 0.0), abs=1e-4)
    assert scene.contacts.penetration(scene.towards((0.1, 0.0, 0.0))) == 0.0


@pytest.mark.parametrize("aside", [0.0, 0.01, 0.02])
def test_a_step_through_a_ball_meets_the_plane_where_it_goes_in(aside: float) -> None:
    """The ray and the sphere, by Pythagoras; the way in is found to a hundredth of the step."""
    secant = Secant(Sphere(CENTRE, 0.03), 3000.0, 10.0, 0.0)
    assert secant.meets((0.0, 0.0, aside), (0.12, 0.0, 0.0), 0.12)
    normal = math.sqrt(0.03**2 - aside**2) / 0.03, 0.0, -aside / 0.03
    assert secant.normal == pytest.approx(normal, abs=0.04)
