"""TCP's timer: the same round trips give the same time as in Linux, by its TCP_INFO.

`kernel_rto.json` has what Linux 6.18 said of a socket (tcpi_rto after each round trip, [us]) over a cable with a delay,
made of two TUN devices in two network namespaces: a segment of 8 bytes, its echo, the next. The first round trip is
that of the connection. The kernel rounds its time up to a multiple of 4 ms.
"""

import json
import os
import socket
import threading
import time
from pathlib import Path

import pytest

from netem.background import BackgroundRelay
from netem.retransmission import MAX_TIMER_S, RoundTrips

KERNEL: dict[str, list[tuple[int, int]]] = json.loads(Path(__file__).with_name("kernel_rto.json").read_text())


@pytest.mark.parametrize("delay", KERNEL)
def test_the_time_is_that_of_the_kernels_tcp_info(delay: str) -> None:
    trips = RoundTrips()
    for number, (trip_us, rto_us) in enumerate(KERNEL[delay], start=1):
        trips.measure(1e-6 * trip_us, number, number)
        assert trips.timer_s() == pytest.approx(1e-6 * rto_us, rel=0.02)


def test_the_recording_has_the_delays_of_its_names() -> None:
    for name, rows in KERNEL.items():
        assert 1e-3 * sum(trip for trip, _ in rows) / len(rows) == pytest.approx(float(name.split()[0]), rel=0.08)


def test_the_margin_falls_by_a_quarter_of_the_excess_each_round_trip() -> None:
    """By hand: round trips of 1 s. The deviation, 2 s at first, falls by a quarter at each; the margin follows it."""
    trips = RoundTrips()
    trips.measure(1.0, 1, 1)
    assert trips.timer_s() == pytest.approx(3.0)
    trips.measure(1.0, 2, 2)  # the largest deviation of this period is still the first one
    assert trips.timer_s() == pytest.approx(3.0)
    trips.measure(1.0, 3, 3)
    assert trips.timer_s() == pytest.approx(1.0 + 2.0 - (2.0 - 1.125) / 4)
    trips.measure(1.0, 3, 9)  # the same period
    assert trips.timer_s() == pytest.approx(1.0 + 2.0 - (2.0 - 1.125) / 4)


def test_doubling_ends_at_the_kernels_maximum() -> None:
    trips = RoundTrips()
    assert [trips.timer_s(tries) for tries in (1, 2, 3, 99)] == [1.0, 2.0, 4.0, MAX_TIMER_S]


@pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="two programs and a relay at once")
@pytest.mark.long
def test_a_lost_segment_comes_a_round_trip_and_200_ms_late() -> None:
    server = socket.create_server(("127.0.0.1", 0))
    arrived: list[float] = []

    def echo() -> None:
        with server.accept()[0] as far:
            while data := far.recv(64):
                arrived.append(time.monotonic())
                far.sendall(data)

    thread = threading.Thread(target=echo, daemon=True)
    thread.start()
    with (
        server,
        BackgroundRelay(f"127.0.0.1:{server.getsockname()[1]}", "delay 50ms", protocol="tcp") as relay,
        socket.create_connection(relay.address[:2]) as near,
    ):
        near.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        for _ in range(5):
            near.sendall(b"ping")
            assert near.recv(64) == b"ping"
        sent = time.monotonic()
        with relay.faults("at 0s: down"):
            near.sendall(b"lost")
            time.sleep(0.05)
        assert near.recv(64) == b"lost"
        assert relay.stats.sent_again == 1  # type: ignore[union-attr]
    thread.join(5.0)
    # 50 ms of delay, and the timer's 300 ms; the rest is this machine's lateness
    assert 0.348 < arrived[-1] - sent < 0.5
