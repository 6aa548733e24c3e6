"""The world's side, to and from the kernel."""

from __future__ import annotations

from hapnet.control.prediction import PredictedDevice
from hapnet.control.set_position_coupling import SetPositionCoupling
from hapnet.kernel import integrator, sides, walls
from hapnet.kernel.memory import load, store
from hapnet.plant.integrator import PassiveIntegrator
from hapnet.plant.worlds.account import EnvironmentAccount
from hapnet.plant.worlds.walls import Contacts
from hapnet.side.world import WorldSide, WorldState
from hapnet.simulation.compiled.mirror import put, read, value, vector


def read_side(record: sides.WorldSide, side: WorldSide) -> None:
    coupling, contacts = coupling_of(side), side.scene.contacts
    assert isinstance(contacts, Contacts)
    _mass(record.mass, _integrator(side))
    _contacts(record.contacts, contacts)
    store(record.coupling, coupling)
    read(record.environment, environment_of(side).state(), "start_J stored_J slack_min")
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
    coupling, n = coupling_of(side), record.mass.n
    load(coupling, record.coupling)
    environment = environment_of(side)
    stored, least = float(record.environment.stored_J), float(record.environment.slack_min)
    environment.restore(environment.state()._replace(stored_J=stored, slack_min=least))
    _integrator(side).restore(vector(record.mass, "x", n), vector(record.mass, "v", n))
    side.restore(
        WorldState(int(counts.steps), float(counts.stepped_s), float(counts.longest_step_s), int(counts.world_last_ns))
    )


def _mass(record: integrator.PassiveIntegrator, mass: PassiveIntegrator) -> None:
    record.n = len(mass.position)
    put(record, "x", mass.position)
    put(record, "v", mass.velocity)
    for i, row in enumerate(mass.terms):
        for j, (double_mass, damping, half_stiffness) in enumerate(row):
            record.M[i][j] = record.M[j][i] = double_mass / 2.0
            record.B[i][j] = record.B[j][i] = damping
            record.K[i][j] = record.K[j][i] = 2.0 * half_stiffness
    record.is_diagonal = int(value(mass, "diagonal"))


def _contacts(record: walls.Contacts, contacts: Contacts) -> None:
    record.axes, record.walls = len(contacts.axes), len(contacts.walls)
    for k, axis in enumerate(contacts.axes):
        record.normal[k][: len(axis.normal)] = axis.normal
        for end in ("upper", "lower"):
            face = getattr(axis, end)
            for name in ("at", "stiffness", "damping"):
                getattr(record, f"{end}_{name}")[k] = getattr(face, name)
    for k, wall in enumerate(contacts.walls):
        record.wall_normal[k][: len(wall.normal)] = wall.normal
        record.wall_offset[k], record.wall_stiffness[k] = wall.offset, wall.stiffness
