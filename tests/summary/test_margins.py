"""Margins of one account: after the first second never above the end, and both ports while a pair runs."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from hapnet.couplings.registry import COUPLINGS, jointly_passive
from hapnet.params import Params
from hapnet.recording.samples import DeviceSample, Recording
from hapnet.simulation.simulation import simulate
from hapnet.summary.from_samples import START_S, LiveFigures, min_total_margin
from hapnet.summary.joint import JointMargin
from hapnet.summary.recorded import from_recording, of_parts
from hapnet.summary.run import combine
from tests.summary.test_verdict import SIDE
from tests.view.test_history import device, world

NANO = 1_000_000_000


@dataclass
class Walk:
    """A side's margin as a random walk at 60 Hz, without samples while its process stood still."""

    rng: np.random.Generator
    kind: str
    seconds: float
    samples: list[tuple[int, float]] = field(default_factory=list)

    def __post_init__(self) -> None:
        times = np.arange(0, round(self.seconds * NANO), NANO // 60) + int(self.rng.integers(NANO // 60))
        margins = 0.05 + np.cumsum(self.rng.normal(0.0, 0.01, len(times)))
        stop_s, length_s = self.rng.uniform(0.0, self.seconds), self.rng.uniform(0.0, 5.0)
        seen = (times < stop_s * NANO) | (times >= (stop_s + length_s) * NANO)
        seen[0] = True
        self.samples = list(zip(times[seen].tolist(), margins[seen].tolist(), strict=True))
        self.end = float(margins[-1])  # what control knows, whether a sample came or not
        self.least = float(margins.min())


@pytest.mark.slow
def test_after_the_start_is_never_above_the_end_in_1000_runs_with_stops() -> None:
    """Stops of 0 to 5 s, at any time, on either side; in some nothing was sampled after the first second."""
    rng, names, without = np.random.default_rng(9), sorted(COUPLINGS), 0
    for number in range(1000):
        coupling, seconds = names[number % len(names)], rng.uniform(0.2, 8.0)
        parts, joint = [], JointMargin()
        walks = [Walk(rng, kind, seconds) for kind in ("device", "world")]
        for walk in walks:
            live = LiveFigures()
            for at_ns, margin in walk.samples:
                live.see(device(at_ns, margin) if walk.kind == "device" else world(at_ns, margin))
            ledger = {"margin_J": min(walk.least, walk.end), "slack_J": 0.0, "bound_J": 0.05, "margin_end_J": walk.end}
            parts.append({**SIDE, "in_flight_nJ": 0, "ledger": {**ledger, "margin_later_J": live.later_J(walk.end)}})
        for at_ns, margin, kind in sorted((*one, walk.kind) for walk in walks for one in walk.samples):
            joint.take(kind, at_ns, margin)
        links = {"up": None, "down": None}
        theorem = combine(*parts, links, seed=1, duration_s=seconds, coupling=coupling, **joint.margins())["theorem"]
        end, later = theorem["margin_end_J"], theorem["margin_later_J"]
        without += later is None
        if later is not None:
            assert theorem["margin_J"] <= later <= end, (number, coupling)
    assert 20 < without < 500


@pytest.mark.parametrize("lag_ns", [0, NANO // 4, 3 * NANO])
def test_both_ports_while_a_pair_runs_are_those_of_its_recording(lag_ns: int) -> None:
    """Whatever order the samples of the two sides come in: the world's come later by `lag_ns`."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        walks = [Walk(rng, kind, 6.0) for kind in ("device", "world")]
        joint = JointMargin()
        order = sorted(
            (at_ns + (lag_ns if walk.kind == "world" else 0), walk.kind, at_ns, margin)
            for walk in walks
            for at_ns, margin in walk.samples
        )
        for _, kind, at_ns, margin in order:
            joint.take(kind, at_ns, margin)
        columns = [
            {
                "time_s": np.array([at / NANO for at, _ in walk.samples]),
                "margin_J": np.array([m for _, m in walk.samples]),
            }
            for walk in walks
        ]
        recording = Recording({"aligned": True}, columns[0], columns[1], [], None)
        found = joint.margins()
        assert found["total_margin_J"] == pytest.approx(min_total_margin(recording), abs=1e-12)
        start_s = max(one["time_s"][0] for one in columns)
        assert found["total_later_J"] == pytest.approx(min_total_margin(recording, start_s + START_S), abs=1e-12)


HANDS, SCENES = ("press", "sine", "rest", "hand-3"), ("wall", "free", "sphere")


def with_stop(recording: Recording, rng: np.random.Generator) -> Recording:
    """As if a side's process had stood still for up to 5 s: nothing of it was sampled meanwhile."""
    kind = rng.choice(["device", "world"])
    columns = getattr(recording, kind)
    times = columns["time_s"]
    begun = rng.uniform(0.0, times[-1])
    seen = (times < begun) | (times >= begun + rng.uniform(0.0, 5.0))
    seen[0] = True
    return replace(recording, summary=None, **{kind: {name: column[seen] for name, column in columns.items()}})


@pytest.mark.soak
@pytest.mark.timeout(3000)
def test_after_the_start_is_never_above_the_end_in_1000_whole_runs() -> None:
    """As the run says it, and as its recording does in which a side stood still."""
    rng, names, told = np.random.default_rng(12), sorted(COUPLINGS), 0
    for number in range(1000):
        delay, jitter = rng.uniform(0.0, 150.0), rng.uniform(0.0, 30.0)
        link = f"delay {delay:.0f}ms {jitter:.0f}ms loss {rng.uniform(0.0, 10.0):.1f}%"
        params = Params().set({
            "coupling": names[number % len(names)], "operator": str(rng.choice(HANDS)),
            "scene": str(rng.choice(SCENES)),
            "duration_s": round(float(rng.uniform(0.2, 8.0)), 3), "link.up": link, "link.down": link,
            "operator_model.wait_s": 0.0, "device.servo": "sampled",
            "device.watchdog_s": float(rng.choice([0.0, 0.02])),
        })  # fmt: skip
        result = simulate(params, seed=number)
        whole = result.recording
        stopped = with_stop(whole, rng)
        halves = {"device": {**result.summary, "world": None}, "world": {**result.summary, "device": None}}
        of_run = of_parts(halves, {}, stopped, {}, coupling=params.coupling, seed=number)
        for summary in (result.summary, from_recording(stopped), of_run):
            theorem = summary["theorem"]
            least, later, end = theorem["margin_J"], theorem["margin_later_J"], theorem["margin_end_J"]
            if later is not None and end is not None and not theorem["diverged"]:
                told += 1
                assert least <= later <= end, (number, params.coupling, theorem)
    print(f"{told} margins after the start, none above the end")
    assert told > 1000


def test_a_side_that_restarts_begins_the_sum_anew() -> None:
    joint = JointMargin()
    for at, kind, margin in ((0, "device", 0.1), (1, "world", -0.9), (2, "device", 0.1)):
        joint.take(kind, at, margin)
    assert joint.margins()["total_margin_J"] == pytest.approx(-0.8)
    joint.begin("world")
    assert joint.margins() == {"total_margin_J": None, "total_end_J": None, "total_later_J": None}
    joint.take("device", 3, 0.1)
    joint.take("world", 4, 0.05)
    joint.take("device", 5, 0.2)
    assert joint.margins()["total_margin_J"] == pytest.approx(0.15)


def test_the_couplings_tried_are_of_both_kinds() -> None:
    assert {jointly_passive(name) for name in COUPLINGS} == {True, False}
    assert DeviceSample is type(device(0))
