"""One case: what is measured against theory, the run's own accounts, and the reference over an ideal link."""

import itertools
import math
from collections.abc import Sequence

import numpy as np
import pytest
from scipy import signal

from hapnet.control.two_port import TwoPort
from hapnet.couplings import held_torque
from hapnet.errors import InvalidParameter
from hapnet.ext.metrics import METRICS
from hapnet.ext.study import case
from hapnet.ext.study.case import check, measure, simulated
from hapnet.params import Params
from hapnet.simulation.simulation import Simulation

SAMPLED: dict[str, object] = {"device.servo": "sampled", "duration_s": 4.0}
LIGHT: dict[str, object] = {
    "operator": "sine", "operator_model.mass": 0.1, "operator_model.damping": 0.5, "operator_model.stiffness": 20.0,
}  # fmt: skip


def params(link: str, **changes: object) -> Params:
    dotted = {name.replace("__", "."): value for name, value in changes.items()}
    return Params().set({**SAMPLED, "link.up": link, "link.down": link, **dotted})


@pytest.mark.parametrize(("device", "world"), [(100.0, 500.0), (200.0, 300.0)])
def test_a_press_over_an_ideal_link_feels_the_springs_in_series(device: float, world: float) -> None:
    """At rest: K (x - y) felt, K' (x - y) and K_w y on the proxy, so K K_w / (K' + K_w) of the device's depth x."""
    found = measure(
        params("", device__stiffness=device, world__stiffness=world, device__step_limit_N=0.0, rendering="paper"), 1
    )
    assert found["stiffness_percent"] == pytest.approx(100.0, abs=1.5)
    assert found["force_error_N"] == found["force_error_percent"] == 0.0
    assert found["margin_J"] == pytest.approx(0.1 + 0.05)  # nothing came out: both ceilings


def test_a_solid_is_measured_as_a_wall_is() -> None:
    """A ball that is pressed in its middle feels as the wall does."""
    own = {"dof": 3, "duration_s": 2.2, "operator_model.reach_s": 0.5}
    wall, ball = (measure(params("delay 20ms 5ms loss 5%", scene=name, **own), 3) for name in ("wall", "sphere"))
    assert all(wall[name] is not None for name in ("stiffness_percent", "true_force_error_N", "first_contact_ms"))
    for name in METRICS:
        assert ball[name] == pytest.approx(wall[name], rel=1e-3, abs=1e-6), name


def field(position: Sequence[float], velocity: Sequence[float], t: float) -> float:
    """A force whose surface nothing knows."""
    return -1000.0 * max(0.0, position[0] - 0.02)


def test_what_needs_a_surface_is_left_out_where_none_is_known() -> None:
    found = measure(params("delay 20ms", scene=f"{__name__}:field", duration_s=1.0), 3)
    unknown = {name for name, value in found.items() if value is None}
    assert {"stiffness_percent", "true_force_error_N", "free_rms_mm", "drag_N", "first_contact_ms"} <= unknown
    assert found["contact_rms_mm"] is None  # the proxy's penetration is not known
    assert found["peak_force_N"] is not None


def test_every_metric_and_no_other() -> None:
    found = measure(params("delay 20ms"), 3)
    assert list(found) == list(METRICS)
    assert all(value is None or math.isfinite(value) for value in found.values())
    packets = [found[name] for name in ("packets_up_per_s", "packets_down_per_s", "packets_per_s")]
    up, down, both = (value for value in packets if value is not None)
    assert up > 200.0  # PSPM's period of 5 ms alone
    assert both == pytest.approx(up + down)
    slack = found["slack_J"]
    assert slack >= -1e-9


