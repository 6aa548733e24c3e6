"""What the streams show of the path, against links whose figures are known: two clocks that have nothing in common."""

import math
from typing import Any

import numpy as np
import pytest

from hapnet.checks import Vector
from hapnet.params import Params
from hapnet.side.endpoint import ControlHalf, WireHalf
from hapnet.simulation.simulation import simulate
from hapnet.summary import path as paths
from hapnet.wire.messages import Position, Role, decode, encode
from hapnet.wire.path import Counts, Path, PathFigures, arrive
from hapnet.wire.peer_monitor import PeerMonitor
from hapnet.wire.replay_window import ReplayWindow
from hapnet.wire.session import Session
from netem import Link, LinkProfile
from tests.wire.test_numbering import FORGED

MS = 1_000_000
AHEAD = {"device": 5_000_000_000, "world": 987_654_321_000_000}
"""What the sides' clocks show when the network's shows 0 [ns]."""
PERIODS = {"device": 5 * MS, "world": 30 * MS}


class SetPositionCoupling:
    """A coupling of which nothing is asked but to take what comes."""

    def receive(self, sample: Vector, sent_s: float, age_s: float) -> None:
        self.sample = sample

    def credit(self, energy_J: float) -> None:
        raise AssertionError("nobody sends energy here")

    def on_peer_changed(self) -> float:
        return 0.0


class Side(ControlHalf, WireHalf):
    """Sends positions and takes what comes once a period, as a servo or a world does."""

    def __init__(self, role: Role, incarnation: int) -> None:
        session = Session(role=role, dof=1, name=role, incarnation=incarnation)
        ControlHalf.__init__(self, session.positions)
        WireHalf.__init__(self, session, self)
        self._coupling: Any = SetPositionCoupling()

    def speak(self, now_ns: int) -> bytes:
        self.take(0)
        data = self._send(now_ns, ((0.0,), 0.0))
        assert data is not None
        return data


def run(up: str, down: str, seconds: float, *, mute_s: tuple[float, float] = (0.0, 0.0)) -> dict[str, Side]:
    """Both sides over these links, paired over a perfect one; nobody speaks between the times of `mute_s`."""
    sides = {"device": Side("device", 1), "world": Side("world", 2)}
    links = {
        "device": Link[bytes](LinkProfile.parse(up), seed=1),
        "world": Link[bytes](LinkProfile.parse(down), seed=2),
    }
    other = {"device": "world", "world": "device"}
    for now_ns in range(0, 20 * MS, MS):
        for role, side in sides.items():
            for _, data in side.poll(now_ns + AHEAD[role])[0]:
                sides[other[role]].receive(now_ns + AHEAD[other[role]], data)
    assert all(side.session.peer for side in sides.values())
    for now_ns in range(20 * MS, round(seconds * 1e9), MS):
        for role, side in sides.items():
            if now_ns % PERIODS[role] == 0 and not mute_s[0] <= now_ns * 1e-9 < mute_s[1]:
                links[role].send(now_ns, side.speak(now_ns + AHEAD[role]), 100)
            for _, data in links[role].poll(now_ns):
                sides[other[role]].receive(now_ns + AHEAD[other[role]], data)
    return sides


def figures(sides: dict[str, Side]) -> tuple[PathFigures, PathFigures]:
    return sides["device"].session.path.figures(), sides["world"].session.path.figures()


def test_a_round_trip_needs_no_common_clock_and_no_symmetry() -> None:
    for known in figures(run("delay 30ms", "delay 50ms", 3.0)):
        trips = known.round_trip_min_ns, known.round_trip_p50_ns, known.round_trip_p99_ns
        assert trips == pytest.approx((80 * MS,) * 3, rel=1 / 32)  # the histogram's bins
        assert (known.jitter_p99_ns, known.lost, known.stalls) == (0, 0, 0)


def test_jitter_and_loss_are_of_each_direction() -> None:
    device, world = figures(run("delay 40ms loss 10%", "delay 40ms 20ms", 60.0))
    assert world.jitter_p99_ns == 0
    assert world.lost / world.sent == pytest.approx(0.10, abs=0.01)  # 12,000 messages: 3.7 standard deviations
    assert device.lost / device.sent < 0.005  # what is still under way
    # uniform over 20 to 60 ms: half of the messages take more than 20 ms longer than the least
    assert device.jitter_p50_ns == pytest.approx(20 * MS, abs=3 * MS)
    assert device.jitter_p99_ns == pytest.approx(39.6 * MS, abs=2 * MS)
    assert 60 * MS <= device.round_trip_min_ns <= 63 * MS


def test_age_is_half_the_least_round_trip_and_what_has_passed_since() -> None:
    """A world's position is 40 ms old when it comes and 70 when the next does; so the report has it."""
    device, world = figures(run("delay 40ms", "delay 40ms", 3.0))
    assert device.age_p50_ns == pytest.approx(70 * MS, rel=1 / 32)
    assert world.age_p99_ns == pytest.approx(45 * MS, rel=1 / 32)


