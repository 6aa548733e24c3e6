"""Benchmarks of netem on this machine: lateness against a bare timer, messages per second, and datagrams forwarded."""

from __future__ import annotations

import asyncio
import ctypes
import multiprocessing
import os
import socket
import sys
import time
from contextlib import suppress
from dataclasses import asdict, dataclass
from heapq import heappop, heappush
from multiprocessing.connection import Connection
from statistics import median
from typing import Any

import numpy as np

from netem.aio import TFD_CLOEXEC, TFD_NONBLOCK, AsyncLink
from netem.errors import NetemError
from netem.link import Link
from netem.profile import LinkProfile
from netem.relay import SOCKET_BUFFER, RelayStats, UdpRelay, socket_drops

LATENESS_PROFILE = "delay 40ms limit 10000"
CORE_PROFILE = "delay 40ms 10ms loss gemodel 1% 20% reorder 5% rate 1gbit limit 10000"
RATE = 2000
"""Releases per second in the lateness benchmark."""

_PERIOD_NS = 10**9 // RATE
_CORE_INTERVAL_NS = 20_000  # 40 ms of delay: 2,000 in flight
_CORE_MESSAGES = 500_000
_PACKET = 100
_LINGER_S = 0.5  # how long an end still listens after its last datagram

_libc: Any = ctypes.CDLL(None, use_errno=True) if sys.platform != "win32" else None
_CLOCK_MONOTONIC, _TFD_TIMER_ABSTIME = 1, 1


@dataclass(frozen=True, slots=True)
class Lateness:
    """Time from due to release at 2,000 releases per second [us]: medians of the runs' (p50, p99), for three releasers.

    `link` : `AsyncLink`. `bare` : a timerfd on an otherwise idle asyncio loop. `thread` : a thread that only reads a
    timerfd, the minimum possible on this machine.
    """

    runs: int
    seconds: float
    link: tuple[float, float]
    bare: tuple[float, float]
    thread: tuple[float, float]

    @property
    def ratios(self) -> tuple[float, float]:
        """The link's p50 and p99 over those of the bare timerfd loop."""
        return self.link[0] / self.bare[0], self.link[1] / self.bare[1]

    def as_dict(self) -> dict[str, object]:
        """All fields by name, as in JSON, and the ratios."""
        return asdict(self) | {"ratios": self.ratios}

    def lines(self) -> list[str]:
        """A table."""
        out = [f"lateness at {RATE} releases per second, median of {self.runs} runs of {self.seconds:.1f} s each [us]"]
        out.append(f"  {'':32}{'p50':>8}{'p99':>8}")
        rows = {"link": self.link, "bare timerfd on an asyncio loop": self.bare}
        rows |= {"bare timerfd in a thread": self.thread}
        out += [f"  {name:32}{p50:8.1f}{p99:8.1f}" for name, (p50, p99) in rows.items()]
        return [*out, f"  {'link over bare':32}{self.ratios[0]:8.2f}{self.ratios[1]:8.2f}"]


def lateness(runs: int = 5, seconds: float = 3.0) -> Lateness:
    """Measure in alternate runs of the link, the bare loop and the bare thread, all on the same schedule.

    Raises NetemError: there is no timerfd here.
    """
    late = [[_percentiles(values) for values in run] for run in lateness_runs(runs, seconds)]
    directions = zip(*late, strict=True)
    middle = [(median(p50 for p50, _ in values), median(p99 for _, p99 in values)) for values in directions]
    return Lateness(runs, _count(seconds) / RATE, *middle)


def lateness_runs(runs: int, seconds: float) -> list[tuple[list[int], list[int], list[int]]]:
    """The raw data of `lateness`: in every run, each release's lateness [ns] by link, bare loop and bare thread.

    Raises NetemError: there is no timerfd here.
    """
    if not hasattr(_libc, "timerfd_create"):
        raise NetemError("lateness: there is no timerfd here to compare with")
    count = _count(seconds)
    return [
        (asyncio.run(_link_lateness(count)), asyncio.run(_bare_lateness(count)), _thread_lateness(count))
        for _ in range(runs)
    ]


@dataclass(frozen=True, slots=True)
class CoreThroughput:
    """Messages per second on one core, medians. `link` : sends and polls after each. `heap` : pushes and pops."""

    runs: int
    messages: int
    in_flight: int
    profile: str
    link: float
    heap: float

    def as_dict(self) -> dict[str, object]:
        """All fields by name, as JSON has them."""
        return asdict(self)

    def lines(self) -> list[str]:
        """A table."""
        return [
            f"core, {self.in_flight} in flight, median of {self.runs} runs of {self.messages} messages [1/s]",
            f"  {'link: ' + self.profile}",
            f"  {'':32}{self.link:12,.0f}",
            f"  {'bare heappush and heappop':32}{self.heap:12,.0f}",
        ]