def test_the_whole_run_is_measured() -> None:
    """A hand that waits for half of the run, then presses: each figure again, from all samples, in other words.

    The force error is that against the run over an ideal link, tick by tick; the power above 20 Hz Welch's, by scipy.
    """
    given = params("delay 20ms", duration_s=5.0, operator_model__wait_s=2.5, operator_model__hold_s=2.0)
    found = measure(given, 4)
    run = simulated(given, 4)
    device, world = run.recording.device, run.recording.world
    assert device["time_s"].tolist() == pytest.approx([k * 1e-3 for k in range(1, 5001)], abs=0.021)
    assert world["time_s"][0] < 0.1
    assert world["time_s"][-1] > 4.9

    force = device["force_N"][:, 0]
    assert found["peak_force_N"] == np.abs(force).max()
    assert found["force_step_N"] == max(abs(b - a) for a, b in itertools.pairwise(force.tolist()))
    errors: dict[str, list[float]] = {"free_rms_mm": [], "contact_rms_mm": []}
    steps = list(zip(world["time_s"], world["position_m"][:, 0], world["penetration_m"] > 0.0, strict=True))
    for t, x in zip(device["time_s"], device["position_m"][:, 0], strict=True):
        after = next((k for k, step in enumerate(steps) if step[0] > t), None)
        if after is not None and after > 0:
            (t0, p0, inside), (t1, p1, _) = steps[after - 1], steps[after]
            away = x - (p0 + (p1 - p0) * (t - t0) / (t1 - t0))
            if inside:
                errors["contact_rms_mm"].append(away)
            if x <= given.world.wall.position_m:  # free is where the device is, whatever the proxy does
                errors["free_rms_mm"].append(away)
    for name, parts in errors.items():
        assert len(parts) > 500
        assert found[name] == pytest.approx(1e3 * math.sqrt(np.mean(np.square(parts))), rel=1e-6)
    ideal = simulated(params("", duration_s=5.0, operator_model__wait_s=2.5, operator_model__hold_s=2.0), 4)
    apart = force - ideal.recording.device["force_N"][:, 0]
    assert found["force_error_N"] == pytest.approx(math.sqrt(np.mean(apart**2)), rel=1e-2)
    f, spectrum = signal.welch(force, 1000.0, "hann", nperseg=1000, noverlap=750)
    assert found["buzz_N2"] == pytest.approx(float(spectrum[f > 20.0].sum() * (f[1] - f[0])), rel=1e-9)
    assert found["stiffness_percent"] == pytest.approx(100.0, abs=3.0)  # of the second half alone
    assert found["first_contact_ms"] is not None
    assert found["packets_up_per_s"] == run.result.summary["links"]["up"]["offered"] / 5.0


def test_free_space_has_no_contact() -> None:
    found = measure(params("", scene="free", operator="sine"), 0)
    unknown = {name for name, value in found.items() if value is None}
    assert unknown == {
        "contact_rms_mm", "stiffness_percent", "felt_N_per_m", "true_force_error_percent", "contact_to_drag",
        "first_contact_ms", "first_contact_missed", "later_contact_ms",
        "drift_mm_per_min", "free_first_mm", "free_last_mm", "drag_last_N",  # 4 s only
        "stiffness_worst_percent", "true_force_error_last_percent", "world_force_error_percent", "contacts_ratio",
        "swing_N",  # a sine never stops
        "free_rms_deg", "contact_rms_deg", "peak_torque_Nm", "torque_step_Nm",  # nothing turns
        "torque_error_percent", "true_torque_error_percent",
    }  # fmt: skip


def test_what_is_not_passive_is_seen_and_what_is_passive_too() -> None:
    """A light hand over 35 ms in each direction: held set-positions give it joules (Colgate and Schenkel), PSPM
    none."""
    held, passive = (measure(params("4g", coupling=name, rendering="paper", **LIGHT), 0) for name in ("zoh", "pspm"))
    for name in ("margin_J", "hand_margin_J", "actuator_margin_J"):
        below, above = held[name], passive[name]
        assert below < -0.05
        assert above > 0.0
    assert held["slack_J"] is None


