"""Hands that share one reservoir: who needs energy takes it from the others, and no account changes by it."""

from functools import cache

import pytest

from hapnet.errors import InvalidParameter
from hapnet.ext.many.graph import graph_of
from hapnet.ext.many.run import GraphResult, GraphSimulation
from tests.many.test_hostile_seat import HOLDING
from tests.many.test_refilled_seats import Port
from tests.measure.reservoirs import graph_around, short_of, uneven
from tests.support.carrying_hands import Carrier
from tests.support.hostile_hands import run as with_a_third

pytestmark = pytest.mark.long  # whole runs of several pairs, or many steps


@cache
def made(kind: str) -> tuple[GraphSimulation, GraphResult, list[Port]]:
    """Two uneven hands, each run once."""
    simulation = uneven(2, kind, 6.0)
    ports = [Port(pair) for pair in simulation.pairs.values()]
    return simulation, simulation.run(), ports


def test_uneven_hands_come_nearer_to_what_they_ask_for() -> None:
    """The prototype: 1.62 mm in place of 2.65."""
    (separate, _), (pooled, _) = (short_of(made(kind)[1]) for kind in ("separate", "pooled"))
    assert separate > 1e-3  # the hand that squeezes harder has too little
    assert pooled < 0.7 * separate


@pytest.mark.parametrize("kind", ["separate", "pooled"])
def test_each_account_is_as_exact(kind: str) -> None:
    """Beside the work at each seat's port: what a seat got counts as work of its world, and what it gave as less."""
    simulation, result, ports = made(kind)
    node = result.summary["nodes"]["table"]
    seats = node["reservoirs"]["seats"]
    got, given = (sum(seat[key] for seat in seats.values()) for key in ("got_J", "given_J"))
    assert got == pytest.approx(given, abs=1e-12)
    assert (got > 0.01) is (kind == "pooled")
    for (name, pair), port in zip(simulation.pairs.items(), ports, strict=True):
        ledger = pair.world_endpoint.coupling.ledger
        assert ledger.work == pytest.approx(port.work + seats[name]["got_J"] - seats[name]["given_J"], abs=1e-12)
        assert ledger.slack_min >= -1e-12
        assert result.pairs[name].summary["theorem"]["margin_J"] >= -1e-9
        assert result.pairs[name].summary["theorem"]["bound_J"] == pytest.approx(0.15)
    shared = simulation.pairs["h0-table"].setup.scene.shared
    assert shared.account.slack_min >= -1e-12
    assert sum(seat.work for seat in shared.seats) == pytest.approx(sum(port.work for port in ports), abs=1e-12)


@pytest.mark.slow
def test_a_liar_takes_from_a_group_and_is_named() -> None:
    shares = {}
    for kind in ("separate", "pooled"):
        for third in ("honest", "liar"):
            result, _ = with_a_third(third, world={"reservoir": kind})
            shares[kind, third] = sum(result.pairs[name].summary["world"]["modulated_share"] for name in HOLDING)
            named = "third-table took" in result.summary["verdict"]["reason"]
            assert named is ((kind, third) == ("pooled", "liar"))
            assert result.summary["verdict"]["passive"] is True
    assert shares["separate", "liar"] <= shares["separate", "honest"] + 0.01
    assert shares["pooled", "liar"] > shares["pooled", "honest"] + 0.05


@pytest.mark.parametrize("law", ["popc", "zoh", "two-layer"])
def test_a_law_without_reservoirs_has_none_to_share(law: str) -> None:
    hands = {"one": Carrier(0, -1.0), "other": Carrier(0, 1.0)}
    graph = graph_around(hands, "pooled", 1.0)
    with pytest.raises(InvalidParameter, match=rf"world\.reservoir is 'pooled'.*separate with the coupling {law}"):
        GraphSimulation(graph, change=lambda params: params.set({"coupling": law}))


def test_an_engines_hands_share_no_reservoir() -> None:
    """The engine keeps the account of its proxies, so no energy can pass between them beside it."""
    world = {"kind": "world", "scene": "mujoco:examples/graphs/carried_box.xml", "world": {"reservoir": "pooled"}}
    nodes = {name: {"kind": "device", "operator": "rest"} for name in ("one", "other")}
    edges = [{"from": name, "to": "table", "proxy": side} for name, side in zip(nodes, ("left", "right"), strict=True)]
    with pytest.raises(InvalidParameter, match=r"world\.reservoir is 'pooled'.*the engine keeps the account"):
        GraphSimulation(graph_of({"nodes": {**nodes, "table": world}, "edges": edges}))
