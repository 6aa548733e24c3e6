"""A lossy cable: a TUN device in each of two network namespaces, and the link emulator between them, in user space.

``python -m tests.faults.tun PID PID WORDS SEED`` joins the namespaces of two processes until its standard input ends.
What is lost there is lost below TCP, as on a real network; nothing of the kernel's own emulation is needed.
"""

import asyncio
import ctypes
import fcntl
import os
import struct
import sys
import time
from functools import partial

from numpy.random import SeedSequence

from netem import Link, LinkProfile
from netem.aio import AsyncLink

CABLE = "cable"
"""The name of either device, in its own namespace."""

_CLONE_NEWNET = 0x40000000  # linux/sched.h
_TUNSETIFF, _IFF_TUN, _IFF_NO_PI = 0x400454CA, 0x0001, 0x1000  # linux/if_tun.h
_BIGGEST = 65_536


def open_tun(pid: int) -> int:
    """A TUN device in the network namespace of that process, which this one is in from then on."""
    libc = ctypes.CDLL(None, use_errno=True)
    space = os.open(f"/proc/{pid}/ns/net", os.O_RDONLY)
    try:
        if libc.setns(space, _CLONE_NEWNET) != 0:
            raise OSError(ctypes.get_errno(), f"cannot enter the network namespace of {pid}")
    finally:
        os.close(space)
    device = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
    fcntl.ioctl(device, _TUNSETIFF, struct.pack("16sH22x", CABLE.encode(), _IFF_TUN | _IFF_NO_PI))
    return device


def _drop_or_write(device: int, packet: bytes) -> None:
    try:
        os.write(device, packet)
    except OSError:  # the interface is down: a cable that is out
        return


def _forward(device: int, link: AsyncLink[bytes]) -> None:
    now_ns = time.monotonic_ns()
    while True:
        try:
            packet = os.read(device, _BIGGEST)
        except OSError:
            break
        link.link.send(now_ns, packet, len(packet))
    link.release()


async def main(first: int, second: int, words: str, seed: int) -> None:
    """Join the namespaces of two processes by a link in both directions."""
    profile, devices = LinkProfile.parse(words), (open_tun(first), open_tun(second))
    loop = asyncio.get_running_loop()
    for source, sink, stream in zip(devices, reversed(devices), SeedSequence(seed).spawn(2), strict=True):
        link: AsyncLink[bytes] = AsyncLink(Link(profile, stream), partial(_drop_or_write, sink))
        loop.add_reader(source, _forward, source, link)
    print("ready", flush=True)
    await asyncio.to_thread(sys.stdin.read)


if __name__ == "__main__":
    asyncio.run(main(int(sys.argv[1]), int(sys.argv[2]), sys.argv[3], int(sys.argv[4])))
