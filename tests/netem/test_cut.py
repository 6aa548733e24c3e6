"""TCP connections that the relay cuts on demand: what both programs see."""

import contextlib
import socket
import time
from collections.abc import Iterator
from typing import Literal

import pytest

from netem import NetemError, ProfileError, Timeline
from netem.background import BackgroundRelay
from netem.cli import main

Cut = Literal["reset", "end"]


@contextlib.contextmanager
def connected(words: str) -> Iterator[tuple[BackgroundRelay, socket.socket, socket.socket]]:
    """A relay, and both ends of a connection through it that has carried data in both directions."""
    with (
        socket.create_server(("127.0.0.1", 0)) as server,
        BackgroundRelay(f"127.0.0.1:{server.getsockname()[1]}", words, protocol="tcp") as relay,
        socket.create_connection(relay.address[:2]) as near,
        server.accept()[0] as far,
    ):
        for sock in (near, far):
            sock.settimeout(5.0)
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        near.sendall(b"there")
        assert far.recv(64) == b"there"
        far.sendall(b"back")
        assert near.recv(64) == b"back"
        yield relay, near, far


def clients(relay: BackgroundRelay) -> int:
    """The connections that the relay still has, after at most 2 s."""
    for _ in range(100):
        if not (left := int(relay.stats.clients)):
            break
        time.sleep(0.02)
    return left


def cut(relay: BackgroundRelay, how: Cut, by_timeline: bool) -> None:
    if by_timeline:
        with relay.faults(f"at 0s: {how}"):
            return
    relay.cut(how)


@pytest.mark.parametrize("by_timeline", [False, True])
def test_a_reset_reaches_both_programs_at_once(by_timeline: bool) -> None:
    with connected("delay 5ms") as (relay, near, far):
        relay.change("delay 9s", "delay 9s")
        started = time.monotonic()
        cut(relay, "reset", by_timeline)
        for program in (near, far):
            with pytest.raises(ConnectionResetError):
                program.recv(64)
        assert time.monotonic() - started < 4.0  # not after the link's delay
        assert clients(relay) == 0


@pytest.mark.parametrize("by_timeline", [False, True])
def test_an_end_comes_after_what_was_sent(by_timeline: bool) -> None:
    with connected("delay 50ms") as (relay, near, far):
        near.sendall(b"last")
        time.sleep(0.02)  # it is on the link now
        cut(relay, "end", by_timeline)
        assert [far.recv(64), far.recv(64)] == [b"last", b""]
        assert near.recv(64) == b""
        assert clients(relay) == 0


def test_an_end_of_a_connection_whose_client_has_ended_already() -> None:
    with connected("delay 20ms") as (relay, near, far):
        near.shutdown(socket.SHUT_WR)
        assert far.recv(64) == b""
        relay.cut("end")
        assert near.recv(64) == b""
        assert clients(relay) == 0


def test_a_reset_while_the_link_is_down() -> None:
    with connected("delay 5ms") as (relay, near, _), relay.faults("at 0s: down"):
        relay.cut("reset")
        with pytest.raises(ConnectionResetError):
            near.recv(64)
        assert clients(relay) == 0


def test_a_connection_after_the_cut_is_as_before() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"127.0.0.1:{server.getsockname()[1]}"
        with BackgroundRelay(address, "delay 5ms", protocol="tcp") as relay:
            relay.cut("reset")
            with socket.create_connection(relay.address[:2]) as near, server.accept()[0] as far:
                near.sendall(b"there")
                assert far.recv(64) == b"there"


def test_only_tcp_has_connections(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(ProfileError, match="only for TCP connections"):
        Timeline.parse("at 1s: reset")
    timeline = Timeline.parse("at 1s: reset; at 2s: end", connections=True)
    assert Timeline.parse(str(timeline), connections=True) == timeline
    with BackgroundRelay("127.0.0.1:9", "") as relay:
        with pytest.raises(NetemError, match="protocol='tcp'"):
            relay.cut("end")
        with pytest.raises(ProfileError, match="only for TCP connections"), relay.faults(timeline):
            pass
    ports = ["--listen", "127.0.0.1:0", "--to", "127.0.0.1:9", "--timeline", "at 1s: end", "--duration", "0.1"]
    assert main(["udp", *ports]) == 2
    assert "only for TCP connections" in capsys.readouterr().err
    assert main(["tcp", *ports]) == 0
