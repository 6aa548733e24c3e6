"""Algorithm 1: its energy law to rounding, the reservoir never negative, both shufflings, bad arguments."""

import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from hapnet.control.pspm import SetPositionModulator
from hapnet.errors import InvalidParameter
from tests.conftest import random_spd

finite = st.floats(-0.2, 0.2)


def modulator(n: int, seed: int, **kw: object) -> SetPositionModulator:
    K = random_spd(np.random.default_rng(seed), n, 5.0, 5000.0)
    return SetPositionModulator(stiffness=K, position=np.zeros(n), **kw)  # type: ignore[arg-type]


@settings(max_examples=150, deadline=None)
@given(
    n=st.integers(1, 3),
    seed=st.integers(0, 10**6),
    shuffle=st.sampled_from(["harvested", "all"]),
    limited=st.booleans(),
    steps=st.lists(
        st.tuples(
            st.lists(finite, min_size=6, max_size=6),
            st.floats(-1e-3, 1e-2),
            st.floats(0.0, 1e-2),
        ),
        min_size=1,
        max_size=30,
    ),
)
@pytest.mark.long
def test_energy_is_conserved_and_never_negative(
    n: int, seed: int, shuffle: str, limited: bool, steps: list[tuple[list[float], float, float]]
) -> None:
    """E(k) - deficit(k) = E(k-1) - deficit(k-1) + E_y + D - Pbar - E_x - discarded, Pbar by an independent formula."""
    m = modulator(n, seed, shuffle=shuffle, force_limit=3.0 if limited else None)
    K = m.spring.K

    def phi(e: np.ndarray) -> float:
        s = math.sqrt(e @ K @ e)
        knee = 3.0 / math.sqrt(np.linalg.eigvalsh(K)[-1]) if limited else math.inf
        return 0.5 * s * s if s <= knee else knee * s - 0.5 * knee * knee

    for values, dissipated, received in steps:
        y, x = np.array(values[:n]), np.array(values[3 : 3 + n])
        before, held = np.array(m.set_position), m.account
        r = m.update(set_position=y, position=x, dissipated=dissipated, received=received)
        jump = phi(x - r.set_position) - phi(x - before)
        assert r.energy >= 0.0
        assert r.deficit >= 0.0
        assert not (r.energy > 0.0 and r.deficit > 0.0)
        assert min(r.sent, r.discarded) >= 0.0
        assert r.energy <= m.ceiling
        assert r.jump == pytest.approx(jump, abs=1e-12)
        gained = received + dissipated - jump - r.sent - r.discarded
        assert r.energy - r.deficit - held == pytest.approx(gained, abs=1e-11)
        if shuffle == "all":
            assert r.discarded == 0.0
        assert r.sent <= max(0.0, r.sent + r.discarded - (received if shuffle == "harvested" else 0.0))


def test_takes_the_set_position_as_it_is_when_the_energy_suffices() -> None:
    m = SetPositionModulator(stiffness=100.0, position=[0.0], ceiling=0.05)
    r = m.update(set_position=[0.03], position=[0.0], dissipated=0.0)  # 1/2 100 0.03^2 = 45 mJ of 50
    assert r.set_position[0] == 0.03
    assert r.energy == pytest.approx(0.005)


def test_goes_as_far_as_the_energy_pays_for() -> None:
    m = SetPositionModulator(stiffness=100.0, position=[0.0], ceiling=0.02)
    r = m.update(set_position=[0.03], position=[0.0], dissipated=0.0)  # 20 mJ: sqrt(2 0.02 / 100) = 20 mm
    assert r.set_position[0] == pytest.approx(0.02, rel=1e-15)
    assert 0.0 <= r.energy < 1e-17


def test_ceiling_and_both_shufflings() -> None:
    """Surplus 12 mJ, of it 5 mJ received: all of it is sent as printed, only the 7 harvested by default."""
    for shuffle, sent, discarded in (("all", 0.012, 0.0), ("harvested", 0.007, 0.005)):
        m = SetPositionModulator(stiffness=1.0, position=[0.0], ceiling=0.05, shuffle=shuffle)  # type: ignore[arg-type]
        r = m.update(set_position=[0.0], position=[0.0], dissipated=0.007, received=0.005)
        assert (r.energy, r.sent, r.discarded) == (0.05, pytest.approx(sent), pytest.approx(discarded))


