"""How full a reservoir is, and what goes to an emptier one: nothing is created, and the reserve stays."""

from collections import deque

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from hapnet.control.coupling import PositionSample, ProxySample
from hapnet.control.limits import Silence
from hapnet.control.pspm import SetPositionModulator
from hapnet.control.reservoir_level import MARGIN, SHARING_S, gift, level
from hapnet.control.set_position_coupling import SetPositionCoupling
from hapnet.control.smoothing import Pipeline

TICK = 1e-3
K = 100.0


def side(energy: float, ceiling: float = 0.05, reserve: float = 0.0, *, shares: bool = True) -> SetPositionCoupling:
    modulator = SetPositionModulator(
        stiffness=K, position=[0.0], ceiling=ceiling, energy=energy, reserve=reserve, injects=False
    )
    return SetPositionCoupling(modulator, stages=Pipeline([]), silence=Silence("hold", 0.5), shares=shares)


def test_the_level_is_the_share_that_can_be_spent() -> None:
    assert level(0.03, 0.0, 0.01, 0.05, False) == pytest.approx(0.5)  # 20 of 40 mJ
    assert level(0.02, 0.02, 0.0, 0.05, False) == pytest.approx(0.8)  # with what comes back
    assert level(0.05, 0.05, 0.0, 0.05, False) == 1.0
    assert level(0.005, 0.0, 0.01, 0.05, False) == 0.0
    assert level(0.05, 0.0, 0.0, 0.05, True) == 0.0  # it did not suffice
    assert level(0.0, 0.0, 0.0, 0.0, False) == 1.0  # it can keep nothing


numbers = st.floats(0.0, 1.0)


@given(numbers, numbers, numbers, numbers, st.floats(0.0, 10.0))
@pytest.mark.long
def test_a_gift_is_never_more_than_can_be_spared(own: float, peer: float, room: float, spare: float, dt: float) -> None:
    given_J = gift(dt, own, peer, room, spare - 0.5)
    assert 0.0 <= given_J <= max(0.0, spare - 0.5)
    assert given_J <= room * max(0.0, own - peer)
    if own <= peer + MARGIN:
        assert given_J == 0.0
    assert gift(dt, own, -1.0, room, spare) == 0.0  # the peer does not report one


@settings(max_examples=60)
@given(st.integers(0, 2**32 - 1))
@pytest.mark.long
def test_no_update_creates_energy_whatever_levels_are_told(seed: int) -> None:
    """E + phi after = E + phi before + received + D - sent - discarded, to rounding."""
    rng = np.random.default_rng(seed)
    reserve = float(rng.uniform(0.0, 0.02))
    one = side(float(rng.uniform(0.02, 0.05)), reserve=reserve)
    x = 0.0
    for _ in range(200):
        x += float(rng.normal(0.0, 1e-3))
        if rng.random() < 0.3:
            reported = PositionSample((float(rng.normal(0.0, 0.02)),), float(rng.random()))
            one.receive(reported, float(rng.random()), 0.0)
        if rng.random() < 0.1:
            one.credit(received := float(rng.uniform(0.0, 0.01)))
        else:
            received = 0.0
        dissipated = float(rng.normal(1e-4, 1e-4))
        before = one.account + one.potential((x,))
        done = one.update(TICK, (x,), dissipated)
        after = one.account + one.potential((x,))
        assert after == pytest.approx(before + received + dissipated - done.sent - done.discarded, abs=1e-15)
        assert one.account >= -one.deficit
        assert done.sent >= 0.0
        assert done.discarded >= 0.0


@pytest.mark.long
def test_what_a_side_gives_stays_above_its_reserve() -> None:
    """A peer that reports for ever that it is empty gets all but the reserve and the margin."""
    one = side(0.05, reserve=0.02)
    sent = 0.0
    for k in range(20_000):
        one.receive(PositionSample((0.0,), 0.0), 1.0 + k, 0.0)
        sent += one.update(TICK, (0.0,), 0.0).sent
    kept = 0.02 + MARGIN * 0.03
    assert one.reservoir == pytest.approx(kept, rel=1e-3)
    assert sent == pytest.approx(0.05 - kept, rel=1e-3)


def test_what_covers_a_held_force_is_not_given_away() -> None:
    """45 of 50 mJ must stay in spring and reservoir, as a force is held: 5 mJ can go, however empty the peer is."""
    modulator = SetPositionModulator(stiffness=K, position=[0.0], ceiling=0.05)
    modulator.modulate((0.0,), (0.0,), 0.0, 0.0, 0.045)
    assert modulator.give(SHARING_S, 0.0, 0.045) == pytest.approx(0.005)


