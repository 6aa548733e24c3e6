"""The history: what is kept, on which clock, and when it begins anew."""

import dataclasses
import threading
from typing import Any

import numpy as np
import pytest

from hapnet.ext.page.history import CAPACITY, MOST_EPISODES, MOST_EVENTS, PARTS, Episode, History
from hapnet.mechanics.plane import Plane
from hapnet.recording.samples import DeviceSample, Event, WorldSample
from hapnet.recording.telemetry import KnownPlanes, Status
from hapnet.wire.messages import Role

MS = 1_000_000
SEC = 1000 * MS


def device(time_ns: int, margin: float = 0.1, x: float = 0.0, dof: int = 1) -> DeviceSample:
    at = (x,) * dof
    return DeviceSample(time_ns, at, at, at, (2.0 * x,) * dof, None, 0.05, 0.0, 0.0, 0.0, 0.0, margin, 0.0)


def world(time_ns: int, margin: float = 0.1, x: float = 0.0, depth: float = 0.0) -> WorldSample:
    return WorldSample(
        time_ns, 0.03, (x,), (0.0,), (x,), (x,), (0.0,), (3.0 * x,), depth, 0.04, 0.0, 0.0, 0.0, margin, 0.0
    )


def status(role: Role, incarnation: int = 1, **about: Any) -> Status:
    return Status(role, 0, incarnation, True, False, "", about, {}, {})


def account(margin_J: float = 0.1, **other: Any) -> dict[str, Any]:
    """A side's half as it reports it, of a pair that began with 50 mJ on each side."""
    ledger = {"margin_J": margin_J, "slack_J": 0.0, "bound_J": 0.05, "margin_end_J": margin_J + 0.02}
    values = {f"ledger.{name}": value for name, value in ledger.items()}
    return {**values, "deficit_max_J": 0.0, "sent_nJ": 0, "credited_nJ": 0, "incarnations": 1, **other}


def reports(role: Role, incarnation: int = 1, *, coupling: str = "pspm", final: bool = False, **values: Any) -> Status:
    """A status with an account."""
    about = {"coupling": coupling, "clock": "one", "params": {"rendering": "paper", "device": {}}}
    return dataclasses.replace(status(role, incarnation, **about), account=account(**values), final=final)


def test_nothing_is_known_at_first() -> None:
    snapshot = History().snapshot()
    assert (snapshot.device, snapshot.world, snapshot.summary) == (None, None, None)
    assert snapshot.taken == 0


def test_ten_seconds_are_shown() -> None:
    history = History()
    for second in range(31):
        history.take(device(second * SEC, x=float(second)))
    assert history.snapshot().device.position_m[:, 0].tolist() == list(range(20, 31))


def test_the_last_seconds_are_kept_in_order() -> None:
    history = History(seconds=1.0)
    for tick in range(3000):
        history.take(device(tick * MS, x=float(tick)))
    track = history.snapshot().device
    assert track.position_m[:, 0].tolist() == list(range(1999, 3000))
    np.testing.assert_allclose(track.time_s, np.arange(-1000, 1) / 1000.0, atol=1e-12)
    np.testing.assert_array_equal(track.force_N, 2.0 * track.position_m)


def test_the_parts_of_the_force_and_the_known_planes_are_kept_until_the_device_restarts() -> None:
    history, plane = History(), Plane((1.0, 0.0), 0.02, 3000.0, 10.0)
    parts = [(1.0, 2.0), (3.0, 4.0), (5.0, 6.0), (7.0, 8.0)]
    history.take(status("device"))
    history.take(device(0, dof=2))
    history.take(device(MS, dof=2)._replace(**dict(zip(PARTS, parts, strict=True))))
    history.take(world(MS))
    history.take(KnownPlanes((plane,)))
    snapshot = history.snapshot()
    assert np.isnan(snapshot.device.parts_N[0]).all()
    assert snapshot.device.parts_N[1].tolist() == [list(part) for part in parts]
    assert snapshot.world.parts_N.shape == (1, 0, 1)
    assert snapshot.planes == (plane,)
    history.take(status("device", 2))
    assert history.snapshot().planes is None


