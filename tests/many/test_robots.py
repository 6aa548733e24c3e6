"""Robots that touch the same block, each led by a hand of its own: what the hands feel, and every account."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapnet import cli
from hapnet.checks import Array
from hapnet.errors import InvalidParameter
from hapnet.ext.many.graph import graph_of
from hapnet.ext.many.joint import seat_of
from hapnet.ext.many.run import GraphSimulation
from tests.conftest import ROOT
from tests.many.accounts import require_passive
from tests.many.test_carrying import FROM_S, assert_credit, assert_every_account, forces, steps_of_force
from tests.support.carrying_hands import Carrier
from tests.support.commands import Capture, empty_directory as empty_directory
from tests.support.processes import without_progress
from tests.support.restarted_devices import Device

pytestmark = pytest.mark.long  # whole runs of several pairs, or many steps

ROBOT: dict[str, Any] = {"robot": "simulated"}
SERVED: dict[str, Any] = {**ROBOT, "mass": 0.5, "position_servo": True, "friction_N": 0.3, "own_damping": 2.0}


def table_of(link: str, follower: dict[str, Any], *, block: str = "mass=0.2&drag=1&spring=5", **top: Any) -> Any:
    """A graph in which two hands hold a block with a robot each."""
    hands = {"left": Carrier(0, -1.0), "right": Carrier(0, 1.0)}
    cell = {"kind": "world", "scene": f"shared:block?at=0,0,0&{block}", "follower": follower}
    nodes = {name: {"kind": "device", "operator": "rest"} for name in hands}
    edges = [{"from": name, "to": "cell", "link": link, "at": hand.at} for name, hand in hands.items()]
    return {"duration_s": 8.0, **top, "nodes": {**nodes, "cell": cell}, "edges": edges}


def robots(link: str, follower: dict[str, Any] = ROBOT, **others: Any) -> GraphSimulation:
    hands = {"left": Carrier(0, -1.0), "right": Carrier(0, 1.0)}
    return GraphSimulation(graph_of(table_of(link, follower, **others)), hands=hands)


def cell_of(run: GraphSimulation) -> Any:
    """The world of both robots."""
    seat = seat_of(run.pairs["left-cell"].setup.scene)
    assert seat is not None
    return seat.shared


@pytest.fixture(scope="module")
def ideal() -> dict[str, Array]:
    """Without any delay, with each kind of robot, at their servos' 1,000 ticks a second."""
    found = {name: forces(robots("delay 0ms", kind).run()) for name, kind in (("force", ROBOT), ("served", SERVED))}
    assert all(np.abs(one).mean() > 0.5 for one in found.values())  # both hold the block
    return found


@pytest.mark.slow
@pytest.mark.parametrize("name", ["force", "served"])
@pytest.mark.parametrize(("link", "most_N"), [("delay 40ms 10ms loss 2%", 0.10), ("delay 100ms 30ms loss 10%", 0.25)])
def test_two_hands_carry_a_block_with_two_robots(link: str, most_N: float, name: str, ideal: dict[str, Array]) -> None:
    run = robots(link, ROBOT if name == "force" else SERVED)
    result = run.run()
    assert np.sqrt(np.mean((forces(result) - ideal[name]) ** 2)) <= most_N
    assert steps_of_force(result, 0.0) < 0.05
    assert steps_of_force(result, FROM_S) < 0.05
    assert_every_account(run, result)


@pytest.mark.parametrize("follower", [ROBOT, {**SERVED, "servo_hz": 200.0, "resolution_m": 1e-5}])
def test_every_account_is_kept(follower: dict[str, Any]) -> None:
    """Force times way, summed from the recordings alone, and the world's one account of both robots."""
    run = robots("delay 40ms 10ms loss 5%", follower, duration_s=5.0, record_hz=1000.0)
    result = run.run(lambda _: assert_credit(run))
    assert_every_account(run, result)
    if "resolution_m" not in follower:  # the accounts count true positions, the recordings what encoders say
        require_passive(run, result)
    assert min(pair.summary["motion"]["peak_force_N"] or 0.0 for pair in result.pairs.values()) > 0.3


