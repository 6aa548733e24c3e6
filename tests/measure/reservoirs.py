"""Separate and pooled reservoirs of several hands: uneven hands, and a device that lies."""

from collections.abc import Mapping

import numpy as np

from hapnet.checks import Array
from hapnet.ext.many.graph import Graph, graph_of
from hapnet.ext.many.run import GraphResult, GraphSimulation
from tests.many.test_carrying import LINKS
from tests.many.test_hostile_seat import HOLDING
from tests.support.carrying_hands import Carrier
from tests.support.hostile_hands import run as with_a_third

KINDS = ("separate", "pooled")


def main(duration_s: float = 8.0, kinds: str = "honest,liar,forger,shaker") -> None:
    """Uneven hands carry 0.2 kg; then two hold it beside a third of each kind.

    duration_s: of each run with uneven hands, in simulated time. kinds: of the third hand, with commas between them.
    """
    print("uneven hands: how far their set-positions are from those that they asked for, and how often")
    for count in (2, 4, 8):
        for kind in KINDS:
            result = uneven(count, kind, duration_s).run()
            lacking, shares = short_of(result)
            node = result.summary["nodes"]["table"]
            moved = 1e3 * sum(seat["got_J"] for seat in node["reservoirs"]["seats"].values())
            print(f"{count:3} hands, {kind:8}: |y - ybar| {1e3 * lacking:.2f} mm rms, modulated {np.mean(shares):.1%}, "
                  f"the worst {max(shares):.1%}; {moved:.0f} mJ changed seats; {accounts(result)}")  # fmt: skip
    print("two hold 0.2 kg, a third is not what it says: what the two feel")
    for third in kinds.split(","):
        for kind in KINDS:
            result, speed = with_a_third(third, world={"reservoir": kind})
            grips = [force(result, name) for name in HOLDING]
            shares = [result.pairs[name].summary["world"]["modulated_share"] for name in HOLDING]
            print(f"  {third:6} {kind:8}: mean grip {np.mean([g.mean() for g in grips]):.2f} N, largest "
                  f"{max(g.max() for g in grips):.2f} N, modulated {np.mean(shares):.1%}, block at up to {speed:.2f} "
                  f"m/s; {accounts(result)}; {result.summary['verdict']['reason'][:90]}")  # fmt: skip


def uneven(count: int, kind: str, duration_s: float) -> GraphSimulation:
    """Hands at a block, over mixed links; every second one squeezes two and a half times as deep as the others."""
    hands = {f"h{k}": Carrier((k // 2) % 3, -1.0 if k % 2 else 1.0, 0.02 if k % 2 else 0.008) for k in range(count)}
    return GraphSimulation(graph_around(hands, kind, duration_s), hands=hands)


def graph_around(hands: Mapping[str, Carrier], kind: str, duration_s: float) -> Graph:
    """A block, these hands and their links."""
    world = {"step_min_s": 0.01, "step_max_s": 0.05, "reservoir": kind}
    nodes = {name: {"kind": "device", "operator": "rest"} for name in hands}
    edges = [
        {"from": name, "to": "table", "link": LINKS[k % len(LINKS)], "at": hand.at}
        for k, (name, hand) in enumerate(hands.items())
    ]
    table = {"kind": "world", "scene": "shared:block?at=0,0,0", "world": world}
    return graph_of({"duration_s": duration_s, "nodes": {**nodes, "table": table}, "edges": edges})


def short_of(result: GraphResult) -> tuple[float, list[float]]:
    """The rms of all hands' |y - ybar| [m], and each one's share of modulated set-positions."""
    squares, shares = [], []
    for pair in result.pairs.values():
        columns = pair.recording.world
        assert columns is not None
        squares.append(np.sum((columns["target_m"] - columns["set_position_m"]) ** 2, axis=1))
        shares.append(float(pair.summary["world"]["modulated_share"]))
    return float(np.sqrt(np.mean(np.concatenate(squares)))), shares


def force(result: GraphResult, name: str) -> Array:
    """The size of the force that a hand feels after 2.5 s [N]."""
    columns = result.pairs[name].recording.device
    assert columns is not None
    late = columns["time_ns"] - columns["time_ns"][0] > 2.5e9
    return np.linalg.norm(columns["force_N"][late], axis=1)


def accounts(result: GraphResult) -> str:
    """The least slack of a half, and of the blocks' account."""
    halves = [part["ledger"]["slack_J"] for pair in result.pairs.values() for part in
              (pair.summary["device"], pair.summary["world"])]  # fmt: skip
    return f"slack {min(halves):.0e} J, blocks {result.summary['nodes']['table']['environment']['env_slack_J']:.0e} J"