def core(runs: int = 5, messages: int = _CORE_MESSAGES) -> CoreThroughput:
    """Send through a `Link` in virtual time, 2,000 in flight, and alternate with a bare heap of 2,000."""
    link_rates, heap_rates, in_flight = [], [], 0
    for _ in range(runs):
        seconds, in_flight = _time_link(messages)
        link_rates.append(messages / seconds)
        heap_rates.append(messages / _time_heap(messages))
    return CoreThroughput(runs, messages, in_flight, CORE_PROFILE, median(link_rates), median(heap_rates))


@dataclass(frozen=True, slots=True)
class Forwarding:
    """The result of a UDP relay with a steady stream in both directions, as the two ends count `offered` and `arrived`.

    `end_drops` counts datagrams that the ends' own sockets dropped, not the relay.
    """

    rate: int
    seconds: float
    offered: tuple[int, int]
    arrived: tuple[int, int]
    end_drops: int
    relay: RelayStats

    @property
    def missing(self) -> int:
        """Datagrams that did not arrive."""
        return sum(self.offered) - sum(self.arrived)

    def as_dict(self) -> dict[str, object]:
        """All fields by name, as JSON has them."""
        return asdict(self) | {"missing": self.missing}

    def lines(self) -> list[str]:
        """A table."""
        each = [count / self.seconds for count in self.arrived]
        return [
            f"UDP relay, {_PACKET} B in both directions at once for {self.seconds:.1f} s, {self.rate} per second",
            f"  {'sent up, down':32}{self.offered[0]:12}{self.offered[1]:12}",
            f"  {'arrived':32}{self.arrived[0]:12}{self.arrived[1]:12}",
            f"  {'arrived per second':32}{each[0]:12,.0f}{each[1]:12,.0f}",
            f"  {'socket drops, own drops':32}{self.relay.socket_drops!s:>12}{self.relay.dropped:12}",
            f"  {'missing, of it at the ends':32}{self.missing:12}{self.end_drops:12}",
        ]


def udp(rate: int = 20_000, seconds: float = 10.0, text: str = "delay 5ms limit 100000") -> Forwarding:
    """Run a relay between two processes that send each other `rate` datagrams per second."""
    return asyncio.run(_forward(rate, seconds, LinkProfile.parse(text)))


# Lateness


def _count(seconds: float) -> int:
    return max(100, int(seconds * RATE))


