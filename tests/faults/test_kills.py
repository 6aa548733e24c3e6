"""SIGKILL of either side in contact, and again: the other side lives through it all in one process."""

import random
import time
from pathlib import Path

import numpy as np
import pytest

from hapnet.recording.mcap import read_recording
from hapnet.recording.samples import Recording
from hapnet.summary.run import merge
from hapnet.wire.messages import Role
from tests.conftest import mostly_slow
from tests.faults.invariants import (
    NANO,
    assert_credited_was_sent,
    assert_device_within_limits,
    assert_passive,
    assert_world_within_limits,
    columns_of,
    lengths,
    overruns_in,
)
from tests.faults.support import OTHER, PRESSED, RECOVERY_S, Side, let_pass, pair

LINK = ("--delay", "40ms", "--jitter", "10ms", "--loss", "2%")
ROUND_TRIP_S = 0.1
SILENCE_S = 0.2
LONGEST_PAUSE_S = 1.0
RESERVOIRS_J: dict[Role, float] = {"device": 0.1, "world": 0.05}
"""What each begins with: the defaults of `device.ceiling_J` and `world.ceiling_J`."""


KILLS = [
    ("device", "release", 2, "paper"), ("world", "release", 2, "hapnet"),
    ("device", "hold", 20, "paper"), ("device", "release", 20, "hapnet"),
    ("world", "hold", 20, "paper"), ("world", "release", 20, "hapnet"),
]  # fmt: skip


@pytest.mark.parametrize(("role", "on_silence", "kills", "rendering"), mostly_slow(KILLS, 0, 1))
def test_a_side_killed_in_contact_comes_back(
    role: Role, on_silence: str, kills: int, rendering: str, tmp_path: Path
) -> None:
    rng = random.Random(f"{role} {on_silence}")
    silence = ("--on-silence", on_silence, "--silence-after", SILENCE_S)
    kills_ns, recoveries_s, starts_s = list[int](), list[float](), list[float]()
    silences = list[tuple[int, int]]()
    words = ("--set", "record_hz=1000", "--set", "device.watchdog_s=0")  # which would let the spring go by itself
    with pair(tmp_path, *LINK, *silence, "--rendering", rendering, device=(*PRESSED, *words)) as sides:
        survivor, lives = sides.lives[OTHER[role]][0], sides.lives[role]
        since_ns = sides.until_paired()
        for number in range(kills):
            # a world that begins anew may find the hand deep in its wall, and has no energy to follow it there
            sides.world.until_pressed(since_ns, wall=role == "device" or number == 0)
            let_pass(rng.uniform(0.0, 0.4))
            kills_ns.append(time.monotonic_ns())
            lives[-1].process.kill()
            lives[-1].end()
            let_pass(rng.uniform(0.0, LONGEST_PAUSE_S))
            again = sides.start(role)
            since_ns = survivor.until_said("heard", again.began_ns)
            silence_s = survivor.said("heard", since_ns)[0]["values"]["silence_s"]
            silences.append((since_ns - round(silence_s / NANO), since_ns))
            # it runs: from the first line of its log on; before that Python imports
            recoveries_s.append((since_ns - again.until_said("waiting")) * NANO)
            starts_s.append((since_ns - again.began_ns) * NANO)
        sides.world.until_pressed(since_ns, wall=role == "device")
        sides.stop()
    for since, times in (("its first line", recoveries_s), ("exec", starts_s)):
        print(f"recovery from {since}: median {np.median(times):.3f} s, longest {max(times):.3f} s")
    assert max(recoveries_s) < RECOVERY_S + ROUND_TRIP_S
    assert [notice["values"]["pair"] for notice in survivor.said("paired")] == list(range(1, kills + 2))

    left = read_recording(survivor.recording)
    recordings = [read_recording(side.recording) for side in lives]
    assert not left.torn
    assert [recording.torn for recording in recordings] == [True] * kills + [False]
    assert_pressed(left, recordings, role, kills_ns)
    assert_within_bounds([left], restarted=False)
    assert_within_bounds(recordings[:1], restarted=False)
    assert_within_bounds(recordings[1:], restarted=True)
    assert sum(columns_of(recording)["margin_J"].min() for recording in [left, *recordings]) > 0.0
    for silent_ns, until_ns in silences:
        assert_held_or_released(left, on_silence, silent_ns, until_ns)
    assert_energy(survivor, lives[-1], left, recordings)


