"""A seat whose device has gone is filled again: out of what the blocks have dissipated, never out of nothing."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

from hapnet.ext.many.graph import graph_of
from hapnet.ext.many.reservoirs import SeatAccount
from hapnet.ext.many.run import GraphSimulation
from hapnet.side.endpoint import NANO
from hapnet.simulation.simulation import Simulation
from tests.many.test_killed_devices import Seen, run
from tests.support.carrying_hands import Carrier
from tests.support.restarted_devices import Device

pytestmark = pytest.mark.long  # whole runs of several pairs, or many steps

REFILL_S, CEILING_J = 5.0, 0.05
"""The defaults: longer than any device in these runs is gone before it comes back."""


class Port:
    """The work of the blocks on a seat's proxy, as force times way of all its steps [J]."""

    def __init__(self, pair: Simulation) -> None:
        self.work, self._place = 0.0, np.array(pair.world.mass.position)
        self._write, pair.world._write = pair.world._write, self._see

    def _see(self, sample: Any) -> None:
        if hasattr(sample, "contact_force_N"):
            place = np.array(sample.position_m)
            self.work += float(np.dot(sample.contact_force_N, place - self._place))
            self._place = place
        self._write(sample)


class Watched:
    """A run with killed devices, and the work at each seat's port beside its own accounts."""

    def __init__(self, kills: int, **of_world: object) -> None:
        self.ports: list[Port] = []
        self.seen: Seen = run(kills, seen=self._watch, **of_world)
        self.devices: list[Device] = self.seen.devices
        self.simulation: GraphSimulation = self.seen.simulation
        self.shared: Any = self.devices[0].pair.setup.scene.shared

    def _watch(self, simulation: GraphSimulation) -> None:
        self.ports = [Port(pair) for pair in simulation.pairs.values()]

    def go_on(self, seconds: float) -> None:
        self.simulation._reach(self.simulation.now_ns + round(seconds / NANO))

    @property
    def dissipated_J(self) -> float:
        """What the blocks have dissipated, by the ports: refills are not in it."""
        return -sum(port.work for port in self.ports) - self.shared.stored_J

    @property
    def seats(self) -> list[SeatAccount]:
        """The seats' accounts."""
        world = next(iter(self.simulation._world_of.values()))
        return [world.reservoirs.accounts[device.pair.world] for device in self.devices]

    @property
    def couplings(self) -> list[Any]:
        """The world's ends."""
        return [device.pair.world_endpoint.coupling for device in self.devices]

    @contextmanager
    def others_kept(self) -> Iterator[None]:
        """A context that adds no joule to any bound, and in which all accounts hold."""
        bounds = [coupling.ledger.bound for coupling in self.couplings]
        yield
        assert [coupling.ledger.bound for coupling in self.couplings] == bounds
        self.assert_accounts()

    def assert_accounts(self) -> None:
        """Each half's slack, each pair's margin, and the blocks' one account: both sides of each beside the ports."""
        refilled = sum(seat.refilled_J for seat in self.seats)
        account = self.shared.account
        left = -sum(seat.work for seat in self.shared.seats) - (account.stored_J - account.start_J)
        assert left == pytest.approx(self.dissipated_J - refilled, abs=1e-12)
        assert account.slack_min >= -1e-12
        for device, port, seat, coupling in zip(self.devices, self.ports, self.seats, self.couplings, strict=True):
            own = seat.refilled_J + seat.got_J - seat.given_J
            assert coupling.ledger.work == pytest.approx(port.work + own, abs=1e-12)
            assert coupling.ledger.slack_min >= -1e-12
            assert device.pair.device_endpoint.coupling.ledger.slack_min >= -1e-12


