"""Several hands in one MuJoCo model: what they carry, and every account beside the test's own sums."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapnet.checks import Array, Vector
from hapnet.errors import InvalidParameter
from hapnet.ext.engines.engine_world import EngineMass, EngineWorld
from hapnet.ext.engines.joint import HandsAccount, MujocoHands
from hapnet.ext.engines.mujoco_engine import MujocoEngine
from hapnet.ext.engines.mujoco_model import HandProxy
from hapnet.ext.many.graph import graph_of
from hapnet.ext.many.models import ModelSeat, SharedModel
from hapnet.ext.many.run import GraphSimulation
from hapnet.plant.operator import Impedance
from hapnet.plant.worlds.scene import Scene
from tests.conftest import ROOT
from tests.many.test_carrying import assert_credit, assert_every_account
from tests.support.carrying_hands import smooth
from tests.support.mujoco_models import BALL, BOX, DOOR, model

pytestmark = pytest.mark.long  # whole runs of several pairs, or many steps

mujoco = pytest.importorskip("mujoco")

CARRIED = f"mujoco:{ROOT / 'examples' / 'graphs' / 'carried_box.xml'}"
LINK = "delay 40ms 10ms loss 2%"
WEIGHT_N = 0.05 * 9.81
"""Of the box in that model."""


class Lifter:
    """Comes to its side of the box, presses it, and from 2 s on lifts it by 40 mm. side : along x."""

    def __init__(self, side: float) -> None:
        self.impedance = Impedance()
        self._side = side

    def reference(self, t: float) -> Vector:
        """x_d [m] at `t` [s]."""
        return -self._side * 0.038 * smooth((t - 0.3) / 1.0), 0.0, 0.04 * smooth((t - 2.0) / 1.5)


def lifting(step_s: tuple[float, float], duration_s: float) -> GraphSimulation:
    world = {"step_min_s": step_s[0], "step_max_s": step_s[1]}
    scene = f"{CARRIED}?proxy=left,right"
    table: dict[str, Any] = {
        "duration_s": duration_s,
        "nodes": {
            "table": {"kind": "world", "scene": scene, "dof": 3, "world": world},
            "left": {"kind": "device"},
            "right": {"kind": "device"},
        },
        "edges": [{"from": name, "to": "table", "link": LINK} for name in ("left", "right")],
    }
    return GraphSimulation(graph_of(table), hands={"left": Lifter(-1.0), "right": Lifter(1.0)})


def engine_of(run: GraphSimulation) -> MujocoHands:
    seat = next(iter(run.pairs.values())).world.scene
    assert isinstance(seat, ModelSeat)
    return seat.shared.engine


def energy_J(engine: MujocoHands) -> float:
    """Of the box and the pads, from their velocities and the box's height: the pads have no weight."""
    found = engine.found
    mass = np.zeros((found.model.nv, found.model.nv))
    mujoco.mj_fullM(found.model, found.data, mass)
    return float(0.5 * found.data.qvel @ mass @ found.data.qvel + WEIGHT_N * found.data.body("box").xpos[2])


@pytest.mark.long
def test_two_hands_lift_a_box_and_the_account_is_the_tests_own_sum() -> None:
    """With one substep in each step a hand's work is the recorded force times the recorded way."""
    run = lifting((0.002, 0.002), 4.0)
    engine, start_J = engine_of(run), energy_J(engine_of(run))
    result = run.run(lambda _: assert_credit(run))
    assert_every_account(run, result)
    assert float(engine.found.data.body("box").xpos[2]) == pytest.approx(0.07, abs=0.004)
    work = 0.0
    for pair in result.pairs.values():
        columns = pair.recording.world
        assert columns is not None
        own = -float(np.sum(columns["coupling_force_N"][1:] * np.diff(columns["position_m"], axis=0)))
        assert abs(own) > 5e-3
        assert columns["work_J"][-1] - columns["work_J"][0] == pytest.approx(own, rel=1e-6)
        work += own
    counted = result.summary["nodes"]["table"]["environment"]
    assert counted["work_J"] == pytest.approx(work, rel=1e-6)
    assert counted["env_stored_J"] == pytest.approx(energy_J(engine), rel=1e-9)
    assert -work > energy_J(engine) - start_J > 0.9 * WEIGHT_N * 0.04  # they lifted it, and friction took the rest
    seat = run.pairs["left-table"].world.scene
    assert isinstance(seat, ModelSeat)
    account = seat.shared.account
    assert account.stored_J - account.start_J == pytest.approx(energy_J(engine) - start_J, rel=1e-6)


