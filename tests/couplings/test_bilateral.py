"""Position-position, position-force and four channels between two robots, against what a textbook says of each."""

import math
from typing import Any

import numpy as np
import pytest

from hapnet import Params, simulate
from hapnet.assembly.build import prepare
from hapnet.couplings.link_delays import Delays
from hapnet.couplings.registry import coupling
from hapnet.errors import InvalidParameter
from hapnet.ext.laws.bilateral.four_channel import AccelerationEnd, DisturbanceObserver, tune
from hapnet.ext.laws.bilateral.pf import force_reflection_limit
from hapnet.laws import BILATERAL_NAMES, COUPLING_NAMES
from hapnet.params import RELAXED_HAND
from hapnet.simulation.result import Result
from tests.conftest import mostly_slow

WALL = 3000.0
PAIR: dict[str, object] = {
    "follower.robot": "simulated", "device.servo": "sampled", "operator_model.end_hold_s": 3.0, "duration_s": 6.0,
    "link.up": "ideal", "link.down": "ideal", "operator": "press", "device.mass": 0.5, "device.stiffness": 500.0,
    "device.damping": 2.0, "follower.mass": 0.5, "follower.own_damping": 1.0, "world.stiffness": 1000.0,
    "world.damping": 20.0, "follower.force_limit_N": 40.0,
}  # fmt: skip


def run(law: str, **changes: Any) -> Result:
    return simulate(
        {**PAIR, "coupling": law, **{name.replace("__", "."): one for name, one in changes.items()}}, seed=1
    )


def settled(result: Result, at_s: float = 2.5) -> tuple[float, float, float, float]:
    """x_l, x_f [m], the force on the hand and the wall's on the follower [N], while the hand presses still."""
    found = result.recording
    assert found.world is not None
    i, k = (int(np.searchsorted(side["time_s"], at_s)) for side in (found.device, found.world))
    device, world = found.device, found.world
    return (
        float(device["position_m"][i, 0]), float(world["position_m"][k, 0]), float(device["force_N"][i, 0]),
        float(world["contact_force_N"][k, 0]),
    )  # fmt: skip


STILL: dict[str, Any] = {"operator_model__hold_s": 4.0, "duration_s": 2.6, "operator_model__end_hold_s": 0.0}


def test_they_are_laws_of_their_own_that_need_a_follower() -> None:
    assert set(BILATERAL_NAMES) == {"pp", "pf", "four-channel"}
    assert not set(BILATERAL_NAMES) & set(COUPLING_NAMES)
    for name in BILATERAL_NAMES:
        assert coupling(name).name == name
        with pytest.raises(InvalidParameter, match=rf"^coupling is '{name}'; allowed: .*--follower simulated"):
            simulate({"coupling": name}, seed=1)
        with pytest.raises(InvalidParameter, match=r"^follower\.feedback is 'force'; allowed: left out"):
            simulate({**PAIR, "coupling": name, "follower.feedback": "force"}, seed=1)


def test_position_force_needs_a_robot_that_measures_its_contact() -> None:
    real = {"follower.robot": "serial:/dev/nothing", "scene": "free"}
    prepare({**real, "coupling": "pp"})
    with pytest.raises(InvalidParameter, match=r"^coupling is 'pf'; allowed: pp or pspm with serial:/dev/nothing"):
        prepare({**real, "coupling": "pf"})


@pytest.mark.parametrize("port", mostly_slow([("pspm",), ("bare",)], 1))
def test_position_position_shows_the_springs_in_series(port: str) -> None:
    """At rest: K_l (x_l - x_f) = F_l, and the wall's force is K_f (x_l - x_f). 20 mm: the wall's place."""
    x_l, x_f, felt, touched = settled(run("pp", bilateral__port=port, **STILL))
    depth = x_l - 0.02
    assert felt == pytest.approx(-500.0 * WALL * depth / (1000.0 + WALL), rel=0.02)
    assert touched == pytest.approx(-1000.0 * WALL * depth / (1000.0 + WALL), rel=0.02)
    assert x_f - 0.02 == pytest.approx(1000.0 * depth / (1000.0 + WALL), rel=0.02)


@pytest.mark.parametrize("port", mostly_slow([("pspm",), ("bare",)], 1))
def test_position_force_shows_the_contact_force(port: str) -> None:
    _, x_f, felt, touched = settled(run("pf", bilateral__port=port, **STILL))
    assert touched < -1.0
    assert felt == pytest.approx(touched, rel=0.02)
    assert touched == pytest.approx(-WALL * (x_f - 0.02), rel=0.02)


