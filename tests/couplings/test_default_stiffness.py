"""K by rule, from what the device says of itself."""

import pytest

from hapnet.assembly.choices import choosing
from hapnet.assembly.springs import spring
from hapnet.couplings.stiffness import default_stiffness, local_limit, through
from hapnet.errors import InvalidParameter
from hapnet.params import Params
from hapnet.simulation.simulation import simulate


@pytest.mark.parametrize(
    ("own", "hz", "declared", "exact", "limit"),
    [
        (0.3, 1000.0, None, True, 600.0),  # 2 b/T
        (0.3, 4000.0, None, True, 2400.0),
        (0.0, 1000.0, None, True, 0.0),  # nothing is known
        (0.0, 1000.0, (1.0, 1000.0), False, 1000.0),  # a declaration alone
        (0.3, 1000.0, (1.0, 1000.0), True, 600.0),  # the smaller one, if the damping is known
        (0.6, 1000.0, (1.0, 1000.0), True, 1000.0),
        (0.1, 1000.0, (1.0, 1000.0), False, 1000.0),  # a lower bound makes no device softer
        (0.3, 1000.0, None, False, 600.0),
    ],
)  # fmt: skip
def test_the_local_limit(
    own: float, hz: float, declared: tuple[float, float] | None, exact: bool, limit: float
) -> None:
    assert local_limit(own, hz, declared, exact=exact) == limit


@pytest.mark.parametrize(
    ("limit", "declared", "K"),
    [
        (600.0, None, 600.0),
        (14_500.0, (1.0, 14_500.0), 3500.0),  # a wall of 3000 N/m is felt as 3000 N/m: K' + K_w
        (0.0, None, 100.0),  # nothing is known: the paper's
        (30.0, (1.0, 60.0), 60.0),  # but not what the device cannot
        (60.0, (1.0, 60.0), 60.0),
        (500.0, (600.0, 1000.0), 600.0),  # not less than the device can
    ],
)
def test_the_rule(limit: float, declared: tuple[float, float] | None, K: float) -> None:
    assert default_stiffness(limit, 3500.0, declared) == K


def test_no_wall_is_felt_stiffer_than_it_is() -> None:
    for wall in (200.0, 3000.0):
        K = default_stiffness(1e6, 500.0 + wall)
        assert through([K, 500.0], wall) == pytest.approx(wall)


def test_a_count_of_the_encoders_changes_the_force_by_a_twentieth_of_a_newton_at_most() -> None:
    stiffness = default_stiffness(10_000.0, 3500.0, (1.0, 10_000.0), resolution_m=55e-6)
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
    assert choosing(Params(), spring).device.stiffness == 600.0
    meta = simulate({"duration_s": 0.1}).recording.meta
    assert meta["params"]["device"]["stiffness"] == 600.0


def test_a_stiffness_below_zero_is_refused() -> None:
    with pytest.raises(InvalidParameter, match=r"device\.stiffness.*-1"):
        Params().set({"device.stiffness": -1.0})


def test_a_range_that_is_declared_counts() -> None:
    made = choosing(Params().set({"device.own_damping": 0.0, "device.stiffness_range": (1.0, 300.0)}), spring)
    assert made.device.stiffness == 300.0


def needed_J(K: float, held_s: float = 0.021) -> float:
    """A force F = K s that is held for h at 1 m/s gives out F h - F^2/2K at most, up to 3.3 N, of which the
    damper (0.1 Ns/m) has 0.1. 0.7 of the ceiling is kept for it."""
    spring = min(3.2, held_s * K)
    return 1.0 / 0.7 * (held_s * (spring + 0.1) - spring * spring / (2.0 * K))


def test_the_ceiling_follows_the_spring() -> None:
    slow = {"device.own_damping": 0.6, "device.watchdog_s": 0.03}
    made = choosing(Params().set(slow), spring).device
    assert made.stiffness == 1200.0
    needed = needed_J(1200.0, held_s=0.031)
    assert 0.1 < needed <= made.ceiling_J <= needed + 1e-3
    assert choosing(Params(), spring).device.ceiling_J == 0.1  # enough for 600 N/m


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


class Faster(Fast):
    """A device so fast that no ceiling up to 0.5 J covers its held torque."""

    greatest_speed = 8.0


class Strong(Fast):
    """A strong device. Its own force is no reason for a softer spring."""

    force_limit, greatest_speed = 12.0, 1.0
    stiffness_range = (1.0, 14_500.0)


@pytest.mark.parametrize(
    ("made_of", "stiffness", "needed"),
    [
        (Fast, 1500.0, (0.021 * 3.0 * 3.3 - 3.0**2 / 3000.0) / 0.7),  # 0.3 N of the limit are the damper's, at 3 m/s
        (Faster, 100.0, 0.5),
        (Strong, 3500.0, (0.021 * 12.0 - 11.9**2 / 7000.0) / 0.7),  # as stiff as the springs of wall and world together
    ],
)
def test_what_a_device_declares_counts_for_the_reserve(made_of: type[Fast], stiffness: float, needed: float) -> None:
    hardware = f"tests.couplings.test_default_stiffness:{made_of.__name__}"
    most_N = max(3.3, made_of.force_limit)  # the user allows what the device can
    made = choosing(Params().set({"hardware": hardware, "device.force_limit_N": most_N}), spring).device
    assert made.stiffness == stiffness
    assert needed <= made.ceiling_J <= needed + 1e-3


def test_one_axis_without_stiffness_is_refused() -> None:
    with pytest.raises(InvalidParameter, match=r"device\.stiffness"):
        choosing(Params().set({"device.stiffness": (0.0, 100.0)}), spring)


def test_the_other_laws_keep_the_spring_they_were_tuned_with() -> None:
    for name in ("popc", "pd", "tdpa", "wave"):
        assert choosing(Params().set({"coupling": name}), spring).device.stiffness == 100.0
    assert choosing(Params().set({"coupling": "zoh"}), spring).device.stiffness == 600.0
