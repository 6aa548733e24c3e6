"""Checks all parts of a graph without making its simulation."""

from __future__ import annotations

from hapnet.assembly.build import Setup, held, virtual_mass
from hapnet.assembly.operators import operator
from hapnet.assembly.own_parts import named_section
from hapnet.ext.many.graph import Graph, about
from hapnet.ext.many.hands import graph_setups
from hapnet.ext.many.shared_bodies import bodies_of


def checked_setups(graph: Graph) -> dict[str, Setup]:
    """The setups of all edges, after their hands, masses and device's ends were made once. Raises InvalidParameter."""
    setups = graph_setups(graph, lambda params: params)
    bodies_of(graph, setups, lambda params: params, {}, lambda: 0)
    for name, setup in setups.items():
        with about(f"edges.{name}"):
            hand = operator(setup.params, setup.scene)
            virtual_mass(setup)
            with named_section("device"):
                held(setup)(hand.reference(0.0), False)
    return setups
