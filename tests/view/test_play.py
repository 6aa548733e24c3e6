"""`hapnet play` and `hapnet view` without a browser: real processes, heard through their telemetry."""

import asyncio
import os
import signal
import time
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager
from io import StringIO
from pathlib import Path

import pytest
from rich.console import Console

from hapnet import cli
from hapnet.commands.pair import Pair
from hapnet.commands.standby import Standby
from hapnet.errors import HapnetError, InvalidParameter
from hapnet.ext.page.commands.play import led
from hapnet.ext.page.commands.stage import SESSION, PairSequence
from hapnet.ext.page.history import History
from hapnet.ext.page.watcher import Watcher
from hapnet.params import RELAXED_HAND, Params
from hapnet.recording.mcap import read_recording
from hapnet.recording.telemetry import Status
from hapnet.transport.config import ZenohSettings, free_address
from netem.errors import NetemError
from tests.conftest import ROOT, mostly_slow
from tests.support.processes import started

WAIT_S = 90.0


class Playing:
    """A stage that runs, and what is heard of it."""

    def __init__(self, out: Path, **changes: object) -> None:
        address = free_address()
        self.said = StringIO()
        self.history = History(follows=False)
        params = led(Params().set({name.replace("__", "."): value for name, value in changes.items()}))
        console = Console(file=self.said, width=400)
        self.stage = PairSequence(params, 1, out, address, console, self.history, realtime=False)
        self.watcher = Watcher(ZenohSettings(connect=(address,)), self.history.take, session=SESSION, name="device")
        self.stop = asyncio.Event()
        self.task = asyncio.create_task(self.stage.run(self.stop))
        self.watcher.open()

    async def until(self, condition: Callable[[], bool]) -> None:
        async with asyncio.timeout(WAIT_S):
            while not condition():
                if self.task.done():
                    self.task.result()
                    raise AssertionError("the stage has ended")
                await asyncio.sleep(0.02)

    @property
    def device(self) -> Status | None:
        status = self.history.snapshot().device_status
        return status if status is not None and status.paired else None

    def coupled(self, name: str) -> bool:
        snapshot = self.history.snapshot()
        statuses = (snapshot.device_status, snapshot.world_status)
        return all(s is not None and s.paired and s.about["coupling"] == name for s in statuses)

    @property
    def least_margin_J(self) -> float:
        summary = self.history.snapshot().summary
        return 0.0 if summary is None else summary["theorem"]["margin_J"] or 0.0

    @property
    def handle_m(self) -> float:
        track = self.history.snapshot().device
        return float("nan") if track is None else float(track.position_m[-1, 0])


@asynccontextmanager
async def playing(out: Path, **changes: object) -> AsyncIterator[Playing]:
    play = Playing(out, **changes)
    try:
        yield play
    finally:
        play.stop.set()
        play.stage.leave_at_once()
        await asyncio.wait_for(play.task, WAIT_S)
        play.watcher.close()


@pytest.mark.slow
async def test_what_the_page_asks_reaches_the_running_pair(tmp_path: Path) -> None:
    async with playing(tmp_path, link__up="delay 5ms", link__down="delay 5ms") as play:
        stage = play.stage
        await play.until(lambda: play.coupled("pspm"))
        first = play.device
        stage.lead((0.035,))
        await play.until(lambda: play.handle_m > 0.015)
        stage.link("up", "delay 70ms")
        await play.until(lambda: (d := play.device) is not None and d.link["delay_now_ms"] == pytest.approx(70.0))
        with pytest.raises(NetemError):
            stage.link("down", "delay lots")
        stage.record(True)
        await play.until(lambda: (d := play.device) is not None and d.recording.endswith("01-device.mcap"))
        await play.until(lambda: (tmp_path / "01-world.mcap").exists() and (tmp_path / "01-device.mcap").exists())
        stage.pause(True)
        await play.until(lambda: (d := play.device) is not None and d.paused)
        stage.lead((-0.035,))
        taken = play.history.snapshot().taken
        stood = play.handle_m
        before_ns = first.time_ns
        await play.until(lambda: (d := play.device) is not None and d.time_ns > before_ns + 1_500_000_000 and d.paused)
        assert play.handle_m == stood
        stage.pause(False)
        await play.until(lambda: play.handle_m < 0.0)
        assert play.history.snapshot().taken > taken
        stage.record(False)
        await play.until(lambda: (d := play.device) is not None and not d.recording)
        assert first.incarnation == play.device.incarnation if play.device else False
    for role in ("device", "world"):
        recording = read_recording(tmp_path / f"01-{role}.mcap")
        assert not recording.torn
        assert recording.summary is not None
    assert "hapnet report" in play.said.getvalue()