def test_a_sender_that_pauses_is_no_stall_and_a_network_that_does_is() -> None:
    device, world = figures(run("delay 5ms", "delay 5ms", 3.0, mute_s=(1.0, 1.5)))
    assert (device.stalls, world.stalls) == (0, 0)
    device, world = figures(run("delay 5ms", "delay 5ms slot 400ms 400ms", 3.0))  # what comes, comes in one go
    assert world.stalls == 0
    assert 5 <= device.stalls <= 7
    assert device.max_stall_ns == pytest.approx(370 * MS, abs=30 * MS)


def test_what_an_echo_says_wrongly_is_not_believed() -> None:
    path = Path()
    path.begin(1000 * MS)
    now, sent = 2000 * MS, 77 * MS
    for echo, came in (
        (999 * MS, 70 * MS),  # of a time before the pair
        (2001 * MS, 70 * MS),  # of the future
        (1990 * MS, 78 * MS),  # come after it was sent
        (1990 * MS, 60 * MS),  # held for longer than it was away: 10 - 17 ms
    ):
        path.on_echo(now, sent, echo, came)
    assert path.figures().round_trip_min_ns is None
    path.on_echo(now, sent, 1980 * MS, 70 * MS)
    assert path.figures().round_trip_min_ns == 13 * MS
    path.on_echo(70_000 * MS, sent, 1980 * MS, 70 * MS)  # more than a minute
    assert path.figures().round_trip_p99_ns == 13 * MS


@pytest.mark.parametrize("what", FORGED)
def test_a_forged_position_harms_the_session_no_more_than_its_numbers(what: str) -> None:
    """One frame in the peer's name, as somebody who listens makes it: a position counts again within 0.2 s, in all."""
    sides = run("delay 20ms", "delay 20ms", 3.0)
    world = sides["world"]
    ahead, stamp = FORGED[what]
    now_ns = 3000 * MS
    number, sent_ns = sides["device"].session.positions.next_sequence + ahead, stamp(0, now_ns + AHEAD["device"])
    forged = Position(1, number, sent_ns, (0.5,), 2**60, 2**59)
    world.receive(now_ns + AHEAD["world"], encode(forged))
    before = world.session.outages(now_ns + AHEAD["world"]).received
    for k in range(1, 40):
        at_ns = now_ns + 5 * k * MS
        data = sides["device"].speak(at_ns - 20 * MS + AHEAD["device"])
        world.receive(at_ns + AHEAD["world"], data)
    assert world.session.outages(now_ns + AHEAD["world"]).received >= before + 20
    lost = world.session.path.figures()
    assert lost.lost <= 45
    assert lost.round_trip_p99_ns == pytest.approx(40 * MS, abs=3 * MS)


def test_what_a_side_echoes_is_what_came_last() -> None:
    side = Side("device", 1)
    frames: list[Any] = [decode(side.speak(100))]
    side.pair(restarted=False)
    side.echo(9, 140)
    side.echo(7, 150)  # overtaken on the way, and not used
    frames.append(decode(side.speak(200)))
    side.pair(restarted=False)  # another peer, whose clock is another
    frames.append(decode(side.speak(300)))
    assert [(frame.echo_ns, frame.came_ns) for frame in frames] == [(0, 0), (7, 150), (0, 0)]


def test_the_figures_of_a_while_are_the_difference() -> None:
    path, other = Path(), Path()
    for k in range(100):
        path.on_echo(1000 + 10 * k + k, 50, 1000 + 10 * k, 50)
    before = path.counts()
    for k in range(100, 200):
        for one in (path, other):
            one.on_echo(1000 + 10 * k + k, 50, 1000 + 10 * k, 50)
    assert path.figures(before).round_trip_p50_ns == other.figures().round_trip_p50_ns
    assert path.figures().round_trip_p50_ns < other.figures().round_trip_p50_ns  # type: ignore[operator]
    assert path.figures(path.counts()).round_trip_p50_ns is None
    assert isinstance(before, Counts)


def test_the_path_is_told_at_intervals_once_there_is_something() -> None:
    path, monitor, window, said = Path(), PeerMonitor(500 * MS), ReplayWindow(), []
    monitor.begin(0)
    path.begin(0)
    reporter = paths.PathReporter("device", path)
    for now_ns in (0, 1, paths.REPORT_EVERY_NS - 1, paths.REPORT_EVERY_NS, 2 * paths.REPORT_EVERY_NS):
        said.append(reporter.look(now_ns))
        if now_ns == 1:
            path.on_echo(50 * MS, 50, 10 * MS, 50)  # a round trip of 40 ms
            for number in (0, 1, 3, 4):
                arrive(path, monitor, window, False, (5 * number + 40) * MS, number, 5 * number * MS, 0, 0)
    assert [notice is None for notice in said] == [True, True, True, False, True]
    assert said[3].kind == "path"
    assert said[3].values["round_trip_p50_ms"] == pytest.approx(40.0, rel=0.1)
    assert said[3].values["lost"] == 1
    assert "round trip 40" in said[3].text
    assert "20.0 % lost from the world" in said[3].text
    assert None not in said[3].values.values()


