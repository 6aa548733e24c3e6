"""A graph of one edge is a run of one pair: bit by bit."""

import re
from typing import Any

import numpy as np
import pytest

import hapnet
from hapnet.errors import InvalidParameter
from hapnet.ext.many import shared
from hapnet.ext.many.graph import graph_of
from hapnet.ext.many.run import GraphSimulation
from hapnet.ext.many.shared import Seat
from hapnet.recording.samples import Recording
from tests.conftest import ROOT

pytestmark = pytest.mark.long  # whole runs of several pairs, or many steps

LINKS = {"up": "delay 40ms 10ms loss 2%", "down": "delay 20ms 5ms loss 5%"}


def both(scene: str, operator: str, dof: int) -> tuple[Recording, Recording]:
    """Of the graph's edge, and of `hapnet.simulate` with the same parameters and the servo that graphs have."""
    world = {"kind": "world", "scene": scene, "dof": dof}
    table: dict[str, Any] = {
        "duration_s": 3.0,
        "nodes": {"alice": {"kind": "device", "operator": operator}, "table": world},
        "edges": [{"from": "alice", "to": "table", "link": LINKS}],
    }
    graph = GraphSimulation(graph_of(table), seed=7).run().pairs["alice-table"].recording
    changes = {"scene": scene, "dof": dof, "operator": operator, "device.servo": "sampled", "duration_s": 3.0}
    changes |= {f"link.{way}": link for way, link in LINKS.items()}
    return graph, hapnet.simulate(changes, seed=7, kernel=False).recording


@pytest.mark.parametrize(
    ("scene", "operator", "dof"),
    [
        ("wall", "press", 1),
        ("shared:block?mass=0.2", "press", 3),
        ("shared:block?mass=0.5", "sine", 2),
        (f"mujoco:{ROOT / 'examples' / 'graphs' / 'carried_box.xml'}?proxy=left,right", "press", 3),
    ],
)
def test_a_graph_of_one_edge_is_a_run_of_one_pair(scene: str, operator: str, dof: int) -> None:
    if scene.startswith("mujoco:"):
        pytest.importorskip("mujoco")
    ours, theirs = both(scene, operator, dof)
    for one, other in ((ours.device, theirs.device), (ours.world, theirs.world)):
        assert one is not None
        assert other is not None
        assert one.keys() == other.keys()
        for name in one:
            assert np.array_equal(one[name], other[name], equal_nan=one[name].dtype.kind == "f"), name
    assert ours.world is not None
    assert np.abs(ours.world["contact_force_N"]).max() > 0.1  # it touches


def test_two_hands_far_from_each_other_are_two_pairs() -> None:
    """Each at a block of its own in one world: the first hand's run is that of one pair, to the solver's rounding."""
    scene = "shared:block?mass=0.2&at=50mm,0m,0m + block?mass=0.2&at=1m,0m,0m"
    alone, together = (
        GraphSimulation(graph_of(_table(scene, hands)), seed=3).run().pairs["a-table"].recording for hands in (1, 2)
    )
    assert alone.world is not None
    assert together.world is not None
    for name in ("position_m", "contact_force_N"):
        assert together.world[name] == pytest.approx(alone.world[name], rel=0.0, abs=1e-9), name
    assert np.abs(alone.world["contact_force_N"]).max() > 0.1


def _table(scene: str, hands: int) -> dict[str, Any]:
    names = "ab"[:hands]
    return {
        "duration_s": 2.0,
        "nodes": {
            **{name: {"kind": "device", "operator": "press"} for name in names},
            "table": {"kind": "world", "scene": scene, "dof": 3},
        },
        "edges": [{"from": name, "to": "table", "link": "lan", "at": [0.95 * k, 0, 0]} for k, name in enumerate(names)],
    }


def test_a_seat_counts_positions_from_its_devices_origin() -> None:
    run = GraphSimulation(graph_of(_table("shared:block?mass=0&at=50mm,0m,0m + block?mass=0&at=1m,0m,0m", 2)))
    first, second = (pair.world.scene for pair in run.pairs.values())
    assert isinstance(first, Seat)
    assert isinstance(second, Seat)
    assert first.shared is second.shared
    assert first.contacts.clearance((0.0, 0.0, 0.0)) == pytest.approx(0.02, abs=1e-15)
    assert second.contacts.clearance((0.0, 0.0, 0.0)) == pytest.approx(0.02, abs=1e-15)
    assert second.in_world((0.01, 0.02, 0.03)) == pytest.approx((0.96, 0.02, 0.03), abs=1e-15)


def test_no_stiffness_is_claimed_for_what_is_felt_through_the_delayed_proxy() -> None:
    """Without planes a block feels like the springs, whatever stiffness its contacts have."""
    changes = {"scene": "shared:block", "operator": "press", "duration_s": 1.0}
    summary = hapnet.simulate(changes, kernel=False).summary
    assert summary["environment"]["felt_stiffness_N_m"] is None
    assert summary["environment"]["stiffness_N_m"] is None


def test_the_examples_in_texts_are_worlds() -> None:
    with pytest.raises(InvalidParameter, match="such as") as caught:
        shared.shared_world("shared:ball")
    (documented,) = re.findall(r"``(shared:.*?)``", str(shared.__doc__))
    for text in (documented, str(caught.value).partition("such as ")[2]):
        assert len(shared.shared_world(text).shared.blocks.blocks) == 2


@pytest.mark.parametrize("begins_m", [-0.06, 0.06])
def test_a_hand_that_may_only_watch_feels_nothing_and_changes_nothing(begins_m: float) -> None:
    """Alice pushes a block, and bob is at its other side, or where she is. Her run is that of one pair."""
    scene = "shared:block?mass=0.2&at=0m,0m,0m"
    at = {"at": [-0.06, 0.0, 0.0]}
    press = {"kind": "device", "operator": "press", "operator_model": {"goal_m": 0.05}}
    back = {"kind": "device", "operator": "press", "operator_model": {"goal_m": -np.sign(begins_m) * 0.05}}
    found = []
    for watches in (False, True):
        nodes = {"alice": press, "table": {"kind": "world", "scene": scene, "dof": 3}}
        edges: list[dict[str, Any]] = [{"from": "alice", "to": "table", "link": "lan", **at}]
        if watches:
            nodes["bob"] = back
            edges.append({"from": "bob", "to": "table", "link": "lan", "at": [begins_m, 0, 0], "rights": "watch"})
        table = {"duration_s": 2.0, "nodes": nodes, "edges": edges}
        found.append(GraphSimulation(graph_of(table), seed=3).run().pairs)
    alone, together = (pairs["alice-table"].recording.world for pairs in found)
    bob = found[1]["bob-table"].recording.world
    assert alone is not None
    assert together is not None
    assert bob is not None
    for name in ("position_m", "contact_force_N"):
        assert together[name] == pytest.approx(alone[name], rel=0.0, abs=1e-9), name
    assert np.abs(alone["contact_force_N"]).max() > 0.1
    assert not np.any(bob["contact_force_N"])
    assert np.abs(bob["position_m"][:, 0]).max() > 0.03  # it went through the block


def test_alone_it_may_not_touch_either() -> None:
    table = _table("shared:block?mass=0.2&at=50mm,0m,0m", 1)
    table["edges"][0]["rights"] = "watch"
    world = GraphSimulation(graph_of(table), seed=3).run().pairs["a-table"].recording.world
    assert world is not None
    assert not np.any(world["contact_force_N"])
