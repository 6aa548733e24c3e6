"""The Zenoh relay: samples pass with all they carry, tokens too, nothing comes back, and hapnet's two sides meet."""

import asyncio
import json
import socket
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from functools import partial
from types import SimpleNamespace
from typing import Any

import pytest
import zenoh
from numpy.random import SeedSequence

from hapnet.transport.config import ZenohSettings, free_address
from hapnet.transport.zenoh import ZenohTransport
from netem import LinkProfile, NetemError
from netem.zenoh_relay import ZenohRelay, _Direction

WAIT_S = 30.0
NOTHING = LinkProfile()


class Node:
    """A plain Zenoh peer that writes down what it hears."""

    def __init__(self, **endpoints: str) -> None:
        config = zenoh.Config()
        for side in ("listen", "connect"):
            config.insert_json5(f"{side}/endpoints", json.dumps([endpoints[side]] if side in endpoints else []))
        for key in ("scouting/multicast/enabled", "scouting/gossip/enabled"):
            config.insert_json5(key, "false")
        self.session = zenoh.open(config)
        self.heard: asyncio.Queue[zenoh.Sample] = asyncio.Queue()
        self.tokens: asyncio.Queue[tuple[str, zenoh.SampleKind]] = asyncio.Queue()
        loop = asyncio.get_running_loop()

        def hear(sample: zenoh.Sample) -> None:
            loop.call_soon_threadsafe(self.heard.put_nowait, sample)

        def see(sample: zenoh.Sample) -> None:
            loop.call_soon_threadsafe(self.tokens.put_nowait, (str(sample.key_expr), sample.kind))

        direct = zenoh.handlers.Callback
        self.session.declare_subscriber("**", direct(hear, indirect=False), allowed_origin=zenoh.Locality.REMOTE)
        self.session.liveliness().declare_subscriber("**", direct(see, indirect=False), history=True)

    async def hears(self) -> zenoh.Sample:
        return await asyncio.wait_for(self.heard.get(), WAIT_S)

    async def sees(self) -> tuple[str, zenoh.SampleKind]:
        return await asyncio.wait_for(self.tokens.get(), WAIT_S)


@asynccontextmanager
async def network(up: str = "", key: str = "**") -> AsyncIterator[tuple[Node, Node, ZenohRelay]]:
    """Two nodes that only the relay joins; each has seen the other's token come through, and go."""
    here, there = free_address(), free_address()
    relay = ZenohRelay(here, there, LinkProfile.parse(up), NOTHING, key=key)
    await relay.open()
    far, near = Node(listen=there), Node(connect=here)
    try:
        for sender, receiver in ((near, far), (far, near)):
            token = sender.session.liveliness().declare_token("a/ready")
            assert await receiver.sees() == ("a/ready", zenoh.SampleKind.PUT)
            assert await sender.sees() == ("a/ready", zenoh.SampleKind.PUT)
            undeclare: Callable[[], None] = token.undeclare  # zenoh's stub leaves its type out
            undeclare()
            assert await receiver.sees() == ("a/ready", zenoh.SampleKind.DELETE)
            assert await sender.sees() == ("a/ready", zenoh.SampleKind.DELETE)
        yield near, far, relay
    finally:
        assert await relay.close()
        for node in (near, far):
            await asyncio.to_thread(node.session.close)


async def test_what_is_resent_arrives_once_and_in_order() -> None:
    async with network("loss 50% resend 60 1ms") as (near, far, relay):
        for number in range(100):
            near.session.put("a/b", bytes([number]), congestion_control=zenoh.CongestionControl.BLOCK)
        assert [(await far.hears()).payload.to_bytes()[0] for _ in range(100)] == list(range(100))
        near.session.delete("a/b")
        assert (await far.hears()).kind == zenoh.SampleKind.DELETE
        found = relay.stats.up
    assert (found.delivered, found.lost) == (101, 0)
    assert found.resent >= found.recovered > 20


async def test_a_sample_arrives_with_all_it_carries_and_does_not_come_back() -> None:
    async with network() as (near, far, relay):
        stamp = near.session.new_timestamp()
        for sender, receiver in ((near, far), (far, near)):
            for control in (zenoh.CongestionControl.DROP, zenoh.CongestionControl.BLOCK):
                sender.session.put(
                    "a/b",
                    b"payload",
                    encoding="text/plain;one",
                    attachment=b"attached",
                    priority=zenoh.Priority.REAL_TIME,
                    congestion_control=control,
                    express=True,
                    timestamp=stamp,
                )
                got = await receiver.hears()
                assert (str(got.key_expr), got.payload.to_bytes(), got.kind) == (
                    "a/b",
                    b"payload",
                    zenoh.SampleKind.PUT,
                )
                assert (str(got.encoding), got.express) == ("text/plain;one", True)
                assert got.attachment.to_bytes() == b"attached"
                assert (got.priority, got.congestion_control) == (zenoh.Priority.REAL_TIME, control)
                assert str(got.timestamp) == str(stamp)
            sender.session.delete("a/b")
            got = await receiver.hears()
            assert (str(got.key_expr), got.kind) == ("a/b", zenoh.SampleKind.DELETE)
        # one in each direction crossed after everything else, so an echo would have come before it
        assert near.heard.empty()
        assert far.heard.empty()
        stats = relay.stats
        assert (stats.up.offered, stats.down.offered, stats.dropped, stats.tokens) == (3, 3, 0, 0)


