"""Copies the world's side to and from the kernel."""

from __future__ import annotations

from typing import Any

from hapnet.control.coupling import LawState
from hapnet.control.law import WorldEnd
from hapnet.control.prediction import PredictedDevice
from hapnet.control.set_position_coupling import SetPositionCoupling
from hapnet.ext.compiled.memory import load, store
from hapnet.ext.solids.rigid_contacts import RigidContacts
from hapnet.plant.integrator import PassiveIntegrator
from hapnet.plant.worlds.walls import Contacts
from hapnet.records.record import Record
from hapnet.side.world import WorldSide


def read_side(record: Any, side: WorldSide) -> None:
    coupling = side.coupling
    if isinstance(coupling, SetPositionCoupling) and isinstance(coupling.source, PredictedDevice):
        store(record.predicted, coupling.source)
    for part, own in _parts(record, side):
        store(part, own)


def _parts(record: Any, side: WorldSide) -> list[tuple[Record, Record]]:
    """The kernel's records of the world's side, each with the side's own record."""
    coupling = side.coupling
    assert isinstance(side.mass, PassiveIntegrator), "a scene of walls or solids"
    assert side.environment is not None, "control has started"
    assert isinstance(coupling, SetPositionCoupling | LawState)
    contacts = side.scene.contacts
    assert isinstance(contacts, Contacts | RigidContacts)
    parts: list[tuple[Record, Record]] = [
        (record.contacts, contacts), (record.mass, side.mass), (record.coupling, coupling),
        (record.environment, side.environment), (record.stepped, side.stepped),
    ]  # fmt: skip
    if isinstance(coupling, LawState):
        assert isinstance(coupling.law, WorldEnd), "a law that is compiled"
        parts.append((record.law, coupling.law))
    return parts


def write_side(record: Any, side: WorldSide) -> None:
    for part, own in _parts(record, side):
        load(own, part)
