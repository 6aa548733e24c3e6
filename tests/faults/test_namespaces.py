"""Both sides on hosts of their own with a real cable between them: pulled, put back, and with one side's end meanwhile.

The machine's monotonic clock is the same in all namespaces, so what the two sides wrote can be compared.
"""

import contextlib
import os
import signal
import subprocess
import time
from bisect import bisect_right
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapnet.checks import Array
from hapnet.errors import RecordingError
from hapnet.recording.mcap import read_recording
from hapnet.recording.samples import Columns
from hapnet.wire.messages import Role
from tests.conftest import mostly_slow
from tests.faults.invariants import NANO, columns_of
from tests.faults.namespaces import LIMIT_S, Host, Unavailable, two_hosts
from tests.faults.support import OTHER, RECOVERY_S, RENDERING, Side
from tests.faults.tun import CABLE
from tests.support.processes import HAPNET, assert_side_passive

PORT = 17447

SILENCE_NS = 500_000_000
"""Told to both sides; and no set-position in use may be older while the peer is heard."""

BLOCKED_MS = 200.0
"""A servo that waits for a lost peer waits for longer; one that a busy machine keeps waiting does not."""

LOST_GREETING_S = 1.5
"""Over udp Zenoh says its greeting once: one that is lost costs its time-out and a pause."""

LITTLE = ("--set", "device.ceiling_J=0.001", "--set", "world.ceiling_J=0.001")
"""Reservoirs that are full soon, though they begin empty: then energy flows."""