def test_an_idle_seat_is_filled_by_no_more_than_what_the_blocks_have_dissipated() -> None:
    watched = Watched(2)
    with watched.others_kept():
        assert [seat.refilled_J for seat in watched.seats] == [0.0] * 4  # who comes back soon finds what was left
        number = int(np.argmin([coupling.reservoir for coupling in watched.couplings]))
        one, coupling, seat = watched.devices[number], watched.couplings[number], watched.seats[number]
        one.kill()
        watched.go_on(REFILL_S)  # from its last message on: the time of a silence is not over yet
        before, there = coupling.reservoir, watched.dissipated_J
        assert seat.refilled_J == 0.0
        assert 0.0 < there < CEILING_J - before  # so D is the bound, and a refill out of nothing would be seen
        watched.go_on(1.0)
        given = seat.refilled_J
        assert coupling.reservoir - before == pytest.approx(given, abs=1e-15)
        assert there <= given <= watched.dissipated_J + 1e-15
        assert sum(each.refilled_J for each in watched.seats) == given  # the others have a device
        one.start()
        held, sent = coupling.reservoir, coupling.ledger.sent
        watched.go_on(0.3)
        assert one.pair.device_endpoint.session.credited_nJ * NANO >= 0.5 * held - 1e-9 > 0.0
        assert coupling.ledger.sent - sent >= 0.5 * held - 1e-9


@pytest.mark.slow
@pytest.mark.parametrize(("refill_s", "fills"), [(0.0, False), (1.0, True)])
def test_0_means_never(refill_s: float, fills: bool) -> None:
    watched = Watched(1, seat_refill_s=refill_s)
    with watched.others_kept():
        watched.devices[0].kill()
        watched.go_on(4.0)
        assert (watched.seats[0].refilled_J > 0.0) is fills


def test_among_walls_each_seat_has_only_what_its_own_walls_have_dissipated() -> None:
    hands = {"one": Carrier(0, -1.0), "other": Carrier(0, -1.0)}
    nodes = {name: {"kind": "device", "operator": "rest"} for name in hands}
    edges = [{"from": name, "to": "room", "link": "delay 20ms"} for name in hands]
    room = {"kind": "world", "scene": "wall", "dof": 3, "world": {"seat_refill_s": 1.0}}
    simulation = GraphSimulation(graph_of({"nodes": {**nodes, "room": room}, "edges": edges}), hands=hands)
    one = Device(simulation, "one-room")
    port = Port(one.pair)

    def go_on(seconds: float) -> None:
        simulation._reach(simulation.now_ns + round(seconds / NANO))

    go_on(4.0)
    for _ in range(4):
        one.kill()
        go_on(0.4)  # the newcomer takes half of what the seat has
        one.start()
        go_on(0.6)
    one.kill()
    coupling, account = one.pair.world_endpoint.coupling, one.pair.world.environment
    before = coupling.reservoir
    go_on(3.0)
    given = next(iter(simulation._world_of.values())).reservoirs.accounts[one.pair.world].refilled_J
    assert 0.0 < given <= -port.work + 1e-15  # the walls' springs have given back all that they had
    assert coupling.ledger.work == pytest.approx(port.work + given, abs=1e-12)
    assert account.slack_min >= -1e-12
    assert coupling.ledger.slack_min >= -1e-12
    assert coupling.reservoir == pytest.approx(before + given, rel=1e-3)  # no spring pulls harder at who has left


@pytest.mark.soak
def test_after_fifty_kills_a_seat_is_worth_sitting_down_in() -> None:
    watched = Watched(50)
    with watched.others_kept():
        assert [seat.refilled_J for seat in watched.seats] == [0.0] * 4
        assert min(coupling.reservoir for coupling in watched.couplings) < 1e-3  # that is what refills are for
        watched.devices[0].kill()
        watched.go_on(10.0)
        assert watched.couplings[0].reservoir >= 0.02
        for device in watched.devices[1:]:
            device.kill()
        watched.go_on(12.0)
        assert sum(seat.refilled_J for seat in watched.seats) == pytest.approx(watched.dissipated_J, abs=1e-12)
