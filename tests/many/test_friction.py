"""Friction of hands at blocks, and of blocks at blocks: beside Coulomb's law, and a method of the test's own."""

from math import hypot
from typing import Any

import numpy as np
import pytest

from hapnet.checks import Vector
from hapnet.ext.many.blocks import Block, Blocks
from hapnet.ext.many.graph import graph_of
from hapnet.ext.many.run import GraphSimulation
from hapnet.ext.many.shared import Seat
from hapnet.plant.operator import Impedance
from tests.many.test_blocks import thrown
from tests.many.test_carrying import assert_credit, assert_every_account
from tests.support.carrying_hands import smooth
from tests.support.pushed_blocks import DAMPING, STIFFNESS, Proxy, dissipated_J, pushed, row
from tests.support.rubbing_blocks import RubBench

pytestmark = pytest.mark.long  # whole runs of several pairs, or many steps

G = 9.81
TABLE = Block((0.0, 0.0, -0.04), (0.5, 0.5, 0.01), 0.0, 0.0, 0.0)
STEPS_S = [1e-3, 1e-2, 5e-2]


@pytest.mark.parametrize(("blocks", "proxies"), [(1, 1), (1, 6), (2, 2), (3, 6)])
def test_every_step_is_what_another_method_finds(blocks: int, proxies: int) -> None:
    """Blocks in a row, pressed and rubbed from all sides, in steps of 1 to 100 ms."""
    slid = stuck = 0
    for seed in range(8):
        rng = np.random.default_rng([blocks, proxies, seed, 4])
        plain = row(rng, blocks, proxies)
        made = [
            b._replace(friction=float(rng.uniform(0.0, 1.0)), gravity=float(rng.choice([0.0, 1.0])))
            for b in plain.blocks
        ]
        bench = RubBench(plain.proxies, made, plain.faces)
        bench.world.v = plain.world.v
        for _ in range(10):
            dt, speeds = float(10.0 ** rng.uniform(-3.0, -1.0)), np.array(bench.world.v)
            expected = bench.solved(dt)
            forces, means = pushed(bench.world, bench.proxies, dt)
            found = np.vstack([means, 0.5 * (speeds + np.array(bench.world.v))])
            assert found == pytest.approx(expected, rel=1e-7, abs=1e-7)
            for k, force in enumerate(forces):
                axis = next(axis for (one, _), (axis, _) in bench.faces.items() if one == k)
                push, rub = abs(force[axis]), float(np.linalg.norm(np.delete(force, axis)))
                most = max((bench.mu(pair) for pair in bench.faces if pair[0] == k), default=0.0) * push
                assert rub <= most + 1e-9
                slid += int(push > 0.01 and rub > 0.999 * most > 0.0)
                stuck += int(push > 0.01 and rub < 0.99 * most)
    assert slid > 20
    assert stuck > 10


def test_friction_and_weight_give_out_no_energy_whatever_is_thrown_at_blocks() -> None:
    dropped = 0.0
    for seed in range(40):
        rng = np.random.default_rng([seed, 5])
        plain, hands = thrown(rng, 1 + seed % 3, 6)
        made = [
            b._replace(friction=float(rng.uniform(0.0, 2.0)), gravity=float(rng.choice([0.0, G]))) for b in plain.blocks
        ]
        world = Blocks(made, STIFFNESS, DAMPING)
        world.v = plain.v
        dropped += dissipated_J(world, hands, (10.0 ** rng.uniform(-3.0, -1.0, 40)).tolist(), 1e-12)
    assert dropped > 1.0


def on_a_table(dt: float, friction: float, mass_kg: float = 0.2) -> Blocks:
    """A cube that has come to rest on a fixed table."""
    block = Block((0.0, 0.0, 0.0), (0.03,) * 3, mass_kg, 0.0, 0.0, friction=friction, gravity=G)
    world = Blocks([block, TABLE], STIFFNESS, DAMPING)
    for _ in range(round(5.0 / dt)):
        world.solve(dt, {})
    assert world.x[0] == pytest.approx((0.0, 0.0, -mass_kg * G / STIFFNESS), abs=1e-8)
    return world


