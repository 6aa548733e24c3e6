"""What the Inverse3's driver costs beside bare clients: `python -m tests.support.inverse3_round_trips`. All take turns.

A tick: the driver's `read` and `apply` as a servo calls them, once a millisecond; the answer has come by then. A round
trip: from a command to its state in hand, by the driver's own client, by the synchronous client of `websockets`, and
by a bare TCP socket that is answered with as many bytes.
"""

from __future__ import annotations

import contextlib
import json
import socket
import subprocess
import sys
import time
from collections.abc import Callable

import numpy as np
from websockets.sync.client import connect

from hapnet.devices import inverse3_messages as wire
from hapnet.devices.inverse3 import Inverse3
from hapnet.devices.websocket import Caller
from hapnet.errors import DeviceSilent
from hapnet.realtime.servo import set_timer_slack, tuned_interpreter
from tests.support.processes import Program

TURNS = 3000
COMMAND = wire.command("049D", (0.1, 0.2, 0.3))
ECHO = """
import socket
server = socket.create_server(("127.0.0.1", 0))
print(server.getsockname()[1], flush=True)
connection, _ = server.accept()
connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
while connection.recv(65536):
    connection.sendall(b"x" * 1000 + b"\\n")
"""


class Service(Program):
    def __init__(self) -> None:
        super().__init__("emulate", "inverse3:port=0,events=0", "--operator", "rest")
        self.until_line("emulates inverse3")
        said = next(line for line in self.out + self.err if "emulates" in line)
        self.address, events = said.split("inverse3:")[-1].strip().split(",events=")
        self.events = int(events)


def drive(service: Service) -> Callable[[], None]:
    driver = Inverse3(3, address=service.address, events=service.events)

    def tick() -> None:
        with contextlib.suppress(DeviceSilent):
            driver.read()
        with contextlib.suppress(DeviceSilent):
            driver.apply((0.0, 0.0, 0.0))

    return tick


def call(service: Service) -> Callable[[], None]:
    host, port = service.address.split(":")
    caller = Caller(host, int(port))

    def wait() -> None:
        while not any(wire.parsed(raw) for raw in caller.receive(1.0)):
            pass

    def round_trip() -> None:
        caller.send(COMMAND)
        wait()

    wait()  # for the inventory
    return round_trip


def bare_websocket(service: Service) -> Callable[[], None]:
    client = connect(f"ws://{service.address}", compression=None)
    client.recv()

    def round_trip() -> None:
        client.send(COMMAND.decode())
        json.loads(client.recv())

    return round_trip


def bare_socket(port: int) -> Callable[[], None]:
    connection = socket.create_connection(("127.0.0.1", port))
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def round_trip() -> None:
        connection.sendall(COMMAND)
        came = b""
        while not came.endswith(b"\n"):
            came += connection.recv(65536)

    return round_trip


def main() -> None:
    set_timer_slack()
    services = [Service() for _ in range(3)]
    echo = subprocess.Popen([sys.executable, "-c", ECHO], stdout=subprocess.PIPE, text=True)
    assert echo.stdout is not None
    try:
        taking_turns = {
            "a tick of the driver": drive(services[0]),
            "round trip, its client": call(services[1]),
            "round trip, websockets": bare_websocket(services[2]),
            "round trip, TCP": bare_socket(int(echo.stdout.readline())),
        }
        took: dict[str, list[float]] = {name: [] for name in taking_turns}
        with tuned_interpreter() as collect:
            for _ in range(TURNS):
                for name, act in taking_turns.items():
                    time.sleep(0.00025)
                    before_ns = time.perf_counter_ns()
                    act()
                    took[name].append((time.perf_counter_ns() - before_ns) * 1e-3)
            cycles = collect()
        for name, values in took.items():
            p50, p99 = np.quantile(values, [0.5, 0.99])
            print(f"{name:24} p50 {p50:6.0f} us, p99 {p99:6.0f} us")
        print(f"objects in cycles that garbage collection found: {cycles}")
    finally:
        echo.kill()
        echo.wait()
        for service in services:
            service.kill()


if __name__ == "__main__":
    main()
