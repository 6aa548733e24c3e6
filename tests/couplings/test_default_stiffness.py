"""K by rule, from what the device says of itself."""

import pytest

from hapnet.assembly.choices import choosing
from hapnet.assembly.springs import spring
from hapnet.couplings.stiffness import default_stiffness
from hapnet.errors import InvalidParameter
from hapnet.params import Params
from hapnet.simulation.simulation import simulate


@pytest.mark.parametrize(
    ("own", "B", "hz", "declared", "K"),
    [
        (0.3, 0.1, 1000.0, None, 200.0),  # half of 2 (b - B)/T = 400
        (0.3, 0.1, 500.0, None, 100.0),
        (0.3, 0.1, 5000.0, None, 350.0),  # nobody declared that it renders more
        (0.0, 0.1, 1000.0, None, 100.0),  # nothing is known
        (0.0, 0.1, 1000.0, (1.0, 1000.0), 350.0),  # a declaration alone
        (0.0, 0.1, 1000.0, (1.0, 500.0), 250.0),
        (0.0, 0.1, 1000.0, (600.0, 1000.0), 600.0),  # not less than the device can
        (0.09, 0.1, 1000.0, (1.0, 1000.0), 100.0),  # known, and too little for any held spring
        (0.3, 0.1, 1000.0, (1.0, 700.0), 200.0),
        (0.15, 0.1, 1000.0, None, 100.0),  # at least the paper's
        (0.15, 0.1, 1000.0, (1.0, 60.0), 60.0),  # but not what the device cannot
    ],
)  # fmt: skip
def test_the_rule(own: float, B: float, hz: float, declared: tuple[float, float] | None, K: float) -> None:
    assert default_stiffness(own, B, hz, declared) == K


def test_a_measured_lower_bound_of_the_damping_makes_no_spring_softer() -> None:
    for declared in (None, (1.0, 300.0), (1.0, 1000.0), (1.0, 14_500.0)):
        chosen = [default_stiffness(b, 0.1, 1000.0, declared, exact=False) for b in (0.0, 0.05, 0.23, 0.4, 1.0, 20.0)]
        assert chosen == sorted(chosen)
    assert default_stiffness(1.0, 0.1, 1000.0, (1.0, 14_500.0), exact=False) == 900.0  # half of 2 (b - B)/T


def test_a_count_of_the_encoders_changes_the_force_by_a_twentieth_of_a_newton_at_most() -> None:
    stiffness = default_stiffness(1.0, 0.1, 4000.0, (1.0, 10_000.0), resolution_m=55e-6)
    assert stiffness == pytest.approx(0.05 / 55e-6, abs=0.01)


def test_a_class_that_knows_its_model_only_once_it_is_open_declares_the_least() -> None:
    params = Params().set({"hardware": "hapnet.ext.devices.force_dimension:ForceDimension"})
    assert choosing(params, spring).device.stiffness > 100.0


def test_what_the_user_says_stays() -> None:
    params = Params().set({"device.stiffness": 123.0})
    assert choosing(params, spring) is params


def test_the_papers_feel_has_the_papers_spring() -> None:
    assert choosing(Params().set({"rendering": "paper"}), spring).device.stiffness == 100.0


def test_a_run_records_the_number() -> None:
    assert choosing(Params(), spring).device.stiffness == 200.0
    meta = simulate({"duration_s": 0.1}).recording.meta
    assert meta["params"]["device"]["stiffness"] == 200.0


def test_a_stiffness_below_zero_is_refused() -> None:
    with pytest.raises(InvalidParameter, match=r"device\.stiffness.*-1"):
        Params().set({"device.stiffness": -1.0})


def test_a_range_that_is_declared_counts() -> None:
    made = choosing(Params().set({"device.own_damping": 0.0, "device.stiffness_range": (1.0, 300.0)}), spring)
    assert made.device.stiffness == 150.0


def needed_J(K: float) -> float:
    """A force F = K s that is held for h = 21 ms at 1 m/s gives out F h - F^2/2K at most, up to 3.3 N, of which the
    damper (0.1 Ns/m) has 0.1. Half of the ceiling is kept for it."""
    spring = min(3.2, 0.021 * K)
    return 2.0 * (0.021 * (spring + 0.1) - spring * spring / (2.0 * K))


def test_the_ceiling_follows_the_spring() -> None:
    made = choosing(Params().set({"device.own_damping": 0.6}), spring).device
    assert made.stiffness == 350.0
    assert needed_J(350.0) <= made.ceiling_J <= needed_J(350.0) + 1e-3
    assert choosing(Params(), spring).device.ceiling_J == 0.1  # enough for 200 N/m


def test_the_spring_is_never_stiffer_than_a_ceiling_that_was_set_covers() -> None:
    made = choosing(Params().set({"device.own_damping": 0.6, "device.ceiling_J": 0.06}), spring).device
    assert isinstance(made.stiffness, float)
    assert made.ceiling_J == 0.06
    assert 0.98 * 0.06 < needed_J(made.stiffness) <= 0.06


class Fast:
    """A class that declares itself fast and stiff: a torque that is held at 3 m/s costs three times as much."""

    dof, force_limit, resolution = 1, 3.3, 0.0
    greatest_speed, stiffness_range = 3.0, (1.0, 1500.0)

    def __init__(self, dof: int) -> None: ...
    def read(self, now_ns: int) -> tuple[float, ...]: ...
    def apply(self, force: tuple[float, ...]) -> None: ...


def test_what_a_device_declares_counts_for_the_reserve() -> None:
    made = choosing(Params().set({"hardware": "tests.couplings.test_default_stiffness:Fast"}), spring).device
    assert made.stiffness == 100.0  # at 3 m/s no ceiling up to 0.2 J covers more
    assert made.ceiling_J == 0.2


def test_one_axis_without_stiffness_is_refused() -> None:
    with pytest.raises(InvalidParameter, match=r"device\.stiffness"):
        choosing(Params().set({"device.stiffness": (0.0, 100.0)}), spring)


def test_the_other_laws_keep_the_spring_they_were_tuned_with() -> None:
    for name in ("popc", "pd", "tdpa", "wave"):
        assert choosing(Params().set({"coupling": name}), spring).device.stiffness == 100.0
    assert choosing(Params().set({"coupling": "zoh"}), spring).device.stiffness == 200.0
