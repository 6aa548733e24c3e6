"""The network parted, in both directions or one, and whole again: nothing blocks, nothing is lost for good, and it says
so."""

import random
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapnet.recording.mcap import read_recording
from hapnet.transport.config import free_address
from hapnet.wire.messages import Role
from netem.units import format_time
from tests.conftest import mostly_slow
from tests.faults.invariants import (
    NANO,
    assert_device_within_limits,
    assert_pair_kept_the_rules,
    assert_passive,
    columns_of,
)
from tests.faults.support import METRONOME, OTHER, RECOVERY_S, Side, let_pass, pair
from tests.support.processes import NETEM, started

LINK = "delay 20ms 5ms loss 1%"
ROUND_TRIP_S = 0.05
SILENCE_S = 0.3
SILENCE = ("--on-silence", "release", "--silence-after", SILENCE_S)
TOLD_WITHIN_S = 0.3
"""How well a side knows how long it heard nothing: a step of the world, the link's delay, and a busy machine."""

AWAY_S = 0.25
"""Half of the shortest partition: a servo that waits for the network is away for all of it."""

PAUSE_S = 1.5
FIRST_S = 1.5
KINDS = (("down", "both"), ("loss 100%", "up"), ("down", "down"), ("down", "up"), ("loss 100%", "down"))
SENDER: dict[str, tuple[Role, ...]] = {"both": ("device", "world"), "up": ("device",), "down": ("world",)}


@dataclass(frozen=True)
class Partition:
    """The link of a way, or both, is `what` between two times from pairing [ms]."""

    what: str
    way: str
    begin_ms: int
    end_ms: int


def plan(lengths_s: list[float]) -> Iterator[Partition]:
    begin_s = FIRST_S
    for number, length_s in enumerate(lengths_s):
        yield Partition(*KINDS[number % len(KINDS)], round(1e3 * begin_s), round(1e3 * (begin_s + length_s)))
        begin_s += length_s + PAUSE_S


def timeline(partitions: list[Partition], role: Role) -> str:
    """What happens to what that side sends."""
    entries = []
    for partition in partitions:
        if role in SENDER[partition.way]:
            back = "up" if partition.what == "down" else LINK
            entries += [f"at {partition.begin_ms}ms: {partition.what}", f"at {partition.end_ms}ms: {back}"]
    return "; ".join(entries) or f"at 0s: {LINK}"


def lengths(count: int, longest_s: float, seed: int) -> list[float]:
    """Spread evenly by their logarithm over 0.5 s to the longest, which is one of them."""
    rng = random.Random(seed)
    return [0.5 * (longest_s / 0.5) ** rng.random() for _ in range(count - 1)] + [longest_s]


@pytest.mark.parametrize(
    ("count", "longest_s"),
    [
        pytest.param(2, 1.2, marks=pytest.mark.slow),
        pytest.param(4, 4.0, marks=pytest.mark.soak),
        pytest.param(20, 10.0, marks=pytest.mark.soak),
    ],
    ids=["short", "longer", "full"],
)
def test_partitions(count: int, longest_s: float, tmp_path: Path) -> None:
    partitions = list(plan(lengths(count, longest_s, seed=1)))
    device, world = (("--timeline", timeline(partitions, role)) for role in ("device", "world"))
    with (
        started(command=METRONOME) as bare,
        pair(tmp_path, "--link", LINK, *SILENCE, device=(*device, "--set", "record_hz=1000"), world=world) as sides,
    ):
        both: dict[Role, Side] = {"device": sides.device, "world": sides.world}
        sides.until_paired()
        let_pass(FIRST_S / 2)
        before_MB = {role: side.memory_MB for role, side in both.items()}
        after_MB = dict(before_MB)
        for partition in partitions:
            for role in SENDER[partition.way]:
                end_ns = until_changed(both[role], partition.end_ms)
                both[OTHER[role]].until_said("heard", end_ns)
            after_MB = {role: max(after_MB[role], side.memory_MB) for role, side in both.items()}
        let_pass(PAUSE_S / 2)
        starved_s = sides.device.starved_s
        sides.stop()
    summary = sides.accounts()
    assert summary["theorem"]["margin_J"] > 0.0
    recoveries_s = [s for role in both for s in recoveries(both, role, partitions)]
    print(f"recovery: median {np.median(recoveries_s):.3f} s, longest {max(recoveries_s):.3f} s")
    print(f"memory [MB] before {before_MB}, at most {after_MB}")
    for role, side in both.items():
        assert after_MB[role] - before_MB[role] < 6.0
        assert side.summary[role]["incarnations"] == 1
        assert_outages(both, role, partitions, hiccups=len(bare.out))
    assert_pair_kept_the_rules(*(read_recording(side.recording) for side in both.values()))
    # nothing waited for the network: the servo was away no longer than its process was kept from a processor
    longest_s = summary["device"]["servo"]["longest_ms"] * 1e-3
    print(f"servo away for {longest_s:.3f} s at most; its process waited {starved_s:.3f} s for a processor in all")
    assert longest_s <= AWAY_S + starved_s


