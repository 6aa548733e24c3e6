"""Planes that are no longer sent: known until the world denies them. The lead, which yields to an empty reservoir."""

import math

import numpy as np
import pytest

from hapnet.checks import MOST_PLANES, Vector
from hapnet.control.added_damping import AddedDamping
from hapnet.control.contact_model import ContactModel
from hapnet.control.coupling import ProxySample
from hapnet.control.limits import Silence
from hapnet.control.self_motion import SelfMotion
from hapnet.control.set_position_coupling import SetPositionCoupling
from hapnet.control.smoothing import Pipeline
from hapnet.control.zoh import ZeroOrderHold
from hapnet.mechanics.plane import Plane
from hapnet.mechanics.spring import Spring
from hapnet.simulation.simulation import simulate
from tests.conftest import mostly_slow

K_WORLD, K_WALL, K, TICK = 500.0, 3000.0, 100.0, 1e-3
DAMPING = 1.4
"""What is added in free motion, all of which the lead cancels [Ns/m]."""
WALL = Plane((1.0,), 0.0, K_WALL, 10.0)
FAR, DEEP = (-0.1,), (0.007,)


def model(n: int = 1, *, remembers: bool = True, yields_below: float = 0.5) -> ContactModel:
    eye = np.eye(n)
    return ContactModel(
        FAR * n,
        compliance=(eye / K_WORLD).tolist(),
        lead=(eye * DAMPING / K).tolist(),
        self_motion=SelfMotion(),
        added=AddedDamping((eye * K).tolist(), (eye / K).tolist(), DAMPING, 5.0),
        remembers=remembers,
        yields_below=yields_below,
    )


def answer(
    m: ContactModel, planes: tuple[Plane, ...], place: Vector = FAR, reach_m: float | None = 0.05, level: float = 1.0
) -> None:
    m.receive(ProxySample(place, 1.0, (0.0,) * len(place), planes, reach_m, level), 0.0, 0.0)
    m.step(TICK, place)


def force(m: ContactModel, x: Vector, seconds: float = 0.2) -> float:
    """K (y - x) along the first axis after so long at rest [N]."""
    for _ in range(round(seconds / TICK)):
        y = m.step(TICK, x)
    return K * (y[0] - x[0])


FELT = -DEEP[0] / (1.0 / K + K_WORLD / (K * K_WALL))
"""Of 7 mm: the device's spring in series with the wall's, which is scaled by K/K'."""


def test_a_wall_that_was_met_is_felt_though_it_is_told_no_more() -> None:
    m = model()
    answer(m, (WALL,))
    answer(m, ())  # the proxy is 100 mm away, and has looked 50 mm far
    assert force(m, DEEP) == pytest.approx(FELT, rel=1e-6)


@pytest.mark.parametrize(("place", "reach_m"), [(FAR, 0.2), ((-0.04,), 0.05), ((0.01,), 0.0)])
def test_a_wall_is_gone_when_the_world_has_looked_there(place: Vector, reach_m: float) -> None:
    m = model()
    answer(m, (WALL,))
    answer(m, (), place, reach_m)
    assert force(m, DEEP) == pytest.approx(0.0, abs=1e-5)


def test_without_a_reach_only_the_newest_planes_count() -> None:
    """So with a world that does not say how far it has looked, and with remembering switched off."""
    for m, reach_m in ((model(), None), (model(remembers=False), 0.05)):
        answer(m, (WALL,))
        answer(m, (), reach_m=reach_m)
        assert force(m, DEEP) == pytest.approx(0.0, abs=1e-5)


def test_a_plane_that_moves_is_not_remembered() -> None:
    m = model()
    answer(m, (WALL._replace(velocity_mps=0.01),))
    answer(m, ())
    assert force(m, DEEP) == pytest.approx(0.0, abs=1e-5)


def test_a_plane_that_is_told_again_is_there_once() -> None:
    """Twice, it would be felt with twice the stiffness of the wall."""
    m = model()
    answer(m, (WALL,))
    answer(m, ())
    answer(m, (WALL,), (-0.04,))
    assert force(m, DEEP) == pytest.approx(FELT, rel=1e-6)


def test_a_release_of_the_spring_keeps_what_the_world_told() -> None:
    """The coupling releases its spring after a late tick; a new peer makes it start again."""
    for change, felt in (("release", FELT), ("on_peer_changed", 0.0)):
        m = model()
        c = SetPositionCoupling(
            ZeroOrderHold(Spring(K, 1), FAR, 0.0), stages=Pipeline([]), silence=Silence("hold", 0.5), source=m
        )
        answer(m, (WALL,))
        c.release(FAR, 0.0) if change == "release" else c.on_peer_changed()
        m.step(TICK, FAR)
        assert force(m, DEEP) == pytest.approx(felt, abs=1e-5)


