"""Runs in virtual time: the sampled servo's account, shuffling, closed accounts, determinism, a golden trajectory.

`python -m tests.simulation.test_simulation` writes the golden trajectory anew.
"""

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapnet.assembly.scenes import for_its_scene
from hapnet.checks import Vector
from hapnet.control import continuous_servo, set_position_coupling as couplings, set_position_steps
from hapnet.control.set_position_coupling import SetPositionCoupling
from hapnet.couplings import held_torque
from hapnet.errors import HapnetError, InvalidParameter
from hapnet.params import Params
from hapnet.plant.device import SimulatedDevice
from hapnet.plant.tick import TickResult
from hapnet.recording.samples import Columns
from hapnet.side.continuous_device import ContinuousDeviceSide
from hapnet.side.device import DeviceSide
from hapnet.side.sampled_device import SampledDeviceSide
from hapnet.simulation.simulation import Result, Simulation, simulate
from tests.conftest import mostly_slow
from tests.support.paper import PAPER
from tests.support.theorem_cases import TOLERANCE_J, diagonal, matrix, random_case, random_link, sides

# -- ticks at rest ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("side", "changes"),
    mostly_slow(
        [
            (ContinuousDeviceSide, {}),
            (SampledDeviceSide, {"device.servo": "sampled", "device.resolution_m": 5.5e-5}),
            (SampledDeviceSide, {"coupling": "tdpa", "device.servo": "sampled", "scene": "box", "dof": 2}),
        ],
        1,
    ),
    ids=["continuous", "sampled", "law"],
)
def test_ticks_made_together_are_the_same_ticks(
    monkeypatch: pytest.MonkeyPatch, side: type[DeviceSide], changes: dict[str, object]
) -> None:
    """`rest` makes the ticks in which nothing happens; the run is, to the bit, the one that makes each by `tick`."""
    params = PAPER.set({"duration_s": 3.0, "record_hz": 250.0, "link.up": "delay 7ms 3ms loss 5%", **changes})
    ticked, each, rests = Simulation.tick, dict[int, tuple[float, float]](), list[tuple[int, int, Any]]()
    made = side.rest

    def rest(self: Any, now_ns: int, ticks: int, observe: Any, *, then_tick: bool) -> None:
        first, seen = self.ticks, list[tuple[float, float]]()
        made(self, now_ns, ticks, lambda *works: seen.append(works), then_tick=then_tick)
        for works in seen:
            observe(*works)
        rests.append((first, self.ticks, seen))

    def tick(self: Any, now_ns: int) -> Any:
        message = ticked(self, now_ns)
        if self.device.ledger is not None:
            each[self.device.ticks] = self.device.ledger.work, self.device.hand_work
        return message

    with monkeypatch.context() as patch:
        patch.setattr(side, "rest", rest)
        together = simulate(params, seed=3, kernel=False)
    monkeypatch.setattr(side, "skippable_ticks", DeviceSide.skippable_ticks)
    monkeypatch.setattr(side, "rest", DeviceSide.rest)  # none is left for it
    monkeypatch.setattr(Simulation, "tick", tick)
    singly = simulate(params, seed=3, kernel=False)
    for first, last, seen in rests[1:]:
        works = [each[k] for k in range(first, last + 1)]
        assert seen == [tuple(map(min, zip(*works, strict=True))), works[-1]]
    assert together.device.ticks == singly.device.ticks > 2900
    assert {**together.summary, "wall_clock": None} == {**singly.summary, "wall_clock": None}
    for ours, theirs in ((together.recording.device, singly.recording.device),
                         (together.recording.world, singly.recording.world)):  # fmt: skip
        assert all(np.array_equal(ours[name], theirs[name], equal_nan=True) for name in theirs)


# -- the sampled servo -----------------------------------------------------------------------------------------------


