"""Records ticks and steps as rows of numbers, with the fields of a `DeviceSample` or a `WorldSample`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, TypeAlias

from hapnet.control import contact_equations, set_position_coupling as couplings
from hapnet.control.ledger import Ledger
from hapnet.ext.compiled.endpoint import Wire
from hapnet.ext.compiled.sides import DeviceSideRecord, WorldSideRecord
from hapnet.mechanics import spring as springs
from hapnet.plant.device import Hand
from hapnet.recording.samples import VECTORS, DeviceSample, WorldSample
from hapnet.records.record import OfAxes, Record, equation
from hapnet.records.vectors import copy
from hapnet.wire.path import age_s, transit_s

MOST = 2048
"""The number of samples of each side that may wait for the recorder."""


def row_of(kind: type[NamedTuple]) -> type[Record]:
    """The record class with the fields of a kind of sample."""
    types = {name: OfAxes if name in VECTORS else float for name in kind._fields}
    return type(kind.__name__, (Record,), {"__annotations__": {**types, "time_ns": int}})


if TYPE_CHECKING:
    DeviceRow: TypeAlias = Any
    WorldRow: TypeAlias = Any
else:
    DeviceRow, WorldRow = row_of(DeviceSample), row_of(WorldSample)


class Rows(Record):
    """The samples of both sides.

    every : ticks between two samples. device_rows, world_rows : the number of samples of each side.
    """

    every: int
    device_rows: int
    world_rows: int
    at_device: Annotated[Sequence[DeviceRow], (MOST,)]
    at_world: Annotated[Sequence[WorldRow], (MOST,)]


@equation
def have_room(rows: Rows) -> bool:
    """Whether there is room for one more sample of each side."""
    return rows.device_rows < MOST and rows.world_rows < MOST


@equation
def record_tick(rows: Rows, side: DeviceSideRecord, wire: Wire, hand: Hand, now_ns: int) -> None:
    """Add a row with the fields of a `DeviceSample`."""
    device, n, row = side.plant, side.plant.dof, rows.at_device[rows.device_rows]
    rows.device_rows += 1
    copy(n, device.read_position, row.position_m)
    copy(n, device.read_velocity, row.velocity_mps)
    copy(n, side.servo.held, row.force_N)
    copy(n, device.state.hand_force, row.operator_force_N)
    copy(n, hand.path[hand.at], row.operator_target_m)
    row.operator_work_J = side.hand.work
    of_device(row, side, n)
    _count(row, side.coupling.ledger, wire, now_ns)


@equation
def record_step(rows: Rows, side: WorldSideRecord, wire: Wire, now_ns: int) -> None:
    """Add a row with the fields of a `WorldSample`."""
    mass, n, row = side.mass, side.mass.n, rows.at_world[rows.world_rows]
    rows.world_rows += 1
    copy(n, mass.x, row.position_m)
    copy(n, mass.v, row.velocity_mps)
    copy(n, mass.coupling_force, row.coupling_force_N)
    copy(n, mass.force, row.contact_force_N)
    row.step_s, row.penetration_m = side.stepped.last_s, mass.penetration
    of_world(row, side, n)
    _count(row, side.coupling.ledger, wire, now_ns)


@equation
def of_device(row: DeviceRow, side: DeviceSideRecord, n: int) -> None:
    """Fill in the fields of a coupling of set-positions. `within` : its force is not held."""
    coupling, servo, state, x = side.coupling, side.servo, side.plant.state, row.position_m
    spring, ybar, within = coupling.modulator.spring, coupling.modulator.ybar, side.plant.state.coupled != 0
    copy(n, ybar, row.set_position_m)
    copy(n, coupling.aim, row.target_m)
    springs.force(spring, x, ybar, row.spring_force_N)
    if within:
        copy(n, state.actuator_force, row.force_N)
        copy(n, state.velocity, row.velocity_mps)
        row.operator_work_J = coupling.ledger.work
    for i in range(n):
        own = -servo.damping[i] * servo.velocity[i]
        row.damper_force_N[i] = row.force_N[i] - row.spring_force_N[i] if within else own
        row.model_force_N[i] = row.added_damping_force_N[i] = 0.0
    if side.model.in_use:
        contact_equations.share(side.model, spring, x, ybar, row.model_force_N, row.added_damping_force_N)
    row.reservoir_J, row.deficit_J = coupling.modulator.energy, coupling.modulator.deficit
    row.potential_J = couplings.potential(coupling, x)


@equation
def of_world(row: WorldRow, side: WorldSideRecord, n: int) -> None:
    """Fill in the fields of a coupling of set-positions."""
    coupling = side.coupling
    copy(n, coupling.modulator.ybar, row.set_position_m)
    copy(n, coupling.aim, row.target_m)
    row.reservoir_J, row.potential_J = coupling.modulator.energy, couplings.potential(coupling, side.mass.x)


@equation
def _count(row: DeviceRow | WorldRow, ledger: Ledger, wire: Wire, now_ns: int) -> None:
    """Fill in the time, age and transit of the newest sample in use (as `ControlHalf.used`), and the account."""
    used = wire.endpoint.used
    row.time_ns, row.age_s, row.transit_s = now_ns, age_s(used, now_ns), transit_s(used)
    row.sent_J, row.credited_J, row.margin_J, row.slack_J = ledger.sent, ledger.credited, ledger.margin, ledger.slack
    row.bound_J, row.work_J, row.stored_J, row.account_J = ledger.bound, ledger.work, ledger.stored, ledger.reservoir
