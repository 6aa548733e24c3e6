"""Theorem 1 in extreme cases, every margin checked by an account that shares nothing with the program's own.

Default: 6 cases; ``-m slow``: 18; ``pytest -n 0 -s -m soak test_extremes.py``: 150 and 4,000. Each of the
sabotages at the end is seen by the very checks that the cases pass.
"""

import ast
import math
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapnet.control import ledger
from hapnet.control.ledger import Ledger
from hapnet.control.reserve import ForceGuard
from hapnet.errors import InvalidParameter
from hapnet.params import Params
from hapnet.plant.device import SimulatedDevice
from hapnet.recording.samples import MemoryRecorder, Recording
from hapnet.simulation import simulation
from hapnet.simulation.simulation import Simulation
from hapnet.summary.from_samples import motion
from tests.conftest import mostly_slow, random_spd
from tests.support import independent_account
from tests.support.extreme_cases import UNCHECKED, Examined, examine, extreme_case
from tests.support.independent_account import Witness
from tests.support.paper import PAPER

MOST_REFUSED = 0.05
MOST_TOO_FAST = 0.02


def survey(cases: Sequence[int]) -> None:
    """Nothing may be wrong in any case; few may be refused, each for a reason that holds."""
    examined = [examine(case) for case in cases]
    failed = [one for one in examined if one.wrong]
    kinds = Counter((one.params.device.servo, kind) for one in failed for kind in one.kinds)
    lines = [f"  {servo} servo, {kind}: {count} cases" for (servo, kind), count in sorted(kinds.items())]
    lines += [f"  case {one.case}: {'; '.join(one.wrong)}" for one in failed[:20]]
    assert not failed, f"{len(failed)} of {len(cases)} cases failed:\n" + "\n".join(lines)
    refused = [one for one in examined if one.refused is not None]
    assert len(refused) <= MOST_REFUSED * len(cases), [str(one.refused) for one in refused]
    assert sum(one.too_fast for one in examined) <= MOST_TOO_FAST * len(cases)
    for one in refused:
        assert_violates_unchecked(one)


def assert_violates_unchecked(one: Examined) -> None:
    """A case that is refused would really break what is promised."""
    assert isinstance(one.refused, InvalidParameter)
    assert one.refused.name in UNCHECKED, f"case {one.case}, {one.refused}: say how this check is switched off"
    with UNCHECKED[one.refused.name]():
        assert examine(one.case, one.params).wrong, f"case {one.case} is refused, but holds: {one.refused}"


@pytest.mark.parametrize("cases", mostly_slow([range(40, 46), range(18), range(150), range(4000)], 1, 2), ids=len)
def test_what_is_promised_holds_in_extreme_cases(cases: range) -> None:
    """Several of the first broke a promise when they were drawn: limits of force and step, margins; some diverged."""
    survey(cases)


def test_the_cases_reach_over_five_decades() -> None:
    """What is drawn: parameters of five decades and more, each kind of case often enough."""
    cases = [extreme_case(case) for case in range(200)]
    stiffness = [np.linalg.eigvalsh(np.array(params.device.stiffness)) for params in cases]
    assert max(k[-1] for k in stiffness) / min(k[0] for k in stiffness) > 1e4
    for name in ("device.mass", "operator_model.stiffness", "world.wall.stiffness", "wire.admission_W"):
        values = [params.get(name) for params in cases]
        assert max(values) / min(values) > 1e4, name
    rates = [params.device.servo_hz for params in cases]
    assert min(rates) < 110.0
    assert max(rates) > 4500.0
    for name, value in (
        ("device.servo", "continuous"), ("device.servo", "sampled"), ("device.ceiling_J", 0.0),
        ("world.ceiling_J", 0.0), ("device.force_limit_N", 0.0), ("operator_model.mass", 0.0),
        ("device.on_silence", "release"), ("dof", 1), ("dof", 2), ("dof", 3),
    ):  # fmt: skip
        assert sum(params.get(name) == value for params in cases) > 20, name
    for name in ("device.resolution_m", "wire.deadband", "link.up_timeline", "device.trusted_damping"):
        assert sum(bool(params.get(name)) for params in cases) > 8, name


# -- the account -----------------------------------------------------------------------------------------------------