@pytest.mark.parametrize("dt", STEPS_S)
def test_a_block_that_slides_comes_to_rest_where_coulombs_law_says(dt: float) -> None:
    """After v^2/(2 mu g), in the direction of its velocity; to the way of a step and the springs of the contacts."""
    world, v = on_a_table(dt, 0.5), (1.0, 0.5)
    world.v[0] = (*v, 0.0)
    for _ in range(round(2.0 / dt)):
        world.solve(dt, {})
    way = np.array(world.x[0][:2])
    assert np.hypot(*way) == pytest.approx(np.dot(v, v) / (2.0 * 0.5 * G), rel=0.015)
    assert way[0] / way[1] == pytest.approx(2.0, rel=1e-6)
    assert hypot(*world.v[0]) < 2e-3


@pytest.mark.parametrize("dt", STEPS_S)
def test_a_hand_that_slides_along_a_fixed_block_feels_mu_times_its_push(dt: float) -> None:
    world = Blocks([Block((0.0, 0.0, 0.0), (0.03, 0.5, 0.5), 0.0, 0.0, 0.0, friction=0.4)], STIFFNESS, DAMPING)
    hand = Proxy(np.array([-0.031, -0.1, 0.0]), np.zeros(3), np.zeros(3), damping=5.0)
    for k in range(round(1.5 / dt)):
        hand.place = np.array([-0.025, -0.1 + 0.1 * k * dt, 0.05 * k * dt])
        forces, _ = pushed(world, [hand], dt)
    push, rub = forces[0][0], forces[0][1:]
    assert push < -1.0
    assert np.linalg.norm(rub) == pytest.approx(0.4 * -push, rel=0.01)
    assert rub[0] / rub[1] == pytest.approx(2.0, rel=0.01)
    assert rub[0] < 0.0


def pulled(share: float, dt: float, seconds: float) -> list[float]:
    """The places of a block on a table that a hand pushes along x with a force that rises to this share of mu m g in a
    second [m].

    A soft spring to a far place is a force that hardly depends on the place.
    """
    world, mu, mass = on_a_table(dt, 0.5), 0.5, 0.2
    force = share * mu * mass * G
    hand = Proxy(
        np.array([-0.0301, 0.0, 0.0]),
        np.zeros(3),
        np.zeros(3),
        stiffness=0.01,
        damping=1.0,
    )
    places = []
    for k in range(round(seconds / dt)):
        hand.place[0] = -0.03 + smooth(k * dt) * force / 0.01
        pushed(world, [hand], dt)
        places.append(world.x[0][0])
    return places


@pytest.mark.parametrize("dt", [0.01, 0.05])
def test_a_block_is_held_for_a_minute_at_95_percent_of_friction_and_does_not_creep(dt: float) -> None:
    """It gives way by the spring of its contact, mu N/K, and stays."""
    places = pulled(0.95, dt, 65.0)
    assert places[-1] == pytest.approx(0.95 * 0.5 * 0.2 * G / STIFFNESS, rel=1e-3)
    assert abs(places[-1] - places[round(5.0 / dt)]) < 1e-9


def test_a_block_that_is_pushed_with_more_than_friction_slides() -> None:
    """At 1.05 mu N it gains 5 % of mu g, less the damper of the hand: more than 10 mm in a second."""
    assert pulled(1.05, 0.01, 2.0)[-1] > 0.01


