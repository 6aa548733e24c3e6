"""Four hands hold a block; one device after another is killed in contact, and comes back into its seat."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from hapnet.ext.many.graph import graph_of
from hapnet.ext.many.run import GraphSimulation
from hapnet.records.record import NEVER
from tests.support.carrying_hands import Carrier
from tests.support.restarted_devices import Device

LINK, ROUND_TRIP_S = "delay 40ms 10ms loss 2%", 0.08
STEPS = {"step_min_s": 0.01, "step_max_s": 0.05}
GONE_S, BACK_S = 0.9, 0.7
STEP_LIMIT_N, OWN_MOTION_N = 0.5, 0.1
"""`device.step_limit_N`, and what a hand's own motion adds to it in a tick: 0.15 m/s times 600 N/m times 1 ms."""


class Seen(NamedTuple):
    """The largest step of the force that a device that was not killed rendered in a tick [N], the times from each start
    to the first set-position that the world used [s], the devices, and the run, which may go on."""

    step: float
    back_s: list[float]
    devices: list[Device]
    simulation: GraphSimulation


def run(
    kills: int,
    seed: int = 0,
    seen: Callable[[GraphSimulation], None] = lambda _: None,
    scene: str = "shared:block?at=0,0,0",
    **of_world: object,
) -> Seen:
    """Four hands hold a body, and `kills` devices are killed and come back, one after the other.

    seen : called with the run before it begins. of_world : parameters of the world.
    """
    rng = np.random.default_rng(seed)
    faces = ((0, -1.0), (0, 1.0), (1, -1.0), (1, 1.0))
    hands = {f"hand{number}": Carrier(*face) for number, face in enumerate(faces)}
    world = {"kind": "world", "scene": scene, "world": {**STEPS, **of_world}}
    nodes = {name: {"kind": "device", "operator": "rest"} for name in hands}
    edges = [{"from": name, "to": "table", "link": LINK, "at": hand.at} for name, hand in hands.items()]
    simulation = GraphSimulation(graph_of({"nodes": {**nodes, "table": world}, "edges": edges}), seed, hands=hands)
    devices = [Device(simulation, f"{name}-table") for name in hands]
    seen(simulation)
    simulation._run(10**10, lambda: all(pair.started for pair in simulation.pairs.values()))
    held: list[np.ndarray | None] = [None] * len(devices)
    largest, back_s = 0.0, []

    def go_on(until_ns: int) -> None:
        nonlocal largest
        while simulation.now_ns < until_ns:
            simulation._reach(min(until_ns, simulation.now_ns + 1_000_000))
            for number, device in enumerate(devices):
                side = device.pair.device
                renders = device.pair.clock.tick_ns != NEVER and side.origin_ns is not None
                force = np.array(side.servo.force) if renders else None
                if force is not None and held[number] is not None:
                    largest = max(largest, float(np.linalg.norm(force - held[number])))
                held[number] = force

    go_on(3_000_000_000)
    for _ in range(kills):
        device = devices[int(rng.integers(len(devices)))]
        device.kill()
        go_on(simulation.now_ns + round(GONE_S * 1e9))
        started_ns = simulation.now_ns
        device.start()
        world_end, pairs = device.pair.world_endpoint, device.pair.world_endpoint.session.incarnations
        while world_end.session.incarnations == pairs or world_end.in_use.came_ns < started_ns:
            go_on(simulation.now_ns + 1_000_000)
        back_s.append((simulation.now_ns - started_ns) * 1e-9)
        go_on(started_ns + round(BACK_S * 1e9))
    return Seen(largest, back_s, devices, simulation)


@pytest.mark.parametrize(
    "kills",
    [2, pytest.param(10, marks=pytest.mark.slow), pytest.param(50, marks=pytest.mark.soak)],
)
def test_the_others_feel_no_step_and_nobody_gets_energy_by_coming_back(kills: int) -> None:
    assert_nobody_gains(run(kills))


SLIDES = "".join(
    f'<joint type="slide" axis="{axis}" damping="1" stiffness="5"/>' for axis in ("1 0 0", "0 1 0", "0 0 1")
)


def test_the_same_holds_in_a_mujoco_model(tmp_path: Path) -> None:
    """The block of above as a body of a model; each hand has a sphere, which it lets go while it is away."""
    pytest.importorskip("mujoco")
    box = f'<body gravcomp="1">{SLIDES}<geom type="box" size=".03 .03 .03" mass="0.2"/></body>'
    (tmp_path / "box.xml").write_text(f"<mujoco><worldbody>{box}</worldbody></mujoco>")
    assert_nobody_gains(run(2, scene=f"mujoco:{tmp_path / 'box.xml'}"))


def assert_nobody_gains(seen: Seen) -> None:
    assert seen.step <= STEP_LIMIT_N + OWN_MOTION_N
    assert max(seen.back_s) <= 0.3 + 3.0 * ROUND_TRIP_S
    first = seen.devices[0].pair.world_endpoint.coupling.ledger.bound
    for device in seen.devices:
        world = device.pair.world_endpoint.coupling.ledger
        assert world.bound == first  # of the seat: it does not grow with the processes
        assert world.slack_min >= -1e-12
        for number, ledger in enumerate(device.ledgers):
            assert ledger.slack_min >= -1e-12
            assert (ledger.bound == 0.0) is (number > 0)  # who comes back starts empty
    shared = seen.devices[0].pair.setup.scene.shared
    assert shared.account.slack_min >= -1e-12