@pytest.mark.parametrize("delay_s", [0.0, 0.05, 0.3])
@pytest.mark.long
def test_levels_approach_each_other_over_a_delay_and_nothing_is_lost(delay_s: float) -> None:
    """A full side and an empty one, both with 50 mJ of room: the full one gives until MARGIN is left between them. Over
    a delay it gives for so much longer; then the other one gives back."""
    sides = side(0.05), side(0.0)
    ticks = round(delay_s / TICK) + 1
    ways: tuple[deque[tuple[float, float]], ...] = deque([(1.0, 0.0)] * ticks), deque([(0.0, 0.0)] * ticks)
    total = 0.0
    for k in range(round(10.0 * SHARING_S / TICK)):
        for here, there in ((0, 1), (1, 0)):
            peer_level, energy = ways[there].popleft()
            if energy:
                sides[here].credit(energy)
            sides[here].receive(PositionSample((0.0,), peer_level), 1.0 + k, 0.0)
            sent = sides[here].update(TICK, (0.0,), 0.0).sent
            own = sides[here].level
            assert own is not None
            ways[here].append((own, sent))
        total = sum(one.account for one in sides) + sum(energy for way in ways for _, energy in way)
        assert total == pytest.approx(0.05, abs=1e-15)
    assert abs(sides[0].account - sides[1].account) / 0.05 < MARGIN + 0.02


def test_nothing_is_given_to_a_silent_peer() -> None:
    """Its last word was that it is empty; after the time of silence, 0.5 s here, that is no reason any more."""
    one = side(0.05)
    one.receive(PositionSample((0.0,), 0.0), 1.0, 0.0)
    sent = [one.update(TICK, (0.0,), 0.0).sent for _ in range(1500)]
    assert sum(sent[:400]) > 0.01
    assert sum(sent[502:]) == 0.0


def test_a_side_gives_of_what_it_has_and_not_of_what_is_lent() -> None:
    """20 of 50 mJ, and 30 in the spring: its level is 1, but it gives down to the margin above nothing, not more."""
    modulator = SetPositionModulator(stiffness=K, position=[0.0], ceiling=0.05, injects=True)
    modulator.modulate((np.sqrt(0.06 / K),), (0.0,), 0.0, 0.0)
    assert modulator.level == pytest.approx(1.0)
    given_J = sum(modulator.give(TICK, 0.0, 0.0) for _ in range(10_000))
    assert given_J == pytest.approx(0.02 - MARGIN * 0.05, rel=1e-3)


def test_what_is_given_is_a_share_of_the_room_above_the_reserve() -> None:
    """A full reservoir of 50 mJ, 20 of them a reserve: (50 - 20 mJ) (1 - 0 - margin) dt/tau."""
    modulator = SetPositionModulator(stiffness=K, position=[0.0], ceiling=0.05, reserve=0.02)
    modulator.modulate((0.0,), (0.0,), 0.0, 0.1)
    assert modulator.energy == 0.05
    assert modulator.give(TICK, 0.0, 0.0) == pytest.approx(0.03 * (1.0 - MARGIN) * TICK / SHARING_S, rel=1e-9)


def test_a_side_that_does_not_share_tells_nothing_and_gives_nothing() -> None:
    one = side(0.05, shares=False)
    assert one.level is None
    one.receive(PositionSample((0.0,), 0.0), 1.0, 0.0)
    assert one.update(1.0, (0.0,), 0.0).sent == 0.0


def test_a_new_peer_has_told_nothing() -> None:
    one = side(0.05)
    one.receive(ProxySample((0.0,), 0.0, (0.0,), (), 0.05, 0.0), 1.0, 0.0)
    assert one.peer_level == 0.0
    one.on_peer_changed()
    assert one.peer_level < 0.0


def test_a_modulated_set_position_is_counted_and_told() -> None:
    """100 mm would cost 500 mJ of the 50 that there are: 31.6 mm is what they pay for. Then 10 mm, which costs 5."""
    one = side(0.05)
    one.receive(PositionSample((0.1,), 1.0), 1.0, 0.0)
    one.update(TICK, (0.0,), 0.0)
    assert one.set_position[0] == pytest.approx(np.sqrt(2.0 * 0.05 / K))
    assert (one.level, one.modulated_share) == (0.0, 1.0)
    one.receive(PositionSample((0.01,), 1.0), 2.0, 0.0)
    one.update(TICK, (0.0,), 0.0)
    assert (one.level, one.modulated_share) == (pytest.approx(0.9), 0.5)


def test_a_modulated_set_position_recovers_while_the_peer_has_anything_to_give() -> None:
    """An empty side asks for 20 mm (20 mJ) at rest, where nothing is harvested; a full peer of 50 mJ reports its level
    and gives. The whole of y is there within three time constants of the exchange."""
    here, there = side(0.0), side(0.05)
    for k in range(round(3.0 * SHARING_S / TICK)):
        own, peers = here.level, there.level
        assert own is not None
        assert peers is not None
        there.receive(PositionSample((0.0,), own), 1.0 + k, 0.0)
        here.receive(PositionSample((0.02,), peers), 1.0 + k, 0.0)
        if sent := there.update(TICK, (0.0,), 0.0).sent:
            here.credit(sent)
        here.update(TICK, (0.0,), 0.0)
    assert here.set_position == (0.02,)
