"""Bytes and packets of a user of a shared world at the network interface, and what the router costs for many users."""

import json
import multiprocessing
import os
import time
from multiprocessing.connection import Connection
from typing import Any

import zenoh

from tests.faults.namespaces import Host, two_hosts
from tests.faults.tun import CABLE
from tests.support.processes import HAPNET, Program

SCENE = "shared:block?mass=0.2&at=60mm,0,0"
DEFAULT: tuple[str, ...] = ()
FAST = (
    "--set", "device.pspm_period_s=0.001", "--set", "world.step_min_s=0.001", "--set", "world.step_max_s=0.001",
)  # fmt: skip
CASES = (
    ("default", "tcp", DEFAULT), ("default", "udp", DEFAULT),
    ("default, deadband 0.1", "tcp", ("--deadband", "0.1")), ("default, deadband 0.1", "udp", ("--deadband", "0.1")),
    ("1 kHz", "tcp", FAST), ("1 kHz", "udp", FAST),
    ("1 kHz, deadband 0.1", "udp", (*FAST, "--deadband", "0.1")),
)  # fmt: skip
UP, DOWN = (200.0, 100), (60.0, 200)
"""Messages a second of a user, and the bytes of each, near what the default sends."""


def main(users: str = "1,8,64", seconds: float = 8.0) -> None:
    """One user presses a block of a world with two seats, on a host of its own; then a router serves many.

    users: their numbers, with commas between them. seconds: of each measurement.
    """
    print("one user, all bytes of the Ethernet frames that the device's interface counts:")
    for name, protocol, flags in CASES:
        up, down = of_a_user(protocol, flags, seconds)
        print(f"  {name:22} {protocol}: up {up[0] / 1e3:6.1f} kB/s in {up[1]:5.0f} packets/s ({up[0] / up[1]:4.0f} B), "
              f"down {down[0] / 1e3:6.1f} kB/s in {down[1]:5.0f} packets/s ({down[0] / down[1]:4.0f} B)")  # fmt: skip
    print(f"a router in a process of its own, all users in another; each sends {UP[0]:.0f} messages/s of {UP[1]} B, "
          f"and gets {DOWN[0]:.0f} of {DOWN[1]} B:")  # fmt: skip
    for count in map(int, users.split(",")):
        routed, cpu_s, took_s, sent = of_a_router(count, seconds)
        print(f"  {count:3} users: {routed / took_s:6.0f} messages/s of {sent / took_s:.0f} sent, {cpu_s / took_s:.1%} "
              f"of a core, {1e6 * cpu_s / max(1, routed):.1f} us a message")  # fmt: skip


Flow = tuple[float, float]
"""Bytes and packets a second."""


def of_a_user(protocol: str, flags: tuple[str, ...], seconds: float) -> tuple[Flow, Flow]:
    """The flows up and down at the device's interface, from one second after pairing on."""
    with two_hosts() as (far, near):
        same = ("--scene", SCENE, "--link", "delay 0ms", "--no-files", "--no-multicast-scouting", *flags)
        address = f"{protocol}/{far.address}:17447"
        world = Program("world", "--seats", "alice,bob", "-l", address, *same, command=(*far.enter, *HAPNET))
        with world:
            world.until_line("alice: waiting for the device")
            device = Program(
                "device", "--name", "alice", "-e", address, "--operator", "press", *same, command=(*near.enter, *HAPNET)
            )
            with device:
                device.until_line("paired with the world")
                time.sleep(1.0)
                before, began = counters(near), time.monotonic()
                time.sleep(seconds)
                after, took_s = counters(near), time.monotonic() - began
    rates = [(b - a) / took_s for a, b in zip(before, after, strict=True)]
    return (rates[0], rates[1]), (rates[2], rates[3])


def counters(host: Host) -> list[int]:
    """Bytes and packets sent, then received, by its interface."""
    (found,) = json.loads(host.ip(f"-s -j link show dev {CABLE}"))
    return [found["stats64"][way][what] for way in ("tx", "rx") for what in ("bytes", "packets")]


def of_a_router(count: int, seconds: float) -> tuple[int, float, float, int]:
    """Messages that arrived, CPU time of the router's process and time of the measurement [s], and messages sent."""
    context = multiprocessing.get_context("spawn")
    address = "tcp/127.0.0.1:17998"
    (here, there), (mine, theirs) = context.Pipe(), context.Pipe()
    router = context.Process(target=_router, args=(address, there))
    users = context.Process(target=_users, args=(address, count, seconds, theirs))
    try:
        router.start()
        here.recv()
        users.start()
        mine.recv()
        before = _cpu_s(router.pid)
        mine.send("go")
        arrived, sent, took_s = mine.recv()
        return arrived, _cpu_s(router.pid) - before, took_s, sent
    finally:
        for end, process in ((mine, users), (here, router)):
            end.send("end")
            process.join()


def _cpu_s(number: int | None) -> float:
    with open(f"/proc/{number}/stat", encoding="ascii") as file:
        words = file.read().rpartition(")")[2].split()
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


def _config(mode: str, **endpoints: str) -> Any:
    config = zenoh.Config()
    config.insert_json5("mode", json.dumps(mode))
    config.insert_json5("scouting/multicast/enabled", "false")
    for key, address in endpoints.items():
        config.insert_json5(f"{key}/endpoints", json.dumps([address]))
    return config


def _router(address: str, pipe: Connection) -> None:
    with zenoh.open(_config("router", listen=address)):
        pipe.send("up")
        pipe.recv()


def _users(address: str, count: int, seconds: float, pipe: Connection) -> None:
    """Both ends of so many pairs, each end a client of the router."""
    arrived, ends = [0], []
    for number in range(count):
        for (hz, size), own, other in ((UP, "up", "down"), (DOWN, "down", "up")):
            session = zenoh.open(_config("client", connect=address))

            def see(_: Any) -> None:
                arrived[0] += 1

            heard = zenoh.handlers.Callback(see, indirect=False)
            session.declare_subscriber(f"hapnet/many/{number}/{other}", heard)
            publisher = session.declare_publisher(
                f"hapnet/many/{number}/{own}", congestion_control=zenoh.CongestionControl.DROP,
                priority=zenoh.Priority.REAL_TIME, express=True, reliability=zenoh.Reliability.BEST_EFFORT,
            )  # fmt: skip
            ends.append((session, publisher, 1.0 / hz, bytes(size)))
    pipe.send("ready")
    pipe.recv()
    time.sleep(1.0)
    arrived[0], sent, began = 0, 0, time.monotonic()
    due = [began + period_s * number / len(ends) for number, (_, _, period_s, _) in enumerate(ends)]
    while (now := time.monotonic()) < began + seconds:
        for number, (_, publisher, period_s, data) in enumerate(ends):
            if due[number] <= now:
                publisher.put(data)
                sent, due[number] = sent + 1, max(due[number] + period_s, now)
        time.sleep(0.0005)
    pipe.send((arrived[0], sent, time.monotonic() - began))
    pipe.recv()
    for session, *_ in ends:
        session.close()
