"""The history: what is kept, on which clock, and when it begins anew."""

import dataclasses
import threading
from typing import Any

import numpy as np
import pytest

from hapnet.mechanics.plane import Plane
from hapnet.recording.samples import DeviceSample, Event, WorldSample
from hapnet.recording.telemetry import KnownPlanes, Status
from hapnet.summary.verdict import judge
from hapnet.view.history import CAPACITY, MOST_EPISODES, MOST_EVENTS, PARTS, History
from hapnet.wire.messages import Role

MS = 1_000_000


def device(time_ns: int, margin: float = 0.1, x: float = 0.0, dof: int = 1) -> DeviceSample:
    at = (x,) * dof
    return DeviceSample(time_ns, at, at, at, (2.0 * x,) * dof, None, 0.05, 0.0, 0.0, 0.0, 0.0, margin, 0.0)


def world(time_ns: int, margin: float = 0.1, x: float = 0.0, depth: float = 0.0) -> WorldSample:
    return WorldSample(
        time_ns, 0.03, (x,), (0.0,), (x,), (x,), (0.0,), (3.0 * x,), depth, 0.04, 0.0, 0.0, 0.0, margin, 0.0
    )


def status(role: Role, incarnation: int = 1, **about: Any) -> Status:
    return Status(role, 0, incarnation, True, False, "", about, {}, None)


def test_nothing_is_known_at_first() -> None:
    snapshot = History().snapshot()
    assert (snapshot.device, snapshot.world, snapshot.margin_J, snapshot.min_margin_J) == (None, None, None, None)
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


def test_a_pair_that_has_ended_is_kept_once_with_its_coupling_and_account() -> None:
    """Its sides restart one after the other; between the two, old and new samples together are nobody's account."""
    history = History()

    def begin(incarnation: int, coupling: str, margin: float, at_ns: int) -> None:
        for role in ("device", "world"):
            history.take(status(role, incarnation, coupling=coupling, params={"rendering": "paper", "device": {}}))
            history.take(device(at_ns, margin) if role == "device" else world(at_ns, margin))

    begin(1, "zoh", -0.2, 0)
    begin(2, "pspm", 0.1, MS)
    begin(3, "wave", 0.1, 2 * MS)
    past = history.snapshot().past
    assert [(episode.coupling, episode.rendering) for episode in past] == [("zoh", "paper"), ("pspm", "paper")]
    assert [judge(episode.account)["passive"] for episode in past] == [False, True]
    for number in range(4, 20):
        begin(number, "pspm", 0.1, number * MS)
    assert len(history.snapshot().past) == MOST_EPISODES


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


def test_the_least_margin_is_that_of_the_sum_with_each_side_held() -> None:
    rng = np.random.default_rng(5)
    history, now, sums = History(), {"device": np.nan, "world": np.nan}, []
    for tick in range(1, 500):
        role, margin = ("device", "world")[int(rng.integers(2))], float(rng.normal())
        history.take(device(tick, margin) if role == "device" else world(tick, margin))
        now[role] = margin
        sums.append(now["device"] + now["world"])
    snapshot = history.snapshot()
    assert snapshot.min_margin_J == np.nanmin(sums)
    assert snapshot.margin_J == sums[-1]


def test_a_new_incarnation_begins_anew() -> None:
    history = History()
    history.take(status("device", 1))
    history.take(device(5_000, margin=-7.0, x=1.0))
    history.take(world(5_000, margin=1.0))
    assert history.snapshot().min_margin_J == -6.0
    history.take(status("device", 1))
    assert history.snapshot().min_margin_J == -6.0
    history.take(status("device", 2))
    snapshot = history.snapshot()
    assert (snapshot.device, snapshot.margin_J, snapshot.min_margin_J) == (None, None, None)
    assert snapshot.world is not None
    history.take(device(10, margin=2.0, dof=1))  # on a clock that began anew, too
    assert history.snapshot().min_margin_J == 3.0


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
        if snapshot.device is not None and snapshot.world is not None:
            assert snapshot.margin_J == snapshot.device.margin_J[-1] + snapshot.world.margin_J[-1]
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

SEC = 1000 * MS


def pair_of(seconds: float, **device_fields: float) -> History:
    """A pair that runs well, 10 samples a second of each side, whose device's last sample is changed."""
    history = History()
    history.take(status("device", coupling="pspm"))
    history.take(status("world", coupling="pspm"))
    for tick in range(round(10 * seconds)):
        history.take(world(tick * SEC // 10))
        history.take(device(tick * SEC // 10)._replace(**device_fields if tick == round(10 * seconds) - 1 else {}))
    return history


def passive(history: History) -> bool | None:
    account = history.snapshot().account
    assert account is not None
    return judge(account)["passive"]


def test_what_a_live_pair_is_judged_by() -> None:
    assert History().snapshot().account is None
    assert passive(pair_of(3)) is True
    assert passive(pair_of(3, margin_J=-0.2)) is False
    assert passive(pair_of(3, slack_J=-1e-6)) is False
    assert passive(pair_of(3, deficit_J=1e-6)) is None


def test_the_least_margin_after_the_start() -> None:
    history = pair_of(0.5)
    assert (history.snapshot().min_margin_J, history.snapshot().later_margin_J) == (0.2, None)
    for tick, margin in ((8, 0.3), (10, 0.5), (11, 0.4), (12, 0.6)):
        history.take(device(tick * SEC // 10, margin=margin))
    assert history.snapshot().later_margin_J == pytest.approx(0.5)  # 0.4 and the world's 0.1


def test_energy_that_nobody_sent_shows_once_the_sender_had_time_to_tell() -> None:
    history = pair_of(1, credited_J=10.466)
    assert passive(history) is True  # the world may have sent it, and not said so yet
    for tick in range(10, 40):
        history.take(world(tick * SEC // 10))
        history.take(device(tick * SEC // 10)._replace(credited_J=10.466))
    assert passive(history) is False
    honest = pair_of(1, credited_J=0.02)
    for tick in range(10, 40):
        honest.take(world(tick * SEC // 10)._replace(sent_J=0.02))
        honest.take(device(tick * SEC // 10)._replace(credited_J=0.02))
    assert passive(honest) is True


def test_after_one_side_began_anew_it_is_not_known_and_after_both_did_it_is_again() -> None:
    history = pair_of(3)
    history.take(status("device", 2, coupling="pspm"))
    history.take(device(4 * SEC))
    history.take(world(4 * SEC))
    assert passive(history) is None
    history.take(status("world", 2, coupling="pspm"))
    history.take(device(5 * SEC))
    history.take(world(5 * SEC))
    assert passive(history) is True
