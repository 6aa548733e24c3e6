"""The TCP relay: every byte arrives once and in order whatever the link loses, and ends are passed on."""

from __future__ import annotations

import asyncio
import hashlib
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress

import pytest

from netem import LinkProfile, NetemError
from netem.relay import format_address
from netem.tcp_relay import WINDOW, TcpRelay
from tests.conftest import mostly_slow

WAIT_S = 60.0
Programs = tuple[asyncio.StreamReader, asyncio.StreamWriter]


class Server:
    """Hands out the target's end of each connection."""

    def __init__(self) -> None:
        self._met: asyncio.Queue[Programs] = asyncio.Queue()
        self._writers: list[asyncio.StreamWriter] = []

    async def __aenter__(self) -> Server:
        self._server = await asyncio.start_server(self._meet, "127.0.0.1", 0)
        self.address = format_address(self._server.sockets[0].getsockname())
        return self

    async def __aexit__(self, *_: object) -> None:
        self._server.close()
        for writer in self._writers:
            await closed(writer)

    def _meet(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._writers.append(writer)
        self._met.put_nowait((reader, writer))

    async def met(self) -> Programs:
        return await self._met.get()


async def closed(writer: asyncio.StreamWriter) -> None:
    writer.close()
    with suppress(ConnectionError):
        await writer.wait_closed()


@asynccontextmanager
async def pair(up: str = "", down: str = "", seed: int = 1) -> AsyncIterator[tuple[Programs, Programs, TcpRelay]]:
    """A client's and a target's end, with a relay between them."""
    profiles = LinkProfile.parse(up), LinkProfile.parse(down)
    async with (
        asyncio.timeout(WAIT_S),
        Server() as server,
        TcpRelay("127.0.0.1:0", server.address, *profiles, seed) as relay,
    ):
        client = await asyncio.open_connection(*relay.address[:2])
        target = await server.met()
        try:
            yield client, target, relay
        finally:
            await closed(client[1])


@pytest.mark.parametrize(
    "words",
    mostly_slow(
        ["", "delay 3ms 2ms", "loss 10%", "delay 2ms 2ms loss 20% 30% reorder 20%", "delay 1ms rate 200mbit loss 3%"], 1
    ),
)
async def test_every_byte_arrives_once_and_in_order(words: str) -> None:
    """Both directions at once; SHA-256 over what was sent is an account of its own."""
    data = {"up": bytes(range(256)) * 1200, "down": bytes(reversed(range(256))) * 800}
    async with pair(words, words) as (client, target, relay):

        async def carried(source: Programs, sink: Programs, sent: bytes) -> None:
            source[1].write(sent)
            source[1].write_eof()
            assert hashlib.sha256(await sink[0].read()).digest() == hashlib.sha256(sent).digest()

        await asyncio.gather(carried(client, target, data["up"]), carried(target, client, data["down"]))
        assert (relay.stats.sent_again > 0) or "loss" not in words


async def test_a_lost_segment_costs_linuxs_least_timer_and_no_byte() -> None:
    """Nothing that was sent later shows a lone segment's loss: with half lost, some of thirty wait for the timer."""
    async with pair("loss 50%", seed=3) as (client, target, relay):
        slowest = 0.0
        for number in range(30):
            began = time.monotonic()
            client[1].write(bytes([number]))
            assert await target[0].readexactly(1) == bytes([number])
            slowest = max(slowest, time.monotonic() - began)
            if slowest >= 0.2:
                break
        assert slowest >= 0.2
        assert relay.stats.up.lost > 0


async def test_one_end_may_close_and_still_hear() -> None:
    async with pair("delay 2ms") as (client, target, _):
        client[1].write(b"question")
        client[1].write_eof()
        assert await target[0].read() == b"question"
        target[1].write(b"answer")
        target[1].write_eof()
        assert await client[0].read() == b"answer"


@pytest.mark.parametrize("who", [0, 1])
async def test_a_reset_reaches_the_other(who: int) -> None:
    async with pair() as (client, target, relay):
        ends = (client, target)
        ends[who][1].transport.abort()
        reader, writer = ends[1 - who]
        with pytest.raises(ConnectionError):
            await keeps_talking(reader, writer)
        while relay.stats.clients:
            await asyncio.sleep(0)


async def test_who_does_not_read_holds_the_other_up() -> None:
    """What the relay keeps of a stream is bounded: a sender of 64 MB waits for a target that reads nothing."""
    async with pair() as (client, target, relay):
        client[1].transport.set_write_buffer_limits(high=1 << 16)
        sender = asyncio.ensure_future(sent_all(client[1], 64 << 20))
        carried = -1
        while carried != relay.stats.up.offered:  # until nothing moves any more
            carried = relay.stats.up.offered
            await asyncio.sleep(0.2)
        assert not sender.done()
        got = 0
        while data := await target[0].read(1 << 20):
            got += len(data)
        await sender
        assert got == 64 << 20 > WINDOW


async def keeps_talking(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Sees the end of the stream at first, then a write that fails."""
    while True:
        writer.write(b"more")
        await writer.drain()
        assert not await reader.read(1)
        await asyncio.sleep(0)  # neither of these lets others run while the buffers have room


async def sent_all(writer: asyncio.StreamWriter, size: int) -> None:
    for _ in range(0, size, 1 << 16):
        writer.write(bytes(1 << 16))
        await writer.drain()
    writer.write_eof()


async def test_an_outage_is_waited_for() -> None:
    async with pair("delay 1ms") as (client, target, relay):
        relay.up.link.down()
        client[1].write(b"held back")
        while not relay.stats.up.lost_down:
            await asyncio.sleep(0)
        relay.up.link.up()
        assert await target[0].readexactly(9) == b"held back"


async def test_a_target_that_is_not_there_resets_and_is_counted() -> None:
    async with Server() as gone:
        address = gone.address
    async with TcpRelay("127.0.0.1:0", address, LinkProfile(), LinkProfile()) as relay:
        reader, writer = await asyncio.open_connection(*relay.address[:2])
        with pytest.raises(ConnectionError):
            await reader.readexactly(1)
        assert relay.stats.unreachable == 1
        await closed(writer)


async def test_clients_above_the_limit_are_refused() -> None:
    async with (
        Server() as server,
        TcpRelay("127.0.0.1:0", server.address, LinkProfile(), LinkProfile(), max_clients=1) as relay,
    ):
        first = await asyncio.open_connection(*relay.address[:2])
        await server.met()
        second = await asyncio.open_connection(*relay.address[:2])
        with pytest.raises(ConnectionError):
            await second[0].readexactly(1)
        assert (relay.stats.clients, relay.stats.refused) == (1, 1)
        await asyncio.gather(closed(first[1]), closed(second[1]))


async def test_what_cannot_be_is_said() -> None:
    plain = LinkProfile()
    with pytest.raises(NetemError, match="is the address that is listened on; give another"):
        TcpRelay("127.0.0.1:5000", "127.0.0.1:5000", plain, plain)
    with pytest.raises(NetemError, match="corrupt"):
        TcpRelay("127.0.0.1:0", "127.0.0.1:5000", LinkProfile.parse("corrupt 1%"), plain)
    async with Server() as server:
        with pytest.raises(NetemError, match="cannot listen on"):
            await TcpRelay(server.address, "127.0.0.1:9", plain, plain).open()