def sampled_case(seed: int, changes: dict[str, object]) -> Params:
    rng = np.random.default_rng([seed, 7])
    n = int(rng.integers(1, 4))
    return PAPER.set(
        {
            "duration_s": 2.0, "dof": n, "scene": str(rng.choice(["free", "wall"])),
            "operator": str(rng.choice(["sine", "press"])), "device.servo": "sampled",
            "device.own_damping": float(rng.choice([0.0, 0.05, 0.3, 2.0])),
            "device.stiffness": matrix(rng, n, 50.0, 600.0), "device.damping": diagonal(rng, n, 0.02, 1.0),
            "link.up": random_link(rng), "link.down": random_link(rng),
            "device.force_limit_N": float(rng.choice([0.0, 1.0, 3.3])),
            "device.shuffle": str(rng.choice(["harvested", "all"])),
            "operator_model.frequency_hz": float(rng.uniform(0.5, 4.0)),
            **changes,
        }
    )  # fmt: skip


@pytest.mark.parametrize("seeds", mostly_slow((range(10), range(10, 30)), 1), ids=str)
def test_the_measured_harvest_closes_the_account_at_the_actuators_port(seeds: range) -> None:
    """No encoder: -1e-9 J to 1e-9 J at any time, for own damping from 0 up, and what the process itself reports."""
    for seed in seeds:
        result = simulate(sampled_case(seed, {"device.shuffle": "all"}), seed)  # nothing discarded: no slack but error
        device, recording = result.summary["device"], result.recording.device
        assert device["quantisation_J"] == 0.0
        assert np.abs(recording["slack_J"]).max() <= TOLERANCE_J, seed
        assert -TOLERANCE_J <= device["true_slack_J"] <= TOLERANCE_J, seed
        assert device["true_slack_J"] == pytest.approx(device["ledger"]["slack_J"], abs=1e-14), seed
        assert device["reservoir_min_J"] >= 0.0


@pytest.mark.parametrize("trusted", mostly_slow([0.3, 0.0], 1))
def test_encoders_cost_no_more_than_the_recorded_quantisation(trusted: float) -> None:
    """Resolutions of 10 um to 1 mm, chatter, saturation and the trusted share of the own damping included."""
    ratios = []
    below = 0
    for seed in range(15):
        resolution = 10.0 ** np.random.default_rng(seed).uniform(-5.0, -3.0)
        changes = {"device.resolution_m": resolution, "device.own_damping": 0.3, "device.trusted_damping": trusted}
        result = simulate(sampled_case(seed, {**changes}), seed)
        device = result.summary["device"]
        assert device["quantisation_J"] > 0.0
        assert device["true_slack_J"] >= -device["quantisation_J"] - TOLERANCE_J, seed
        assert device["ledger"]["slack_J"] >= -TOLERANCE_J, seed
        below += device["true_slack_J"] < -TOLERANCE_J
        ratios.append(max(0.0, -device["true_slack_J"] / device["quantisation_J"]))
    print(
        f"\ntrusted damping {trusted}: true slack used {max(ratios):.1e} (most), {np.median(ratios):.1e} (median) of "
        f"the quantisation bound in 2 s; below zero in {below} of {len(ratios)}"
    )
    assert below > 5  # or the bound would be tested by nothing