@pytest.mark.parametrize(("friction", "masses"), [(0.0, (0.5, 0.5)), (0.5, (0.2, 2.0))])
def test_four_channels_are_transparent_at_rest(friction: float, masses: tuple[float, float]) -> None:
    """x_l = x_f and f_l = -f_f, with friction too: the observer overcomes it, and knows it as no contact."""
    leader, robot = masses
    own = {"device__mass": leader, "follower__mass": robot, "follower__friction_N": friction}
    x_l, x_f, felt, touched = settled(run("four-channel", **own, **STILL))
    assert abs(x_l - x_f) < 1e-4
    assert touched < -1.0
    assert felt == pytest.approx(touched, abs=max(0.05, 0.1 * friction))


def test_without_the_observer_friction_parts_the_two() -> None:
    """With g near 0 friction F holds the follower off by up to F/(m Kp/2) = 5 mm; with it by less than 0.1 mm."""
    own = {"scene": "free", "follower__friction_N": 0.5, "bilateral__force_gain": 0.0, **STILL}
    apart = {}
    for cutoff in (0.01, 150.0):
        x_l, x_f, *_ = settled(run("four-channel", bilateral__cutoff_rad_s=cutoff, **own))
        apart[cutoff] = abs(x_l - x_f)
    assert 1e-3 < apart[0.01] <= 0.5 / (0.5 * 400.0 / 2.0) * 1.05
    assert apart[150.0] < 1e-4


def test_the_disturbance_observer_lags_as_its_cutoff_says() -> None:
    """A constant load d: the estimate is d (1 - e^(-g t)), and the motion of the robot cancels out."""
    observer, g, m, d, T = DisturbanceObserver(0.5, 100.0, 1), 100.0, 0.5, 2.0, 1e-4
    rng, v = np.random.default_rng(1), 0.0
    for k in range(1, 401):
        force = d + 0.5 * float(rng.normal())
        v += T * (force - d) / m
        observer.look(T, (v,), (force,))
        assert observer.disturbance[0] == pytest.approx(d * (1.0 - math.exp(-g * k * T)), abs=0.02)


def test_what_four_channels_send_is_what_the_published_sum_needs() -> None:
    """Both ends against F = m ((Kp + Kd s)(x_j - x_i) - Cf (f_i + f_j))/2 + d, term by term, with two masses."""
    own = {"coupling": "four-channel", "device.mass": 0.3, "follower.mass": 1.2, "bilateral.force_gain": 0.7}
    params = Params().set({**PAIR, **own})
    tuning = tune(params, Delays(0.0, 0.0))
    Kp, Kd, Cf = 400.0, 40.0, 0.7 * (1.0 / 0.3 + 1.0 / 1.2) / 2.0
    assert (tuning.position_gain, tuning.velocity_gain) == (Kp, Kd)
    assert tuning.force_gain == pytest.approx(Cf)
    ends = [AccelerationEnd(tuning, 500.0, mass, 0.0, 0.0, 1) for mass in (0.3, 1.2)]
    motions = [(0.011, 0.2), (0.007, -0.1)]
    for end, (x, v) in zip(ends, motions, strict=True):
        for _ in range(3):
            end.look(1e-3, (x,), (v,), (0.4,), (0.0,))
    for i, j in ((0, 1), (1, 0)):
        ends[i].receive(ends[j].content(None), 0.0, 0.0)
        (x, v), (xj, vj), m = motions[i], motions[j], (0.3, 1.2)[i]
        f, fj = ends[i].reaction[0], ends[j].reaction[0]
        whole = m / 2 * (Kp * (xj - x) + Kd * (vj - v) - Cf * (f + fj)) + f  # no friction is known: d = f
        damper = m * Kd / 2
        assert ends[i].pull()[0] - damper * v == pytest.approx(whole)
        assert (tuning.leader_damping_Ns_m, tuning.follower_damping_Ns_m)[i] == pytest.approx(damper)


# What vibrates


def test_the_limit_of_force_reflection_is_nyquists() -> None:
    """At the limit the characteristic equation has a root on the imaginary axis; and two limits are known."""
    M, b, k, R = 0.6, 5.0, 135.0, 0.1
    limit = force_reflection_limit(M, b, k, R)
    w = np.linspace(1e-3, 200.0, 400_001)
    loop = limit * np.exp(-1j * w * R) / (k - M * w**2 + 1j * b * w)
    nearest = np.abs(1.0 + loop)
    assert nearest.min() < 1e-4
    assert np.abs(np.imag(loop)[np.argmin(nearest)]) < 1e-3
    assert force_reflection_limit(M, b, k, 0.0) == math.inf
    assert force_reflection_limit(0.0, 0.0, k, R) == pytest.approx(k)  # a mere spring: gain 1 at any phase


