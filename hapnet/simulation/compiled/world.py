"""The world's side, to and from the kernel."""

from __future__ import annotations

from hapnet.control.prediction import PredictedDevice
from hapnet.control.set_position_coupling import SetPositionCoupling
from hapnet.kernel import sides
from hapnet.kernel.memory import load, store
from hapnet.plant.integrator import PassiveIntegrator
from hapnet.plant.worlds.account import EnvironmentAccount
from hapnet.plant.worlds.walls import Contacts
from hapnet.side.world import WorldSide, WorldState


def read_side(record: sides.WorldSide, side: WorldSide) -> None:
    coupling, contacts = coupling_of(side), side.scene.contacts
    assert isinstance(contacts, Contacts)
    store(record.mass, _integrator(side))
    store(record.contacts, contacts)
    store(record.coupling, coupling)
    store(record.environment, environment_of(side))
    if isinstance(coupling.source, PredictedDevice):
        store(record.predicted, coupling.source)


def coupling_of(side: WorldSide) -> SetPositionCoupling:
    coupling = side.coupling
    assert isinstance(coupling, SetPositionCoupling)
    return coupling


def _integrator(side: WorldSide) -> PassiveIntegrator:
    assert isinstance(side.mass, PassiveIntegrator), "a scene of walls"
    return side.mass


def environment_of(side: WorldSide) -> EnvironmentAccount:
    assert side.environment is not None, "control has started"
    return side.environment


def write_side(record: sides.WorldSide, counts: sides.Counts, side: WorldSide) -> None:
    coupling = coupling_of(side)
    load(coupling, record.coupling)
    load(environment_of(side), record.environment)
    load(_integrator(side), record.mass)
    side.restore(
        WorldState(int(counts.steps), float(counts.stepped_s), float(counts.longest_step_s), int(counts.world_last_ns))
    )
