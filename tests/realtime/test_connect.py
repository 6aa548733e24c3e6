"""One side in an asyncio program: what its user reads and changes, and how it ends."""

import asyncio
import re
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, get_args

import pytest
import zenoh

from hapnet import HapnetError, InvalidParameter, Params, ZenohSettings, connect_device, connect_world
from hapnet.checks import Vector
from hapnet.errors import Ended
from hapnet.realtime import connect, side_task
from hapnet.realtime.connected import ConnectedDevice, ConnectedSide, ConnectedWorld, SetPosition
from hapnet.realtime.feed import Stream
from hapnet.realtime.side_events import EventKind, SideEvent
from hapnet.recording.mcap import read_recording
from hapnet.recording.samples import DeviceSample, WorldSample
from hapnet.transport import zenoh as transport
from hapnet.transport.config import free_address, local_address
from netem import LinkProfile, NetemError
from tests.support.cancelling import Handle
from tests.support.pairs import WAIT_S
from tests.support.processes import LIMIT_S, children

NOBODY = "tcp/127.0.0.1:1"
SETTINGS: dict[str, object] = {"operator": "sine", "link.up": "ideal", "link.down": "ideal"}
OF_AN_OWN_DEVICE = {name: value for name, value in SETTINGS.items() if name != "operator"}
HURRIED: dict[str, object] = {**SETTINGS, "device.silence_after_s": 0.1, "world.silence_after_s": 0.1}


@pytest.fixture
def address(tmp_path: Path) -> str:
    return local_address(str(tmp_path))


@asynccontextmanager
async def both(
    address: str, settings: dict[str, object] = SETTINGS
) -> AsyncIterator[tuple[ConnectedWorld, ConnectedDevice]]:
    async with (
        asyncio.timeout(WAIT_S),
        connect_world(settings, listen=address) as world,
        connect_device(settings, connect=address) as device,
    ):
        await world.wait_paired()
        await device.wait_paired()
        yield world, device


async def until(events: Stream[SideEvent], kind: EventKind) -> SideEvent:
    async with asyncio.timeout(WAIT_S):
        async for event in events:
            if event.kind == kind:
                return event
    raise AssertionError(f"no {kind}")


async def test_what_both_sides_tell_while_they_run_and_after(address: str) -> None:
    async with both(address) as (world, device):
        assert (world.role, device.role) == ("world", "device")
        assert world.is_paired
        assert device.is_paired
        of_device, places = device.samples(), device.set_positions()
        seen = [await anext(of_device) for _ in range(3)]
        assert all(isinstance(each, DeviceSample) for each in seen)
        assert seen[0].time_ns < seen[1].time_ns < seen[2].time_ns
        reported = [await anext(places) for _ in range(3)]
        assert reported == [SetPosition(each.time_ns, each.target_m, each.set_position_m) for each in seen]
        assert isinstance(await anext(world.samples()), WorldSample)
        assert device.sample.time_ns >= seen[2].time_ns
        assert device.set_position.time_ns >= seen[2].time_ns
        assert device.sample.margin_J > 0.0
        while (part := device.summary()["device"]) is None or part["sent_nJ"] == 0:
            await anext(of_device)
    sent, credited = device.summary()["device"], world.summary()["world"]
    assert sent["sent_nJ"] == credited["credited_nJ"] + sent["in_flight_nJ"] + sent["abandoned_nJ"] > 0
    for side in (world, device):
        kinds = [event.kind async for event in side.events()]
        assert kinds.count("paired") == kinds.count("ended") == 1
        assert kinds[-1] == "ended"
        with pytest.raises(StopAsyncIteration):
            await anext(side.samples())
        assert (await side.wait_ended())["duration_s"] is not None
        await side.wait_paired()  # it was


async def test_a_device_follows_another_and_both_know_both_accounts(address: str) -> None:
    async with (
        asyncio.timeout(WAIT_S),
        connect_device({**SETTINGS, "scene": "free"}, role="follower", listen=address) as follower,
        connect_device({**SETTINGS, "scene": "free"}, connect=address) as leader,
    ):
        await leader.wait_paired()
        async for sample in follower.samples():
            if abs(sample.position_m[0]) > 0.005:
                break
    assert follower.role == "world"
    for side in (leader, follower):
        summary = side.summary()
        assert summary["verdict"]["passive"], summary["verdict"]
        assert summary["theorem"]["margin_J"] is not None
    with pytest.raises(InvalidParameter, match="role is 'chief'; allowed: "):
        connect_device(role="chief")  # type: ignore[call-overload]


