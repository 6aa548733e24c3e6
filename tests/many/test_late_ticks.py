"""A body with several pairs whose ticks come late, as in real time, and whose pairs begin one after another."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from hapnet.assembly.build import compiled_ends, device_session, device_side
from hapnet.control.coupling import Ends
from hapnet.ext.many.bodies import EdgeDevice, EdgeEnds, HeldBody
from hapnet.ext.many.graph import graph_of
from hapnet.ext.many.hands import graph_setups
from hapnet.ext.many.shared_bodies import body_of
from hapnet.plant.device import SimulatedDevice
from hapnet.recording.samples import DeviceSample, Sample
from hapnet.side.device import DeviceSide
from hapnet.side.endpoint import DeviceEndpoint
from tests.many.accounts import PAPER, Lead, table

MS = 1_000_000
TRUSTED = 0.3  # Ns/m
LATE_NS = [round(at_ms * MS) for at_ms in (1, 2, 3.4, 4.0, 4.4, 5.6, 17.0, 17.3, 18, 19.4, 20.6, 42.0, 43)]
"""When the ticks come: up to 0.6 ms late, two within a period, and after stalls of 11 and 21 ms."""


def pieces() -> tuple[HeldBody, EdgeDevice, EdgeDevice]:
    body = HeldBody(SimulatedDevice(Lead()), waits=False)
    one, other = (EdgeDevice(body, SimulatedDevice(Lead(), mass=mass, damping=mass)) for mass in (0.01, 0.02))
    return body, one, other


def forces() -> Iterator[np.ndarray]:
    rng = np.random.default_rng(3)
    while True:
        yield rng.uniform(-1.0, 1.0, (2, 3))


def test_it_moves_by_the_periods_that_were_missed_and_each_pair_counts_its_own_force() -> None:
    """Beside one device alone, under the sum of the forces, for as many periods as have passed."""
    body, *edges = pieces()
    alone, made = SimulatedDevice(Lead()), 0
    for edge in edges:
        edge.read()
    work = 0.0
    for now_ns, both in zip(LATE_NS, forces(), strict=False):
        held = [np.array(edge.state.torque) for edge in edges]
        due = round((now_ns - LATE_NS[0]) / MS) + 1
        by_hand, before = sum(alone.advance() for _ in range(due - made)), np.array(alone.position)
        made = due
        for edge, own, others in zip(edges, held, reversed(held), strict=True):
            begin = np.array(edge.position)
            rest = sum(edge.advance() for _ in range(edge.shared_periods(now_ns)))
            moved = np.array(edge.position) - begin
            assert np.array(edge.position) == pytest.approx(before, abs=1e-14)
            assert rest == pytest.approx(by_hand + others @ moved, rel=1e-9, abs=1e-15)
            work -= own @ moved
        for edge, own in zip(edges, both, strict=True):
            edge.apply(tuple(own))
        alone.apply(tuple(both.sum(axis=0)))
    assert made == 43
    assert body.work_J == pytest.approx(work, rel=1e-12)
    assert abs(work) > 1e-5


def test_a_pair_that_comes_later_finds_the_body_where_it_is() -> None:
    body, first, late = pieces()
    first.read()
    for k in range(1, 500):
        for _ in range(first.shared_periods(k * MS)):
            first.advance()
        first.apply((0.5, 0.0, 0.0))
    x, _ = late.read()
    assert x == first.position
    assert np.linalg.norm(x) > 1e-3
    began = np.array(x)
    rest = sum(late.advance() for _ in range(late.shared_periods(500 * MS)))
    assert first.shared_periods(500 * MS) == 1
    moved = np.array(late.position) - began
    hand = first.advance()
    assert rest - hand == pytest.approx(np.array([0.5, 0.0, 0.0]) @ moved, rel=1e-9)
    assert body.motion[0] == late.position


class Pairs:
    """The sides of a device with two unequal pairs whose worlds are at the start and say nothing."""

    def __init__(self, faster: Ends) -> None:
        device = {**PAPER["device"], "trusted_damping": TRUSTED, "own_damping": TRUSTED}
        given = table([(0, 1), (0, 2)], **{**PAPER, "device": device})
        given["edges"][0]["share"], given["edges"][1]["share"] = 0.6, 0.3
        graph, self.now_ns = graph_of(given), 0
        setups = graph_setups(graph, lambda params: params)
        body = body_of(graph, graph.nodes["n0"], setups, lambda params: params, Lead(), waits=False)
        assert isinstance(body, HeldBody)
        self.body, self.sides, self.written = body, list[DeviceSide](), dict[str, list[Sample]]()
        for name, setup in setups.items():
            endpoint, kept = DeviceEndpoint(device_session(setup, 1)), self.written.setdefault(name, [])
            shared = replace(setup, ends=EdgeEnds(body, faster))
            side = device_side(shared, endpoint, lambda: self.now_ns, kept.append)
            endpoint.pair(False)
            self.sides.append(side)

    def tick(self, now_ns: int, first: int = 0) -> None:
        self.now_ns = now_ns
        for side in self.sides[first:]:
            side.tick(now_ns)


@pytest.mark.parametrize("compiled", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_both_halves_hold_over_late_ticks_and_their_work_is_force_times_way(compiled: bool) -> None:
    """And that of the damping which they trust, which is at most b dx^2/t over the time t that the device has lived."""
    if compiled:
        pytest.importorskip("numba")
        from hapnet.ext.compiled import real_time

        real_time.make_ready(real_time.named(real_time.SERVO, 3))
    pairs, rng, now_ns = Pairs(compiled_ends() if compiled else Ends()), np.random.default_rng(5), 0
    for k in range(3000):
        late = rng.exponential(0.2) if k % 100 else rng.uniform(2.0, 15.0)
        now_ns = max(now_ns + MS // 5, round((now_ns // MS + 1 + late) * MS))
        pairs.tick(now_ns)
    total = 0.0
    for share, samples, side in zip((0.6, 0.3), pairs.written.values(), pairs.sides, strict=True):
        kept = [one for one in samples if isinstance(one, DeviceSample)]
        force, x = (np.array([getattr(one, name) for one in kept]) for name in ("force_N", "position_m"))
        moved, counted = np.diff(x, axis=0), np.diff([one.work_J for one in kept])
        by_force = -np.sum(force[:-1] * moved, axis=1)
        times = np.array([one.time_ns for one in kept])
        lived_s = 1e-3 * np.diff(np.round((times - times[0]) / MS))
        most = np.divide(share * TRUSTED * np.sum(moved**2, axis=1), lived_s, where=lived_s > 0.0, out=0.0 * by_force)
        assert np.all(counted >= by_force - 1e-12)
        assert np.all(counted <= by_force + most * (1.0 + 1e-9) + 1e-12)
        assert np.sum(counted - by_force) > 0.5 * np.sum(most)
        assert min(one.slack_J for one in kept) >= -1e-12
        assert side.true_slack is not None
        assert side.true_slack >= -1e-12
        assert np.abs(force).max() > 0.3
        total += kept[0].work_J + float(np.sum(by_force))
    assert pairs.body.work_J == pytest.approx(total, rel=1e-9, abs=1e-9)
