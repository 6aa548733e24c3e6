"""A side that is changed while it runs: its link, its hand, a pause, recordings; and what it publishes of itself."""

import asyncio
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from hapnet.errors import InvalidParameter, RecordingError
from hapnet.ext.page import watcher as watcher_module
from hapnet.ext.page.watcher import Watcher
from hapnet.params import Params
from hapnet.realtime.controllers import ThreadedDevice, ThreadedWorld
from hapnet.recording.mcap import read_recording
from hapnet.recording.samples import DeviceSample, Event, WorldSample
from hapnet.recording.telemetry import Status, Telemetry
from hapnet.simulation.simulation import Simulation
from hapnet.transport.config import ZenohSettings, free_address
from netem.errors import NetemError
from tests.conftest import mostly_slow
from tests.support.pairs import WAIT_S, Running, idle, parameters, running


def device_of(running: Running) -> ThreadedDevice:
    assert isinstance(running.side.control, ThreadedDevice)
    return running.side.control


def world_of(running: Running) -> ThreadedWorld:
    assert isinstance(running.side.control, ThreadedWorld)
    return running.side.control


async def test_a_paused_pair_stands_still_and_goes_on() -> None:
    address, params = free_address(), parameters(operator="sine")
    device, world = Running("device", address, params), Running("world", address, params)
    async with running(device, world):
        await device.until(lambda: device.count > 100)
        await world.until(lambda: world.count > 5)
        device.side.pause(True)
        world.side.pause(True)
        ticks, steps = device.count, world.count
        await device.until(lambda: device.count > ticks + 2)  # the tick that was being made is over
        hand, mass = device_of(device).side.device, world_of(world).side.mass
        stood = hand.read()[0], mass.position
        received = world.side.summary()["world"]["received"]
        await device.until(lambda: device.count > ticks + 700)  # longer than a silence would need to be noticed
        assert (hand.read()[0], mass.position) == stood
        assert world.count <= steps + 1
        assert world.side.summary()["world"]["received"] > received + 50  # the protocol goes on
        device.side.pause(False)
        world.side.pause(False)
        await world.until(lambda: mass.position != stood[1])
        await device.until(lambda: hand.read()[0] != stood[0])
        for side in (device, world):
            summary = side.side.summary()[side.side.role]
            assert summary["ledger"]["slack_J"] >= -1e-12
            assert summary["ledger"]["margin_J"] > 0.0
            assert summary["outages"]["count"] == 0
    assert device.reported("pause") == ["paused", "goes on"]


@pytest.mark.parametrize("seed", mostly_slow(range(3), 1))
@pytest.mark.parametrize("servo", ["sampled", "continuous"])
def test_pauses_at_any_time_cost_no_passivity(servo: str, seed: int) -> None:
    """Each side's half of Theorem 1, and the whole, whoever stands still and whenever."""
    rng = np.random.default_rng(seed)
    simulation = Simulation(parameters(operator="press", duration_s=8.0, device__servo=servo), seed, kernel=False)

    def pause(_: float) -> None:
        simulation.device.paused, simulation.world.paused = rng.random(2) < 0.4

    result = simulation.run(pause)
    for side in ("device", "world"):
        assert result.summary[side]["ledger"]["slack_J"] >= -1e-12
        assert result.summary[side]["reservoir_min_J"] >= 0.0
    assert result.summary["theorem"]["margin_J"] >= 0.0
    device = result.recording.device
    assert np.diff(device["time_s"]).max() >= 0.5  # what stands still is not recorded


async def test_the_link_is_changed_while_it_runs() -> None:
    address, params = free_address(), parameters(link__up="")
    device, world = Running("device", address, params), Running("world", address, params)
    async with running(device, world):
        await device.until(lambda: device.count > 50)
        device.side.change_link("delay 60ms")
        before = device.side.summary()["links"]["up"]["delivered"]
        await device.until(lambda: device.side.summary()["links"]["up"]["delivered"] >= before + 30)
        up = (await device.end())["links"]["up"]
    assert up["profile"] == "delay 60ms"
    assert up["delay_p99_ms"] == pytest.approx(60.0, rel=0.012)  # a bin of the histogram is 1.1 % wide
    assert "emulated link, delay 60ms" in device.reported("netem")