async def test_what_has_ended_cannot_be_changed(address: str) -> None:
    async with connect_device(listen=address) as device:
        pass
    acts: list[Callable[[], None]] = [
        lambda: device.change_link("4g"),
        lambda: device.report("a", 1),
        lambda: device.pause(),
        lambda: device.stop_force("why"),
        lambda: device.record("x.mcap"),
        lambda: device.lead((0.0,)),
    ]
    for act in acts:
        with pytest.raises(Ended, match="this side has ended"):
            act()
    with pytest.raises(Ended, match="this side has ended"):
        await device.wait_paired()  # nobody came


async def test_the_link_changes_while_it_runs(address: str) -> None:
    """A link that loses all is a silence at the other side; one that loses none ends it."""
    async with both(address, HURRIED) as (world, device):
        assert device.link == LinkProfile.named("ideal")
        events = world.events()
        device.change_link("loss 100%")
        assert device.link == LinkProfile.parse("loss 100%")
        silence = await until(events, "silence")
        assert silence.level == "warning"
        assert 0.1 <= float(silence.values["silence_s"]) < WAIT_S
        device.change_link("ideal")
        recovered = await until(events, "recovered")
        assert recovered.at_ns > silence.at_ns
        assert float(recovered.values["silence_s"]) >= 0.1
        notes = [event.text for event in _so_far(device) if event.kind == "notice"]
        assert [text for text in notes if "emulated link" in text] == [
            "emulated link, loss 100%",
            "emulated link, ideal",
        ]
        with pytest.raises(NetemError):
            device.change_link("nonsense")


def _so_far(side: ConnectedSide[Any]) -> list[SideEvent]:
    return [item for _, item in side.events()._items]


@pytest.mark.slow
async def test_another_device_is_a_change_of_peer(address: str) -> None:
    async with connect_world(HURRIED, listen=address) as world:
        events, order = world.events(), ("paired", "peer left", "peer changed", "peer left")
        for of_world in (order[:2], order[2:]):
            async with connect_device(HURRIED, connect=address):
                await until(events, of_world[0])
            await until(events, of_world[1])
        assert not world.is_paired