@pytest.mark.parametrize("harvest", ["measured", "range"])
def test_the_hands_work_is_the_actuators_and_the_devices_motion(harvest: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without damping of its own the device passes on what it does not keep: a balance of energy, to rounding."""
    monkeypatch.setattr(held_torque, "check", lambda *args: [])  # which refuses to harvest a range with no damping
    run = simulated(params("delay 10ms", device__own_damping=0.0, device__harvest=harvest), 2)
    side, device = run.result.device, run.recording.device
    x = device["position_m"][:, 0]
    held = np.concatenate([[0.0], device["force_N"][:, 0]])
    work = -float(held[:-1] @ np.diff(np.concatenate([[0.0], x])))  # the press begins at 0
    _, (v,) = side.device.read()
    assert side.hand_work == pytest.approx(work + 0.5 * 0.045 * v * v, abs=1e-12)
    assert side.ledger.work == pytest.approx(work, abs=1e-12)


def test_the_devices_own_damping_is_on_the_hands_side_of_the_actuator() -> None:
    run = simulated(params("delay 10ms", device__own_damping=2.0), 2)
    side, device = run.result.device, run.recording.device
    steps = np.diff(device["position_m"][:, 0])
    dissipated = 2.0 * float(steps @ steps) / 1e-3
    _, (v,) = side.device.read()
    assert side.hand_work == pytest.approx(side.ledger.work + 0.5 * 0.045 * v * v + dissipated, rel=1e-3)


def test_the_continuous_servo_has_its_account_at_the_hand() -> None:
    continuous = params("delay 30ms", device__servo="continuous", duration_s=1.0)
    found = measure(continuous, 0)
    assert found["actuator_margin_J"] is None
    assert found["margin_J"] == simulated(continuous, 0).result.summary["theorem"]["margin_J"]


@pytest.mark.parametrize("coupling", ["pspm", "zoh", "wave"])
def test_a_servo_that_is_left_open_is_the_sampled_one_whatever_the_coupling(coupling: str) -> None:
    changes = {"duration_s": 0.5, "coupling": coupling}
    found = measure(params("delay 9ms", device__servo="auto", **changes), 0)
    assert found == measure(params("delay 9ms", device__servo="sampled", **changes), 0)
    assert found["actuator_margin_J"] is not None


def test_the_lowest_of_one_port_by_hand() -> None:
    both = TwoPort()
    both.device(-2.0)
    both.world(5.0)
    assert both.device_lowest == -2.0
    both.device(1.0)
    both.device(-3.0)
    assert both.device_lowest == -3.0
    both.world(6.0)
    both.device(0.0)
    both.world(7.0)
    assert both.device_lowest == -3.0


def test_what_came_after_the_start_by_hand() -> None:
    """A step runs while the start ends: what the device did before belongs to the start, with that step's work too."""
    both = TwoPort()
    both.device(-2.0)
    assert (both.later, both.now) == (None, -2.0)
    both.begin()
    both.device(1.0)
    assert (both.lowest, both.later, both.now) == (-2.0, -2.0, 1.0)  # it begins where the start ended
    both.world(-3.0)
    assert (both.lowest, both.later) == (-5.0, -5.0)
    late = TwoPort()
    late.device(-2.0)
    late.device(4.0)
    late.begin()
    late.device(5.0)
    late.world(-3.0)
    assert (late.lowest, late.later, late.now) == (-5.0, 1.0, 2.0)
    assert late.device_lowest == -2.0


def test_runs_over_other_links_share_one_reference(monkeypatch: pytest.MonkeyPatch) -> None:
    made = []

    class Counted(Simulation):
        def __init__(self, params: Params, seed: int, **more: bool) -> None:
            made.append((params.link.up, seed))
            super().__init__(params, seed, **more)

    monkeypatch.setattr("hapnet.ext.study.case.Simulation", Counted)
    case._reference.cache_clear()
    short = {"duration_s": 0.5}
    first = measure(params("delay 5ms", **short), 0)
    measure(params("delay 9ms", **short), 0)
    measure(params("", **short), 0)
    assert made == [("", 0), ("delay 5ms", 0), ("delay 9ms", 0)]
    measure(params("delay 5ms", **short), 1)
    assert made[3:] == [("", 1), ("delay 5ms", 1)]
    case._reference.cache_clear()
    assert measure(params("delay 5ms", **short), 0) == first
    first["margin_J"] = 17.0  # a caller's own
    assert measure(params("", **short), 0)["margin_J"] != 17.0


def test_what_does_not_make_a_run_is_refused() -> None:
    for asked in (check, lambda wrong: measure(wrong, 0)):
        with pytest.raises(InvalidParameter, match="operator"):
            asked(params("", operator="nobody"))
        with pytest.raises(InvalidParameter, match=r"duration_s is 0\.0; allowed: above 0"):
            asked(params("", duration_s=0.0))


@pytest.mark.slow
@pytest.mark.parametrize("operator", ["press", "sine"])
@pytest.mark.parametrize("link", ["lan", "4g", "wan-intercontinental"])
@pytest.mark.parametrize("coupling", ["pspm", "zoh"])
def test_position_couplings_render_the_series_stiffness_and_do_not_drift_over_any_link(
    coupling: str, link: str, operator: str
) -> None:
    """By their law, at rest, whatever the delay: the bias of the estimators over 10 s is below these figures."""
    for seed in range(2):
        found = measure(params(link, duration_s=10.0, coupling=coupling, operator=operator, rendering="paper"), seed)
        stiffness, drift = found["stiffness_percent"], found["drift_mm_per_min"]
        assert stiffness is None or stiffness == pytest.approx(100.0, abs=2.5)
        assert drift == pytest.approx(0.0, abs=2.5)