def assert_pressed(left: Recording, recordings: list[Recording], role: Role, kills_ns: list[int]) -> None:
    """Before each kill the hand felt the coupling, and the wall unless the world had already been killed before."""
    for recording, killed_ns in zip(recordings, kills_ns, strict=False):
        device, world = (recording, left) if role == "device" else (left, recording)
        assert world.world is not None
        force = lengths(device.device["force_N"][device.device["time_ns"] <= killed_ns])
        assert force.max() > 0.0  # who starts again has next to no energy, and a hand that rests adds none
        if recording is recordings[0]:
            assert force[-1] > 0.3
        if role == "device" or recording is recordings[0]:
            assert world.world["penetration_m"][world.world["time_ns"] <= killed_ns][-1] > 0.0


def assert_within_bounds(recordings: list[Recording], *, restarted: bool) -> None:
    for recording in recordings:
        columns = columns_of(recording)
        assert_passive(columns, restarted=restarted)
        if recording.device is not None:
            assert_device_within_limits(recording)
        else:
            assert_world_within_limits(recording)


def assert_held_or_released(left: Recording, on_silence: str, silent_ns: int, until_ns: int) -> None:
    """What the survivor did between the last position that came and the next: nothing, or let the spring go."""
    assert not overruns_in(left, silent_ns, until_ns)  # the watchdog is off
    columns = columns_of(left)
    times = columns["time_ns"]
    force = lengths(columns["force_N"] if left.device is not None else columns["coupling_force_N"])
    before = force[times <= silent_ns][-1]
    if on_silence == "hold":
        silence = (times > silent_ns + 60_000_000) & (times < until_ns - 1_000_000)  # the longest step of the world
        assert len(np.unique(columns["target_m"][silence])) == 1
        assert force[silence].min() > 0.25 * before
    else:  # the hand, or the mass, comes to rest
        silence = (times > silent_ns + (SILENCE_S + 0.4) / NANO) & (times < until_ns - 1_000_000)
        assert force[silence].max(initial=0.0) < max(0.1 * before, 1e-9)  # none, if there was none


def assert_energy(survivor: Side, last: Side, left: Recording, recordings: list[Recording]) -> None:
    """Nothing of a pair that is over was credited to the next, and the bound counts every start once."""
    mine = columns_of(left)
    began = [int(notice["monotonic_ns"]) for notice in survivor.said("paired")]
    for recording, since_ns in zip(recordings, [0, *began[1:]], strict=True):
        theirs = columns_of(recording)
        until = mine["time_ns"] <= theirs["time_ns"][-1]  # after that the other's sent total is not known any more
        assert_credited_was_sent(theirs, mine, False, since_ns)
        assert_credited_was_sent({name: column[until] for name, column in mine.items()}, theirs, True, since_ns)
    ended, new = (side.summary[side.role] for side in (survivor, last))
    assert ended["incarnations"] == len(recordings)
    assert new["incarnations"] == 1
    assert ended["in_flight_nJ"] == new["in_flight_nJ"] == 0
    assert new["abandoned_nJ"] == 0
    # what was acknowledged was credited by one of them, and what one of them credited had been sent
    acknowledged_nJ = ended["sent_nJ"] - ended["abandoned_nJ"]
    before_nJ = sum(round(columns_of(recording)["credited_J"][-1] / NANO) for recording in recordings[:-1])
    assert before_nJ + new["credited_nJ"] <= ended["sent_nJ"] + len(recordings)
    assert 0 <= new["credited_nJ"] <= acknowledged_nJ <= ended["sent_nJ"]
    # the last pair's own, to the nanojoule
    index = int(np.searchsorted(mine["time_ns"], began[-1], side="right")) - 1
    credited_before_nJ = round(mine["credited_J"][index] / NANO)
    assert new["sent_nJ"] == ended["credited_nJ"] - credited_before_nJ
    # what each reservoir began with, and nothing for those that took another's place
    assert ended["ledger"]["bound_J"] == RESERVOIRS_J[survivor.role]
    assert ended["peers_J"] == RESERVOIRS_J[OTHER[survivor.role]]
    assert new["ledger"]["bound_J"] == 0.0
    assert survivor.summary["theorem"]["bound_J"] == sum(RESERVOIRS_J.values())
    device, world = (survivor, last) if survivor.role == "device" else (last, survivor)
    assert merge(device.summary, world.summary)["theorem"]["bound_J"] == sum(RESERVOIRS_J.values())
