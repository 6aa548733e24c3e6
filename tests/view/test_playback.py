"""A recording is played to the page at its own pace, again and again."""

from __future__ import annotations

from pathlib import Path

import pytest

from hapnet import Params, cli, simulate
from hapnet.recording.samples import DeviceSample, Recording, WorldSample
from hapnet.recording.telemetry import Status, Telemetry
from hapnet.view.history import History
from hapnet.view.panel import verdict
from hapnet.view.playback import REST_NS, Playback

START_NS = 5_000_000_000
MS = 1_000_000


@pytest.fixture(scope="module")
def recording() -> Recording:
    return simulate(Params().set({"duration_s": 1.5, "record_hz": 50.0, "operator": "press"}), seed=1).recording


def played(recording: Recording, until_ms: int) -> list[tuple[int, Telemetry]]:
    """What comes, and when [ns], looked at every 10 ms."""
    came: list[tuple[int, Telemetry]] = []
    now_ns = START_NS
    playback = Playback(lambda message: came.append((now_ns, message)), recording, "mine", now_ns)
    for at_ms in range(0, until_ms, 10):
        now_ns = START_NS + at_ms * MS
        playback.advance(now_ns)
    return came


def test_every_sample_comes_when_it_is_due(recording: Recording) -> None:
    came = [(now, one) for now, one in played(recording, 1600) if not isinstance(one, Status)]
    expected = recording.samples()
    assert [type(one) for _, one in came] == [type(one) for one in expected]
    for (now_ns, one), sample in zip(came, expected, strict=True):
        assert one.time_ns - START_NS == sample.time_ns - expected[0].time_ns
        assert 0 <= now_ns - one.time_ns < 10 * MS
        assert repr(one) == repr(sample._replace(time_ns=one.time_ns))  # an age before the first message is NaN


def test_it_begins_again_as_another_pair_after_a_rest(recording: Recording) -> None:
    samples = recording.samples()
    lasts_ms = (samples[-1].time_ns - samples[0].time_ns + REST_NS) // MS + 1
    came = played(recording, lasts_ms + 300)
    statuses = [one for _, one in came if isinstance(one, Status)]
    assert {one.role for one in statuses} == {"device", "world"}
    assert [one.incarnation for one in statuses] == sorted(one.incarnation for one in statuses)
    assert {(one.incarnation, one.paused) for one in statuses} == {(1, False), (1, True), (2, False)}
    again = [now for now, one in came if isinstance(one, DeviceSample) and now >= START_NS + lasts_ms * MS - 10 * MS]
    assert len(again) == pytest.approx(15, abs=2)  # 300 ms at 50 Hz


def test_the_page_knows_of_it_what_it_knows_of_a_pair(recording: Recording) -> None:
    history = History(keeps_past=False)
    playback = Playback(history.take, recording, "mine", START_NS)
    for at_ms in range(0, 8000, 10):  # more than two rounds
        playback.advance(START_NS + at_ms * MS)
    shown = history.snapshot()
    assert shown.device is not None
    assert shown.world is not None
    assert shown.aligned
    assert shown.past == ()
    kept = verdict(shown)
    assert kept is not None
    assert kept["passive"] is True
    assert shown.device_status is not None
    assert shown.device_status.path["round_trip_p50_ms"] > 60.0
    assert shown.device_status.about["name"] == "mine"


def test_one_side_alone_is_played_too(recording: Recording) -> None:
    alone = Recording(recording.meta, None, recording.world, [], None)
    came = [one for _, one in played(alone, 500)]
    assert {type(one) for one in came} == {Status, WorldSample}
    assert {one.role for one in came if isinstance(one, Status)} == {"world"}


def test_what_is_no_recording_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bad = tmp_path / "bad.mcap"
    bad.write_text("nothing", "utf-8")
    for files, says in (
        ([str(bad)], "is not a recording"),
        (["a", "b", "c"], "one recording, or the device's"),
        (["a", "-e", "tcp/127.0.0.1:1"], "left out where a running pair is watched"),
    ):
        assert cli.main(["view", *files]) == 2
        err = capsys.readouterr().err
        assert says in err
        assert err.count("\n") == 1
