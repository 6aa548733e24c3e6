"""Energy bounding: whatever comes over the network and whatever the hand does, its port gives nothing out."""

import numpy as np
import pytest

from hapnet.ext.laws.eba import EnergyBounding
from hapnet.ext.laws.parts.virtual_coupling import NEVER, Reset
from hapnet.mechanics.spring import Spring
from tests.conftest import mostly_slow
from tests.support.hand_port import LIGHT_HAND, lowest_energies
from tests.support.paper import PAPER

T = 0.001
b = 0.3


def bounding(
    dof: int = 1, *, own: float = b, resolution: float = 0.0, K: float = 500.0, reset: Reset = NEVER
) -> EnergyBounding:
    return EnergyBounding(
        Spring(K, dof), (0.1,) * dof, (0.0,) * dof, own_damping=own, period=T, resolution=resolution, reset=reset
    )  # fmt: skip


class Port:
    """The hand's port of a device without mass that damps by `b`, moved at a constant speed within a tick."""

    def __init__(self) -> None:
        self.energy = self.lowest = 0.0

    def move(self, force: float, dx: float, dt: float, damping: float = b) -> None:
        """While `force` is held; within the tick the energy is a parabola of time for dx, its ends and its middle."""
        for part in (0.5, 1.0):
            self.lowest = min(self.lowest, self.energy + part * (damping * dx * dx / dt - force * dx))
        self.energy += damping * dx * dx / dt - force * dx


def test_it_counts_what_was_really_held_and_what_the_device_damped() -> None:
    """2 mm in 1 ms against 1.5 N: 0.3 4e-6 / 0.001 + 3 mJ; 1 mm in 2 ms with 1 N gives 1 mJ back, less 0.15."""
    law = bounding()
    law.force(T, (0.002,), (0.0,), (-1.5,))
    assert law.energy == pytest.approx((0.0012 + 0.003,))
    law.release(2 * T, (0.003,), (1.0,))
    assert law.energy == pytest.approx((0.0042 - 0.001 + 0.00015,))
    assert law.set_position == (0.003,)
    law = bounding(2)
    law.force(T, (0.002, 0.001), (0.0, 0.0), (-1.5, 0.5))
    assert law.energy == pytest.approx((0.0042, 0.0003 - 0.0005))


def test_the_force_is_clipped_to_what_the_damping_pays() -> None:
    """E = 1.2 mJ: sqrt(4 0.0012 0.3 / 0.001) = 1.2 N, of the 5 that the spring asks for, either way."""
    for y in (0.012, -0.008):
        law = bounding()
        law.receive((y,))
        force = law.force(T, (0.002,), (0.0,), (0.0,))[0]
        assert abs(force) == pytest.approx(1.2)
        assert force * y > 0.0
    law = bounding(K=10.0)
    law.receive((0.012,))
    assert law.force(T, (0.002,), (0.0,), (0.0,)) == pytest.approx((0.1,))  # and left alone below that


def test_it_renders_nothing_before_anything_was_paid_and_minds_each_axis() -> None:
    law = bounding(2)
    law.receive((0.05, 0.05))
    assert law.force(T, (0.0, 0.0), (0.0, 0.0), (0.0, 0.0)) == (0.0, 0.0)
    first, second = law.force(T, (0.002, 0.0), (0.0, 0.0), (0.0, 0.0))
    assert first == pytest.approx(1.2)
    assert second == 0.0
    law.force(0.0, (0.002, 0.0), (0.0, 0.0), (0.0, 0.0))  # no time has passed, nothing was damped
    assert law.energy == pytest.approx((0.0012, 0.0))


def wander(
    law: EnergyBounding, seed: int, *, damping: float = b, maximum: float = T, ticks: int = 3000, greed: float = 0.7
) -> tuple[Port, float]:
    """Random positions come; the hand moves at random, or (`greed`) as takes the most out: dx = F dt / 2b.

    Also the largest F^2 (dt - T) / 4b of a tick longer than T.
    """
    rng = np.random.default_rng(seed)
    port = Port()
    x = force = debt = 0.0
    for n in range(ticks):
        if rng.random() < 0.05:
            law.receive((x + float(rng.normal(0.0, 0.02)),))
        dt = float(rng.uniform(0.2 * T, maximum)) if n % 3 else maximum
        dx = force * dt / (2.0 * damping) if rng.random() < greed else float(rng.normal(0.0, 0.1)) * dt
        port.move(force, dx, dt, damping)
        debt = max(debt, force * force * (dt - T) / (4.0 * damping))
        x += dx
        force = law.force(dt, (x,), (dx / dt,), (max(-3.3, min(force, 3.3)),))[0]
        force = max(-3.3, min(force, 3.3))
    return port, debt


@pytest.mark.parametrize("seed", range(20))
def test_the_hands_port_is_passive_whatever_the_network_and_the_hand_do(seed: int) -> None:
    port, _ = wander(bounding(), seed)
    assert port.lowest >= -1e-12


def test_from_a_reset_on_a_push_renders_two_b_over_T() -> None:
    """F_n^2 = (4b/T) E_n = F_{n-1}^2 + 4 b v F_{n-1} + (2 b v)^2: 2 b v a tick, 600 N/m of a wall that is stiffer."""
    v, stiff = 0.05, bounding(K=1e6)
    force: tuple[float, ...] = (0.0,)
    for n in range(1, 101):
        force = stiff.force(T, (v * T * n,), (v,), force)
        assert force[0] == pytest.approx(-2.0 * b * v * n, rel=1e-9)
    softer = bounding(K=500.0)
    force = (0.0,)
    for n in range(1, 101):
        force = softer.force(T, (v * T * n,), (v,), force)
    assert force[0] == pytest.approx(-500.0 * v * T * 100 - 0.1 * v)  # one that is not is left alone


