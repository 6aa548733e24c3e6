"""The hands of a world with several: what it reports of them, and what of that the page shows."""

from typing import Any

import numpy as np
import pytest

pytest.importorskip("viser", reason="the live page's library is not installed")

from hapnet.ext.many.graph import graph_of
from hapnet.ext.many.hands import world_setups
from hapnet.ext.page.hands import COLORS, hands_of, in_words
from hapnet.ext.page.history import History
from hapnet.plant.worlds.picture import FREE, HERE, LEFT, SeenHand
from hapnet.recording.telemetry import Status
from tests.conftest import ROOT

BOX = ROOT / "examples" / "graphs" / "carried_box.xml"


def of_world(*hands: Any) -> Status:
    return Status("world", 0, 1, True, False, "", {"hands": hands}, {}, {})


def scenes(scene: str, *names: str) -> list[Any]:
    nodes = {name: {"kind": "device", "operator": "rest"} for name in names}
    edges = [{"from": name, "to": "world"} for name in names]
    graph = graph_of({"nodes": {**nodes, "world": {"kind": "world", "scene": scene, "dof": 0}}, "edges": edges})
    made = [setup.scene for setup in world_setups(graph, graph.edges_of("world"), lambda params: params)]
    for name, one in zip(names, made, strict=True):
        one.proxy(0.1, 1.0, 100.0)
        one.hand = SeenHand(name, FREE, -1)
    return made


def test_each_hand_is_at_the_pose_that_the_picture_has_for_it() -> None:
    made = scenes("shared:block?at=60mm,0,0 + block?at=0,0,-90mm&mass=0", "alice", "bob", "carol")
    for number, one in enumerate(made):
        one.mass.place((0.01 * number, 0.02, 0.0))
    for number, one in enumerate(made):
        poses, hands = one.picture().poses(), one.hands
        assert [hand.name for hand in hands] == ["alice", "bob", "carol"]
        for other, hand in enumerate(hands):
            if other == number:
                assert hand.body == -1
            else:
                np.testing.assert_allclose(poses[hand.body, :3], (0.01 * other, 0.02, 0.0), atol=1e-12)


def test_the_hands_of_a_model_are_at_their_bodies() -> None:
    """The pads of the model are 120 mm apart; each hand's own place is its origin."""
    pytest.importorskip("mujoco")
    for number, (one, away_m) in enumerate(
        zip(scenes(f"mujoco:{BOX}?proxy=left,right", "alice", "bob"), (0.12, -0.12), strict=True)
    ):
        mine, other = one.hands[number], one.hands[1 - number]
        assert mine.body == -1
        np.testing.assert_allclose(one.picture().poses()[other.body, :3], (away_m, 0.0, 0.0), atol=1e-9)


def test_a_hand_alone_is_not_listed() -> None:
    assert scenes("shared:block", "alice")[0].hands == ()


def test_a_hand_comes_leaves_and_is_back() -> None:
    seat = scenes("shared:block", "alice", "bob")[0]
    states = []
    for heard in (False, True, False, True):
        seat.see(heard)
        states.append(seat.hands[0].state)
    assert states == [FREE, HERE, LEFT, HERE]


def test_the_page_names_those_who_have_come_and_itself() -> None:
    names = {"seat2": "Zoe"}
    history = History(names=names)
    history.take(of_world(("seat1", HERE, -1), ("seat2", LEFT, 1), ("seat3", FREE, 2), ("seat4", HERE, 3)))
    expected = [("seat1, you", COLORS[0]), ("Zoe, left", COLORS[1]), ("seat4", COLORS[3])]
    assert in_words(history.snapshot()) == expected
    names.clear()
    assert in_words(history.snapshot())[1][0] == "seat2, left"


@pytest.mark.parametrize("told", [(), "alice", 7, (7,), (("alice", HERE),), ((1, HERE, 2),), (("alice", HERE, "2"),)])
def test_what_is_no_list_of_hands_is_not_shown(told: Any) -> None:
    history = History()
    history.take(Status("world", 0, 1, True, False, "", {"hands": told}, {}, {}))
    assert hands_of(history.snapshot()) == []


def test_more_hands_than_colours_begin_again() -> None:
    history = History()
    history.take(of_world(*[(f"seat{n}", HERE, n) for n in range(len(COLORS) + 1)]))
    colors = [hand.color for hand in hands_of(history.snapshot())]
    assert len(set(colors)) == len(COLORS)
    assert colors[-1] == colors[0]
