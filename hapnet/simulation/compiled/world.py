"""The world's side, to and from the kernel."""

from __future__ import annotations

from hapnet.control.prediction import PredictedDevice
from hapnet.control.set_position_coupling import SetPositionCoupling
from hapnet.kernel import prediction, sides
from hapnet.kernel.memory import load, store
from hapnet.plant.integrator import PassiveIntegrator
from hapnet.plant.worlds.account import EnvironmentAccount
from hapnet.plant.worlds.walls import Contacts
from hapnet.side.world import WorldSide, WorldState
from hapnet.simulation.compiled.couplings import (
    read_coupling,
    read_stages,
    write_coupling,
)
from hapnet.simulation.compiled.mirror import optional, put, read, value


def read_side(record: sides.WorldSide, side: WorldSide) -> None:
    coupling, contacts = coupling_of(side), side.scene.contacts
    assert isinstance(contacts, Contacts)
    store(record.mass, _integrator(side))
    store(record.contacts, contacts)
    read_coupling(record.coupling, coupling)
    store(record.spring, coupling.spring)
    store(record.ledger, coupling.ledger)
    read_stages(record.stages, coupling)
    store(record.environment, environment_of(side))
    if isinstance(coupling.source, PredictedDevice):
        _predicted(record.predicted, coupling.source)


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
    write_coupling(record.coupling, coupling)
    load(coupling.ledger, record.ledger)
    load(environment_of(side), record.environment)
    load(_integrator(side), record.mass)
    side.restore(
        WorldState(int(counts.steps), float(counts.stepped_s), float(counts.longest_step_s), int(counts.world_last_ns))
    )


def _predicted(record: prediction.PredictedDevice, source: PredictedDevice) -> None:
    """The prediction, which is then in use."""
    record.in_use, record.stop_s = 1, value(source, "stop_s")
    read(record, source, "", lag="lag", y="y", age="age", fresh="fresh", mean_step="step")
    optional(record, "aimed_s", "has_aimed", value(source, "aimed_s"))
    predictor = value(source, "predictor")
    read(record, predictor, "window longest longest_curve")
    times, places = list(value(predictor, "stamps")), list(value(predictor, "positions"))
    record.count = len(times)
    put(record, "times", times)
    put(record, "places", places)