def test_loss_is_told_of_the_sample_without_bias_whatever_else_is_dropped() -> None:
    """Every fourth message is one of the sample, and some of these come late; of the others half are dropped as
    overtaken. Each loss is known."""
    rng, path, monitor, window = np.random.default_rng(3), Path(), PeerMonitor(500 * MS), ReplayWindow()
    monitor.begin(0)
    path.begin(0, every=4)
    lost, dropped = rng.random(60_000) < 0.15, rng.random(60_000) < 0.5
    dropped[::4] = False
    came = np.flatnonzero(~lost & ~dropped).tolist()
    for at, number in sorted((8 * number + (12 if number % 16 == 0 else 0), number) for number in came):
        arrive(path, monitor, window, False, 40 * MS + at * MS, number, 8 * MS * number, 0, 0)
    known = path.figures()
    assert known.sent == came[-1] - came[0] + 1
    assert known.lost / known.sent == pytest.approx(np.mean(lost[: came[-1] // 4 * 4 + 1 : 4]), abs=1e-4)
    assert known.lost / known.sent == pytest.approx(0.15, abs=0.009)  # three standard deviations of 15,000
    late = known.arrived + known.overtaken + known.lost - known.sent
    assert late == pytest.approx(60_000 / 16 * 0.85 * 0.85 * 0.5, rel=0.05)  # the next one is there before
    assert (known.overtaken - late) / known.sent == pytest.approx(np.mean(~lost & dropped), abs=0.009)


def test_where_nothing_is_overtaken_every_message_counts_and_no_sample() -> None:
    rng, path, monitor, window = np.random.default_rng(3), Path(), PeerMonitor(500 * MS), ReplayWindow()
    monitor.begin(0)
    path.begin(0, every=4)
    lost = rng.random(2_000) < 0.15
    lost[[0, -1]] = False
    for number in np.flatnonzero(~lost).tolist():
        arrive(path, monitor, window, False, 5 * MS * number + 40 * MS, number, 5 * MS * number, 0, 0)
    known = path.figures()
    assert (known.sent, known.lost, known.overtaken) == (2_000, int(lost.sum()), 0)


def test_in_virtual_time_the_summary_has_the_path_and_it_is_the_links() -> None:
    changes = {"duration_s": 10.0, "link.up": "delay 40ms 10ms loss 5%", "link.down": "delay 60ms loss 2%"}
    summary = simulate(Params().set(changes), seed=3).summary
    path, links = summary["path"], summary["links"]
    for way in ("up", "down"):
        link = links[way]
        assert path[way]["loss"] == pytest.approx(link["lost"] / link["offered"], abs=0.02)
        assert path[way]["sent"] > 200
    assert path["round_trip_p50_ms"] == pytest.approx(100.0, abs=2.0)  # of all messages, not of the newest only
    assert path["down"]["jitter_p99_ms"] == 0.0
    assert path["up"]["jitter_p99_ms"] == pytest.approx(19.8, abs=1.0)
    assert path["down"]["age_p99_ms"] > path["round_trip_min_ms"] / 2


def test_each_side_tells_the_way_to_it_and_both_make_a_whole() -> None:
    device, world = (paths.of_side(role, known) for role, known in zip(
        ("device", "world"), figures(run("delay 30ms loss 5%", "delay 50ms", 3.0)), strict=True
    ))  # fmt: skip
    assert device["up"] is None
    assert world["down"] is None
    whole = paths.of_both(device, world)
    assert whole["down"] == device["down"]
    assert whole["up"] == world["up"]
    assert whole["round_trip_min_ms"] == pytest.approx(80.0)
    assert paths.of_both(None, world)["round_trip_min_ms"] == world["round_trip_min_ms"]
    assert paths.of_both(None, None) == paths.unknown() == paths.of_side("device", Path().figures())
    assert f"{100.0 * whole['up']['loss']:.1f} %" in paths.words(world, "world")
    assert "from the device" in paths.words(world, "world")
    assert paths.words(paths.unknown(), "device") == ""
    assert math.isclose(whole["up"]["loss"], whole["up"]["lost"] / whole["up"]["sent"])


def test_each_direction_is_as_its_receiver_measured_it_and_not_as_the_other_heard_of_it() -> None:
    """After a run on one machine each side's summary has both directions: the far one is what it was told, in part."""
    device, world = (paths.of_side(role, known) for role, known in zip(
        ("device", "world"), figures(run("delay 30ms loss 5%", "delay 50ms", 3.0)), strict=True
    ))  # fmt: skip
    assert device["down"] is not None
    assert world["up"] is not None
    heard = dict.fromkeys(world["up"])
    measured = {"device": {**device, "up": {**heard, "sent": 1}}, "world": {**world, "down": {**heard, "sent": 2}}}
    whole = paths.of_both(measured["device"], measured["world"])
    assert (whole["up"], whole["down"]) == (world["up"], device["down"])
    assert paths.of_both(measured["device"], None)["up"] == {**heard, "sent": 1}
