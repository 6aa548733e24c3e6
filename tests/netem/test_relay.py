"""The UDP relay: what goes in comes out on the other side, for many clients, and what does not is counted."""

import asyncio
import json
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import pytest

from netem import LinkProfile, NetemError
from netem.relay import UdpRelay, format_address, parse_address, socket_drops
from netem.timeline import Timeline

NOTHING = LinkProfile()
WAIT_S = 30.0


@contextmanager
def udp_socket(family: int = socket.AF_INET, host: str = "127.0.0.1") -> Iterator[socket.socket]:
    with socket.socket(family, socket.SOCK_DGRAM) as made:
        made.bind((host, 0))
        made.setblocking(False)
        yield made


@contextmanager
def relay_to(server: socket.socket, up: str = "", down: str = "", **options: float) -> Iterator[UdpRelay]:
    listen = "[::1]:0" if server.family == socket.AF_INET6 else "127.0.0.1:0"
    profiles = (LinkProfile.parse(up), LinkProfile.parse(down))
    relay = UdpRelay(listen, format_address(server.getsockname()), *profiles, **options)  # type: ignore[arg-type]
    try:
        yield relay
    finally:
        relay.close()


async def received(at: socket.socket) -> tuple[bytes, tuple[object, ...]]:
    loop = asyncio.get_running_loop()
    return await asyncio.wait_for(loop.sock_recvfrom(at, 65_536), WAIT_S)


@pytest.mark.parametrize("family", [socket.AF_INET, socket.AF_INET6])
async def test_both_ways_for_many_clients(family: socket.AddressFamily) -> None:
    host = "::1" if family == socket.AF_INET6 else "127.0.0.1"
    with udp_socket(family, host) as server, relay_to(server) as relay:
        with udp_socket(family, host) as first, udp_socket(family, host) as second:
            for client, data in ((first, b""), (second, b"two"), (first, bytes(60_000))):
                client.sendto(data, relay.address)
                got, source = await received(server)
                assert got == data
                server.sendto(b"answer to " + data, source)
                assert (await received(client))[0] == b"answer to " + data
        stats = relay.stats
        assert (stats.clients, stats.clients_seen, stats.dropped) == (2, 2, 0)
        assert stats.up.delivered == stats.down.delivered == 3
        relay.close()
        relay.close()
        assert relay.stats.clients == 0


async def test_each_way_has_its_profile() -> None:
    with udp_socket() as server, udp_socket() as client, relay_to(server, "delay 30ms", "loss 100%") as relay:
        sent = time.monotonic()
        client.sendto(b"x", relay.address)
        _, source = await received(server)
        assert time.monotonic() - sent >= 0.030
        server.sendto(b"lost", source)
        server.sendto(b"lost", source)
        client.sendto(b"y", relay.address)
        await received(server)
        assert relay.stats.down.lost == 2


@pytest.mark.parametrize("order", ["", " unordered", " unordered rate 50mbit"])
async def test_what_is_resent_crosses_once(order: str) -> None:
    """Of two hundred, each with 61 tries of which half are lost, everything crosses; in order if asked to."""
    resend = f"delay 1ms loss 50% resend 60 1ms{order}"
    with udp_socket() as server, udp_socket() as client, relay_to(server, resend, "loss 100%") as relay:
        for number in range(200):
            client.sendto(bytes([number]), relay.address)
        got = [(await received(server))[0][0] for _ in range(200)]
        found = relay.stats.up
    assert sorted(got) == list(range(200))
    assert (got == sorted(got)) == (not order)
    assert (found.offered, found.delivered, found.lost, found.in_flight) == (200, 200, 0, 0)
    assert found.resent >= found.recovered > 50


async def test_what_is_duplicated_crosses_twice() -> None:
    with udp_socket() as server, udp_socket() as client, relay_to(server, "duplicate 100%", "loss 100%") as relay:
        for number in range(20):
            client.sendto(bytes([number]), relay.address)
        got = [(await received(server))[0][0] for _ in range(40)]
        found = relay.stats.up
    assert got == [number for number in range(20) for _ in range(2)]
    assert (found.offered, found.delivered, found.duplicated) == (40, 40, 20)


async def test_clients_above_the_limit_are_refused_and_idle_ones_closed() -> None:
    with (
        udp_socket() as server,
        udp_socket() as first,
        udp_socket() as second,
        relay_to(server, max_clients=1, idle_s=0.1) as relay,
    ):
        first.sendto(b"first", relay.address)
        await received(server)
        second.sendto(b"refused", relay.address)
        first.sendto(b"again", relay.address)
        assert (await received(server))[0] == b"again"
        assert (relay.stats.clients, relay.stats.dropped) == (1, 1)
        async with asyncio.timeout(WAIT_S):
            while relay.stats.clients:
                await asyncio.sleep(0.01)
        second.sendto(b"now there is room", relay.address)
        assert (await received(server))[0] == b"now there is room"
        assert relay.stats.clients_seen == 2


async def test_a_target_that_is_not_there_is_counted_and_may_come_back() -> None:
    with udp_socket() as gone:
        address = gone.getsockname()
    relay = UdpRelay("127.0.0.1:0", format_address(address), NOTHING, NOTHING)
    with udp_socket() as client:
        client.sendto(b"nobody", relay.address)
        async with asyncio.timeout(WAIT_S):
            while relay.stats.dropped == 0:
                await asyncio.sleep(0.01)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as server:
            server.bind(address)
            server.setblocking(False)
            client.sendto(b"somebody", relay.address)
            assert (await received(server))[0] == b"somebody"
    relay.close()