@pytest.mark.parametrize(("margin_J", "final", "passive"), [
    (0.1, True, True), (0.1, False, None), (-0.2, True, False), (-0.2, False, False),
])  # fmt: skip
def test_a_pair_that_is_watched_and_ends_is_kept_once_with_its_last_verdict(
    margin_J: float, final: bool, passive: bool | None
) -> None:
    """Without both final accounts it may have lost passivity at its end; a bound that was broken stays so."""
    history = History()
    for role in ("device", "world"):
        history.take(reports(role, 1, coupling="zoh", margin_J=margin_J, final=final))
    for number in range(2, 20):
        for role in ("device", "world"):
            history.take(reports(role, number, final=True))
        episodes = history.snapshot().past
        assert len(episodes) == min(number - 1, MOST_EPISODES)
        if number == 3:
            assert [(one.coupling, one.rendering) for one in episodes] == [("zoh", "paper"), ("pspm", "paper")]
            assert [one.verdict["passive"] for one in episodes] == [passive, True]


def test_who_runs_the_pair_gives_the_verdict_of_one_that_has_ended() -> None:
    history = History(follows=False)
    for number in (1, 2):
        for role in ("device", "world"):
            history.take(reports(role, number))
    assert history.snapshot().past == ()
    given = Episode("zoh", "paper", {"passive": False, "reason": "margin -13.33 mJ"})
    history.end(given)
    assert history.snapshot().past == (given,)


def test_while_another_pair_starts_nothing_is_shown_of_the_old_one() -> None:
    history = History(follows=False)
    for role in ("device", "world"):
        history.take(reports(role, 1))
    assert passive(history) is True
    history.leave()
    history.take(reports("device", 1))  # it ends, and reports meanwhile
    assert passive(history) is None
    history.take(status("device", 2))
    history.take(reports("world", 1))
    assert passive(history) is None
    history.take(reports("device", 2))
    assert passive(history) is None
    history.take(reports("world", 2))
    assert passive(history) is True


def test_memory_is_bounded_and_the_newest_stay() -> None:
    history = History(seconds=1e6)
    for tick in range(CAPACITY + 10):
        history.take(device(tick * MS, x=float(tick)))
    for number in range(MOST_EVENTS + 5):
        history.take(Event(number, "kind", ""))
    snapshot = history.snapshot()
    assert snapshot.device.position_m[:, 0].tolist() == list(range(10, CAPACITY + 10))
    assert [event.time_ns for event in snapshot.events] == list(range(5, MOST_EVENTS + 5))


def test_a_snapshot_is_a_copy() -> None:
    history = History()
    history.take(device(1, x=1.0))
    before = history.snapshot()
    history.take(device(2, x=2.0))
    assert before.device.position_m.tolist() == [[1.0]]


@pytest.mark.parametrize(("clocks", "ends"), [(("a", "a"), (-2.0, 0.0)), (("a", "b"), (0.0, 0.0))])
def test_one_clock_only_where_both_name_the_same(clocks: tuple[str, str], ends: tuple[float, float]) -> None:
    history = History()
    history.take(device(1_000 * MS))
    history.take(world(3_000 * MS))
    history.take(status("device", clock=clocks[0]))
    history.take(status("world", clock=clocks[1]))
    snapshot = history.snapshot()
    assert snapshot.aligned == (clocks[0] == clocks[1])
    assert (snapshot.device.time_s[-1], snapshot.world.time_s[-1]) == ends


def test_a_clock_without_a_name_is_shared_with_nobody() -> None:
    history = History()
    history.take(status("device"))
    history.take(status("world"))
    assert not history.snapshot().aligned


def test_a_new_incarnation_begins_anew() -> None:
    history = History()
    history.take(status("device", 1))
    history.take(device(5_000, x=1.0))
    history.take(world(5_000))
    history.take(status("device", 1))
    assert history.snapshot().device is not None
    history.take(status("device", 2))
    assert history.snapshot().device is None
    assert history.snapshot().world is not None
    history.take(device(10))  # on a clock that began anew, too
    assert history.snapshot().device is not None


