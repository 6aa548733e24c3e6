import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from hapnet.couplings.registry import COUPLINGS
from hapnet.installing import versions
from hapnet.params import Params
from hapnet.recording.samples import Recording
from hapnet.simulation.simulation import Simulation, simulate
from hapnet.summary.recorded import from_recording, of_recordings
from hapnet.summary.run import Summary, combine, device_summary, merge

SIDE_KEYS = {"ledger", "reservoir_min_J", "sent_nJ", "credited_nJ", "discarded_nJ", "abandoned_nJ", "incarnations"}
LINK_KEYS = {"profile", "offered", "delivered", "lost", "reordered", "delay_p50_ms", "delay_p99_ms"}


def side(margin: float | None, bound: float | None, sent: int, credited: int, abandoned: int | None = 0) -> Summary:
    return {
        "ledger": {"margin_J": margin, "slack_J": 0.0, "bound_J": bound},
        "sent_nJ": sent,
        "credited_nJ": credited,
        "in_flight_nJ": 3,
        "abandoned_nJ": abandoned,
    }


def both(device: Summary | None, world: Summary | None, coupling: str = "pspm", **known: Any) -> Summary:
    links = {"up": None, "down": None}
    return combine(device, world, links, seed=1, duration_s=2.0, coupling=coupling, **known)


@pytest.fixture(scope="module", params=["pspm", "zoh"])
def simulated(request: pytest.FixtureRequest) -> Any:
    params = Params().set({"duration_s": 1.0, "operator": "sine", "coupling": request.param})
    return simulate(params, 1)


def test_keys_that_programs_rely_on(simulated: Any) -> None:
    summary = json.loads(json.dumps(simulated.summary, allow_nan=False))
    assert set(summary) >= {
        "verdict", "theorem", "device", "world", "links", "motion", "seed", "duration_s", "coupling", "versions",
        "wall_clock",
    }  # fmt: skip
    assert set(summary["theorem"]) >= {"margin_J", "bound_J", "energy_out_J", "margin_end_J", "margin_later_J"}
    assert set(summary["verdict"]) >= {"passive", "reason"}
    assert set(summary["device"]) >= SIDE_KEYS | {"quantisation_J", "servo"}
    assert set(summary["device"]["servo"]) >= {"ticks", "late_p50_us", "late_p99_us", "skipped"}
    assert set(summary["world"]) >= SIDE_KEYS | {"step"}
    assert set(summary["world"]["step"]) >= {"count", "mean_s", "max_s"}
    for name in ("device", "world"):
        assert set(summary[name]["ledger"]) >= {"margin_J", "slack_J"}
    for way in ("up", "down"):
        assert set(summary["links"][way]) >= LINK_KEYS
    assert set(summary["motion"]) >= {
        "free_rms_m", "contact_rms_m", "peak_force_N", "peak_penetration_m", "contacts",
    }  # fmt: skip


def test_without_pspm_there_is_no_reservoir(simulated: Any) -> None:
    """With PSPM the device harvests from a hand that moves, sends it, and the world is credited with it."""
    summary = simulated.summary
    known = summary["coupling"] == "pspm"
    for name in ("device", "world"):
        assert (summary[name]["reservoir_min_J"] is not None) == known
    flows = [summary[side][flow] for side in ("device", "world") for flow in ("sent_nJ", "credited_nJ")]
    if known:
        assert summary["device"]["sent_nJ"] > 0
        assert summary["world"]["credited_nJ"] > 0
    else:
        assert flows == [0, 0, 0, 0]


def test_both_reservoirs_full_bound_is_two_ceilings(simulated: Any) -> None:
    """Everything starts at rest at ybar = x: d^2 = E(0) + E_0 = 0.1 J + 0.05 J, for either coupling."""
    assert simulated.summary["theorem"]["bound_J"] == pytest.approx(0.15, rel=1e-12)


