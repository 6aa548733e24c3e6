"""A program may be cancelled wherever it waits: the device renders no force then, and nothing of the side is left."""

import asyncio
from collections.abc import AsyncIterator, Callable, Coroutine
from pathlib import Path
from typing import Any

import pytest

from hapnet import Params, RealtimeSide, ZenohSettings, connect_device, connect_world, prepare, read_recording
from hapnet.realtime import shutdown
from hapnet.realtime.connected import ConnectedWorld
from hapnet.realtime.side_events import EventKind
from hapnet.transport.config import local_address
from tests.conftest import mostly_slow
from tests.support.cancelling import Handle, Leaks, Noting, cancelled_at, watched
from tests.support.pairs import WAIT_S

PROGRAM, SIDE = "program", "SideTask._run"
"""Tasks by name: the user's own, and the one that runs the side, which ends with the event loop only."""

SETTINGS: dict[str, object] = {
    "coupling": "zoh",  # a force that needs no energy of a peer that comes again and again
    "link.up": "ideal",
    "link.down": "ideal",
    "record_hz": 25.0,
    "device.force_ramp_s": 0.02,
    "device.self_test_N": 0.0,  # the handle stands still
    "device.watchdog_s": 0,  # a machine that tests may hold a servo up, which then renders no force
    "world.silence_after_s": 0.05,
    "world.step_min_s": 0.002,
    "world.step_max_s": 0.004,
}
FIRST = 24
"""Of the first so many places every third is tried in every run; all of them in the slow one."""


class Place:
    """A world that waits for devices, and what is watched beside it."""

    def __init__(self, address: str, world: ConnectedWorld, leaks: Leaks) -> None:
        self.address, self.world, self.leaks = address, world, leaks
        self.more: dict[str, Any] = {"device": Handle}
        self.felt = False

    async def program(self) -> None:
        """Touch the wall, change the link, look at the world and leave."""
        self.felt = False
        async with connect_device(SETTINGS, connect=self.address, **self.more) as device:
            await device.wait_paired()
            async for sample in device.samples():
                self.felt = True
                if sample.force_N[0] < -0.1:
                    break
            device.change_link("delay 1ms")
            async for event in device.events():
                if "emulated link" in event.text:
                    break
            await anext(self.world.samples())

    async def cancelled(self, number: int, victim: str) -> bool:
        """Cancel one run of the program at this place; False if it does not wait so often."""
        hit, task = await cancelled_at(number, self.program, victim)
        await self.leaks.require_none()
        if not hit:
            task.result()
            for handle in Handle.made[-1:]:  # none if it was in another process
                assert min(force[0] for force in handle.forces) < -0.1  # there was a force to be taken away
        elif victim == PROGRAM:
            assert task.cancelled()
        else:
            assert task.cancelled() or task.exception() is not None
        return hit


@pytest.fixture(autouse=True)
def few_looks(monkeypatch: pytest.MonkeyPatch) -> None:
    """A side that leaves looks now and then whether all is acknowledged: at the same place each time."""
    monkeypatch.setattr(shutdown, "_LOOK_S", 0.1)


@pytest.fixture
async def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Place]:
    address = local_address(str(tmp_path))
    async with watched(monkeypatch) as sessions, connect_world(SETTINGS, listen=address) as world:
        Handle.made = []
        warm = Place(address, world, Leaks(sessions))
        await warm.program()  # Zenoh keeps some of what its first sessions make
        yield Place(address, world, Leaks(sessions))


async def test_some_places(place: Place) -> None:
    """Of a program, of the task that runs its side, and of a side without its block, which is cancelled itself."""
    for number in range(0, FIRST, 3):
        assert await place.cancelled(number, (PROGRAM, SIDE)[number % 2])
        if number < 12:
            hit, task = await cancelled_at(number, side_program(place.address), PROGRAM)
            await place.leaks.require_none()
            assert hit
            assert task.cancelled()