def test_a_deficit_is_carried_until_paid() -> None:
    m = SetPositionModulator(stiffness=100.0, position=[0.0], ceiling=0.05, energy=0.001)
    r = m.update(set_position=[0.0], position=[0.0], dissipated=-0.004)
    assert (r.energy, r.deficit) == (0.0, pytest.approx(0.003))
    assert r.set_position[0] == 0.0
    r = m.update(set_position=[0.01], position=[0.002], dissipated=0.001)
    assert (r.energy, r.deficit) == (0.0, pytest.approx(0.002 - 0.5 * 100 * 0.002**2))
    assert r.set_position[0] == 0.002
    r = m.update(set_position=[0.002], position=[0.002], dissipated=0.01)
    assert (r.energy, r.deficit) == (pytest.approx(0.01 - 0.002 + 0.0002), 0.0)


def test_extremes_give_the_papers_bound() -> None:
    """(10): 0.1 (4 mm)^2 / 5 ms + 0.2 (2 mm)^2 / 5 ms."""
    m = SetPositionModulator(stiffness=1.0, position=[0.0, 0.0], damping=[0.1, 0.2], ceiling=1.0, energy=0.0)
    r = m.update(set_position=[0.0, 0.0], position=[0.0, 0.0], extremes=([-0.001, 0.0], [0.003, 0.002]), interval=0.005)
    assert r.energy == pytest.approx(0.1 * 0.004**2 / 0.005 + 0.2 * 0.002**2 / 0.005)


def test_an_exhausted_reservoir_can_always_stay_where_it_is() -> None:
    """ybar(k) = ybar(k-1) is feasible whatever happens (the paper's remark below (9))."""
    rng = np.random.default_rng(0)
    m = modulator(3, 7, energy=0.0)
    for _ in range(500):
        x, y = rng.normal(size=3) * 0.05, rng.normal(size=3) * 0.05
        before = math.dist(y, m.set_position)
        r = m.update(set_position=y, position=x, dissipated=0.0)
        assert math.dist(y, r.set_position) <= before * (1 + 1e-12)


@pytest.mark.parametrize("scale", [1e-30, 1e-18, 1e-12, 1e-3])
def test_rounding_never_creates_energy(scale: float) -> None:
    """Nearly empty reservoirs: E stays exactly >= 0 and phi never exceeds what was at hand."""
    rng = np.random.default_rng(3)
    for n in (1, 2, 3):
        m = modulator(n, n, energy=0.0)
        for _ in range(300):
            x, y = rng.normal(size=n) * 0.04, rng.normal(size=n) * 0.04
            held, phi = m.account, m.spring.potential(tuple(x - np.array(m.set_position)))
            received = scale * float(rng.random())
            r = m.update(set_position=y, position=x, dissipated=0.0, received=received)
            assert r.energy >= 0.0
            assert m.spring.potential(tuple(x - r.set_position)) <= held + received + phi


@pytest.mark.parametrize(
    "kw",
    [
        {"set_position": [0.0], "position": [0.0, 0.0], "dissipated": 0.0},
        {"set_position": [0.0, float("nan")], "position": [0.0, 0.0], "dissipated": 0.0},
        {"set_position": [0.0, 0.0], "position": [0.0, 0.0], "dissipated": float("inf")},
        {"set_position": [0.0, 0.0], "position": [0.0, 0.0], "dissipated": 0.0, "received": -1.0},
        {"set_position": [0.0, 0.0], "position": [0.0, 0.0]},
        {"set_position": [0.0, 0.0], "position": [0.0, 0.0], "extremes": ([0, 0], [1, 1])},
    ],
)
def test_bad_input_is_refused_and_changes_nothing(kw: dict[str, object]) -> None:
    m = modulator(2, 1)
    before = (m.energy, m.deficit, m.set_position)
    with pytest.raises(InvalidParameter):
        m.update(**kw)  # type: ignore[arg-type]
    assert (m.energy, m.deficit, m.set_position) == before


def test_the_reservoir_cannot_start_above_its_ceiling() -> None:
    with pytest.raises(InvalidParameter, match="ceiling"):
        SetPositionModulator(stiffness=1.0, position=[0.0], ceiling=0.05, energy=0.06)