@pytest.mark.slow
async def test_another_coupling_is_another_episode_with_an_account_of_its_own(tmp_path: Path) -> None:
    """On a bad link, with a loose hand: the plain coupling breaks the bound, PSPM does not."""
    bad = "delay 40ms 10ms loss 2%"
    async with playing(tmp_path, link__up=bad, link__down=bad) as play:

        async def shake(until: Callable[[float], bool]) -> None:
            """Move the hand to and fro until the least margin is as wanted."""
            began = time.monotonic()
            while not until(play.least_margin_J):
                assert time.monotonic() < began + WAIT_S
                play.stage.lead((0.01 if int(4.0 * time.monotonic()) % 2 else -0.01,))
                await asyncio.sleep(0.05)

        await play.until(lambda: play.coupled("pspm"))
        begun = time.monotonic()
        await shake(lambda margin: time.monotonic() > begun + 4.0)
        assert play.least_margin_J >= 0.0
        play.stage.coupling("zoh", "paper")
        await play.until(lambda: play.coupled("zoh"))
        await shake(lambda margin: margin < -0.05)
        play.stage.coupling("pspm", "paper")
        await play.until(lambda: play.coupled("pspm") and play.least_margin_J > 0.0)
        assert [episode.coupling for episode in play.history.snapshot().past] == ["pspm", "zoh"]
        play.stage.smoothing(0.02)
        await play.until(lambda: (d := play.device) is not None and d.about["params"]["device"]["smoothing_s"] == 0.02)
        with pytest.raises(InvalidParameter):
            play.stage.smoothing(-1.0)
        play.stage.coupling("wave", "auto")  # which has no such filter
        await play.until(lambda: play.coupled("wave"))
        assert (d := play.device) is not None
        assert d.about["params"]["device"]["smoothing_s"] == 0.0
    lines = [line for line in play.said.getvalue().splitlines() if line[:1].isdigit()]
    assert [line.split(",")[0] for line in lines] == ["1: hapnet", "2: zoh", "3: paper", "4: paper", "5: wave"]
    assert ["NOT PASSIVE" in line for line in lines[:3]] == [False, True, False]


@pytest.mark.slow
async def test_the_hand_stays_where_it_is_when_the_coupling_changes(tmp_path: Path) -> None:
    """It presses the wall; each pair's recording says which coupling and feel it is of."""
    async with playing(tmp_path, link__up="delay 5ms", link__down="delay 5ms") as play:
        await play.until(lambda: play.coupled("pspm"))
        play.stage.record(True)
        play.stage.lead((0.04,))
        await play.until(lambda: play.handle_m > 0.025)
        await asyncio.sleep(1.0)
        pressed = play.handle_m
        play.stage.coupling("popc", "auto")
        await play.until(lambda: play.coupled("popc") and (d := play.device) is not None and bool(d.recording))
    first, second = (read_recording(tmp_path / f"{number}-device.mcap") for number in ("01", "02"))
    assert [one.meta["coupling"] for one in (first, second)] == ["pspm", "popc"]
    assert first.meta["params"]["rendering"] == "hapnet"
    assert second.device["position_m"][0, 0] == pytest.approx(pressed, abs=3e-3)
    assert second.device["position_m"].min() > 0.02


@pytest.mark.slow
async def test_the_next_pair_is_one_of_processes_that_wait_for_it(tmp_path: Path) -> None:
    """They are there some seconds after a pair has begun; what is not needed ends with the stage, as do broken ones."""
    async with playing(tmp_path) as play:
        await play.until(lambda: len(play.stage.reserve.processes) == 2)
        waiting = {role: standby.child.pid for role, standby in play.stage.reserve.processes.items()}
        play.stage.coupling("zoh", "paper")
        await play.until(lambda: play.coupled("zoh"))
        assert {role: child.pid for role, child in play.stage._pair._children.items()} == waiting
        await play.until(lambda: len(play.stage.reserve.processes) == 2)
        left = {standby.child.pid for standby in play.stage.reserve.processes.values()}
        play.stage.reserve.processes["world"].child.kill()  # the next world is started as the first was
        await play.until(lambda: play.stage.reserve.processes["world"].child.returncode is not None)
        play.stage.coupling("pspm", "paper")
        await play.until(lambda: play.coupled("pspm"))
    assert not alive(left)


@pytest.mark.slow
async def test_another_scene_begins_where_it_begins(tmp_path: Path) -> None:
    async with playing(tmp_path, link__up="", link__down="") as play:
        await play.until(lambda: play.coupled("pspm"))
        play.stage.lead((0.03,))
        await play.until(lambda: play.handle_m > 0.015)
        with pytest.raises(InvalidParameter, match="nowhere"):
            play.stage.scene("nowhere")
        play.stage.scene("sphere")
        await play.until(lambda: (d := play.device) is not None and d.about["scene"].startswith("sphere"))
        await play.until(lambda: (t := play.history.snapshot().device) is not None and t.position_m.shape[1] == 3)
        track = play.history.snapshot().device
        assert abs(track.position_m[0]).max() < 0.012
        play.stage.mesh("mine.OBJ", (ROOT / "examples" / "ring.obj").read_bytes())
        await play.until(lambda: (d := play.device) is not None and d.about["scene"].startswith("mesh"))
        play.stage.scene("wall")  # the one of the command line, too
        await play.until(lambda: (d := play.device) is not None and d.about["scene"] == "wall")


