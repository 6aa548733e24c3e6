"""The kinds of scenarios, each compiled separately: they differ in the coupling's two ends and the mass's surroundings.

A side whose end is a law contains the law's record, and calls the law's equations; a side of set-positions is that of
sides.py.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

from hapnet.control import carrying, coupling, law, set_position_coupling
from hapnet.ext.compiled import law_sides, link, samples, sides, simulation, solids
from hapnet.ext.compiled.names import Kind
from hapnet.ext.compiled.simulation import Scenario
from hapnet.ext.solids.rigid_step import SolidContact
from hapnet.mechanics.sliding import clearance, slide, slide_along_walls, stays, stays_in_walls
from hapnet.plant import integrator
from hapnet.plant.tick import held_tick, tick as make_tick
from hapnet.plant.worlds import walls
from hapnet.records.record import Record, holding
from hapnet.side import device as ticks, held_device, world as steps

Choices = dict[Callable[..., Any], Callable[..., Any]]


OF_SET_POSITIONS: Choices = {
    coupling.update: sides.update, coupling.potential: set_position_coupling.potential, integrator.respond: sides.meet,
    walls.apply: integrator.solve, clearance: walls.clearance, carrying.displace: integrator.displace,
    slide: slide_along_walls, stays: stays_in_walls,
    steps.advance: sides.advance, steps.take: sides.take_at_world,
    steps.answer: sides.answer, steps.settle: sides.settle, ticks.measure: sides.measure,
    ticks.take: sides.take_at_device, ticks.act: sides.act, ticks.hold: sides.hold,
}  # fmt: skip
"""The functions compiled in place of others for ends of set-positions and a mass among walls."""


def choices(kind: Kind) -> Choices:
    """The functions to compile in place of others for this kind."""
    chosen: Choices = OF_SET_POSITIONS | simulation.CHOICES | link.CHOICES
    if (device := kind.device) is not None:
        chosen |= device.lines() | {
            make_tick: held_tick, samples.of_device: law_sides.of_device, ticks.measure: law_sides.measure,
            ticks.take: law_sides.take_from_world, ticks.act: law_sides.act, ticks.hold: law_sides.hold,
            law_sides.take_at_device: device.take, law.render: device.render,
            law_sides.set_device_outgoing: device.set_outgoing, held_device.potential: law_sides.no_energy,
            held_device.account: law_sides.account_of,
        }  # fmt: skip
    if (world := kind.world) is not None:
        chosen |= world.lines() | {
            coupling.update: law_sides.update, coupling.potential: law_sides.no_potential,
            steps.advance: law_sides.advance, steps.take: law_sides.take_from_device,
            steps.answer: law_sides.answer,
            samples.of_world: law_sides.of_world,
            law_sides.take_at_world: world.take, law_sides.stamped: world.stamp, law_sides.begin: world.begin,
            law_sides.drag: world.drag, law_sides.moved: world.moved, law_sides.set_world_outgoing: world.set_outgoing,
        }  # fmt: skip
    if kind.solid:
        chosen |= solids.AMONG_SOLIDS
    return chosen


@cache
def scenario(kind: Kind) -> type[Scenario]:
    """The record class of a scenario of this kind."""
    made: dict[str, type[Record]] = {}
    if kind.solid:
        made["world"] = holding(sides.WorldSideRecord, contacts=SolidContact)
    for name, side, end in (
        ("device", law_sides.LawDevice, kind.device), ("world", law_sides.LawWorld, kind.world)
    ):  # fmt: skip
        if end is not None:
            around = {"contacts": SolidContact} if kind.solid and end is kind.world else {}
            made[name] = holding(side, law=end, **around)
    return holding(Scenario, **made) if made else Scenario
