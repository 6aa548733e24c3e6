"""The couplings by name: what a link's delays are taken to be, how a law is tuned for them, and that it runs."""

import json
import math
import re
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from hapnet.assembly.build import prepare
from hapnet.control.coupling import LawState
from hapnet.couplings.link_delays import delays
from hapnet.couplings.registry import COUPLINGS, ideal_stiffness
from hapnet.errors import InvalidParameter
from hapnet.params import Params
from hapnet.simulation.simulation import simulate
from netem import LinkProfile
from netem.trace import CapacityTrace, ConditionTrace
from tests.conftest import ROOT, mostly_slow
from tests.support.processes import started

DEFAULT = "delay 40ms 10ms loss 2%"


def profile(words: str) -> LinkProfile:
    return LinkProfile.named(words)


def test_a_links_delays_are_those_of_its_words() -> None:
    """Uniform jitter ends at J, of the other distributions 3 J are hardly ever exceeded; then all resends."""
    assert delays(profile(DEFAULT), profile(DEFAULT)) == pytest.approx((0.04, 0.1))
    assert delays(profile("4g"), profile("delay 10ms")) == pytest.approx((0.0225, 0.035 + 3 * 0.003 + 3 * 0.008 + 0.01))
    assert delays(profile("ideal"), profile("ideal")) == (0.0, 0.0)


def test_of_a_trace_they_are_what_one_waits_for_its_opportunities() -> None:
    """Nine gaps of 10 ms and one of 110 ms: by waiting at every instant of the 200 ms, half and nine tenths of them."""
    times = [10 * n for n in range(1, 10)] + [200]
    trace = CapacityTrace("memory", tuple(1_000_000 * t for t in times))
    instants = np.arange(0.0, 0.2, 1e-5)
    ends = np.array(times) * 1e-3
    waits = ends[np.searchsorted(ends, instants, side="right")] - instants
    link = profile("delay 5ms").replace(trace=trace)
    found = delays(link, profile("ideal"))
    assert found.one_way_s == pytest.approx((0.005 + np.quantile(waits, 0.5)) / 2.0, abs=2e-5)
    assert found.round_trip_bound_s == pytest.approx(0.005 + np.quantile(waits, 0.9), abs=2e-5)


def test_of_regular_opportunities_one_waits_uniformly() -> None:
    """Every 20 ms, two at a time."""
    trace = CapacityTrace("memory", tuple(20_000_000 * n for n in range(1, 51) for _ in range(2)))
    link = LinkProfile(trace=trace)
    assert delays(link, link) == pytest.approx((0.010, 0.036))


def test_of_conditions_over_time_they_are_quantiles_of_the_time() -> None:
    """10 ms for 6 s, 50 ms for 2.5 s, 300 ms for 0.5 s, 20 ms for as long again: a tenth of the time is 0.95 s."""
    times, held = (0, 6_000, 8_500, 9_000), (10, 50, 300, 20)
    conditions = ConditionTrace(
        "memory", tuple(1_000_000 * t for t in times), tuple(1_000_000 * d for d in held), (0.0,) * 4
    )
    link = profile("delay 1ms").replace(csv=conditions)
    assert delays(link, link) == pytest.approx((0.011, 0.102))


def tuned(coupling: str, link: str = DEFAULT, **changes: object) -> dict[str, float]:
    named = {name.replace("__", "."): value for name, value in changes.items()}
    return asdict(prepare(Params().set({"coupling": coupling, "link.up": link, "link.down": link, **named})).tuning)


def test_popc_damps_no_more_than_a_device_can_render() -> None:
    """5 Ns/m of a desktop device, m/T of a light one, or what the user says."""
    assert tuned("popc") == {"damping_cap_Ns_m": 5.0, "velocity_floor_m_s": 0.002, "predicts": False}
    assert tuned("popc", device__mass=0.003)["damping_cap_Ns_m"] == pytest.approx(3.0)
    assert tuned("popc", popc__damping_cap=20.0)["damping_cap_Ns_m"] == 20.0


