"""One side in real time: it runs its part, survives what its peer does, and ends in order."""

from __future__ import annotations

import asyncio
import logging
import shutil
import socket
import threading
import time
from pathlib import Path
from typing import Any

import msgpack
import pytest
import zenoh
from hypothesis import given, settings, strategies as st

from hapnet import cli
from hapnet.assembly.build import prepare
from hapnet.errors import HapnetError, RecordingError
from hapnet.params import Params
from hapnet.realtime import runner
from hapnet.realtime.controllers import ThreadedDevice, ThreadedWorld
from hapnet.realtime.runner import RealtimeSide
from hapnet.recording.mcap import read_recording
from hapnet.side.notices import Notice
from hapnet.simulation.simulation import Simulation
from hapnet.transport.config import ZenohSettings, free_address
from hapnet.transport.zenoh import ZenohTransport
from hapnet.wire.messages import VERSION, Role
from netem import Link
from tests.support.pairs import WAIT_S, Running, idle, parameters, running


@pytest.mark.parametrize(("role", "way"), [("device", "up"), ("world", "down")])
def test_a_sides_link_is_that_of_its_seed(role: Role, way: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same draws as in virtual time, where a replay looks for them; other seeds and the other way have others."""
    made: list[Link[Any]] = []

    class Kept(Link[Any]):
        def __init__(self, *given: Any, **named: Any) -> None:
            super().__init__(*given, **named)
            made.append(self)

    monkeypatch.setattr("hapnet.realtime.runner.Link", Kept)
    params = Params().set({"link.up": SEEDED, "link.down": SEEDED})
    RealtimeSide(prepare(params, "sampled"), role, ZenohSettings(connect=("tcp/127.0.0.1:1",)), seed=5)
    [link] = made
    simulated = {seed: Simulation(params, seed) for seed in (5, 6)}
    expected = {(s, name): _releases(getattr(simulated[s], name)) for s in simulated for name in ("up", "down")}
    found = _releases(link)
    assert [key for key, releases in expected.items() if releases == found] == [(5, way)]


SEEDED = "delay 20ms 5ms loss 20%"


def _releases(link: Link[Any]) -> list[tuple[int, int]]:
    for number in range(200):
        link.send(0, number, 100)
    return link.poll(10**12)


IDLE_DEVICE = idle("device")


async def test_two_sides_run_part_and_agree(tmp_path: Path) -> None:
    address, params = free_address(), parameters(operator="sine")
    began_ns = time.time_ns()
    device = Running("device", address, params, record=tmp_path / "device.mcap")
    await device.until(lambda: bool(device.reported("waiting")))
    assert f"dialling {address}" in device.reported("waiting")[0]
    world = Running("world", address, params, record=tmp_path / "world.mcap")
    async with running(device, world):
        await device.until(
            lambda: device.side.control.origin_ns is not None and device.side.wire.session.sent_nJ > 1_000_000
        )
        await world.until(lambda: world.count >= 10)
        of_world, of_device = await asyncio.gather(world.end(), device.end())
    [at_device], [at_world] = device.reported("paired"), world.reported("paired")
    assert at_device.startswith("paired with the world, encrypted, key ")
    assert at_device.endswith("; the world must show the same: its identity is not proved")
    assert at_device.replace("the world", "the device") == at_world  # the key too
    up, down = of_device["device"], of_world["world"]
    for summary in (up, down):
        assert summary["ledger"]["margin_J"] > 0.0
        assert summary["ledger"]["slack_J"] >= -1e-9
        assert summary["reservoir_min_J"] >= 0.0
        assert set(summary["dropped"]) <= {"stale", "closed", "unpaired", "retired"}
    assert up["sent_nJ"] > 0
    assert up["sent_nJ"] == down["credited_nJ"] + up["in_flight_nJ"] + up["abandoned_nJ"]
    assert down["sent_nJ"] == up["credited_nJ"] + down["in_flight_nJ"] + down["abandoned_nJ"]
    assert of_device["links"]["up"]["lost"] > 0
    assert 3.0 <= of_device["links"]["up"]["delay_p50_ms"] <= 7.0
    assert (of_device["links"]["down"], of_world["links"]["up"]) == (None, None)
    for role in ("device", "world"):
        recording = read_recording(tmp_path / f"{role}.mcap")
        assert not recording.torn
        assert recording.meta["role"] == role
        assert recording.meta["utc_clock"] == "system"
        assert began_ns < recording.meta["utc_origin_ns"] < time.time_ns()
        assert recording.summary is not None


async def test_duration_counts_from_pairing() -> None:
    """The device waits for longer than it is to run, and runs for so long all the same; the world's clock bounds it."""
    address, params = free_address(), parameters(duration_s=0.3)
    began = time.monotonic()
    device = Running("device", address, params)
    await device.until(lambda: bool(device.reported("waiting")) and time.monotonic() > began + 0.35)
    waited = time.monotonic()
    world = Running("world", address, params)
    summaries = await asyncio.wait_for(asyncio.gather(device.task, world.task), WAIT_S)
    most = time.monotonic() - waited
    for summary in summaries:
        assert 0.3 <= summary["duration_s"] <= most
    assert summaries[0]["wall_clock"]["elapsed_s"] >= summaries[0]["duration_s"] + 0.35


@settings(max_examples=200, deadline=None)
@given(sent=st.integers(0, 10**12), due=st.integers(0, 2 * 10**12))
def test_the_loop_looks_after_the_protocol_between_two_ticks(sent: int, due: int) -> None:
    """At two fifths of a period after a tick's message or whole periods later, never early, less than a period late."""
    link_driver = IDLE_DEVICE._link_driver
    link_driver._sent_ns, link_driver._asked_ns, period = sent, None, 1_000_000
    granted = link_driver._calm_ns(due)
    assert (granted - sent) % period == 400_000
    assert granted >= sent + 400_000
    assert due <= granted
    assert granted < max(due, sent + 400_000) + period
    link_driver._sent_ns = sent + 12_345
    assert link_driver._calm_ns(due) == granted  # it stays, or each tick would set the timer anew


def test_the_worlds_loop_does_not_wait() -> None:
    link_driver = idle("world")._link_driver
    link_driver._sent_ns = 5
    assert (link_driver._calm_ns(7), link_driver._calm_ns(None)) == (7, None)


async def test_garbage_from_the_network_is_counted_and_the_servo_goes_on() -> None:
    address, params = free_address(), parameters(link__up="", link__down="")
    world, device = Running("world", address, params), Running("device", address, params)
    config = zenoh.Config.from_json5(
        f'{{mode: "client", connect: {{endpoints: ["{address}"]}}, scouting: {{multicast: {{enabled: false}}}}}}'
    )
    dropped = world.side.wire.session.dropped
    async with running(world, device):
        await world.until(lambda: world.side.control.origin_ns is not None)
        stranger = await asyncio.to_thread(zenoh.open, config)
        try:
            before = world.count
            frames = [b"", b"garbage", b"\xff" * 5000, msgpack.packb([VERSION, 99, 5])]
            frames += [msgpack.packb([VERSION, 1, 5, 0, 0, [x], 0, 0]) for x in ("x", float("nan"))]
            frames += [msgpack.packb([VERSION, 1, 5, 10**6, 0, [0.5], 0, 0])]
            frames += [msgpack.packb([VERSION, 2, 5, 6, total_nJ, 0]) for total_nJ in (-1, 10**12)]

            def shower() -> bool:
                for frame in frames:
                    for kind in ("position", "energy", "control"):
                        stranger.put(f"hapnet/default/device/up/{kind}", frame)
                return {"size", "malformed", "kind", "type", "range", "rival"} <= set(dropped)

            await world.until(shower)
            seen = world.count
            await world.until(lambda: world.count > seen + 5)
            ticks = device.count
            await device.until(lambda: device.count > ticks + 100)
        finally:
            await asyncio.to_thread(stranger.close)
        summary = (await asyncio.gather(world.end(), device.end()))[0]
    assert before <= seen
    assert world.side._transport.callback_errors == 0
    assert summary["world"]["dropped"]["malformed"] >= 3
    assert summary["world"]["incarnations"] == 1
    assert summary["world"]["ledger"]["slack_J"] >= -1e-9


async def test_of_sides_that_do_not_fit_the_device_ends_with_the_reason_and_the_world_waits_on() -> None:
    address = free_address()
    world = Running("world", address, parameters(scene="free", dof=2))
    device = Running("device", address, parameters(scene="free", dof=1, operator="rest"))
    async with running(world, device):
        with pytest.raises(HapnetError, match=r"(was refused|refuses this side): .*degrees of freedom"):
            await asyncio.wait_for(asyncio.shield(device.task), WAIT_S)
        await world.until(lambda: bool(world.reported("refused")))
        assert "degrees of freedom" in world.reported("refused")[0]
        other = Running("device", address, parameters(scene="free", dof=2, operator="rest"))
        async with running(other):
            await world.until(lambda: bool(world.reported("paired")))


async def test_a_world_that_restarts_is_paired_anew() -> None:
    address, params = free_address(), parameters(operator="rest")
    device = Running("device", address, params)
    world = Running("world", address, params)
    async with running(device, world):
        await device.until(lambda: device.side.control.origin_ns is not None)
        await world.end()
        await device.until(lambda: bool(device.reported("left")))
        again = Running("world", address, params)
        async with running(again):
            await device.until(lambda: len(device.reported("paired")) == 2)
            await again.until(lambda: again.count >= 3)
            later, summary = await asyncio.gather(again.end(), device.end())
    assert set(device.reported("left")) == {"the world left: the run is over"}  # perhaps the second one's too: both end
    assert device.reported("paired")[1].startswith("paired with the world (another process; pair 2), ")
    assert summary["device"]["incarnations"] == 2
    assert summary["device"]["ledger"]["slack_J"] >= -1e-9
    assert later["world"]["ledger"]["bound_J"] == 0.0  # a restarted side starts with an empty reservoir
    assert later["world"]["credited_nJ"] >= 20_000_000  # and is given half of the other's, which was nearly full
    assert summary["device"]["sent_nJ"] >= later["world"]["credited_nJ"]
    assert later["world"]["ledger"]["margin_J"] >= -1e-9


@pytest.mark.parametrize("once", [False, True])
async def test_a_world_whose_device_leaves_says_that_it_waits_or_ends_with_it(once: bool) -> None:
    address, params = free_address(), parameters()
    world, device = Running("world", address, params, once=once), Running("device", address, params)
    async with running(world, device):
        await world.until(lambda: world.side.control.origin_ns is not None)
        await device.end()
        if once:
            await asyncio.wait_for(asyncio.shield(world.task), WAIT_S)
            assert world.reported("once") == ["this side ends, as its first device has left (--once)"]
        else:
            waits = "waits for another device until it is stopped (--once would end it now)"
            await world.until(lambda: waits in world.reported("waiting"))


async def test_a_device_whose_place_was_taken_while_it_was_cut_off_ends_with_the_reason() -> None:
    address = free_address()
    world = Running("world", address, parameters(operator="sine", world__silence_after_s=0.2))
    lines = {"link.up_timeline": "at 50ms: down; at 1s: up"}
    cut_off = Running("device", address, parameters(operator="sine", **lines))
    async with running(world, cut_off):
        await world.until(lambda: bool(world.reported("paired")))
        other = Running("device", address, parameters(operator="sine"))
        async with running(other):
            await world.until(lambda: len(world.reported("paired")) == 2)
            with pytest.raises(HapnetError, match="the world refuses this side: replaced by device"):
                await asyncio.wait_for(asyncio.shield(cut_off.task), WAIT_S)
            await other.until(lambda: other.count > 100)
            assert world.reported("heard")


async def test_a_stop_while_waiting_leaves_no_file(tmp_path: Path) -> None:
    side = Running("device", free_address(), parameters(), record=tmp_path / "x.mcap")
    await side.until(lambda: bool(side.reported("waiting")))
    summary = await side.end()
    assert summary["duration_s"] is None
    assert summary["device"]["ledger"]["margin_J"] is None
    assert not list(tmp_path.iterdir())


def test_a_recording_that_cannot_be_written_is_refused_at_once() -> None:
    with pytest.raises(RecordingError, match=r"/proc/no\.mcap"):
        RealtimeSide(
            prepare(parameters(), "sampled"),
            "world",
            ZenohSettings(listen=("tcp/127.0.0.1:1",)),
            record=Path("/proc/no.mcap"),
        )


async def test_a_failing_control_thread_ends_the_side_with_its_error(monkeypatch: pytest.MonkeyPatch) -> None:
    address, params = free_address(), parameters()
    world, device = Running("world", address, params), Running("device", address, params)

    def broken(now_ns: int) -> bytes | None:
        raise ArithmeticError("a step failed")

    async with running(world, device):
        control = world.side.control
        assert isinstance(control, ThreadedWorld)
        await world.until(lambda: control.origin_ns is not None)
        monkeypatch.setattr(control.side, "step", broken)
        with pytest.raises(ArithmeticError, match="a step failed"):
            await asyncio.wait_for(asyncio.shield(world.task), WAIT_S)


async def test_nothing_is_said_from_a_control_thread(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not of an overrun, of dropped messages, of a recording that fails, nor through Python's logging."""
    address, params = free_address(), parameters()
    device = Running("device", address, params, record=tmp_path / "d" / "x.mcap")
    control = device.side.control
    world = Running("world", address, params)
    assert isinstance(control, ThreadedDevice)
    threads: dict[str, set[str]] = {}
    reporter = device.side._reporter  # private, as all that is said goes through it
    handle, tick, notify = logging.Logger.handle, control.side.tick, reporter._notify

    def handled(logger: logging.Logger, record: logging.LogRecord) -> None:
        threads.setdefault("logging", set()).add(threading.current_thread().name)
        handle(logger, record)

    def report(notice: Notice) -> None:
        threads.setdefault(notice.kind, set()).add(threading.current_thread().name)
        notify(notice)

    def late(now_ns: int) -> bytes | None:
        if control.side.ticks == 100:
            time.sleep(0.05)
        return tick(now_ns)

    monkeypatch.setattr(logging.Logger, "handle", handled)
    monkeypatch.setattr(reporter, "_notify", report)
    monkeypatch.setattr(control.side, "tick", late)
    async with running(world, device):
        await device.until(lambda: (tmp_path / "d" / "x.mcap").exists())
        shutil.rmtree(tmp_path / "d")
        await asyncio.to_thread(device.side._on_message, None, "control", b"garbage", time.monotonic_ns())
        await asyncio.to_thread(device.side._warn, "something went wrong")
        await device.until(lambda: {"overrun", "dropped", "recording", "paired", "transport"} <= set(threads))
        await asyncio.gather(device.end(), world.end())
    assert {name for names in threads.values() for name in names} == {threading.main_thread().name}


async def test_a_hurried_side_does_not_wait_for_what_is_in_flight(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing goes out any more, so that nothing can be acknowledged: without hurry an hour would pass."""
    monkeypatch.setattr(runner, "LINGER_S", 3600.0)
    address, params = free_address(), parameters(operator="sine")
    device, world = Running("device", address, params), Running("world", address, params)
    async with running(device, world):
        await device.until(lambda: device.side.wire.session.credited_nJ > 0)
        device.side._link_driver._put = lambda kind, data: True
        await device.until(lambda: not device.side.wire.session.settled)
        device.stop.set()
        device.side.leave_at_once()
        await asyncio.wait_for(device.task, WAIT_S)
        world.side.leave_at_once()


async def test_a_side_that_fails_says_goodbye() -> None:
    address, params = free_address(), parameters()
    world, device = Running("world", address, params), Running("device", address, params)
    async with running(world, device):
        await world.until(lambda: world.side.control.origin_ns is not None)
        device.side._fail(HapnetError("it broke"))
        with pytest.raises(HapnetError, match="it broke"):
            await asyncio.wait_for(asyncio.shield(device.task), WAIT_S)
        await world.until(lambda: bool(world.reported("left")))
        assert world.reported("left") == ["the device left: it failed"]


async def test_an_address_in_use_is_one_error() -> None:
    address = free_address()
    host, port = address.removeprefix("tcp/").split(":")
    with socket.socket() as taken:
        taken.bind((host, int(port)))
        taken.listen()
        world = Running("world", address, parameters())
        with pytest.raises(HapnetError, match="cannot open Zenoh"):
            await asyncio.wait_for(world.task, WAIT_S)


# A peer of another version, seen from the command


class OldPeer:
    """A world of the next protocol version on a thread of its own, which says hello until it is told to stop."""

    def __init__(self, address: str) -> None:
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._main(address)))

    def __enter__(self) -> OldPeer:
        self._thread.start()
        return self

    def __exit__(self, *exc: object) -> None:
        self._stopping.set()
        self._thread.join()

    async def _main(self, address: str) -> None:
        transport = ZenohTransport(ZenohSettings(listen=(address,)), lambda kind, data, now_ns: None, role="world")
        hello = msgpack.packb([VERSION + 1, 3, 77, 1, "world", 1, "of tomorrow", {}, "more"])
        await transport.open()
        while not self._stopping.is_set():
            transport.put("control", hello)
            await asyncio.sleep(0.02)
        await transport.close()


def test_a_peer_of_another_version_is_one_line_and_exit_code_2(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    address, record = free_address(), tmp_path / "device.mcap"
    with OldPeer(address):
        assert cli.main(["device", "-e", address, "--record", str(record)]) == 2
    err = capsys.readouterr().err
    reported = f"peer speaks protocol {VERSION + 1}, this side speaks {VERSION}"
    assert err == f"hapnet: a world was refused: {reported}\n"
    assert not record.exists()