def lifted(mass_kg: float, mu: float, squeeze_N: float, dt: float) -> tuple[float, float]:
    """By how much two hands lift a block that they squeeze [m], and how much they put in beyond what is stored [J]."""
    world = on_a_table(dt, mu, mass_kg)
    hands = [
        Proxy(np.array([side * 0.0305, 0.0, 0.0]), np.zeros(3), np.zeros(3), 0.1, 1.0, 3.0) for side in (-1.0, 1.0)
    ]
    start, work = world.stored_J({}), 0.0
    for k in range(round(5.0 / dt)):
        up = 0.05 * smooth((k * dt - 1.0) / 2.0)
        for hand, side in zip(hands, (-1.0, 1.0), strict=True):  # 1 N/m: a constant squeeze, and 200 N/m upwards
            hand.place = np.array([hand.x[0] - side * squeeze_N, 0.0, hand.x[2] + 200.0 * (up - hand.x[2])])
        forces, means = pushed(world, hands, dt)
        work -= dt * float(np.sum(forces * means))
    slack = work - (world.stored_J({k: tuple(hand.x) for k, hand in enumerate(hands)}) - start)
    return world.x[0][2], slack


@pytest.mark.parametrize("dt", [0.01, 0.03])
@pytest.mark.parametrize("share", [0.97, 1.03])
def test_two_hands_lift_a_block_if_its_weight_is_below_twice_mu_times_their_push(share: float, dt: float) -> None:
    mu, squeeze_N = 0.5, 1.5
    height, slack = lifted(share * 2.0 * mu * squeeze_N / G, mu, squeeze_N, dt)
    assert (height > 0.03) is (share < 1.0)
    assert slack >= -1e-12
    if share > 1.0:
        assert height < 1e-3


class Lifter:
    """Comes to its side of a cube of 60 mm, presses it, and from 2 s on lifts it by 40 mm. side : along x."""

    def __init__(self, side: float) -> None:
        self.impedance = Impedance()
        self._side = side

    def reference(self, t: float) -> Vector:
        """x_d [m] at `t` [s]."""
        return -self._side * 0.042 * smooth((t - 0.3) / 1.0), 0.0, 0.04 * smooth((t - 2.0) / 1.5)


def lifted_over(link: str, block: str, duration_s: float, *, table: str, up_m: float) -> tuple[Seat, dict[str, Any]]:
    """Two hands lift a block of 60 g from a fixed one, at this place: each pair and the world keep their accounts.

    block : more properties. up_m : at which height the hands begin. Returns a seat and the summary of the world.
    """
    lifts = f"block?mass=0.06&friction=0.8&gravity=9.81&spring=0&at=0,0,0&{block}"
    graph: dict[str, Any] = {
        "duration_s": duration_s,
        "nodes": {
            "table": {"kind": "world", "scene": f"shared:{lifts} + block?mass=0&size=400mm,400mm,20mm&at={table}"},
            "left": {"kind": "device"},
            "right": {"kind": "device"},
        },
        "edges": [
            {"from": name, "to": "table", "link": link, "at": [side * 0.06, 0, up_m]}
            for name, side in (("left", -1.0), ("right", 1.0))
        ],
    }
    run = GraphSimulation(graph_of(graph), hands={"left": Lifter(-1.0), "right": Lifter(1.0)})
    result = run.run(lambda _: assert_credit(run))
    assert_every_account(run, result)
    seat = run.pairs["left-table"].world.scene
    assert isinstance(seat, Seat)
    return seat, result.summary["nodes"]["table"]


@pytest.mark.parametrize("link", ["delay 40ms 10ms loss 2%", "delay 100ms 30ms loss 10%"])
def test_two_hands_lift_a_block_over_a_link(link: str) -> None:
    seat, world = lifted_over(link, "drag=0", 5.0, table="0,0,-40mm", up_m=0)
    assert seat.shared.blocks.x[0] == pytest.approx((0.0, 0.0, 0.04), abs=0.006)
    stored = world["environment"]["env_stored_J"]
    assert stored > 0.9 * 0.06 * G * seat.shared.blocks.x[0][2]  # its weight, above where it stood


def test_without_friction_hands_slip_off() -> None:
    world = on_a_table(0.01, 0.0)
    hands = [
        Proxy(np.array([side * 0.0305, 0.0, 0.0]), np.zeros(3), np.array([side * 0.02, 0.0, 0.01]))
        for side in (-1.0, 1.0)
    ]
    for _ in range(300):
        forces, _ = pushed(world, hands, 0.01)
    assert abs(forces[0][0]) > 1.0
    assert world.x[0][2] < 0.0