def test_two_hands_lift_a_box_with_slow_steps() -> None:
    run = lifting((0.01, 0.05), 4.0)
    result = run.run(lambda _: assert_credit(run))
    assert_every_account(run, result)
    box = engine_of(run).found.data.body("box").xpos
    assert box.tolist() == pytest.approx([0.0, 0.0, 0.07], abs=0.004)


def scripted(t: float) -> Vector:
    return 0.05 * np.sin(4.0 * t), 0.02 * np.sin(3.0 * t), 0.015 * (np.cos(2.0 * t) - 1.0)


@pytest.mark.parametrize(
    ("content", "query", "held"),
    [(BOX, "?at=0,0,0.03&radius=0.01", HandProxy(at=(0.0, 0.0, 0.03))), (DOOR, "?proxy=handle", HandProxy("handle"))],
)
def test_one_hand_alone_moves_as_in_a_world_for_one_hand(
    tmp_path: Path, content: str, query: str, held: HandProxy
) -> None:
    scene = model(tmp_path / "m.xml", content) + query
    single = EngineWorld(MujocoEngine(scene, 3))
    shared = SharedModel(MujocoHands(scene, 3, [held]), scene)
    seat = ModelSeat(shared, scene, Scene("m", 1, ()))
    one, other = single.proxy(0.02, 14.0, 500.0), seat.proxy(0.02, 14.0, 500.0)
    assert isinstance(one, EngineMass)
    rng, t = np.random.default_rng(3), 0.0
    for _ in range(150):
        dt = float(rng.uniform(0.01, 0.05))
        t += dt
        for mass in (one, other):
            mass.limit_energy(0.05)
        assert other.step(dt, scripted(t)) == one.step(dt, scripted(t))
        assert (other.position, other.velocity) == (one.position, one.velocity)
        assert seat.contact_force == single.contact_force
        assert seat.stored_J(()) == single.stored_J(())


def pushed(tmp_path: Path, hands: int) -> Array:
    """The recorded positions of the first of so many hands, each with a sphere and a box of its own, 1 m apart."""
    boxes = BOX + BOX.replace('name="box" pos="0.03', 'name="more" pos="1.03')
    names = "ab"[:hands]
    table: dict[str, Any] = {
        "duration_s": 2.0,
        "nodes": {
            **{name: {"kind": "device", "operator": "press"} for name in names},
            "table": {"kind": "world", "scene": model(tmp_path / "m.xml", boxes), "dof": 3},
        },
        "edges": [{"from": name, "to": "table", "link": "lan", "at": [k, 0, 0.02]} for k, name in enumerate(names)],
    }
    run = GraphSimulation(graph_of(table), seed=3)
    columns = run.run().pairs["a-table"].recording.world
    assert columns is not None
    if hands > 1:
        ways = [float(engine_of(run).found.data.body(name).xpos[0]) - x for name, x in (("box", 0.03), ("more", 1.03))]
        assert ways[0] > 0.01
        assert ways[1] == pytest.approx(ways[0], abs=2e-3)
    positions: Array = columns["position_m"]
    return positions


def test_two_hands_far_from_each_other_are_two_pairs(tmp_path: Path) -> None:
    alone, together = (pushed(tmp_path, hands) for hands in (1, 2))
    assert together == pytest.approx(alone, rel=0.0, abs=1e-6)


ROD = (
    '<body name="rod" gravcomp="1" pos="0 0 0.3"><joint type="slide" axis="1 0 0"/>'
    '<geom type="box" size="0.1 0.01 0.01" mass="0.02"/>'
    '<site name="one" pos="-0.1 0 0"/><site name="two" pos="0.1 0 0"/><site name="three"/></body>'
)


def seats(tmp_path: Path, content: str, *held: HandProxy, **options: str) -> list[ModelSeat]:
    """A seat for each of these proxies, on a coupling with B' = 14 Ns/m and K' = 500 N/m."""
    scene = model(tmp_path / "m.xml", content, **options)
    shared, steps = SharedModel(MujocoHands(scene, 3, held), scene), Scene("m", 1, ())
    made = [ModelSeat(shared, scene, steps) for _ in held]
    for seat in made:
        seat.proxy(0.02, 14.0, 500.0)
    return made