@pytest.mark.parametrize(("share", "vibrates"), [(0.85, False), (1.2, True)])
def test_position_force_vibrates_above_that_limit(share: float, vibrates: bool) -> None:
    """The hand of 135 N/m on a leader of 0.5 kg, a follower that is stiff and fast, and a wall that changes and has no
    damping. The round trip is the link's 60 ms and what ticks and steps take."""
    hand, round_trip = Params().operator_model, 2 * 0.03 + 0.008
    limit = force_reflection_limit(hand.mass + 0.5, hand.damping + 2.0 + 0.3, hand.stiffness, round_trip)
    found = run(
        "pf", link__up="delay 30ms", link__down="delay 30ms", world__wall__stiffness=share * limit,
        world__wall__damping=0.0, world__stiffness=20_000.0, world__damping=120.0, follower__mass=0.2,
        follower__step_limit_N=0.0, operator_model__hold_s=5.0, operator_model__end_hold_s=0.0,
    ).recording  # fmt: skip
    force, time_s = found.device["force_N"][:, 0], found.device["time_s"]
    swings = [float(np.ptp(force[(time_s > begin) & (time_s < begin + 0.7)])) for begin in (2.0, 3.5, 5.0)]
    assert swings == sorted(swings, reverse=not vibrates)
    assert (swings[2] > swings[0]) is vibrates


@pytest.mark.parametrize("law", mostly_slow([(name,) for name in ("pf", "pp", "four-channel")], 1))
def test_a_bare_law_breaks_the_bound_where_pspm_behind_it_does_not(law: str) -> None:
    """A loosely held light leader, stiff springs and 100 ms each way: the delay's energy comes out."""
    pair = {
        "device__stiffness": 900.0, "device__damping": 0.5, "device__mass": 0.1, "bilateral__position_gain": 2500.0,
        "link__up": "delay 100ms", "link__down": "delay 100ms",
        **{name.replace(".", "__"): one for name, one in RELAXED_HAND.items()},
    }  # fmt: skip
    bare, behind = (run(law, bilateral__port=port, **pair).summary for port in ("bare", "pspm"))
    assert bare["theorem"]["margin_J"] < -0.1
    assert behind["theorem"]["margin_J"] >= 0.0
    assert [one["verdict"]["passive"] for one in (bare, behind)] == [False, True]


@pytest.mark.parametrize("seed", mostly_slow([(seed,) for seed in range(21)], 2))
def test_behind_pspm_any_law_over_any_link_to_any_arm_is_passive(seed: int) -> None:
    """Both halves of the theorem, and nothing comes out of the robot and its surroundings that did not go in."""
    rng = np.random.default_rng(seed)

    def log(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(math.log(low), math.log(high))))

    mass, inside = log(0.05, 5.0), bool(rng.random() < 0.5)
    way = f"delay {rng.uniform(0.0, 200.0):.0f}ms {rng.uniform(0.0, 30.0):.0f}ms loss {rng.uniform(0.0, 40.0):.0f}%"
    found = run(
        BILATERAL_NAMES[seed % 3], bilateral__port="pspm", link__up=way, link__down=way, follower__mass=mass,
        follower__friction_N=log(0.01, 5.0), follower__own_damping=log(0.05, 5.0), follower__position_servo=inside,
        follower__servo_hz=log(60.0, 1000.0), follower__motion_scale=log(0.2, 5.0), follower__force_scale=log(0.2, 5.0),
        follower__resolution_m=float(rng.choice([0.0, 2e-5])), world__stiffness=mass * log(100.0, 4000.0),
        world__damping=mass * log(5.0, 100.0), device__mass=log(0.05, 1.0), device__stiffness=log(50.0, 2000.0),
        device__damping=log(0.1, 4.0), bilateral__position_gain=log(50.0, 2500.0), bilateral__force_gain=log(0.2, 3.0),
        bilateral__friction_known=log(0.3, 3.0), duration_s=4.0, operator_model__end_hold_s=0.0,
        operator=str(rng.choice(["press", "sine", "hand-21"])), scene=str(rng.choice(["wall", "free", "box"])),
    ).summary  # fmt: skip
    assert found["verdict"]["passive"] is True
    assert found["theorem"]["margin_J"] >= 0.0
    for side in ("device", "world"):
        assert found[side]["ledger"]["slack_J"] >= -1e-12  # type: ignore[literal-required]