async def test_the_link_shapes_and_only_the_key_passes() -> None:
    async with network("delay 30ms", key="a/**") as (near, far, relay):
        loop = asyncio.get_running_loop()
        began = loop.time()
        near.session.put("other", b"stays")
        near.session.put("a/c", b"goes")
        assert str((await far.hears()).key_expr) == "a/c"
        assert loop.time() - began >= 0.030
        assert relay.stats.up.offered == 1


async def test_hapnets_two_sides_find_each_other_through_it() -> None:
    here, there = free_address(), free_address()
    profile = LinkProfile.parse("delay 10ms")
    relay = ZenohRelay(here, there, profile, profile)
    await relay.open()
    loop = asyncio.get_running_loop()
    heard: asyncio.Queue[tuple[str, bytes]] = asyncio.Queue()

    def hear(kind: str, data: bytes, now_ns: int) -> None:
        loop.call_soon_threadsafe(heard.put_nowait, (kind, data))

    world = ZenohTransport(ZenohSettings(listen=(there,)), hear, role="world")
    device = ZenohTransport(ZenohSettings(connect=(here,)), hear, role="device")
    try:
        await world.open()
        await device.open()
        async with asyncio.timeout(WAIT_S):
            while not (world.partners and device.partners):
                await asyncio.sleep(0.01)
        for side in (device, world):
            assert side.put("position", side.role.encode())
            assert await asyncio.wait_for(heard.get(), WAIT_S) == ("position", side.role.encode())
        assert await world.close()
        async with asyncio.timeout(WAIT_S):
            while device.partners:
                await asyncio.sleep(0.01)
    finally:
        await world.close()
        await device.close()
        assert await relay.close()


async def test_bad_endpoints_and_keys_are_refused() -> None:
    free = free_address()
    with pytest.raises(NetemError, match=r"^key: 'a//b'"):
        ZenohRelay(free, free_address(), NOTHING, NOTHING, key="a//b")
    with pytest.raises(NetemError, match="is the endpoint that is listened on; give another"):
        ZenohRelay(free, free, NOTHING, NOTHING)
    with pytest.raises(NetemError, match=r"^listen: 'garbage'"):
        ZenohRelay("garbage", free, NOTHING, NOTHING)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        relay = ZenohRelay(f"tcp/127.0.0.1:{taken.getsockname()[1]}", free, NOTHING, NOTHING)
        with pytest.raises(NetemError, match="in use"):
            await relay.open()
        assert await relay.close()


async def test_what_is_above_the_backlog_or_cannot_be_put_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """The backlog is of what waits for the loop, and of what waits for a network that blocks."""
    monkeypatch.setattr("netem.zenoh_relay.MAX_BACKLOG", 2)
    one: Any = _Direction(asyncio.get_running_loop(), NOTHING, SeedSequence(1))
    put: list[bytes] = []
    blocked: list[Callable[[], None]] = []

    class Session:
        def put(self, key: str, payload: bytes, **options: object) -> None:
            if payload == b"2":
                raise zenoh.ZError("closed")
            put.append(payload)

    async def offer(control: zenoh.CongestionControl, *payloads: bytes) -> None:
        options = dict.fromkeys(("encoding", "priority", "express", "attachment", "timestamp"))
        for each in payloads:
            payload = zenoh.ZBytes(each)
            put = {"kind": zenoh.SampleKind.PUT, "key_expr": "k", "payload": payload, "congestion_control": control}
            one.receive(SimpleNamespace(**options, **put))
        await asyncio.sleep(0)

    one.close()
    one.session = Session()
    one._blocker = SimpleNamespace(submit=lambda job, *args: blocked.append(partial(job, *args)))
    await offer(zenoh.CongestionControl.DROP, b"1", b"2", b"3")
    assert (put, one.dropped) == ([b"1"], 2)
    for payload in (b"4", b"5", b"6"):
        await offer(zenoh.CongestionControl.BLOCK, payload)
    assert (len(blocked), one.dropped) == (2, 3)
    blocked.pop()()
    await offer(zenoh.CongestionControl.BLOCK, b"7")
    assert (put, len(blocked), one.dropped) == ([b"1", b"5"], 2, 3)