async def test_a_timeline_plays_on_the_link() -> None:
    with udp_socket() as server, udp_socket() as client, relay_to(server, "loss 100%") as relay:
        relay.up.play(Timeline.parse("at 0s: down; at 50ms: delay 1ms; at 50ms: up"))
        async with asyncio.timeout(WAIT_S):
            while not relay.up.link.is_up:
                client.sendto(b"lost", relay.address)
                await asyncio.sleep(0.01)
        client.sendto(b"through", relay.address)
        assert (await received(server))[0] == b"through"
        assert relay.stats.up.lost_down > 0


def test_addresses() -> None:
    assert parse_address("to", "127.0.0.1:5000") == ("127.0.0.1", 5000)
    assert parse_address("to", "[::1]:5000") == ("::1", 5000)
    assert parse_address("to", "localhost:0") == ("localhost", 0)
    for text in ("", "5000", "host", "host:", ":5000", "::1:5000", "host:65536", "host:-1", "[]:1", "a b:1"):
        with pytest.raises(NetemError, match=r"^to: "):
            parse_address("to", text)


async def test_bad_addresses_are_refused() -> None:
    with udp_socket() as taken:
        used = format_address(taken.getsockname())
        with pytest.raises(NetemError, match=r"listen: cannot listen on .*in use"):
            UdpRelay(used, "127.0.0.1:9", NOTHING, NOTHING)
    with pytest.raises(NetemError, match="is the address that is listened on; give another"):
        UdpRelay("127.0.0.1:9", "127.0.0.1:9", NOTHING, NOTHING)
    with pytest.raises(NetemError, match="a port from 1"):
        UdpRelay("127.0.0.1:0", "127.0.0.1:0", NOTHING, NOTHING)
    with pytest.raises(NetemError, match=r"cannot resolve 'no\.such\.invalid'"):
        UdpRelay("127.0.0.1:0", "no.such.invalid:9", NOTHING, NOTHING)


def test_the_kernel_counts_what_a_full_buffer_drops() -> None:
    with udp_socket() as receiver, udp_socket() as sender:
        receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 10_000)
        for _ in range(1000):
            sender.sendto(bytes(100), receiver.getsockname())
        kept = 0
        with suppress(BlockingIOError):
            while receiver.recv(100):
                kept += 1
        assert kept < 1000
        assert socket_drops(receiver) == 1000 - kept
    assert socket_drops(receiver) is None


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("irtt") is None, reason="irtt is not installed (Debian: apt-get install irtt)")
def test_irtt_measures_what_was_asked_for(tmp_path: Path) -> None:
    """Uniform jitter of 8 ms has a standard deviation of 8/sqrt(3) = 4.62 ms in each direction."""
    with udp_socket() as one, udp_socket() as other:
        server_port, relay_port = one.getsockname()[1], other.getsockname()[1]
    words = ["--up", "delay 30ms 8ms loss 5%", "--down", "delay 20ms loss 2%"]
    relay_words = ["--listen", f"127.0.0.1:{relay_port}", "--to", f"127.0.0.1:{server_port}", *words]
    server = subprocess.Popen(
        ["irtt", "server", "-i", "1ms", "-b", f"127.0.0.1:{server_port}"], stdout=subprocess.DEVNULL
    )
    relay = subprocess.Popen(
        [sys.executable, "-c", "import netem.cli as c; raise SystemExit(c.main())", "udp", *relay_words],
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        assert "relaying" in relay.stdout.readline()
        out = tmp_path / "irtt.json"
        command = ["irtt", "client", "-Q", "-i", "2ms", "-d", "20s", "-l", "100", "-o", str(out)]
        subprocess.run([*command, f"127.0.0.1:{relay_port}"], check=True, timeout=60, stdout=subprocess.DEVNULL)
    finally:
        for process in (relay, server):
            process.terminate()
            process.communicate(timeout=60)
    found = json.loads(out.read_text())
    trips = [trip for trip in found["round_trips"] if trip["lost"] == "false"]
    up = np.array([trip["delay"]["send"] for trip in trips]) * 1e-6
    down = np.array([trip["delay"]["receive"] for trip in trips]) * 1e-6
    stats = found["stats"]
    up_loss, down_loss = stats["upstream_loss_percent"], stats["downstream_loss_percent"]
    print(f"up {up.mean():.3f} +- {up.std():.3f} ms, {up_loss:.2f} %; ", end="")
    print(f"down {np.median(down):.3f} +- {down.std():.3f} ms, {down_loss:.2f} %")
    assert up.mean() == pytest.approx(30.0, abs=0.6)
    assert up.std() == pytest.approx(8 / 3**0.5, rel=0.05)
    assert np.median(down) == pytest.approx(20.0, abs=0.6)
    sent = len(found["round_trips"])
    for lost, share in ((up_loss, 0.05), (down_loss, 0.02)):
        assert lost / 100 == pytest.approx(share, abs=5 * (share * (1 - share) / sent) ** 0.5)


def test_a_relayed_datagram_is_corrupted_by_one_bit() -> None:
    from netem.models import flip_bit
    from netem.relay import _flip

    data, client = _flip((b"\0" * 10, "client"), lambda payload: flip_bit(payload, 0.5))  # type: ignore[arg-type]
    assert (sum(byte.bit_count() for byte in data), client) == (1, "client")