def test_what_is_old_or_does_not_fit_is_dropped() -> None:
    history = History()
    history.take(device(10, x=1.0))
    for late in (device(10, x=2.0), device(9, x=2.0), device(20, dof=2), device(20)._replace(force_N=(1.0, 2.0))):
        history.take(late)
    snapshot = history.snapshot()
    assert snapshot.taken == 1
    assert snapshot.device.position_m.tolist() == [[1.0]]


def test_any_thread_may_tell_it_and_what_is_copied_is_consistent() -> None:
    history = History()

    def report(role: Role) -> None:
        for tick in range(1, 3000):
            history.take(device(tick, margin=tick) if role == "device" else world(tick, margin=tick, x=float(tick)))

    threads = [threading.Thread(target=report, args=(role,)) for role in ("device", "world")]
    for thread in threads:
        thread.start()
    while any(thread.is_alive() for thread in threads):
        snapshot = history.snapshot()
        for track in (snapshot.device, snapshot.world):
            assert track is None or np.all(np.diff(track.time_s) > 0.0)
    for thread in threads:
        thread.join()
    assert history.snapshot().taken == 2 * 2999


def test_a_status_is_kept_as_it_is() -> None:
    history = History()
    reported = status("world", clock="c")
    history.take(reported)
    assert history.snapshot().world_status == reported
    newer = dataclasses.replace(reported, paused=True)
    history.take(newer)
    assert history.snapshot().world_status == newer
    assert history.snapshot().device_status is None


# -- the verdict -----------------------------------------------------------------------------------------------------


def pair_of(coupling: str = "pspm", other: dict[str, Any] | None = None, **values: Any) -> History:
    """A pair whose device reports `values`, and its world `other`."""
    history = History()
    history.take(reports("world", coupling=coupling, **other or {}))
    history.take(reports("device", coupling=coupling, **values))
    return history


def passive(history: History) -> bool | None:
    """As the page shows it; None also where nothing is shown."""
    summary = history.snapshot().summary
    return None if summary is None else summary["verdict"]["passive"]


def test_a_live_pair_is_judged_by_what_its_sides_report() -> None:
    assert History().snapshot().summary is None
    assert passive(pair_of()) is True
    assert passive(pair_of(margin_J=-0.2)) is False
    assert passive(pair_of(**{"ledger.slack_J": -1e-6})) is False
    assert passive(pair_of(deficit_max_J=1e-6)) is None
    assert passive(pair_of(incarnations=2)) is None


def test_its_reasons_are_those_of_the_summary_at_its_end() -> None:
    shown = pair_of(margin_J=-0.2).snapshot().summary
    assert shown["verdict"]["reason"].startswith("gave out 200 mJ, more than the 100 mJ allowed")
    assert shown["theorem"]["margin_end_J"] == pytest.approx(-0.06)


def test_a_receiver_may_report_energy_before_its_sender_does() -> None:
    """Nothing says which of both reports is the newer one."""
    assert passive(pair_of(credited_nJ=7, other={"sent_nJ": 0})) is True
    assert passive(pair_of(sent_nJ=0, other={"credited_nJ": 7})) is True


@pytest.mark.parametrize(("least_J", "judged"), [(0.01, True), (-0.01, False)])
def test_a_coupling_that_is_passive_jointly_is_judged_by_both_margins_at_one_time(least_J: float, judged: bool) -> None:
    """The halves alone say nothing: -500 mJ at the device belongs to another time than the world's minimum."""
    history = pair_of("wave", margin_J=-0.5)
    for tick, (own, far) in enumerate([(0.05, 0.05), (-0.5, 0.5 + least_J), (0.1, 0.02)]):
        history.take(world(tick * MS, far))
        history.take(device(tick * MS, own))
    history.take(reports("device", coupling="wave", margin_J=-0.5))
    assert passive(history) is judged
    assert history.snapshot().summary["theorem"]["margin_J"] == pytest.approx(least_J)
    apart = pair_of("wave")
    apart.take(dataclasses.replace(reports("device", coupling="wave"), about={"coupling": "wave", "clock": "other"}))
    assert passive(apart) is None


def test_a_recording_has_the_verdict_of_its_summary() -> None:
    history = pair_of()
    broken = pair_of(margin_J=-0.2).snapshot().summary
    history.judge_by(broken)
    assert passive(history) is False