@pytest.mark.parametrize(("reset", "given"), [(NEVER, True), (Reset(0.05, 0.1), False)], ids=["never", "after 0.1 s"])
def test_what_was_paid_for_one_wall_does_not_pay_for_the_next_pull(reset: Reset, given: bool) -> None:
    """The hand presses 10 mm into a wall, which vanishes; after 0.2 s without force the network pulls."""
    law, port = bounding(reset=reset), Port()
    x = force = 0.0

    def tick(dx: float) -> None:
        nonlocal x, force
        port.move(force, dx, T)
        x += dx
        force = law.force(T, (x,), (dx / T,), (force,))[0]

    for _ in range(200):
        tick(5e-5)
    law.receive((x,))
    for _ in range(200):
        tick(0.0)
    paid = port.energy
    assert paid > 0.02  # 1/2 K x^2 = 25 mJ, but for the first ticks
    law.receive((x + 0.1,))
    for _ in range(500):
        tick(force * T / (2.0 * b))  # as takes the most out
    assert (port.energy < 0.5 * paid) is given
    assert given or port.energy >= paid - 1e-12


@pytest.mark.parametrize("seed", range(5))
def test_it_is_not_if_the_device_damps_less_than_is_trusted(seed: int) -> None:
    port, _ = wander(bounding(), seed, damping=0.5 * b)
    assert port.energy < -0.1


@pytest.mark.parametrize("seed", range(5))
def test_late_ticks_leave_a_debt_that_does_not_add_up(seed: int) -> None:
    port, debt = wander(bounding(), seed, maximum=1.5 * T)
    assert debt > 0.0
    assert port.lowest >= -debt - 1e-12


@pytest.mark.parametrize("seed", range(10))
def test_counts_do_not_leak(seed: int) -> None:
    """The law sees whole counts; the port's energy is that of the true positions, chatter about a count's edge too."""
    r = 5.5e-5
    law, port = bounding(resolution=r), Port()
    rng = np.random.default_rng(seed)
    x = counted = force = 0.0
    for n in range(4000):
        if n % 20 == 0:
            law.receive((x + float(rng.normal(0.0, 0.02)),))
        edge = (round(x / r) + (0.5 if force > 0.0 else -0.5)) * r
        if n % 400 < 100:  # charges it
            dx = float(rng.normal(0.0, 0.1)) * T
        elif rng.random() < 0.5:  # to either side of the nearest edge, the force's way
            dx = edge - x + float(rng.choice([-1.0, 1.0])) * 1e-9
        else:
            dx = force * T / (2.0 * b)
        port.move(force, dx, T)
        x += dx
        before, counted = counted, r * round(x / r)
        force = max(-3.3, min(3.3, law.force(T, (counted,), ((counted - before) / T,), (force,))[0]))
    assert port.lowest >= -1e-12


def test_motion_within_a_count_is_paid_for() -> None:
    """A network that knows it pulls whichever way the hand moves, by less than the encoder sees: 0.9 r to and fro."""
    r = 5.5e-5
    law, port = bounding(resolution=r), Port()
    x = force = 0.0
    for _ in range(5):  # the hand pays first
        port.move(force, 37 * r, T)
        x += 37 * r
        force = law.force(T, (x,), (0.0,), (force,))[0]
    port.move(force, 0.45 * r, T)
    force = law.force(T, (x,), (0.0,), (force,))[0]
    given = port.energy
    for n in range(3000):
        to = 1.0 if n % 2 else -1.0
        port.move(force, to * 0.9 * r, T)
        law.receive((x - 0.02 * to,))  # the next move goes back
        force = law.force(T, (x,), (0.0,), (force,))[0]
    assert port.energy < 0.5 * given  # it does take what it can
    assert port.lowest >= -1e-12


def test_what_counts_hide_is_taken_off() -> None:
    """r = 0.1 mm: r/2 of the 2 N that the force changed by, and r/2 of the 2 N held when the next is bounded."""
    law = bounding(resolution=1e-4)
    law.force(T, (0.0021,), (0.0,), (0.0,))
    assert law.energy == pytest.approx((0.3 * 0.002**2 / T,))
    law.receive((1.0,))
    force = law.force(T, (0.0021,), (0.0,), (2.0,))[0]
    assert law.energy == pytest.approx((0.0012 - 0.0001,))
    assert force == pytest.approx((4.0 * (0.0011 - 0.0001) * 0.3 / T) ** 0.5)


def test_chatter_of_a_count_is_not_harvested() -> None:
    law = bounding(resolution=1e-4)
    for n in range(1000):
        law.force(T, (1e-4 * (n % 2),), (0.0,), (0.0,))
    assert law.energy == (0.0,)


@pytest.mark.parametrize(
    "link", mostly_slow(["delay 40ms 10ms loss 2%", "wan-intercontinental", "delay 20ms loss gemodel 5% 10%"], 1)
)
def test_in_a_light_hand_it_is_passive_on_links_where_the_plain_coupling_is_not(link: str) -> None:
    params = PAPER.set({**LIGHT_HAND, "link.up": link, "link.down": link})
    params = params.set({"device.stiffness": 500.0, "world.stiffness": 2500.0})
    hand, _, _ = lowest_energies(params.set({"coupling": "eba"}), seed=2)
    assert hand >= -1e-12
    assert lowest_energies(params.set({"coupling": "zoh"}), seed=2)[0] < -0.1


def test_in_a_light_hand_a_lie_shows() -> None:
    params = PAPER.set({**LIGHT_HAND, "coupling": "eba", "device.stiffness": 500.0, "world.stiffness": 2500.0})
    params = params.set({"device.own_damping": 0.02, "eba.damping": 3.0})
    assert lowest_energies(params, seed=2)[0] < -1.0