async def test_a_device_that_gives_out_more_than_it_may_tells_it_once(
    address: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With an account that is off by more than the bound; its own half of the theorem is then below zero."""
    watch = side_task.SideTask._watch

    def off(task: side_task.SideTask, sample: Any) -> None:
        if isinstance(sample, DeviceSample):
            sample = sample._replace(margin_J=-0.001)
        watch(task, sample)

    monkeypatch.setattr(side_task.SideTask, "_watch", off)
    async with both(address) as (_, device):
        samples = device.samples()
        for _ in range(3):
            await anext(samples)
        lost = await until(device.events(), "passivity lost")
        assert lost.text == "the margin of the device's half fell to -1 mJ"
        assert lost.level == "error"
    assert [event.kind for event in _so_far(device)].count("passivity lost") == 1


async def test_a_slow_reader_misses_samples_and_is_told_how_many(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(side_task, "MOST_SAMPLES", 5)
    async with both(address, {**SETTINGS, "record_hz": 1000.0}) as (_, device):
        slow, quick = device.samples(), device.samples()
        first = await anext(slow)
        async for sample in quick:
            if sample.time_ns > first.time_ns + 50_000_000:
                break
        second = await anext(slow)
        assert slow.missed > 0
        ticks = 1 + (second.time_ns - first.time_ns) / 1e6
        assert slow.missed < ticks
        missed = await until(device.events(), "missed")
        assert missed.values["count"] in (slow.missed, quick.missed)


class Failing(Handle):
    """A device that is read until it is told to fail."""

    broken = False

    def read(self) -> tuple[Vector, Vector]:
        if self.broken:
            raise OSError("cable")
        return super().read()


async def test_a_failure_is_raised_where_the_program_waits_and_when_the_block_is_left(address: str) -> None:
    arm, connected = Failing(), list[ConnectedDevice]()

    async def program() -> None:
        async with asyncio.timeout(WAIT_S), connect_device(OF_AN_OWN_DEVICE, device=arm, connect=address) as device:
            connected.append(device)
            await device.wait_paired()
            await world.wait_paired()
            samples, events = device.samples(), device.events()
            arm.broken = True
            for wait in (_all(samples), _all(events), device.wait_ended()):
                with pytest.raises(HapnetError, match="cable"):
                    await wait
            with pytest.raises(HapnetError, match="cable"):
                device.change_link("4g")

    async with connect_world(SETTINGS, listen=address) as world:
        with pytest.raises(HapnetError, match=r"failed: read\(\) raised OSError: cable"):
            await program()
        assert (await until(world.events(), "peer left")).text == "the device left: it failed"
    assert arm.closed
    assert arm.forces[-1] == (0.0,)
    ended = _so_far(connected[0])[-1]
    assert (ended.kind, ended.level) == ("ended", "error")
    assert "cable" in ended.text


async def _all(stream: Stream[Any]) -> None:
    async for _ in stream:
        pass


async def test_a_world_that_does_not_fit_ends_the_wait_for_it(address: str) -> None:
    settings = {**SETTINGS, "operator": "rest"}
    async with connect_world({**settings, "dof": 2}, scene="free", listen=address):
        with pytest.raises(HapnetError, match="degrees of freedom"):
            async with asyncio.timeout(WAIT_S), connect_device(settings, scene="free", connect=address) as device:
                await device.wait_paired()


async def test_the_programs_own_error_is_what_is_raised(address: str) -> None:
    async def program() -> None:
        async with connect_device(SETTINGS, connect=address) as device:
            await device.wait_paired()
            await world.wait_paired()  # by itself, a little sooner or later
            raise KeyError("mine")

    async with connect_world(SETTINGS, listen=address) as world:
        with pytest.raises(KeyError, match="mine"):
            await program()
        assert (await until(world.events(), "peer left")).text == "the device left: the run is over"


async def test_a_side_may_end_by_itself(address: str, tmp_path: Path) -> None:
    """The device's time is over; the world, which runs once, ends with it; the recording is whole."""
    file = tmp_path / "device.mcap"
    async with (
        asyncio.timeout(WAIT_S),
        connect_world(SETTINGS, listen=address, once=True) as world,
        connect_device(SETTINGS, connect=address, duration_s=0.2, record=file) as device,
    ):
        duration_s = (await device.wait_ended())["duration_s"]
        assert 0.2 <= duration_s < WAIT_S
        await world.wait_ended()
        with pytest.raises(Ended):
            world.change_link("4g")
    recording = read_recording(file)
    assert not recording.torn
    assert recording.summary is not None
    assert recording.meta["params"]["duration_s"] == 0.2


async def test_a_client_whose_router_never_comes_can_be_left(monkeypatch: pytest.MonkeyPatch) -> None:
    """Opening waits for the router for ever, so the block has not begun yet."""
    settings = ZenohSettings(mode="client", connect=(NOBODY,))
    loop, opening = asyncio.get_running_loop(), asyncio.Event()

    def opens(config: zenoh.Config, original: Callable[[zenoh.Config], zenoh.Session] = zenoh.open) -> zenoh.Session:
        loop.call_soon_threadsafe(opening.set)
        return original(config)

    monkeypatch.setattr(transport.zenoh, "open", opens)

    async def program() -> None:
        async with connect_device(zenoh=settings):
            raise AssertionError("nobody is there")

    task = asyncio.create_task(program())
    async with asyncio.timeout(WAIT_S):
        await opening.wait()
        assert not task.done()
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task


@pytest.mark.slow
async def test_a_servo_in_a_process_of_its_own_is_read_alike(address: str) -> None:
    before = children()  # another test's browser, perhaps
    async with (
        asyncio.timeout(LIMIT_S),
        connect_world(SETTINGS, listen=address),
        connect_device(SETTINGS, connect=address, realtime=True) as device,
    ):
        await device.wait_paired()
        samples = device.samples()
        first, second = await anext(samples), await anext(samples)
        assert first.time_ns < second.time_ns
    assert children() <= before
    part = device.summary()["device"]
    assert part["servo"]["ticks"] > 0


@pytest.mark.slow
async def test_a_program_leads_the_hand(address: str) -> None:
    settings = {**SETTINGS, "operator": "mouse", "scene": "free"}
    async with both(address, settings) as (_, device):
        device.lead([0.01])
        async for sample in device.samples():
            if sample.position_m[0] > 0.002:
                break
        with pytest.raises(InvalidParameter):
            device.lead([0.01, 0.0])
    async with connect_device(Params(), listen=address) as device:
        with pytest.raises(InvalidParameter, match="operator"):
            device.lead([0.01])


def test_the_page_is_a_program_that_runs(capsys: pytest.CaptureFixture[str]) -> None:
    page = (Path(connect.__file__).parent / "README.md").read_text("utf-8")
    section = page[page.index("## In an asyncio program") :].partition("\n## ")[0]
    code = section.split("```python\n", 1)[1].split("```", 1)[0]
    exec(compile(code.replace("tcp/127.0.0.1:17447", free_address()), "README.md", "exec"), {"__name__": "page"})
    said = capsys.readouterr().out
    for words in (
        "paired |",
        "set-position SetPosition(",
        "notice | emulated link, delay 50ms loss 5%",
        "ended | after",
    ):
        assert words in said
    reported = " ".join(re.findall(r"^\| (`.*?) \|", section, re.MULTILINE))  # the table's first column
    assert sorted(re.findall("`(.*?)`", reported)) == sorted(get_args(EventKind))