def test_the_link_is_changed_before_it_runs() -> None:
    side = idle("device")
    side.change_link("delay 7ms")
    assert side.summary()["links"]["up"]["profile"] == "delay 7ms"


@pytest.mark.parametrize(
    ("words", "error"), mostly_slow([("dealy 3ms", NetemError), ("corrupt 5%", InvalidParameter)], 1)
)
async def test_a_link_that_is_none_changes_nothing(words: str, error: type[Exception]) -> None:
    address, params = free_address(), parameters()
    device = Running("device", address, params)
    async with running(device):
        profile = device.side.profile
        with pytest.raises(error):
            device.side.change_link(words)
        assert device.side.profile == profile


async def test_a_led_hand_goes_where_it_is_told() -> None:
    """Into the wall: the handle stops where hand, couplings and wall are in balance, the proxy at the wall.

    ``K_h (goal - x) = K (x - p)`` at the device and ``K' (x - p) = K_w (p - wall)`` in the world.
    """
    address, params = free_address(), parameters(operator="mouse", link__up="", link__down="")
    device, world = Running("device", address, params), Running("world", address, params)
    hand, K, K_v = params.operator_model.stiffness, 100.0, 500.0  # the defaults
    wall, K_w, goal = params.world.wall.position_m, params.world.wall.stiffness, 0.045
    balance = np.array([[hand + K, -K], [K_v, -(K_v + K_w)]])
    x, p = np.linalg.solve(balance, [hand * goal, -K_w * wall])
    assert p < wall + 0.003 < x - 0.010
    async with running(device, world):
        await device.until(lambda: device.count > 10)
        handle, mass = device_of(device).side.device, world_of(world).side.mass
        assert handle.read()[0] == (0.0,)
        device.side.lead((goal,))
        await device.until(lambda: abs(handle.read()[0][0] - x) < 1e-3 and abs(mass.position[0] - p) < 1e-3)
        with pytest.raises(InvalidParameter, match="position"):
            device.side.lead((0.1, 0.2))
        with pytest.raises(InvalidParameter, match="on a device's side"):
            world.side.lead((0.1,))


async def test_a_hand_that_is_not_led_cannot_be() -> None:
    device = Running("device", free_address(), parameters(operator="rest"))
    async with running(device):
        with pytest.raises(InvalidParameter, match="mouse"):
            device.side.lead((0.01,))


async def test_nor_can_the_hand_that_holds_a_device_of_its_own() -> None:
    with pytest.raises(InvalidParameter, match=r"operator is 'mouse'.*it is not simulated"):
        Running("device", free_address(), parameters(operator="mouse", hardware="examples.own_device:Rail"))
    device = Running("device", free_address(), parameters(hardware="examples.own_device:Rail"))
    async with running(device):
        with pytest.raises(InvalidParameter, match="operator"):
            device.side.lead((0.01,))


def test_nobody_leads_a_hand_in_virtual_time() -> None:
    with pytest.raises(InvalidParameter, match="mouse"):
        Simulation(Params().set({"operator": "mouse"}))