def test_the_account_knows_nothing_of_what_it_checks() -> None:
    tree = ast.parse(Path(independent_account.__file__).read_text("utf-8"))
    imported = {node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    imported |= {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    assert not [name for name in imported if name.startswith(("hapnet.control", "hapnet.ext.metrics", "hapnet.plant"))]


def audited(servo: str, n: int) -> Params:
    """A hand that shakes a stiff spring beyond its limit, over a link that is down for a while, deadband and all."""
    rng = np.random.default_rng(n)
    return PAPER.set(
        {
            "duration_s": 1.5, "dof": n, "record_hz": 1000.0, "scene": "wall", "operator": "sine",
            "world.wall.position_m": 0.004,
            "operator_model.mass": 0.1, "operator_model.damping": 1.0, "operator_model.frequency_hz": 4.0,
            "device.servo": servo, "device.substeps": 1, "device.stiffness": random_spd(rng, n, 100.0, 600.0).tolist(),
            "device.damping": rng.uniform(0.5, 2.0, n).tolist(), "device.force_limit_N": 2.0,
            "device.greatest_speed": 3.0, "device.on_silence": "release", "device.silence_after_s": 0.1,
            "world.mass": random_spd(rng, n, 0.01, 0.2).tolist(), "world.step_min_s": 0.002,
            "world.damping": random_spd(rng, n, 5.0, 20.0).tolist(),
            "world.stiffness": random_spd(rng, n, 200.0, 2000.0).tolist(),
            "world.silence_after_s": 0.1,
            "link.up": "delay 15ms 5ms loss 5%", "link.down": "delay 15ms 5ms loss 5%",
            "link.up_timeline": "at 0.5s: down; at 0.8s: up", "link.down_timeline": "at 0.5s: down; at 0.8s: up",
            "wire.deadband": 0.3,
        }
    )  # fmt: skip


@pytest.mark.parametrize("n", mostly_slow([1, 2, 3], 1))
@pytest.mark.parametrize("servo", ["continuous", "sampled"])
def test_the_account_agrees_with_every_margin(servo: str, n: int) -> None:
    """Saturated, with deadband, silence and release; at the least, at the end and over time."""
    params = audited(servo, n)
    found = examine(1, params)
    assert not [text for text in found.wrong if text.startswith(("account", "samples", "motion"))], found.wrong
    assert None not in (found.account.device_min, found.account.both_least, found.account.hand_and_world_least)
    result = simulation.simulate(params, 1)  # the same again: does it show what it is to show?
    device, summary = result.recording.device, result.summary
    K = np.array(params.device.stiffness)
    stretch = device["position_m"] - device["set_position_m"]
    knee_J = 0.5 * (2.0 * params.device.spring_share) ** 2 / np.linalg.eigvalsh(K)[-1]
    assert np.max(0.5 * np.einsum("ki,ij,kj->k", stretch, K, stretch)) > knee_J
    assert summary["device"]["outages"]["count"] > 0
    assert np.any(np.all(device["target_m"] == device["position_m"], axis=1))
    assert min(summary[side]["sent_nJ"] for side in ("device", "world")) > 1000
    chatty = simulation.simulate(params.set({"wire.deadband": 0.0}), 1).summary
    assert summary["links"]["up"]["offered"] < 0.7 * chatty["links"]["up"]["offered"]
    assert np.ptp(found.account.device) > 1e-3
    assert np.ptp(found.account.world) > 1e-3


# -- the checks can fail ---------------------------------------------------------------------------------------------


def kinds_of(params: Params) -> set[str]:
    found = examine(1, params)
    assert found.refused is None
    return found.kinds


def test_torque_in_the_wrong_direction_is_in_the_summary(monkeypatch: pytest.MonkeyPatch) -> None:
    """A device that gives the reverse of what it is asked for, and says so."""
    apply = SimulatedDevice.apply

    def reversed_(self: SimulatedDevice, force: tuple[float, ...]) -> tuple[float, ...]:
        opposite = tuple(-component for component in force)
        apply(self, opposite)
        return opposite

    monkeypatch.setattr(SimulatedDevice, "apply", reversed_)
    found = examine(1, audited("sampled", 1))
    assert found.account.device_min < 0.01  # of 0.05 J: it does give energy away,
    assert not {kind for kind in found.kinds if kind.startswith("account")}, found.wrong  # and the ledger knows


@pytest.mark.parametrize("servo", ["continuous", "sampled"])
def test_a_ledger_that_always_says_0_is_seen(servo: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def observe(self: Ledger, stored: float, reservoir: float) -> None:
        self.margin = self.margin_min = self.slack = self.slack_min = 0.0

    monkeypatch.setattr(ledger, "observe", observe)
    kinds = kinds_of(audited(servo, 1))
    assert {"account of the device", "account of the world", "account of the device over time"} <= kinds


@pytest.mark.parametrize("servo", ["continuous", "sampled"])
def test_a_ledger_that_stops_half_way_is_seen(servo: str, monkeypatch: pytest.MonkeyPatch) -> None:
    put_in = ledger.put_in
    calls: Counter[int] = Counter()

    def half(self: Ledger, work: float) -> None:
        calls[id(self)] += 1
        put_in(self, work if calls[id(self)] <= 20 else 0.0)

    monkeypatch.setattr(ledger, "put_in", half)
    kinds = kinds_of(audited(servo, 1))
    assert {"account of the device over time", "account of the world over time"} <= kinds


@pytest.mark.parametrize(
    ("limit", "case", "word"), [("limit", 58, "force asked for"), ("step", 64, "step"), ("reach", 46, "device margin")]
)
def test_a_limit_of_the_held_force_that_is_ignored_is_seen(
    limit: str, case: int, word: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its length, its step, and what the account can pay for, in one of the default cases each."""
    careless(limit, monkeypatch)
    assert word in examine(case).kinds


def test_a_force_of_ten_times_the_limit_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """The actuators would cut it, which must not be relied upon."""
    params = audited("sampled", 1).set({"device.force_limit_N": 0.02})
    assert not examine(1, params).wrong
    careless("limit", monkeypatch)
    found = next(text for text in examine(1, params).wrong if text.startswith("force asked for"))
    assert float(found.split()[3]) > 10.0 * params.device.force_limit_N


def careless(limit: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """From now on the guards of forces do without this limit."""
    make = ForceGuard.__init__

    def without(self: ForceGuard, **limits: float) -> None:
        make(self, **{**limits, limit: 0.0 if limit == "reach" else math.inf})

    monkeypatch.setattr(ForceGuard, "__init__", without)


def test_a_continuous_servo_whose_damper_knows_no_limit_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    make = SimulatedDevice.__init__

    def unlimited(self: SimulatedDevice, *args: Any, **kwargs: Any) -> None:
        make(self, *args, **{**kwargs, "force_limit": None})

    assert not examine(51).wrong
    monkeypatch.setattr(SimulatedDevice, "__init__", unlimited)
    assert "force" in examine(51).kinds


def test_half_a_run_measured_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    def half(recording: Recording) -> dict[str, float | int | None]:
        device, world = recording.device, recording.world
        assert device is not None
        assert world is not None
        halves = [{key: values[: len(values) // 2] for key, values in side.items()} for side in (device, world)]
        return motion(Recording(recording.meta, *halves, recording.events, recording.summary))

    monkeypatch.setattr(simulation, "motion", half)
    kinds = kinds_of(audited("sampled", 2))
    assert {"motion free_rms_m", "motion contact_rms_m", "motion contacts"} <= kinds


def test_a_sample_that_is_lost_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    write = MemoryRecorder.write
    count = 0

    def forgetful(self: MemoryRecorder, sample: Any) -> None:
        nonlocal count
        count += 1
        if count % 1000:
            write(self, sample)

    monkeypatch.setattr(MemoryRecorder, "write", forgetful)
    assert {"samples of the device"} <= kinds_of(audited("sampled", 1))


def test_energy_from_nowhere_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """A nanojoule more than was sent, at any time in the run."""
    simulation = Simulation(audited("continuous", 1), 1)
    witness = Witness(simulation)
    simulation.pair()
    assert witness.least_gap_nJ == 0
    simulation.device_endpoint.credit(witness.world.credited_nJ + 1)
    assert witness.least_gap_nJ < 0