@pytest.mark.parametrize(
    ("realtime", "step"),
    [
        (False, 16),
        pytest.param(False, 3, marks=pytest.mark.soak),
        pytest.param(True, 12, marks=pytest.mark.slow),
        pytest.param(True, 3, marks=pytest.mark.soak),
    ],
)
async def test_a_recording_is_whole_and_a_servos_process_is_gone(
    place: Place, realtime: bool, step: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Wherever a program is cancelled that has either; the last force is zero in the other process too."""
    file, force = tmp_path / "run.mcap", tmp_path / "force"
    monkeypatch.setenv(Noting.FILE, str(force))
    place.more = {"device": "tests.support.cancelling:Noting", "record": file, "realtime": realtime}
    number, hit = 0, True
    while hit:
        hit = await place.cancelled(number, PROGRAM)
        if force.exists():
            assert float(force.read_text("ascii")) == 0.0
            force.unlink()
        if place.felt or file.exists():
            recording = read_recording(file)
            assert not recording.torn
            assert recording.summary is not None
            file.unlink()
        number += step
    assert number > 2 * step


@pytest.mark.parametrize(("victim", "step"), mostly_slow([(PROGRAM, 4), (SIDE, 4), (PROGRAM, 1), (SIDE, 1)], 0, 2))
async def test_every_place(place: Place, victim: str, step: int) -> None:
    """Or every fourth, among the slow tests."""
    number = 0
    while await place.cancelled(number, victim):
        number += step
    assert number > FIRST


@pytest.mark.parametrize("step", mostly_slow([3, 1], 0, 1))
async def test_every_place_of_a_world_whose_device_stays(
    step: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The world is cancelled; the device, which renders a force, waits for the next one."""
    address = local_address(str(tmp_path))
    settings = {**SETTINGS, "device.silence_after_s": 0.05}
    async with watched(monkeypatch) as sessions:

        async def program() -> None:
            async with connect_world(settings, connect=address) as world:
                await world.wait_paired()
                await anext(world.samples())

        async with connect_device(settings, device=Handle, listen=address):
            await program()
            kept, number, hit = Handle.made, 0, True
            while hit:
                leaks = Leaks(sessions)
                hit, _ = await cancelled_at(number, program, PROGRAM)
                await leaks.require_none()
                number += step
        assert number > 10
        assert kept[0].forces[-1] == (0.0,)


async def test_a_second_cancellation_only_hurries(place: Place) -> None:
    """Cancelled again and again on its way out, the program is out when nothing is left, and not before."""
    paired = asyncio.Event()

    async def program() -> None:
        async with connect_device(SETTINGS, device=Handle, connect=place.address) as device:
            await device.wait_paired()
            paired.set()
            await asyncio.Event().wait()

    async with asyncio.timeout(WAIT_S):
        task = asyncio.create_task(program())
        await paired.wait()
        while not task.done():
            task.cancel()
            await asyncio.sleep(0.001)
        assert task.cancelled()
        await place.leaks.require_none()


async def test_a_cancellation_on_the_way_out_does_not_stop_it_half_way(place: Place) -> None:
    """The world is notified, as by any program that leaves."""
    leaving = asyncio.Event()

    async def program() -> None:
        async with connect_device(SETTINGS, device=Handle, connect=place.address) as device:
            await device.wait_paired()
            await heard("peer changed", 1)  # the world pairs by itself, a little sooner or later
            leaving.set()

    async def heard(kind: EventKind, times: int) -> None:
        async for event in place.world.events():
            times -= event.kind == kind
            if not times:
                break

    async with asyncio.timeout(WAIT_S):
        task = asyncio.create_task(program())
        await leaving.wait()
        task.cancel()
        await asyncio.wait((task,))
        assert task.cancelled()
        await place.leaks.require_none()
        await heard("peer left", 2)  # the first was the one before all tests


def side_program(address: str) -> Callable[[], Coroutine[Any, Any, Any]]:
    """A side without its block."""
    setup = prepare(Params().set({**SETTINGS, "hardware": "tests.support.cancelling:Handle"}))

    async def program() -> None:
        await RealtimeSide(setup, "device", ZenohSettings(connect=(address,))).run(asyncio.Event(), 0.1)

    return program


@pytest.mark.parametrize("step", mostly_slow([3, 1], 0, 1))
async def test_every_place_of_a_side_without_its_block(place: Place, step: int) -> None:
    program, number, hit = side_program(place.address), 0, True
    while hit:
        hit, task = await cancelled_at(number, program, PROGRAM)
        await place.leaks.require_none()
        number += step
    assert task.result() is None
    assert number > 12


def test_the_loops_own_end(tmp_path: Path) -> None:
    """`asyncio.run` cancels what is left when the main coroutine returns."""
    Handle.made = []
    address = local_address(str(tmp_path))

    async def use() -> None:
        async with connect_device(SETTINGS, device=Handle, listen=address):
            await asyncio.Event().wait()

    async def main() -> asyncio.Task[Any]:
        task = asyncio.create_task(use())
        while not Handle.made or not Handle.made[0].forces:
            await asyncio.sleep(0.001)
        return task

    task = asyncio.run(main())
    assert task.cancelled()
    assert Handle.made[0].closed
    assert Handle.made[0].forces[-1] == (0.0,)