async def test_recordings_begin_and_end_while_it_runs(tmp_path: Path) -> None:
    address, params = free_address(), parameters(operator="sine")
    device, world = Running("device", address, params), Running("world", address, params)
    first, second = tmp_path / "1.mcap", tmp_path / "2.mcap"
    async with running(device, world):
        await device.until(lambda: device.count > 100)
        device.side.record(first)
        began = device.count
        await device.until(lambda: device.count > began + 200)
        device.side.record(second)
        await device.until(lambda: device.count > began + 400)
        device.side.record(None)
        ended, ended_ns = device.count, time.monotonic_ns()
        await device.until(lambda: device.count > ended + 100)
        with pytest.raises(RecordingError):
            device.side.record(Path("/proc/no.mcap"))
        await device.end()
    early, late = read_recording(first), read_recording(second)
    for recording in (early, late):
        assert recording.summary is not None
        assert not recording.torn
        assert len(recording.device["time_s"]) >= 30
    assert early.device["time_s"][0] > 0.09  # from pairing
    assert early.device["time_s"][-1] < late.device["time_s"][0]
    assert late.device["time_ns"][-1] <= ended_ns


class Heard:
    """What a watcher hands over."""

    def __init__(self) -> None:
        self.messages: list[Telemetry] = []
        self.lock = threading.Lock()

    def take(self, message: Telemetry) -> None:
        with self.lock:
            self.messages.append(message)

    def all(self, kind: type) -> list[Telemetry]:
        with self.lock:
            return [message for message in self.messages if isinstance(message, kind)]

    def newest(self, role: str) -> Status | None:
        found = [m for m in self.all(Status) if isinstance(m, Status) and m.role == role]
        return found[-1] if found else None


async def test_who_watches_hears_both_sides_through_the_one_it_dials() -> None:
    address, params = free_address(), parameters(operator="sine", record_hz=500.0)
    device, world, heard = Running("device", address, params), Running("world", address, params), Heard()
    watcher = Watcher(ZenohSettings(connect=(address,)), heard.take)
    watcher.open()
    async with running(device, world):
        await device.until(lambda: heard.newest("device") is not None and heard.newest("world") is not None)
        before, began = device.count, time.monotonic()
        since = len(heard.all(DeviceSample))
        await device.until(lambda: device.count > before + 500)
        samples = len(heard.all(DeviceSample)) - since
        assert 0 < samples <= 60.0 * (time.monotonic() - began) + 2  # of 500 recorded a second
        world.side.change_link("delay 33ms")
        await world.until(lambda: any(isinstance(m, Event) and "33ms" in m.text for m in heard.all(Event)))
        await world.until(lambda: (status := heard.newest("world")) is not None and status.link["delay_now_ms"] == 33.0)
        status = heard.newest("device")
        assert status.paired
        assert status.incarnation == device.side.wire.session.identity.incarnation
        assert status.about["params"]["operator"] == "sine"
        assert heard.all(WorldSample)
        times = [m.time_ns for m in heard.all(DeviceSample) if isinstance(m, DeviceSample)]
        assert times == sorted(set(times))
    watcher.close()
    assert watcher.pair == ("default", "device")
    assert (watcher.telemetry.unreadable, watcher.others) == (0, set())


async def test_telemetry_can_be_off() -> None:
    address, heard = free_address(), Heard()
    quiet, loud = parameters(telemetry_hz=0.0), parameters()
    watcher = Watcher(ZenohSettings(connect=(address,)), heard.take)
    watcher.open()
    device, world = Running("device", address, quiet), Running("world", address, loud)
    async with running(device, world):
        await world.until(lambda: heard.newest("world") is not None and device.count > 500)
        assert not heard.all(DeviceSample)
        assert heard.newest("device") is None
    watcher.close()


@pytest.mark.slow
async def test_a_pair_that_has_ended_is_let_go_for_the_next(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(watcher_module, "GONE_S", 1.2)
    address, heard = free_address(), Heard()
    watcher = Watcher(ZenohSettings(connect=(address,)), heard.take)
    watcher.open()
    for session in ("first", "second"):
        world = Running("world", address, parameters(), session=session)
        async with running(world):
            await world.until(lambda session=session: watcher.pair == (session, "device"))
        async with asyncio.timeout(WAIT_S):
            while watcher.pair is not None:
                await asyncio.sleep(0.02)
    watcher.close()