@pytest.mark.slow
async def test_a_process_that_fails_ends_it_with_its_own_words(tmp_path: Path) -> None:
    play = Playing(tmp_path)
    await play.until(lambda: play.coupled("pspm"))
    play.stage._pair._children["world"].kill()
    with pytest.raises(HapnetError, match="world"):
        await asyncio.wait_for(play.task, WAIT_S)
    play.watcher.close()


@pytest.mark.slow
async def test_what_is_asked_while_the_processes_start_is_not_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The parameters are written by then, and nobody is there yet to receive them."""
    play = Playing(tmp_path)
    start = Pair.start

    async def asked(pair: Pair, ready: Mapping[str, Standby]) -> None:
        await start(pair, ready)
        play.stage.link("down", "delay 33ms")
        play.stage.record(True)
        await asyncio.sleep(0)

    monkeypatch.setattr(Pair, "start", asked)
    try:
        await play.until(lambda: (s := play.history.snapshot().world_status) is not None and s.paired)
        await play.until(lambda: (d := play.device) is not None and d.recording.endswith("01-device.mcap"))
        world = play.history.snapshot().world_status
        assert world.link["profile"] == "delay 33ms"
    finally:
        play.stop.set()
        play.stage.leave_at_once()
        await asyncio.wait_for(play.task, WAIT_S)
        play.watcher.close()
    assert play.said.getvalue().count("recording ") == 1


@pytest.mark.parametrize("words", ["trace /etc/hostname", 'delay 1ms "csv" /etc/hostname'])
def test_a_page_reads_no_file(words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not even to say what is wrong with it: that would be shown to whoever has the page open."""
    monkeypatch.setattr(Path, "read_text", None)
    monkeypatch.setattr(Path, "open", None)
    monkeypatch.setattr("builtins.open", None)
    stage = PairSequence(
        led(Params()), 1, tmp_path, "tcp/127.0.0.1:1", Console(file=StringIO()), History(), realtime=False
    )
    with pytest.raises(InvalidParameter, match="the page reads no files"):
        stage.link("up", words)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("hardware=examples.own_device:Rail", "hapnet view"),
        ("telemetry_hz=0", "shows telemetry"),
        ("hardware=omni?axes=joints", "axes are in m"),
    ],
)
def test_what_no_page_can_show_or_lead_is_refused(change: str, words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["play", "--set", change]) == 2
    assert words in capsys.readouterr().err


def test_the_hand_is_relaxed_unless_it_was_set() -> None:
    assert led(Params()).operator_model.stiffness == RELAXED_HAND["operator_model.stiffness"]
    assert led(Params().set({"operator_model.mass": 1.0})).operator_model.stiffness == Params().operator_model.stiffness
    assert led(Params().set({"operator": "press", "duration_s": 3.0})).operator == "mouse"


def children_of(pid: int) -> set[int]:
    return {int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()}


def alive(pids: set[int]) -> set[int]:
    return {pid for pid in pids if Path(f"/proc/{pid}").exists()}


@pytest.mark.parametrize("number", mostly_slow([signal.SIGINT, signal.SIGTERM], 1))
def test_play_says_where_its_page_is_and_leaves_nothing_behind(number: signal.Signals) -> None:
    pytest.importorskip("viser")
    with started("play", "--no-browser", "--port", 0) as program:
        program.until_line("open http://127.0.0.1:")
        program.until("both processes", lambda: len(children_of(program.process.pid)) >= 2)
        children = children_of(program.process.pid)
        os.kill(program.process.pid, number)
        code, _, errors = program.end()
        assert code == 128 + number, errors
        assert not errors
        assert not alive(children)


@pytest.mark.slow
def test_view_shows_a_pair_that_runs_elsewhere() -> None:
    pytest.importorskip("viser")
    address = free_address()
    with (
        started("world", "-l", address, "--set", "telemetry_hz=20") as world,
        started("device", "-e", address, "--operator", "sine") as device,
        started("view", "-e", address, "--no-browser", "--port", 0) as view,
    ):
        view.until_line("watching session default of device device")
        for program in (view, device, world):
            os.kill(program.process.pid, signal.SIGINT)
            assert program.end()[0] == 130


def test_a_mouse_leads_no_hand_but_in_play() -> None:
    with started("device", "--operator", "mouse") as program:
        code, _, errors = program.end()
    assert code == 2
    assert "hapnet play" in errors