def test_margin_of_two_processes_is_the_sum_of_their_own() -> None:
    theorem = both(side(0.02, 0.05, 0, 0), side(0.03, 0.06, 0, 0), total_later_J=0.07)["theorem"]
    known = {"margin_J": 0.05, "bound_J": 0.11, "energy_out_J": 0.06}
    assert theorem["margin_later_J"] is None  # what was recorded is another account than that of the halves
    assert {name: theorem[name] for name in known} == pytest.approx(known)
    assert theorem["margin_end_J"] is None  # of older recordings
    ended = [side(0.02, 0.05, 0, 0), side(0.03, 0.06, 0, 0)]
    for part, end in zip(ended, (0.09, 0.04), strict=True):
        part["ledger"] |= {"margin_end_J": end, "margin_later_J": end - 0.01}
    theorem = both(*ended)["theorem"]
    assert (theorem["margin_end_J"], theorem["margin_later_J"]) == (pytest.approx(0.13), pytest.approx(0.11))


def test_where_energy_was_credited_that_nobody_sent_both_halves_bound_nothing() -> None:
    forged = both(side(0.02, 0.05, 5, 0), side(0.03, 0.06, 0, 6))
    assert forged["theorem"]["margin_J"] is None
    assert forged["verdict"]["passive"] is False


def test_margin_on_one_clock_is_bound_plus_least_two_port_energy() -> None:
    theorem = both(side(0.02, 0.05, 0, 0), side(0.03, 0.06, 0, 0), two_port_J=-0.01)["theorem"]
    assert theorem["margin_J"] == pytest.approx(0.10)
    assert theorem["energy_out_J"] == pytest.approx(0.01)
    more = both(*[side(0.02, 0.05, 0, 0)] * 2, two_port_J=0.0, two_port_end_J=0.03, two_port_later_J=0.02)["theorem"]
    assert (more["margin_end_J"], more["margin_later_J"]) == (pytest.approx(0.13), pytest.approx(0.12))


def test_least_margins_of_different_times_bound_nothing_where_energy_passes_through_the_link() -> None:
    sides = side(-0.5, 0.05, 0, 0), side(0.03, 0.06, 0, 0)
    for coupling in sorted(set(COUPLINGS) - {"pspm", "zoh", "two-layer"}):
        theorem = both(*sides, coupling)["theorem"]
        assert (theorem["margin_J"], theorem["bound_J"]) == (None, pytest.approx(0.11))
        assert both(*sides, coupling, total_margin_J=0.04)["theorem"]["margin_J"] == 0.04
        assert both(*sides, coupling, two_port_J=-0.01)["theorem"]["margin_J"] == pytest.approx(0.10)
    assert both(*sides, "zoh", total_margin_J=0.04)["theorem"]["margin_J"] == pytest.approx(-0.47)


def test_at_the_start_the_margin_is_the_bound_recorded_or_not() -> None:
    sides = side(-0.5, 0.05, 0, 0), side(0.03, 0.06, 0, 0)
    assert both(*sides, "pd", total_margin_J=0.2)["theorem"]["margin_J"] == pytest.approx(0.11)


def test_after_a_restart_what_was_recorded_is_not_all() -> None:
    sides = side(-0.5, 0.05, 0, 0) | {"incarnations": 2}, side(0.03, 0.06, 0, 0)
    assert both(*sides, "pd", total_margin_J=0.04)["theorem"]["margin_J"] is None


@pytest.fixture(scope="module")
def soft() -> Any:
    """PD into a soft wall: far more goes in at the hand, and out at the world, than d^2."""
    wall = {"world.wall.stiffness": 100.0, "world.wall.damping": 0.0, "operator_model.goal_m": 0.2}
    return simulate(Params().set({**wall, "coupling": "pd", "duration_s": 4.0, "device.servo": "sampled"}), 0)


def parts_of(whole: Recording, summary: Summary | None) -> list[Recording]:
    """What the two processes would have recorded."""
    device = {**summary, "world": None} if summary else None
    world = {**summary, "device": None} if summary else None
    return [replace(whole, world=None, summary=device), replace(whole, device=None, summary=world)]