def test_eba_trusts_the_devices_own_damping() -> None:
    assert tuned("eba") == {"damping_Ns_m": 0.3, "predicts": False}
    assert tuned("eba", eba__damping=0.1)["damping_Ns_m"] == 0.1
    with pytest.raises(InvalidParameter, match=r"device\.own_damping is 0.*eba\.damping"):
        tuned("eba", device__own_damping=0.0)
    assert tuned("eba", device__own_damping=0.0, eba__damping=0.1)["damping_Ns_m"] == 0.1


@pytest.mark.parametrize(("link", "K_p"), [("ideal", 100.0), (DEFAULT, 64.1), ("delay 270ms", 16.8)])
def test_pd_pays_for_the_round_trip_and_for_holding(link: str, K_p: float) -> None:
    """R: both delays and jitters, 5 ms, 50 ms, 1 ms; K_d = K_p R/2, never above 5 Ns/m: K_p gives way instead."""
    tuning = tuned("pd", link, device__stiffness=100.0)
    one_way = {"ideal": 0.0, DEFAULT: 0.05, "delay 270ms": 0.27}[link]
    assert tuning["stiffness_N_m"] == pytest.approx(K_p, rel=0.002)
    assert tuning["damping_Ns_m"] == pytest.approx(tuning["stiffness_N_m"] * (2.0 * one_way + 0.056) / 2.0)
    assert tuning["damping_Ns_m"] <= 5.0 + 1e-12


def test_pd_takes_the_users_damping_and_leaves_the_spring_alone() -> None:
    tuning = tuned("pd", pd__damping=12.0, pd__coordination=1.0, pd__extra_damping=0.5)
    assert list(tuning.values()) == [100.0, 12.0, 1.0, 0.5]


@pytest.mark.parametrize(("K_p", "link"), [(20.0, "delay 60ms"), (50.0, "delay 30ms"), (500.0, "delay 30ms")])
def test_pds_own_spring_keeps_its_condition(K_p: float, link: str) -> None:
    """K_d = K_p R/2, R as above; K_p gives way where K_d would be above 5 Ns/m."""
    tuning = tuned("pd", link, device__stiffness=100.0, pd__stiffness=K_p)
    R = 2e-3 * float(link.strip("delay ms")) + 0.056
    assert tuning["stiffness_N_m"] == pytest.approx(min(K_p, 10.0 / R))
    assert tuning["damping_Ns_m"] == pytest.approx(tuning["stiffness_N_m"] * R / 2.0)


def test_pd_says_when_the_device_does_not_damp_what_holding_its_force_needs() -> None:
    """0.3 against 100/2000 + 2.8 Ns/m; 3 would do."""
    params = Params().set({"coupling": "pd", "link.up": "ideal", "link.down": "ideal", "device.stiffness": 100.0})
    (warning,) = prepare(params).warnings
    assert "0.3 Ns/m" in warning
    assert "above 2.85 Ns/m" in warning
    assert prepare(params.set({"device.own_damping": 3.0})).warnings == ()


def test_the_ideal_is_the_spring_that_was_asked_for() -> None:
    """Scaled, the device's 100 N/m sees 3000/3500 of the way; one spring: 100 and 3000 in series, however tuned."""
    for coupling in ("zoh", "popc", "eba"):
        params = Params().set({"coupling": coupling, "device.stiffness": 100.0})
        assert ideal_stiffness(params, 3000.0) == pytest.approx(100.0 * 3000.0 / 3500.0)
    assert ideal_stiffness(params.set({"coupling": "pd"}), 3000.0) == pytest.approx(1.0 / (1.0 / 100.0 + 1.0 / 3000.0))


