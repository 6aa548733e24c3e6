"""A recording is played to the page at its own pace, again and again."""

from pathlib import Path

import pytest

from hapnet import Params, cli, simulate
from hapnet.ext.page.history import History
from hapnet.ext.page.numbers import verdict
from hapnet.ext.page.playback import REST_NS, Playback
from hapnet.recording.samples import DeviceSample, Recording, WorldSample
from hapnet.recording.telemetry import Status, Telemetry

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
    history = History(follows=False)
    history.judge_by(recording.summary)
    playback = Playback(history.take, recording, "mine", START_NS)
    for at_ms in range(0, 8000, 10):  # more than two rounds
        playback.advance(START_NS + at_ms * MS)
    shown = history.snapshot()
    assert shown.device is not None
    assert shown.world is not None
    assert shown.aligned
    assert shown.past == ()
    assert verdict(shown) == recording.summary["verdict"]
    assert shown.device_status.path["round_trip_p50_ms"] > 60.0
    assert shown.device_status.about["name"] == "mine"


def test_it_goes_where_the_scrubber_is_with_the_account_up_to_there(recording: Recording) -> None:
    """All samples up to there come at once, each as far before the present as it was recorded before that place."""
    came: list[Telemetry] = []
    playback = Playback(came.append, recording, "mine", START_NS)
    playback.advance(START_NS)
    assert playback.duration_s == pytest.approx(1.5, abs=0.05)
    came.clear()
    playback.seek(1.0)
    playback.advance(now_ns := START_NS + 200 * MS)
    samples, expected = [one for one in came if not isinstance(one, Status)], recording.samples()
    first_ns = expected[0].time_ns
    wanted = [one.time_ns - first_ns for one in expected if one.time_ns - first_ns <= 1_000 * MS]
    assert [
        one.time_ns - now_ns + 1_000 * MS for one in samples if isinstance(one, DeviceSample | WorldSample)
    ] == wanted
    assert {one.incarnation for one in came if isinstance(one, Status)} == {2}
    assert playback.at_s == pytest.approx(1.0)
    for asked, at in ((99.0, playback.duration_s), (-1.0, 0.0)):
        playback.seek(asked)
        playback.advance(now_ns)
        assert playback.at_s == pytest.approx(at)


def test_it_stands_still_where_it_is_paused_and_says_so(recording: Recording) -> None:
    came: list[Telemetry] = []
    playback = Playback(came.append, recording, "mine", START_NS)
    playback.advance(START_NS + 300 * MS)
    playback.pause(True)
    assert playback.paused
    came.clear()
    for at_ms in range(300, 2300, 10):
        playback.advance(START_NS + at_ms * MS)
    assert playback.at_s == pytest.approx(0.3)
    assert all(isinstance(one, Status) and one.paused for one in came)
    assert came
    playback.seek(0.8)  # the scrubber still goes anywhere
    playback.advance(START_NS + 2300 * MS)
    assert playback.at_s == pytest.approx(0.8)
    playback.pause(False)
    playback.advance(START_NS + 2400 * MS)
    assert playback.at_s == pytest.approx(0.9)


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
        (["a", "-e", "tcp/127.0.0.1:1"], "leave it out to watch a running pair"),
    ):
        assert cli.main(["view", *files]) == 2
        err = capsys.readouterr().err
        assert says in err
        assert err.count("\n") == 1