@pytest.mark.parametrize("seeds", mostly_slow((range(3), range(3, 8)), 1), ids=str)
def test_the_range_harvest_needs_own_damping_on_a_sampled_servo(seeds: range, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without it the program refuses, and with that check off the slack goes below zero; above the sufficient
    condition it does not."""
    lowest = []
    for seed in seeds:
        params = sampled_case(seed, {"device.harvest": "range", "device.own_damping": 0.0, "device.step_limit_N": 0.0})
        with pytest.raises(InvalidParameter, match="range needs more than"):
            simulate(params, seed)
        with monkeypatch.context() as unchecked:
            unchecked.setattr(held_torque, "check", lambda *args: [])
            result = simulate(params, seed)
        lowest.append(result.summary["device"]["true_slack_J"])
        assert lowest[-1] < -1e-6, seed
        # b > K T/2 + 2 B on each axis; the rows' sums bound a K that couples the axes.
        K, B = np.abs(np.array(params.device.stiffness)).sum(axis=1), np.array(params.device.damping)
        enough = 1.001 * float(np.max(K * 1e-3 / 2.0 + 2.0 * B))
        result = simulate(params.set({"device.own_damping": enough}), seed)
        assert result.warnings == ()
        assert result.summary["device"]["true_slack_J"] >= -TOLERANCE_J, seed
    print(f"\nrange harvest, no own damping: slack {min(lowest):.1e} to {max(lowest):.1e} J in 2 s")


def test_a_stiffness_that_couples_the_axes_needs_more_damping_than_its_diagonal_says() -> None:
    """K = [[200, 190], [190, 200]]: 390 N/m along (1, 1). 0.1 + 2 B would do for its diagonal alone."""
    params = PAPER.set(
        {"dof": 2, "device.servo": "sampled", "device.harvest": "range", "device.damping": 0.01, "duration_s": 0.1,
         "device.stiffness": [[200.0, 190.0], [190.0, 200.0]], "device.own_damping": 0.15}
    )  # fmt: skip
    (warning,) = simulate(params).warnings
    assert "above 0.215 Ns/m" in warning


# -- shuffling -------------------------------------------------------------------------------------------------------


class Watch:
    """What each side harvested by its own balance, D - Pbar of every update, and what the hand put in [J]."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self.harvested: dict[SetPositionCoupling, float] = {}
        self.hand = 0.0
        update, run, advance = couplings.update, SimulatedDevice.run, SimulatedDevice.advance

        def watched_update(coupling: SetPositionCoupling, dt: float, x: Vector, dissipated: float, keep: float) -> None:
            update(coupling, dt, x, dissipated, keep)
            gain = max(0.0, dissipated - coupling.modulator.jump)
            self.harvested[coupling] = self.harvested.get(coupling, 0.0) + gain

        def watched_run(device: SimulatedDevice, ticks: int) -> list[TickResult]:
            results = run(device, ticks)
            self.hand += sum(max(0.0, tick[0]) for tick in results)
            return results

        def watched_advance(device: SimulatedDevice) -> float:
            work = advance(device)
            self.hand += max(0.0, work)
            return work

        for module in (set_position_steps, continuous_servo):  # where the world's end calls it, and the device's
            patch.setattr(module, "update", watched_update)
        patch.setattr(SimulatedDevice, "advance", watched_advance)
        patch.setattr(SimulatedDevice, "run", watched_run)


@pytest.mark.parametrize(
    "duration_s", [pytest.param(60.0, marks=pytest.mark.slow), pytest.param(600.0, marks=pytest.mark.soak)]
)
def test_the_default_shuffling_does_not_orbit(duration_s: float) -> None:
    sent = {}
    for shuffle in ("harvested", "all"):
        with pytest.MonkeyPatch.context() as patch:
            watch = Watch(patch)
            params = PAPER.set({"device.shuffle": shuffle, "world.shuffle": shuffle})
            result = simulate(params.set({"duration_s": duration_s, "record_hz": 10.0}), 1, kernel=False)
        both = result.device.coupling, result.world.coupling
        sent[shuffle] = [coupling.ledger.sent for coupling in both]
        harvested = [watch.harvested[coupling] for coupling in both]
        if shuffle == "harvested":
            assert all(s <= h + 1e-12 for s, h in zip(sent[shuffle], harvested, strict=True))
            assert max(sent[shuffle]) <= watch.hand  # all energy there is comes from the hand
        print(
            f"\n{duration_s:.0f} s, shuffle {shuffle}: sent {sent[shuffle][0]:.3f} J, {sent[shuffle][1]:.3f} J; "
            f"harvested {harvested[0]:.3f} J, {harvested[1]:.3f} J; the hand put in {watch.hand:.3f} J"
        )
    assert min(sent["all"]) > 30.0 * max(sent["harvested"])


# -- accounts, determinism -------------------------------------------------------------------------------------------


def test_accounts_close_once_the_links_have_delivered() -> None:
    """Control and wire together: what one side gave is what the other was credited, to the nanojoule."""
    busy = 0
    for case in range(500, 506):
        params = random_case(case, 1.0).set({"wire.admission_W": 1e3, "wire.admission_burst_J": 10.0})
        result = simulate(params, case)
        energy = result.summary["energy"]
        for way, giver in (("up", result.device), ("down", result.world)):
            flow = energy[way]
            assert flow["in_flight_nJ"] == 0, case
            assert flow["sent_nJ"] == flow["credited_nJ"] + flow["abandoned_nJ"], case
            assert flow["abandoned_nJ"] == 0, case
            given = giver.coupling.ledger.sent
            assert flow["sent_nJ"] * 1e-9 == pytest.approx(given, abs=1.1e-9), case  # less than 1 nJ is kept back
            busy += flow["sent_nJ"] > 0
    assert busy > 4


@pytest.mark.parametrize("policy", ["hold", "release"])
@pytest.mark.parametrize(
    ("up", "down"),
    mostly_slow(
        [
            ("at 2s: down; at 5s: up", "at 2s: down; at 5s: up"),
            ("at 2s: down; at 5s: up", ""),
            ("", "at 2s: loss 100%; at 5s: delay 40ms"),
        ],
        1,
    ),
    ids=["both ways", "one way", "loss of all"],
)
def test_a_partition_leaves_both_sides_passive_and_heals(up: str, down: str, policy: str) -> None:
    changes: dict[str, object] = {
        "duration_s": 8.0, "link.up": "delay 30ms 5ms", "link.down": "delay 30ms 5ms", "link.up_timeline": up,
        "link.down_timeline": down, "operator": "sine", "world.wall.position_m": 0.005, "record_hz": 1000.0,
    }  # fmt: skip
    for side in ("device", "world"):
        changes |= {f"{side}.on_silence": policy, f"{side}.silence_after_s": 0.2}
    result = simulate(PAPER.set(changes), 3)
    summary = result.summary
    assert summary["theorem"]["margin_J"] >= -1e-9
    for name, heard, other in (("device", down, "up"), ("world", up, "down")):
        side = summary[name]
        assert side["ledger"]["slack_J"] >= -1e-9
        assert side["reservoir_min_J"] >= 0.0
        assert summary["energy"][other]["in_flight_nJ"] == summary["energy"][other]["abandoned_nJ"] == 0
        outages = side["outages"]
        if heard:  # a message every step or PSPM period of 50 ms at most, and 25 to 35 ms on the way
            assert outages["count"] == 1
            assert outages["longest_s"] == pytest.approx(3.0, abs=0.06)
            assert outages["recovery_max_s"] <= 0.06
            assert side["missing"] > 3.0 / 0.05
        else:
            assert outages == {"count": 0, "longest_s": 0.0, "total_s": 0.0, "recovery_max_s": 0.0}
    device = result.recording.device
    held = device["force_N"][(device["time_s"] > 4.0) & (device["time_s"] < 4.9), 0]
    moved = device["position_m"][(device["time_s"] > 4.0) & (device["time_s"] < 4.9), 0]
    if down:  # the device hears nothing: its spring is held where it was, or follows the hand
        assert (np.ptp(held) > 50.0 * np.ptp(moved)) == (policy == "hold")  # K = 100 N/m
        assert (abs(held).max() < 0.1) == (policy == "release")


def columns_of(result: Result) -> Iterator[Columns]:
    for side in (result.recording.device, result.recording.world):
        assert side is not None
        yield side


def same(one: Result, other: Result) -> bool:
    equal = [
        a.keys() == b.keys() and all(np.array_equal(a[name], b[name], equal_nan=True) for name in a)
        for a, b in zip(columns_of(one), columns_of(other), strict=True)
    ]
    summaries = [{name: part for name, part in r.summary.items() if name != "wall_clock"} for r in (one, other)]
    return all(equal) and summaries[0] == summaries[1]


@pytest.mark.parametrize("servo", ["continuous", "sampled"])
def test_the_same_seed_gives_the_same_run_bit_for_bit(servo: str) -> None:
    params = random_case(3, 2.0).set({"device.servo": servo, "operator": "sine"})
    first = simulate(params, 5)
    assert same(first, simulate(params, 5))
    assert not same(first, simulate(params, 6))


def test_switched_off_it_neither_harvests_nor_sends() -> None:
    summary = simulate(PAPER.set({"coupling": "zoh", "duration_s": 3.0}), 1).summary
    for side in sides(summary):
        assert side["reservoir_min_J"] is None
        assert (side["sent_nJ"], side["credited_nJ"]) == (0, 0)
    assert summary["theorem"]["bound_J"] == pytest.approx(0.1 + 0.05)
    assert min(side["ledger"]["slack_J"] for side in sides(summary)) < -1e-3


def test_a_link_that_carries_nothing_is_named() -> None:
    with pytest.raises(HapnetError, match="did not find each other"):
        simulate(PAPER.set({"link.up": "loss 100%"}))


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({"device.harvest": "measured"}, "device.harvest"),
        ({"device.resolution_m": 1e-5}, "device.resolution_m"),
        ({"device.trusted_damping": 0.1}, "device.trusted_damping"),
        ({"device.spring_share": 1.5}, "device.spring_share"),
        ({"dof": 2, "scene": "paper"}, "dof"),
        ({"dof": 2, "device.stiffness": [[1.0, 2.0], [2.0, 1.0]]}, "stiffness"),
        ({"operator": "nobody"}, "operator"),
        ({"hardware": "mymodule:Arm"}, "hardware is 'mymodule:Arm'; allowed: simulated"),
    ],
)
def test_what_does_not_fit_together_is_named(changes: dict[str, object], name: str) -> None:
    with pytest.raises(InvalidParameter, match=name):
        simulate(PAPER.set({"duration_s": 0.1, **changes}))