@pytest.mark.parametrize("torn", [False, True])
def test_two_recordings_tell_of_both_ports_what_one_clock_saw(soft: Any, torn: bool) -> None:
    """The simulation's margin, at every tick, is the reference: never above, and within 1 mJ."""
    exact, minimum = soft.summary["theorem"]["margin_J"], soft.summary["world"]["ledger"]["margin_J"]
    assert exact >= 0.0
    assert soft.summary["device"]["ledger"]["margin_J"] + minimum < -0.02  # what their sum would say
    parts = parts_of(soft.recording, None if torn else soft.summary)
    reported = of_recordings([Path("device.mcap"), Path("world.mcap")], parts)
    assert exact - 1e-12 <= reported["theorem"]["margin_J"] <= exact + 1e-3
    assert reported["tuning"] == soft.summary["tuning"] != {}
    apart = [replace(part, meta={**part.meta, "clock": name}) for part, name in zip(parts, "ab", strict=True)]
    assert of_recordings([Path("device.mcap"), Path("world.mcap")], apart)["theorem"]["margin_J"] is None


def test_one_torn_recording_of_both_sides_tells_of_both_ports(soft: Any) -> None:
    reported = from_recording(soft.recording)
    assert reported["theorem"]["margin_J"] == pytest.approx(soft.summary["theorem"]["margin_J"], abs=1e-3)
    assert reported["tuning"] == soft.summary["tuning"]
    assert from_recording(parts_of(soft.recording, None)[0])["theorem"]["margin_J"] is None


def test_the_half_theorem_claims_nothing_of_a_law(soft: Any) -> None:
    for summary in (soft.summary, from_recording(soft.recording)):
        assert summary["device"]["ledger"]["slack_J"] is summary["world"]["ledger"]["slack_J"] is None
        assert summary["device"]["true_slack_J"] is None


@pytest.mark.parametrize(
    ("device", "world"),
    [
        (side(0.02, 0.05, 0, 0), None),
        (None, side(0.02, 0.05, 0, 0)),
        (side(None, None, 0, 0), side(0.02, 0.05, 0, 0)),
        (None, None),
    ],
)
def test_one_side_alone_has_no_theorem(device: Summary | None, world: Summary | None) -> None:
    found = both(device, world)
    assert {*found["theorem"].values()} == {None, False}
    assert found["verdict"]["passive"] is None


def test_energy_in_flight_is_what_neither_side_has() -> None:
    energy = both(side(0, 0, sent=100, credited=7, abandoned=20), side(0, 0, sent=10, credited=70))["energy"]
    assert energy["up"] == {"sent_nJ": 100, "credited_nJ": 70, "in_flight_nJ": 10, "abandoned_nJ": 20, "early_J": None}
    assert energy["down"] == {"sent_nJ": 10, "credited_nJ": 7, "in_flight_nJ": 3, "abandoned_nJ": 0, "early_J": None}


def test_what_was_given_up_and_credited_nevertheless_is_not_abandoned() -> None:
    """The sender left before the acknowledgement came: of its 20 nJ the receiver has credited 15."""
    energy = both(side(0, 0, sent=100, credited=0, abandoned=20), side(0, 0, sent=0, credited=95))["energy"]
    assert energy["up"] == {"sent_nJ": 100, "credited_nJ": 95, "in_flight_nJ": 0, "abandoned_nJ": 5, "early_J": None}


def test_one_side_knows_its_own_in_flight_and_not_what_was_credited() -> None:
    energy = both(side(0, 0, sent=100, credited=7, abandoned=20), None)["energy"]
    assert energy["up"] == {"sent_nJ": 100, "credited_nJ": None, "in_flight_nJ": 3, "abandoned_nJ": 20, "early_J": None}
    assert energy["down"] == {
        "sent_nJ": None,
        "credited_nJ": 7,
        "in_flight_nJ": None,
        "abandoned_nJ": None,
        "early_J": None,
    }