async def _link_lateness(count: int) -> list[int]:
    """Each release offers the next message on the schedule, so that messages enter and leave at the same rate."""
    delay_ns = LinkProfile.parse(LATENESS_PROFILE).delay_ns
    late: list[int] = []
    done = asyncio.get_running_loop().create_future()

    def deliver(due_ns: int) -> None:
        late.append(time.monotonic_ns() - due_ns)
        if len(late) < count:
            running.link.send(due_ns, due_ns + delay_ns)
        elif not done.done():
            done.set_result(None)

    running: AsyncLink[int] = AsyncLink(Link(LinkProfile.parse(LATENESS_PROFILE)), deliver)
    start_ns = time.monotonic_ns()
    for number in range(delay_ns // _PERIOD_NS):
        running.link.send(start_ns + number * _PERIOD_NS, start_ns + number * _PERIOD_NS + delay_ns)
    running.release()
    await done
    running.close()
    return late[:count]


async def _bare_lateness(count: int) -> list[int]:
    loop = asyncio.get_running_loop()
    late: list[int] = []
    done = loop.create_future()
    fd = _libc.timerfd_create(_CLOCK_MONOTONIC, TFD_NONBLOCK | TFD_CLOEXEC)
    due_ns = time.monotonic_ns() + 10 * _PERIOD_NS

    def fire() -> None:
        nonlocal due_ns
        os.read(fd, 8)
        late.append(time.monotonic_ns() - due_ns)
        if len(late) == count:
            done.set_result(None)
        else:
            due_ns += _PERIOD_NS
            _arm(fd, due_ns)

    loop.add_reader(fd, fire)
    _arm(fd, due_ns)
    await done
    loop.remove_reader(fd)
    os.close(fd)
    return late


def _thread_lateness(count: int) -> list[int]:
    late: list[int] = []
    fd = _libc.timerfd_create(_CLOCK_MONOTONIC, TFD_CLOEXEC)
    due_ns = time.monotonic_ns() + 10 * _PERIOD_NS
    for _ in range(count):
        _arm(fd, due_ns)
        os.read(fd, 8)
        late.append(time.monotonic_ns() - due_ns)
        due_ns += _PERIOD_NS
    os.close(fd)
    return late


def _arm(fd: int, due_ns: int) -> None:
    # struct itimerspec: no interval, then seconds and nanoseconds
    value = (ctypes.c_long * 4)(0, 0, *divmod(due_ns, 10**9))
    _libc.timerfd_settime(fd, _TFD_TIMER_ABSTIME, value, None)


def _percentiles(late_ns: list[int]) -> tuple[float, float]:
    p50, p99 = (np.percentile(late_ns, (50, 99)) * 1e-3).tolist()
    return p50, p99


# Core


def _time_link(messages: int) -> tuple[float, int]:
    link: Link[int] = Link(LinkProfile.parse(CORE_PROFILE), seed=1)
    send, poll = link.send, link.poll
    fill = 4000  # after these, as many messages leave as are sent
    for now_ns in range(0, fill * _CORE_INTERVAL_NS, _CORE_INTERVAL_NS):
        send(now_ns, now_ns, _PACKET)
        poll(now_ns)
    in_flight = link.stats.in_flight
    start_ns = fill * _CORE_INTERVAL_NS
    began = time.perf_counter()
    for now_ns in range(start_ns, start_ns + messages * _CORE_INTERVAL_NS, _CORE_INTERVAL_NS):
        send(now_ns, now_ns, _PACKET)
        poll(now_ns)
    return time.perf_counter() - began, in_flight


def _time_heap(messages: int) -> float:
    due = np.random.default_rng(1).integers(0, 10**9, messages + 2000).tolist()
    heap: list[tuple[int, int]] = []
    for number in range(2000):
        heappush(heap, (due[number], number))
    began = time.perf_counter()
    for number in range(2000, 2000 + messages):
        heappush(heap, (due[number] + number * 1000, number))
        heappop(heap)
    return time.perf_counter() - began


# UDP


async def _forward(rate: int, seconds: float, profile: LinkProfile) -> Forwarding:
    """Run the relay in this process, and a client and a server that both send and receive in two others."""
    context = multiprocessing.get_context("spawn")
    pipes: list[Any] = [context.Pipe() for _ in range(2)]  # their type is another on Windows
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        server_port: int = probe.getsockname()[1]
    relay = UdpRelay("127.0.0.1:0", f"127.0.0.1:{server_port}", profile, profile)
    ports = (("client", relay.address[1]), ("server", server_port))
    ends = [
        context.Process(target=_end, args=(role, port, rate, seconds, pipe[1]), daemon=True)
        for (role, port), pipe in zip(ports, pipes, strict=True)
    ]
    loop = asyncio.get_running_loop()
    try:
        for end, pipe in zip(reversed(ends), reversed(pipes), strict=True):
            end.start()  # the server first, so that the client's first datagram is not lost
            await loop.run_in_executor(None, _expect, pipe[0], 30.0)
        for pipe in pipes:
            pipe[0].send("go")
        counts = [await loop.run_in_executor(None, _expect, pipe[0], seconds + 30.0) for pipe in pipes]
        stats = relay.stats
    finally:
        relay.close()
    (up, down_arrived, client_drops), (down, up_arrived, server_drops) = counts
    return Forwarding(rate, seconds, (up, down), (up_arrived, down_arrived), client_drops + server_drops, stats)


def _expect(pipe: Connection, seconds: float) -> tuple[int, int, int]:
    if not pipe.poll(seconds):
        raise NetemError("udp: one end of the benchmark did not answer")
    answer: tuple[int, int, int] = pipe.recv()
    return answer


def _end(role: str, port: int, rate: int, seconds: float, pipe: Connection) -> None:
    """Send `rate` datagrams per second, evenly, and count those that arrive; runs in its own process."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as mine:
        for option in (socket.SO_RCVBUF, socket.SO_SNDBUF):
            mine.setsockopt(socket.SOL_SOCKET, option, SOCKET_BUFFER)
        if role == "server":
            mine.bind(("127.0.0.1", port))
            pipe.send((0, 0, 0))
            _, peer = mine.recvfrom(_PACKET)  # the client's first datagram carries its address
            mine.connect(peer)
            mine.send(b"")
        else:
            mine.connect(("127.0.0.1", port))
            mine.send(b"")
            mine.recv(_PACKET)
            pipe.send((0, 0, 0))
        pipe.recv()
        mine.setblocking(False)
        sent, arrived = _exchange(mine, rate, seconds)
        pipe.send((sent, arrived, socket_drops(mine) or 0))


def _exchange(mine: socket.socket, rate: int, seconds: float) -> tuple[int, int]:
    payload, buffer = bytes(_PACKET), bytearray(_PACKET)
    count, sent, arrived = int(rate * seconds), 0, 0
    start = time.perf_counter()
    end = start + seconds + _LINGER_S
    while (now := time.perf_counter()) < end:
        for _ in range(min(count, int((now - start) * rate)) - sent):
            mine.send(payload)
            sent += 1
        with suppress(BlockingIOError):
            while True:
                mine.recv_into(buffer)
                arrived += 1
        time.sleep(0.0002)
    return sent, arrived