def test_a_simulation_needs_an_end() -> None:
    with pytest.raises(HapnetError, match="duration"):
        simulate(PAPER.set({"duration_s": 0.0}))


# -- golden ----------------------------------------------------------------------------------------------------------

GOLDEN = Path(__file__).parents[1] / "data" / "golden_1dof.json"
HOW = "python -m tests.simulation.test_simulation: 2 s of the default run of one axis, seed 1, every 10 ms; SI units"
SECTION_4: dict[str, object] = {
    "device.stiffness": 100.0, "device.ceiling_J": 0.05, "device.shuffle": "harvested", "world.shuffle": "harvested",
}  # fmt: skip
"""What it was made with, whatever the defaults become."""


def flat(table: dict[str, Any], prefix: str = "") -> dict[str, object]:
    out: dict[str, object] = {}
    for name, value in table.items():
        out.update(flat(value, f"{prefix}{name}.") if isinstance(value, dict) else {prefix + name: value})
    return out


def golden_run(params: Params) -> dict[str, list[float]]:
    """Device at every 10 ms, proxy as of the last step before."""
    device, world = columns_of(simulate(params, 1))
    latest = np.searchsorted(world["time_ns"], device["time_ns"], side="right") - 1
    known = latest >= 0
    return {
        "time_s": device["time_s"][known].tolist(),
        "device_m": device["position_m"][known, 0].tolist(),
        "proxy_m": world["position_m"][latest[known], 0].tolist(),
        "device_reservoir_J": device["reservoir_J"][known].tolist(),
        "world_reservoir_J": world["reservoir_J"][latest[known]].tolist(),
    }


