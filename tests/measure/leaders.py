"""Teachers, chains and held followers: how far they are from their leader, and whether the forecast is right."""

from typing import Any

import numpy as np

from hapnet.ext.many.graph import graph_of
from hapnet.ext.many.hands import graph_setups
from hapnet.ext.many.paths import node_rows
from tests.many.accounts import PAPER, apart_mm, ran, require_passive, table

STAR, CHAIN = [(0, 1), (0, 2), (0, 3), (0, 4)], [(0, 1), (1, 2), (2, 3)]
SOFT = {"stiffness": 40.0, "damping": 0.5, "mass": 0.1}
LAST_S = 30.0
"""The end of a long run, in which a starving follower shows [s]."""


def main(duration_s: float = 8.0, long_s: float = 60.0) -> None:
    """The distances over 50 ms and 20 % loss from second 3 to `duration_s`; the forecast against runs of `long_s`."""
    for name, edges, others in (
        ("teacher, 4 students", STAR, {}),
        ("one of them held", STAR, {"held": (4,)}),
        ("chain of 4", CHAIN, {}),
    ):
        for rendering, params in (("hapnet", {}), ("paper", PAPER)):
            run, result = ran(table(edges, duration_s=duration_s, **others, **params))
            require_passive(run, result)
            apart = ", ".join(f"{apart_mm(result, 'n0-n1', edge):.1f}" for edge in result.pairs)
            shares = [pair.summary["world"]["modulated_share"] or 0.0 for pair in result.pairs.values()]  # type: ignore[index]
            print(f"{name:20} {rendering:6} apart {apart} mm; modulated {', '.join(f'{one:.0%}' for one in shares)}")
    for name, edges, force, held, params in _forecasts():
        graph = table(edges, duration_s=long_s, held=held, **params)
        for edge in graph["edges"]:
            edge["force"] = force
        _against_forecast(name, graph)


def _forecasts() -> list[tuple[str, list[tuple[int, int]], bool, tuple[int, ...], dict[str, Any]]]:
    """Each graph's name, edges, whether the leaders feel them, who is held, and parameters."""
    one = [(0, 1)]
    dampers = [(f"not felt, B {B}", one, False, (0,), {"device": {"damping": B}}) for B in (0.1, 0.25, 0.5)]
    return [
        ("felt", one, True, (0,), {}),
        *dampers,
        ("held firmly", one, True, (1,), {}),
        ("held loosely", one, True, (1,), {"operator_model": SOFT}),
        ("chain", CHAIN, True, (0,), {}),
        ("chain, not felt", CHAIN, False, (0,), {"device": {"damping": 0.8}}),
    ]


def _against_forecast(name: str, table_of: dict[str, Any]) -> None:
    graph = graph_of(table_of)
    rows = {row["node"]: row for row in node_rows(graph, graph_setups(graph, lambda params: params))}
    _, result = ran(table_of)
    for edge, pair in result.pairs.items():
        row, world = rows[graph.edges[edge].world], pair.recording.world
        assert world is not None
        late = world["time_ns"] > world["time_ns"][-1] - LAST_S * 1e9
        off = np.linalg.norm(world["set_position_m"] - world["target_m"], axis=1) > 1e-4
        reach = "" if row["reach_m"] is None else f", reaches {1e3 * row['reach_m']:.0f} mm"
        dampings = f"gets {row['gets_Ns_m']:.3g}, spends {row['spends_Ns_m']:.3g} Ns/m{reach}"
        share = f"modulated {off[late].mean():.0%} of the last {LAST_S:.0f} s"
        print(f"{name:16} {row['node']}: {dampings}; will starve: {row['starves']}; {share}")


if __name__ == "__main__":
    main()