class Pair:
    """The world on one host, the device on the other."""

    def __init__(self, world: Host, device: Host, directory: Path, dial: str, listen: str | None = None) -> None:
        self.hosts: dict[Role, Host] = {"world": world, "device": device}
        self._directory = directory
        self._endpoints: dict[Role, tuple[str, str]] = {"world": ("-l", listen or dial), "device": ("-e", dial)}
        self.lives: dict[Role, list[Side]] = {"world": [], "device": []}

    def start(self, role: Role, *words: str) -> Side:
        stem = self._directory / f"{role}{len(self.lives[role])}"
        settled = ("--silence-after", SILENCE_NS * NANO, "--set", "record_hz=1000", "--duration", 120)
        hand = ("--operator", "sine") if role == "device" else ()  # never twice at the same place
        there = (*self.hosts[role].enter, *HAPNET)
        side = Side(role, stem, *RENDERING, *self._endpoints[role], *settled, *hand, *words, command=there)
        self.lives[role].append(side)
        return side

    def start_both(self, *words: str) -> tuple[Side, Side]:
        """The world and the device, paired."""
        world, device = self.start("world", *words), self.start("device", *words)
        world.until_said("paired")
        device.until_said("paired")
        return world, device

    def stop(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """Ask both to end; what the world and the device then say of themselves."""
        last = [self.lives["world"][-1], self.lives["device"][-1]]
        for side in last:
            side.process.send_signal(signal.SIGTERM)
        for side in last:
            assert side.end()[0] == 128 + signal.SIGTERM, side.err
        return last[0].summary["world"], last[1].summary["device"]


@contextlib.contextmanager
def joined(directory: Path, dial: str, listen: str | None = None, cable: str | None = None) -> Iterator[Pair]:
    """Two hosts, the first for the world.

    dial, listen : endpoints; a protocol stands for the world's address. cable : in the emulator's words; None: perfect.
    """
    with contextlib.ExitStack() as stack:
        try:
            world, device = stack.enter_context(two_hosts(cable))
        except Unavailable as reason:
            pytest.skip(str(reason))
        pair = Pair(world, device, directory, dial if "/" in dial else f"{dial}/{world.address}:{PORT}", listen)
        try:
            yield pair
        finally:
            for side in (*pair.lives["world"], *pair.lives["device"]):
                side.kill()


def samples(side: Side) -> Columns:
    return columns_of(read_recording(side.recording))


def sent_ns(receiver: Columns, sender: Columns) -> Array:
    """When the sender was where the receiver's set-position is, at each of the receiver's samples; -1: never before.

    A target is, bit for bit, a position that the sender had; the last time counts if there are several. A tick reads
    the clock, then takes what has arrived. It may be held up in between: what it uses was sent before the next tick.
    """
    times: dict[bytes, list[int]] = {}
    for time_ns, position in zip(sender["time_ns"].tolist(), sender["position_m"], strict=True):
        times.setdefault(position.tobytes(), []).append(time_ns)
    found = []
    ends_ns = [*receiver["time_ns"].tolist()[1:], sender["time_ns"][-1]]
    for end_ns, target in zip(ends_ns, receiver["target_m"], strict=True):
        had = times.get(target.tobytes(), [])
        before = bisect_right(had, end_ns)
        found.append(had[before - 1] if before else -1)
    return np.array(found)


def assert_new(
    receiver: Columns, sender: Columns, pulled_ns: int, heard_ns: int, until_ns: int, released_ns: list[int]
) -> None:
    """No set-position from the past: never one after a later one; and soon after the silence only fresh ones.

    Where the watchdog let the receiver's spring go, the set-position is its own until something comes.
    """
    used_ns, sent = receiver["time_ns"], sent_ns(receiver, sender)
    order = sent[(used_ns >= pulled_ns) & (sent >= 0)]
    assert (np.diff(order) >= 0).all()
    after = (used_ns >= heard_ns + SILENCE_NS) & (used_ns < until_ns)
    for at_ns in released_ns:
        after &= (used_ns < at_ns) | (used_ns > at_ns + SILENCE_NS)
    assert (sent[after] >= 0).all()
    assert (used_ns[after] - sent[after] < SILENCE_NS).all()


def assert_all_credited(world: dict[str, Any], device: dict[str, Any]) -> None:
    """To the nanojoule, in both directions."""
    for sender, receiver in ((device, world), (world, device)):
        assert sender["in_flight_nJ"] == sender["abandoned_nJ"] == 0
        assert 0 < sender["sent_nJ"] == receiver["credited_nJ"]


def test_the_hosts_have_nothing_in_common_but_the_cable(tmp_path: Path) -> None:
    with joined(tmp_path, "tcp") as pair:
        world, device = pair.hosts["world"], pair.hosts["device"]
        spaces = {host.run("readlink", "/proc/self/ns/net") for host in (world, device)}
        assert len(spaces | {os.readlink("/proc/self/ns/net")}) == 3
        for host, other in ((world, device), (device, world)):
            links = {line.split(":")[1].split("@")[0].strip() for line in host.ip("-o link").splitlines()}
            assert links == {"lo", CABLE}
            assert f"dev {CABLE}" in host.ip(f"route get {other.address}")
        world.pull()
        with pytest.raises(subprocess.CalledProcessError, match="ip"):
            world.ip(f"route get {device.address}")


def _cable(protocol: str, where: Role, on_silence: str, *down_s: float, mark: Any = pytest.mark.slow) -> Any:
    times = "-".join(f"{each:g}s" for each in down_s)
    return pytest.param(protocol, down_s, where, on_silence, marks=mark, id=f"{protocol}-{where}-{times}")


@pytest.mark.parametrize(
    ("protocol", "down_s", "where", "on_silence"),
    [
        _cable("tcp", "device", "hold", 3.0),
        _cable("tcp", "world", "release", 10.0, 1.0, mark=pytest.mark.soak),
        _cable("tcp", "device", "release", 30.0, mark=pytest.mark.soak),
        _cable("udp", "world", "release", 3.0, 5.0, 1.5, mark=pytest.mark.soak),
        _cable("udp", "device", "hold", 3.0, 1.5, 1.0),
        _cable("udp", "device", "hold", 10.0, 3.0, 1.5, mark=pytest.mark.soak),
    ],
)
def test_the_cable_is_pulled_and_put_back(
    protocol: str, down_s: tuple[float, ...], where: Role, on_silence: str, tmp_path: Path
) -> None:
    """Both go on without each other, and are together again soon after; nothing is lost, credited twice, or late.

    Over udp Zenoh says its greeting once, and waits for a second if that is lost: there, the median of three is asked.
    """
    spans: list[tuple[int, int, list[int], int]] = []
    with joined(tmp_path, protocol) as pair:
        sides = world, device = pair.start_both("--on-silence", on_silence)
        world.until("contact", lambda: in_contact(world))
        for each_s in down_s:
            began_ns = time.monotonic_ns()
            pair.hosts[where].pull()
            pulled_ns = max(side.until_said("silent", began_ns) for side in sides)
            device.until("the time is over", _later(began_ns + round(each_s / NANO)), LIMIT_S)
            plugged_ns = pair.hosts[where].plug()
            heard_ns = [side.until_said("heard", plugged_ns) for side in sides]
            device.until("what comes after", _later(max(heard_ns) + 2 * SILENCE_NS))
            spans.append((pulled_ns, plugged_ns, heard_ns, time.monotonic_ns()))
        ends = pair.stop()
    recovery_s = [(max(heard_ns) - plugged_ns) * NANO for _, plugged_ns, heard_ns, _ in spans]
    print("recovered after", recovery_s, "s")
    assert (np.median(recovery_s) if protocol == "udp" else max(recovery_s)) < RECOVERY_S
    assert_all_credited(*ends)
    for end in ends:
        assert_side_passive(end)
        assert end["incarnations"] == 1
        assert end["outages"]["count"] >= len(down_s)
    assert ends[1]["servo"]["longest_ms"] < BLOCKED_MS
    device_samples, world_samples = samples(device), samples(world)
    events = read_recording(device.recording).events
    released_ns = [event.time_ns for event in events if event.kind == "overrun"]
    for pulled_ns, plugged_ns, heard_ns, until_ns in spans:
        for side, mine, other, mine_ns in (
            (world, world_samples, device_samples, heard_ns[0]),
            (device, device_samples, world_samples, heard_ns[1]),
        ):
            silent_ns = [notice["values"]["since_ns"] for notice in side.said("silent", mine_ns)]  # again, over udp
            its_ns = released_ns if side is device else []
            assert_new(mine, other, pulled_ns, mine_ns, min([until_ns, *silent_ns]), its_ns)
        for columns in (world_samples, device_samples):
            alone = (columns["time_ns"] >= pulled_ns + SILENCE_NS // 5) & (columns["time_ns"] < plugged_ns)
            if on_silence == "hold":
                assert_held(columns["time_ns"][alone], columns["target_m"][alone], released_ns)
            elif alone.any():  # the set-position is where the side itself was at its last update, a few periods ago
                own_ns = sent_ns(columns, columns)[alone]
                assert (columns["time_ns"][alone] - own_ns).max() < SILENCE_NS // 5


def assert_held(times_ns: Array, target: Array, released_ns: list[int]) -> None:
    """It never moved; but where this machine held the servo up, its watchdog let the spring go."""
    moved = np.flatnonzero((np.diff(target, axis=0) != 0.0).any(axis=1))
    for before_ns, after_ns in zip(times_ns[moved], times_ns[moved + 1], strict=True):
        assert any(before_ns < at_ns <= after_ns for at_ns in released_ns)


def in_contact(world: Side) -> bool:
    try:
        columns = read_recording(world.recording).world
    except RecordingError:  # nothing there yet
        return False
    return columns is not None and bool(columns["penetration_m"][-1] > 0.0)


def _later(time_ns: int) -> Callable[[], bool]:
    return lambda: time.monotonic_ns() >= time_ns


DEATHS = [
    ("tcp", "device", False), ("udp", "world", True),
    ("tcp", "world", False), ("udp", "device", False), ("tcp", "device", True), ("udp", "world", False),
    ("tcp", "world", True), ("udp", "device", True),
]  # fmt: skip


@pytest.mark.parametrize(("protocol", "victim", "pulled"), mostly_slow(DEATHS, 0, 1))
def test_one_side_dies_in_contact(protocol: str, victim: Role, pulled: bool, tmp_path: Path) -> None:
    """Started again it is a new pair with the survivor, soon after it runs.

    If its host died nothing reaches the survivor: the cable is out when the process ends, and until it runs again.
    """
    with joined(tmp_path, protocol) as pair:
        pair.start_both(*LITTLE)
        _kill_in_contact(pair, victim, pull=pulled)
        restarted = _start_again(pair, victim)
        from_ns = restarted.until_said("waiting" if pulled else "")
        _assert_recovers(pair, victim, pair.hosts[victim].plug() if pulled else from_ns, protocol)


def _kill_in_contact(pair: Pair, victim: Role, *, pull: bool = False) -> None:
    world = pair.lives["world"][0]
    world.until("contact", lambda: in_contact(world))
    if pull:
        pair.hosts[victim].pull()
    pair.lives[victim][0].kill()


def _start_again(pair: Pair, victim: Role) -> Side:
    """Once the survivor has noticed."""
    pair.lives[OTHER[victim]][0].until_said("silent")
    return pair.start(victim, *LITTLE)


def _assert_recovers(pair: Pair, victim: Role, from_ns: int, protocol: str) -> None:
    """Both soon hear each other again, and at the end each nanojoule has been credited once."""
    survivor, restarted = pair.lives[OTHER[victim]][0], pair.lives[victim][1]
    heard_ns, paired_ns = survivor.until_said("heard", from_ns), restarted.until_said("paired", from_ns)
    recovery_s = (max(heard_ns, paired_ns) - from_ns) * NANO
    print("recovered after", recovery_s, "s")
    assert recovery_s < RECOVERY_S + LOST_GREETING_S * (protocol == "udp")
    silent_ns = survivor.said("silent")[0]["monotonic_ns"]
    before_nJ = _credited_nJ(survivor, silent_ns)

    def energy_flows() -> bool:
        now_ns = time.monotonic_ns()
        return _credited_nJ(survivor, now_ns) > before_nJ or _credited_nJ(restarted, now_ns) > 0

    survivor.until("what comes after", _later(heard_ns + 2 * SILENCE_NS))
    survivor.until("energy of the new pair", energy_flows)
    ends = dict(zip(("world", "device"), pair.stop(), strict=True))
    old, new = ends[OTHER[victim]], ends[victim]
    assert_side_passive(old)
    assert (old["incarnations"], new["incarnations"]) == (2, 1)
    assert new["ledger"]["slack_J"] >= -1e-9
    assert new["reservoir_min_J"] >= 0.0
    assert ends["device"]["servo"]["longest_ms"] < BLOCKED_MS
    assert old["credited_nJ"] - before_nJ == new["sent_nJ"]
    assert new["sent_nJ"] + new["credited_nJ"] > 0
    assert new["in_flight_nJ"] == new["abandoned_nJ"] == old["in_flight_nJ"] == 0
    assert new["credited_nJ"] <= old["sent_nJ"] - old["abandoned_nJ"]


def _credited_nJ(side: Side, time_ns: int) -> int:
    """What it had credited by then."""
    columns = samples(side)
    return round(float(columns["credited_J"][np.searchsorted(columns["time_ns"], time_ns, side="right") - 1]) / NANO)


ANY, IPV6 = ("0.0.0.0", "10.117.0.1"), ("[::]", "[fd00:117::1]")


@pytest.mark.parametrize(
    ("protocol", "listen", "dial"), mostly_slow([("tcp", *ANY), ("udp", *IPV6), ("udp", *ANY), ("tcp", *IPV6)], 0, 2)
)
def test_both_start_before_the_cable_is_in(protocol: str, listen: str, dial: str, tmp_path: Path) -> None:
    """A world on all addresses of its host, of either kind; the device dials one that cannot be reached yet.

    A greeting or a neighbour's solicitation that goes out as the cable comes in may be lost: the kernel's next is a
    second later.
    """
    with joined(tmp_path, f"{protocol}/{dial}:{PORT}", listen=f"{protocol}/{listen}:{PORT}") as pair:
        for host in pair.hosts.values():
            host.pull()
        sides = pair.start("world"), pair.start("device")
        for side in sides:
            side.until_said("waiting")
        plugged_ns = [host.plug() for host in pair.hosts.values()][-1]
        assert max(side.until_said("paired") for side in sides) - plugged_ns < (RECOVERY_S + 1.0) / NANO
        pair.stop()