def test_three_hands_at_one_light_body_hold_it_between_them(tmp_path: Path) -> None:
    """Each spring is stiff for 20 g at 4 ms. Rest is where the three equal springs balance: the mean."""
    hands = seats(tmp_path, ROD, HandProxy("one"), HandProxy("two"), HandProxy("three"))
    shared, aims = hands[0].shared, (0.03, -0.01, 0.01)
    for _ in range(40):
        shared.begin_step(0.03, {seat: (aim, 0.0, 0.0) for seat, aim in zip(hands, aims, strict=True)})
        done = [shared.step_of(seat, 0.03, ()) for seat in hands]
    assert shared.observed.undone == 0
    for step, aim in zip(done, aims, strict=True):
        assert step.position[0] == pytest.approx(0.01, abs=1e-6)
        assert step.coupling_force[0] == pytest.approx(500.0 * (aim - 0.01), abs=1e-3)


def test_a_hand_that_is_not_here_lets_go(tmp_path: Path) -> None:
    """The other one takes the rod to its own place; the spring of the first stores what its length says."""
    one, two = seats(tmp_path, ROD, HandProxy("one"), HandProxy("two"))
    shared, aims = one.shared, {one: (0.0, 0.0, 0.0), two: (0.02, 0.0, 0.0)}
    one.is_here = False
    harvested = 0.0
    for _ in range(40):
        shared.begin_step(0.03, aims)  # type: ignore[arg-type]  # a seat's own class
        step = shared.step_of(one, 0.03, ())
        assert step.coupling_force == (0.0, 0.0, 0.0)
        harvested += step.dissipated_J
        shared.step_of(two, 0.03, ())
    assert one.mass.position[0] == pytest.approx(0.02, abs=1e-6)
    assert harvested == pytest.approx(-0.5 * 500.0 * 0.02**2, rel=1e-4)


def test_the_force_of_a_hand_without_energy_is_left_out_and_those_of_others_act(tmp_path: Path) -> None:
    engine = MujocoHands(model(tmp_path / "m.xml", ROD), 3, [HandProxy("one"), HandProxy("two")])
    account = HandsAccount(engine, "rod")
    force, works = account.joint_substep(0.004, (1.0, 0.0, 0.0, 2.0, 0.0, 0.0), [0.0, 1.0])
    assert force == (0.0, 0.0, 0.0, 2.0, 0.0, 0.0)
    way = 0.004 * 0.004 * 2.0 / 0.02  # semi-implicit Euler: h v, with v = h F/m
    assert works == pytest.approx([0.0, 2.0 * way], rel=1e-9)
    assert account.observed.undone == 1


def test_what_an_active_model_gives_out_is_paid_by_damping(tmp_path: Path) -> None:
    """A ball that would bounce higher and higher, between two hands."""
    ball = BALL.replace('pos="-0.2 0 0.1"', 'pos="0 0 0.1"')
    held = HandProxy(at=(-0.1, 0.0, 0.1)), HandProxy(at=(0.1, 0.0, 0.1))
    hands = seats(tmp_path, ball, *held, solref="-20000 -1", option='timestep="0.004" integrator="Euler"')
    shared, work = hands[0].shared, 0.0
    start_J = shared.stored_J
    for k in range(300):
        goals = (0.07 * np.sin(0.05 * k), 0.0, 0.0), (-0.07 * np.sin(0.05 * k), 0.0, 0.0)
        shared.begin_step(0.02, dict(zip(hands, goals, strict=True)))
        for seat in hands:
            work -= shared.step_of(seat, 0.02, ()).work_J
        assert work - (shared.stored_J - start_J) >= -1e-12
    assert shared.observed.given_J > 1e-3
    assert shared.observed.paid_J == pytest.approx(shared.observed.given_J, rel=1e-6)


def test_spheres_that_overlap_at_the_start_are_refused(tmp_path: Path) -> None:
    scene = model(tmp_path / "m.xml", BOX)
    at = ([0.0, 0.0, 0.2], [0.0, 0.009, 0.2])
    table = {
        "nodes": {"a": {"kind": "device"}, "b": {"kind": "device"}, "t": {"kind": "world", "scene": scene}},
        "edges": [{"from": name, "to": "t", "at": place} for name, place in zip("ab", at, strict=True)],
    }
    with pytest.raises(InvalidParameter, match=r"edges\.b-t\.at is \[0\.0, 0\.009, 0\.2\]; allowed: .* 0\.01 m .*a-t"):
        GraphSimulation(graph_of(table))