def test_merge_takes_from_each_process_its_own() -> None:
    links = {"up": {"profile": "delay 1ms"}, "down": None}, {"up": None, "down": {"profile": "delay 2ms"}}
    parts = [
        combine(a, b, link, seed=seed, duration_s=seed, coupling="pspm")
        for a, b, link, seed in ((side(0.1, 0.2, 5, 0), None, links[0], 3), (None, side(0.3, 0.4, 0, 5), links[1], 4))
    ]
    whole = merge(*parts)
    assert whole["device"] == side(0.1, 0.2, 5, 0)
    assert whole["world"] == side(0.3, 0.4, 0, 5)
    assert whole["links"] == {"up": {"profile": "delay 1ms"}, "down": {"profile": "delay 2ms"}}
    assert (whole["seed"], whole["duration_s"]) == (3, 3)
    assert whole["energy"]["up"]["in_flight_nJ"] == 0
    assert merge(*parts, seed=9)["seed"] == 9


def test_a_recording_tells_what_its_samples_tell(simulated: Any) -> None:
    recording: Recording = simulated.recording
    reported = from_recording(recording)
    summary = simulated.summary
    assert recording.device is not None
    for name, columns in (("device", recording.device), ("world", recording.world)):
        assert reported[name]["ledger"]["margin_J"] == columns["margin_J"].min() >= summary[name]["ledger"]["margin_J"]
        assert reported[name]["sent_nJ"] <= summary[name]["sent_nJ"] + 1  # the ledger counts what makes no whole nJ yet
    assert reported["duration_s"] == pytest.approx(summary["duration_s"], abs=0.06)
    assert reported["device"]["abandoned_nJ"] is None
    assert reported["theorem"]["bound_J"] is None


def keys(value: Any) -> Any:
    return {key: keys(item) for key, item in value.items()} if isinstance(value, dict) else None


def test_a_recordings_summary_has_the_keys_of_a_live_one(simulated: Any) -> None:
    """`dropped`, `path` and `profile` apart, whose keys and value only the live one knows."""
    live = dict(simulated.summary, motion=None, path=None)
    live["device"], live["world"] = (dict(live[side], dropped=None) for side in ("device", "world"))
    reported = from_recording(simulated.recording)
    assert keys(dict(reported, motion=None, path=None)) == keys(live)
    assert reported["world"]["dropped"] is None
    assert set(reported["device"]["servo"].values()) == {None}
    assert reported["links"]["up"]["profile"] == live["links"]["up"]["profile"]
    assert reported["links"]["up"]["offered"] is None
    json.dumps(reported, allow_nan=False)


def test_a_recording_counts_every_step_of_the_world(simulated: Any) -> None:
    step, live = from_recording(simulated.recording)["world"]["step"], simulated.summary["world"]["step"]
    assert step["count"] == live["count"]
    assert step["mean_s"] == pytest.approx(live["mean_s"], rel=1e-12)
    assert step["max_s"] == live["max_s"]


def test_a_recording_without_pspm_has_no_reservoir(simulated: Any) -> None:
    reported = from_recording(simulated.recording)
    for side in ("device", "world"):
        assert (reported[side]["reservoir_min_J"] is not None) == (simulated.summary["coupling"] == "pspm")


def test_a_side_that_ends_before_its_first_tick_knows_no_slack() -> None:
    """Control has started and nothing was observed: the least of no slacks is no number, and JSON has none for it."""
    simulation = Simulation(Params().set({"device.servo": "sampled"}))
    simulation._run(10**10, lambda: simulation.device.origin_ns is not None)
    part = device_summary(simulation.device, "pspm")
    assert simulation.device.ticks == 0
    assert part["true_slack_J"] is None
    json.dumps(part, allow_nan=False)


def test_versions_name_what_is_installed() -> None:
    found = versions()
    assert {"hapnet-haptics", "numpy", "python"} <= set(found)
    assert found["numpy"] != "not installed"