def changes(side: Side, at_ms: int) -> list[int]:
    """When its link changed at that time of the timeline [ns]."""
    return [
        int(notice["monotonic_ns"])
        for notice in side.said("netem")
        if notice["text"].startswith(f"emulated link, at {format_time(at_ms * 1_000_000)}:")
    ]


def until_changed(side: Side, at_ms: int) -> int:
    side.until(f"the change at {at_ms} ms", lambda: bool(changes(side, at_ms)))
    return changes(side, at_ms)[0]


def endings(both: dict[Role, Side], role: Role, partitions: list[Partition]) -> Iterator[tuple[Partition, int, Any]]:
    """Each partition of what the other side sends, its end [ns], and what this side said when it heard again."""
    for partition in partitions:
        if OTHER[role] in SENDER[partition.way]:
            end_ns = changes(both[OTHER[role]], partition.end_ms)[0]
            yield partition, end_ns, both[role].said("heard", end_ns)[0]


def recoveries(both: dict[Role, Side], role: Role, partitions: list[Partition]) -> Iterator[float]:
    """From the end of each partition to the first position that came [s]."""
    for _, end_ns, heard in endings(both, role, partitions):
        recovery_s = (heard["monotonic_ns"] - end_ns) * NANO
        assert recovery_s < RECOVERY_S + ROUND_TRIP_S
        yield recovery_s


def assert_outages(both: dict[Role, Side], role: Role, partitions: list[Partition], hiccups: int) -> None:
    """What a side reports of what it had to do without is what was done, and more only where the machine hiccuped."""
    reported_s = [
        (heard["values"]["silence_s"], (partition.end_ms - partition.begin_ms) * 1e-3)
        for partition, _, heard in endings(both, role, partitions)
    ]
    for silence_s, done_s in reported_s:
        assert silence_s == pytest.approx(done_s, abs=TOLD_WITHIN_S)
    all_s = [notice["values"]["silence_s"] for notice in both[role].said("heard")]
    outages = both[role].summary[role]["outages"]
    assert len(reported_s) <= len(all_s) <= len(reported_s) + hiccups
    assert outages["count"] == len(all_s)
    assert outages["total_s"] == pytest.approx(sum(all_s), abs=1e-6)
    assert outages["longest_s"] == pytest.approx(max(all_s, default=0.0), abs=1e-6)
    assert outages["recovery_max_s"] < RECOVERY_S


@pytest.mark.slow
@pytest.mark.parametrize("gone_s", mostly_slow([0.5, 3.0], 0, 1))
def test_the_zenoh_session_lost_and_opened_again(gone_s: float, tmp_path: Path) -> None:
    """All of the way between the two is one relay, which is killed and started again."""
    between = free_address()
    with pair(tmp_path, *SILENCE, dial=between, device=("--set", "record_hz=1000")) as sides:
        relay = ("zenoh", "--listen", between, "--connect", sides.address, *LINK.split())
        with started(*relay, command=NETEM) as first:
            sides.until_paired()
            let_pass(1.0)
            first.kill()
        let_pass(gone_s)
        with started(*relay, command=NETEM) as second:
            heard_ns = [side.until_said("heard", second.began_ns) for side in (sides.device, sides.world)]
            recovery_s = (max(heard_ns) - second.began_ns) * NANO
            print(f"recovery after exec of the relay {recovery_s:.3f} s")
            let_pass(1.0)
            sides.stop()
    assert recovery_s < RECOVERY_S + ROUND_TRIP_S
    summary = sides.accounts()
    for role in ("device", "world"):
        assert summary[role]["incarnations"] == 1
        assert summary[role]["outages"]["count"] >= 1
        assert gone_s <= summary[role]["outages"]["longest_s"] <= gone_s + RECOVERY_S + TOLD_WITHIN_S
    for recording in (read_recording(sides.device.recording), read_recording(sides.world.recording)):
        assert_passive(columns_of(recording))
    assert_device_within_limits(read_recording(sides.device.recording))