def test_what_is_told_and_what_is_remembered_are_four_planes_together() -> None:
    """The plane at x = 30 mm is remembered beside three that are sent near z = 100 mm, and forgotten beside four."""
    beside = Plane((1.0, 0.0, 0.0), 0.03, K_WALL, 0.0)
    near = [Plane((0.0, 0.6, 0.8), 0.07 + 0.01 * k, K_WALL, 0.0) for k in range(MOST_PLANES)]
    for count, felt in ((3, -0.01 / (1.0 / K + K_WORLD / (K * K_WALL))), (4, 0.0)):
        m = model(3)
        answer(m, (beside, Plane((0.0, 1.0, 0.0), 0.03, K_WALL, 0.0)), (0.0, 0.0, 0.0), 1.0)
        answer(m, tuple(near[:count]), (0.0, 0.0, 0.08), 0.01)
        assert m.count == MOST_PLANES
        assert force(m, (0.04, 0.0, 0.0)) == pytest.approx(felt, abs=1e-5)


def test_a_servo_that_was_late_still_knows_the_wall() -> None:
    """Its spring was released, but its world is the same; a world that has been replaced is not."""
    for forgets, felt in (("release", FELT), ("reset", 0.0)):
        m = model()
        answer(m, (WALL,))
        getattr(m, forgets)(FAR)
        m.step(TICK, FAR)
        assert force(m, DEEP) == pytest.approx(felt, abs=1e-5)


def moving(m: ContactModel, speed: float, level: float | None, seconds: float = 4.0) -> float:
    """The force against a steady motion in free space [N]. The world keeps answering, as an old answer adds drag."""
    x = FAR[0]
    for k in range(round(seconds / TICK)):
        if k % 30 == 0:
            m.receive(ProxySample((x,), 1.0, (0.0,), (), 0.05, level), k * TICK, 0.0)
        x += speed * TICK
        y = m.step(TICK, (x,))
    return -K * (y[0] - x)


@pytest.mark.parametrize(("level", "kept"), mostly_slow([(1.0, 1.0), (0.5, 1.0), (0.25, 0.5), (0.0, 0.0)], 2))
def test_the_lead_yields_as_the_worlds_reservoir_empties(level: float, kept: float) -> None:
    """Lead and added damping cancel where the lead is whole; the hand pays for what has gone of it: b v."""
    m = model()
    assert moving(m, 0.067, level, seconds=30.0) == pytest.approx((1.0 - kept) * DAMPING * 0.067, abs=1e-4)
    assert m.kept == pytest.approx(kept, abs=1e-4)


def test_the_lead_yields_over_three_seconds() -> None:
    """A first-order step response: 1/e of the lead is left after 3 s."""
    m = model()
    moving(m, 0.067, 1.0, seconds=1.0)
    moving(m, 0.067, 0.0, seconds=3.0)
    assert m.kept == pytest.approx(math.exp(-1.0), abs=0.02)


def test_the_lead_stays_for_a_world_that_tells_no_level_and_where_it_is_switched_off() -> None:
    for m, level in ((model(), None), (model(yields_below=0.0), 0.0)):
        assert moving(m, 0.067, level) == pytest.approx(0.0, abs=1e-6)


def test_a_low_reservoir_is_not_felt_in_contact() -> None:
    """There the hand feels the wall and nothing else."""
    m = model()
    for _ in range(30):
        answer(m, (WALL,), level=0.0)
        force(m, (0.02,), 0.1)
    x = 0.02
    for _ in range(100):
        x += 0.01 * TICK
        y = m.step(TICK, (x,))
    assert -K * (y[0] - x) == pytest.approx(x / (1.0 / K + K_WORLD / (K * K_WALL)), rel=1e-6)


@pytest.mark.parametrize("remembers", mostly_slow([True, False], 1))
def test_a_wall_that_vanished_while_the_hand_was_away_is_not_felt_any_more(remembers: bool) -> None:
    """A hand comes back from 170 mm at 0.6 m/s, to hold where the wall was. The world says in time that it has gone:
    there is no force but that of a set-position that has not come to rest. The wall would push with 3 N."""
    result = simulate(
        {
            "scene": "moving", "world.wall.timeline": "at 3s: gone", "operator": "press", "duration_s": 6.0,
            "operator_model.start_m": -0.15, "operator_model.reach_s": 0.6, "operator_model.hold_s": 1.5,
            "operator_model.wait_s": 1.0,
            "link.up": "4g", "link.down": "4g", "contact_model.remembers": remembers,
        },
        seed=7,
    )  # fmt: skip
    device = result.recording.device
    assert result.summary["verdict"]["passive"]
    x, force = device["position_m"][:, 0], np.abs(device["force_N"][:, 0])
    deep = (device["time_s"] > 3.2) & (x > 0.03)
    assert np.count_nonzero(deep) > 100
    still = deep & (np.abs(device["velocity_mps"][:, 0]) < 0.01)
    assert force[still].max() < 0.15  # 0.25 mm of a spring of 600 N/m