@pytest.mark.parametrize("coupling", ["popc", "eba"])
def test_a_device_law_differs_from_the_plain_coupling_in_what_it_adds_alone(coupling: str) -> None:
    """In the default hand neither has anything to add: the same run, but for when data are sent."""
    base = Params().set(
        {"rendering": "paper", "device.servo": "sampled", "duration_s": 4.0, "link.up": "ideal", "link.down": "ideal"}
    )
    plain, law = (simulate(base.set({"coupling": name}), seed=3) for name in ("zoh", coupling))
    assert isinstance(law.device.coupling, LawState)
    assert not isinstance(law.world.coupling, LawState)
    assert law.summary["motion"]["peak_force_N"] == pytest.approx(plain.summary["motion"]["peak_force_N"], rel=0.02)
    for name in ("free_rms_m", "contact_rms_m"):
        assert law.summary["motion"][name] == pytest.approx(plain.summary["motion"][name], rel=0.02)


@pytest.mark.parametrize("coupling", ["popc", "eba", "pd"])
def test_it_runs_in_three_dimensions(coupling: str) -> None:
    params = Params().set({"coupling": coupling, "scene": "box", "operator": "sine", "duration_s": 1.0, "dof": 3})
    motion = simulate(params, seed=1).summary["motion"]
    assert 0.0 < motion["peak_force_N"] <= 3.3
    assert math.isfinite(motion["free_rms_m"])
    assert motion["free_rms_m"] < 0.02


@pytest.mark.parametrize("coupling", mostly_slow([(one,) for one in COUPLINGS], 4))
def test_every_coupling_runs_and_is_the_same_again_from_its_summary(coupling: str) -> None:
    """At rest without force; within the actuators' limit in a box; its tuning is in the summary, and is read back."""
    spec = COUPLINGS[coupling]
    base = Params().set({"coupling": coupling, "scene": "box", "dof": 3, "duration_s": 1.0})
    still = simulate(base.set({"operator": "rest"}), seed=1).summary
    assert still["motion"]["peak_force_N"] == pytest.approx(0.0, abs=1e-9)
    setup = prepare(base.set({"operator": "sine"}))
    summary = simulate(setup.params, seed=1).summary
    assert 0.0 < summary["motion"]["peak_force_N"] <= 3.3
    assert summary["motion"]["free_rms_m"] < 0.04
    assert spec.recorded(summary["tuning"]) == setup.tuning
    assert set(spec.shared) <= set(summary["tuning"])


def test_the_page_has_every_coupling() -> None:
    page = (ROOT / "hapnet" / "couplings" / "README.md").read_text("utf-8")
    rows = page.partition("| coupling | published by |")[2].partition("\n\n")[0]
    assert set(re.findall(r"^\| `([^`]+)`", rows, re.MULTILINE)) == set(COUPLINGS)


@pytest.mark.slow
@pytest.mark.realtime
@pytest.mark.parametrize(
    ("coupling", "more"),
    [("pd", ("--realtime",)), *(pytest.param(name, (), marks=pytest.mark.soak) for name in ("popc", "eba"))],
    ids=["pd-realtime", "popc", "eba"],
)
def test_two_processes_over_zenoh(coupling: str, more: tuple[str, ...], tmp_path: Path) -> None:
    words = ("--coupling", coupling, "--duration", 3, "--seed", 1, "--json", "-", "--out", tmp_path / "run", *more)
    with started("run", *words) as program:
        code, stdout, stderr = program.end()
        assert not program.alive
    assert code == 0, stderr
    assert "Traceback" not in stderr
    summary = json.loads(stdout)
    assert summary["coupling"] == coupling
    assert summary["tuning"] == pytest.approx(tuned(coupling))
    assert summary["motion"]["contacts"] >= 1
    assert 0.5 < summary["motion"]["peak_force_N"] < 2.5
    assert summary["motion"]["free_rms_m"] < 0.01
    for way in ("up", "down"):
        assert summary["links"][way]["delivered"] >= 50


def test_a_real_network_under_the_link_counts_in_what_a_law_is_tuned_for() -> None:
    link = LinkProfile.parse("delay 10ms")
    assert delays(link, link, 0.1) == pytest.approx((0.06, 0.12))
    stiff, soft = (prepare(Params().set({"coupling": "pd", "link.path_s": path})).tuning for path in (0.0, 0.3))
    assert soft.stiffness_N_m < 0.6 * stiff.stiffness_N_m