@pytest.mark.parametrize("served", [False, True])
def test_without_dampers_the_work_of_both_actuators_is_stored(served: bool) -> None:
    """Beside force times way of both robots, and kinetic and potential energies of the last moment."""
    mass, stiffness = 0.4, 2000.0
    plain = {**ROBOT, "mass": mass, "own_damping": 0.0, "position_servo": served}
    wall = {"wall": {"damping": 0.0, "stiffness": stiffness}}
    graph = table_of("delay 20ms", plain, block="mass=0.2&drag=0&spring=5", duration_s=4.0, record_hz=1000.0)
    graph["nodes"]["cell"]["world"] = wall
    run = GraphSimulation(graph_of(graph), hands={"left": Carrier(0, -1.0), "right": Carrier(0, 1.0)})
    result = run.run()
    blocks = cell_of(run).blocks
    at, speed, work = np.array(blocks.x[0]), np.array(blocks.v[0]), 0.0
    stored = 0.5 * 0.2 * speed @ speed + 0.5 * 5.0 * at @ at
    for pair, place, side in zip(result.pairs.values(), (-0.06, 0.06), (-1.0, 1.0), strict=True):
        world = pair.recording.world
        assert world is not None
        way = np.diff(world["position_m"], axis=0)
        work += float(np.sum(world["coupling_force_N"][1:] * way)) + float(
            world["coupling_force_N"][0] @ world["position_m"][0]  # of the first step, which began at 0
        )
        end, moving = world["position_m"][-1], world["velocity_mps"][-1]
        depth = max(0.0, 0.03 - side * (end[0] + place - at[0]))
        stored += 0.5 * mass * moving @ moving + 0.5 * stiffness * depth**2
    account = result.summary["nodes"]["cell"]["environment"]
    assert -account["work_J"] == pytest.approx(work, abs=1e-12)
    assert account["env_stored_J"] == pytest.approx(stored, abs=1e-12)
    assert work == pytest.approx(stored, abs=1e-12)
    assert stored > 1e-3


def test_a_robot_beside_one_that_touches_nothing_moves_as_it_does_alone() -> None:
    graph = table_of("delay 20ms", SERVED, duration_s=3.0)
    alone = {**graph, "edges": graph["edges"][:1], "nodes": {k: v for k, v in graph["nodes"].items() if k != "right"}}
    graph["edges"][1]["at"] = [0.5, 0.0, 0.0]
    found = []
    for table in (graph, alone):
        wire = {"admission_W": 1.0, "admission_burst_J": 0.1}  # of several hands
        hands = {"left": Carrier(0, -1.0)} | ({"right": Carrier(0, 1.0)} if table is graph else {})
        found.append(GraphSimulation(graph_of({**table, "wire": wire}), hands=hands).run().pairs["left-cell"].recording)
    one, two = (part.world for part in found)
    assert one is not None
    assert two is not None
    assert np.abs(two["contact_force_N"]).max() > 0.1
    assert one["position_m"] == pytest.approx(two["position_m"], rel=0.0, abs=1e-12)


def test_a_robot_whose_hand_has_gone_holds_the_block() -> None:
    """Unlike a proxy, which is no body: it touches nothing then."""
    run = robots("delay 20ms", SERVED, duration_s=5.0)
    left = Device(run, "left-cell")
    run._run(10**10, lambda: all(pair.started for pair in run.pairs.values()))
    run._reach(run.now_ns + 2_500_000_000)
    left.kill()
    run._reach(run.now_ns + 1_000_000_000)
    blocks = cell_of(run).blocks
    robot = run.pairs["left-cell"].world.mass
    assert robot.position[0] - 0.06 > blocks.x[0][0] - 0.03 + 1e-5  # it is in contact
    assert cell_of(run).account.slack_min >= -1e-12


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"coupling": "popc"}, "with pspm or zoh"),
        ({"follower.servo": "continuous"}, "follower.servo is 'continuous'"),
    ],
)
def test_robots_that_cannot_share_a_block_are_refused(changes: dict[str, Any], says: str) -> None:
    with pytest.raises(InvalidParameter) as raised:
        GraphSimulation(graph_of(table_of("lan", ROBOT)), change=lambda params: params.set(changes, "a test"))
    assert says in str(raised.value)


def test_one_that_only_watches_leads_no_robot() -> None:
    graph = table_of("lan", ROBOT)
    graph["edges"][0]["rights"] = "watch"
    with pytest.raises(InvalidParameter, match="its hand leads a robot"):
        GraphSimulation(graph_of(graph))


@pytest.mark.parametrize("command", [["run"], ["world", "--node", "cell"], ["world", "--seats", "2"]])
def test_several_robots_are_refused_in_real_time(command: list[str], empty_directory: Path, capsys: Capture) -> None:
    if "--seats" in command:
        command = [*command, "--scene", "shared:block", "--follower", "simulated"]
    else:
        (empty_directory / "g.toml").write_text((ROOT / "examples/graphs/two_robots.toml").read_text("utf-8"), "utf-8")
        command = [*command, "--graph", "g.toml"]
    assert cli.main([*command, "--no-files"]) == 2
    _, err = capsys.readouterr()
    assert without_progress(err).count("\n") == 1
    assert "hapnet simulate --graph" in err