def write_golden() -> None:
    params = PAPER.set({**SECTION_4, "duration_s": 2.0, "record_hz": 100.0})
    content = {"how": HOW, "params": flat(params.as_dict()), "columns": golden_run(params)}
    GOLDEN.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def test_the_golden_trajectory() -> None:
    content = json.loads(GOLDEN.read_text(encoding="utf-8"))
    columns = golden_run(for_its_scene(PAPER.set(content["params"])))
    assert columns.keys() == content["columns"].keys()
    for name, values in content["columns"].items():
        assert columns[name] == pytest.approx(values, abs=1e-9), name
    assert max(map(abs, columns["proxy_m"])) > 0.01
    assert not any(math.isnan(value) for values in columns.values() for value in values)


def test_an_outage_is_counted_with_its_length() -> None:
    """Nothing comes for as long as the link is down, and until the next set-position, which is sent every 5 ms."""
    link = {"link.up": "delay 10ms", "link.down": "delay 10ms", "link.up_timeline": "at 1s: down; at 2.2s: up"}
    summary = simulate({"duration_s": 4.0, **link}, seed=1).summary
    outages = summary["world"]["outages"]
    assert outages["count"] == 1
    assert outages["longest_s"] == outages["total_s"] == pytest.approx(1.2, abs=0.011)
    assert summary["device"]["outages"]["count"] == 0


if __name__ == "__main__":
    write_golden()
