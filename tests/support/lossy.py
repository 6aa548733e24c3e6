"""Both sides of the protocol over Zenoh, with a lossy network of datagrams below it; without servo and world.

They pair, shuffle energy in both directions, and settle. So many of them fit into one process that they can be counted.
"""

import asyncio
import contextlib
import secrets
import socket
import threading
import time
from collections import Counter
from collections.abc import AsyncIterator, Callable
from itertools import pairwise

from hapnet.transport.config import ZenohSettings
from hapnet.transport.keys import KeyWatch
from hapnet.transport.security import ANYBODY, Security
from hapnet.transport.zenoh import KINDS, ZenohTransport
from hapnet.wire.messages import Role
from hapnet.wire.session import Session
from netem import LinkProfile
from netem.relay import UdpRelay

LOSSY = "delay 40ms 10ms loss 5%"

PAIRING_S = 60.0
"""How long the link may take to open, and the two sides to pair; Zenoh says each word of its greeting once."""

_TICK_S = 0.005
_POSITION_EVERY = 2  # ticks


class Arrivals(KeyWatch):
    """A watch that remembers when something came on each key [ns], keep-alives too."""

    def __init__(self) -> None:
        super().__init__(KINDS)
        self.times_ns: dict[str, list[int]] = {kind: [] for kind in KINDS}

    def heard(self, kind: str, now_ns: int) -> None:
        super().heard(kind, now_ns)
        self.times_ns[kind].append(now_ns)


class Talker:
    """One side: it says where it is a hundred times a second, and shuffles energy as long as it is to."""

    def __init__(self, role: Role, settings: ZenohSettings) -> None:
        self.session = Session(role=role, dof=1, name=role, incarnation=secrets.randbits(63) + 1)
        self.transport = ZenohTransport(settings, self._on_message, role=role, stream_hz=100.0)
        self.session.sample(self.transport.sampled)
        self.arrivals = self.transport._watch = Arrivals()
        self.shuffles = True
        self.paired_ns: int | None = None
        self.unreadable: Counter[str] = Counter()
        self.frames: Counter[tuple[str, bytes]] = Counter()
        """How often each frame came."""
        self._lock = threading.Lock()

    async def run(self) -> None:
        """Talk until cancelled; the transport is open."""
        tick = 0
        while True:
            now_ns = time.monotonic_ns()
            tick += 1
            with self._lock:
                if self.session.peer is not None and self.paired_ns is None:
                    self.paired_ns = now_ns
                if self.paired_ns is not None and self.shuffles:
                    self.session.shuffle(2e-6)
                outgoing, _ = self.session.poll(now_ns)
            for message in outgoing:
                self.transport.put(message.kind, message.data)
            if self.paired_ns is not None and tick % _POSITION_EVERY == 0:
                self.transport.put("position", self.session.position(now_ns, [1e-3 * tick]))
            await asyncio.sleep(_TICK_S)

    def longest_gap_s(self, kind: str) -> float:
        """The longest time from pairing to now in which nothing came on that key [s]."""
        assert self.paired_ns is not None
        times = [self.paired_ns, *(t for t in self.arrivals.times_ns[kind] if t > self.paired_ns), time.monotonic_ns()]
        return max(b - a for a, b in pairwise(times)) * 1e-9

    def _on_message(self, kind: str, data: bytes, now_ns: int) -> None:
        with self._lock:
            self.session.receive(now_ns, data)
            if self.session.path.arrival is not None:  # as the two halves of a side do
                self.session.positions.echo(*self.session.path.arrival)
            self.unreadable[kind] += len(data) == 1
            self.frames[kind, data] += 1


class Two:
    """A world that listens and a device that dials it through a relay of datagrams."""

    def __init__(self, protocol: str, relay: Callable[[str, str], UdpRelay], world: Security, device: Security) -> None:
        listen, dial = _free_udp_port(), _free_udp_port()
        self.relay = relay(f"127.0.0.1:{dial}", f"127.0.0.1:{listen}")
        self.world = Talker("world", ZenohSettings(listen=(f"{protocol}/127.0.0.1:{listen}",), security=world))
        self.device = Talker("device", ZenohSettings(connect=(f"{protocol}/127.0.0.1:{dial}",), security=device))
        self.sides = (self.world, self.device)

    async def until(self, condition: Callable[[], bool], limit_s: float = PAIRING_S) -> None:
        async with asyncio.timeout(limit_s):
            while not condition():
                await asyncio.sleep(_TICK_S)

    async def until_paired(self) -> None:
        await self.until(lambda: all(side.paired_ns is not None for side in self.sides))

    async def until_all_heard(self) -> None:
        """Each side has heard each key since it was paired."""
        await self.until(lambda: all(_heard_since_pairing(side, kind) for side in self.sides for kind in KINDS))

    @property
    def unsettled(self) -> list[tuple[int, int]]:
        """What was sent and credited, where that is not the same [nJ]."""
        ways = ((self.world, self.device), (self.device, self.world))
        flows = [(sender.session.sent_nJ, receiver.session.credited_nJ) for sender, receiver in ways]
        return [(sent, credited) for sent, credited in flows if sent != credited]


def lossy_relay(words: str, seed: int) -> Callable[[str, str], UdpRelay]:
    """To be called with where it listens and where it sends to."""
    profile = LinkProfile.parse(words)
    return lambda listen, to: UdpRelay(listen, to, profile, profile, seed)


@contextlib.asynccontextmanager
async def talking(
    protocol: str, relay: Callable[[str, str], UdpRelay], world: Security = ANYBODY, device: Security = ANYBODY
) -> AsyncIterator[Two]:
    """Two sides that talk; gone at the end."""
    two = Two(protocol, relay, world, device)
    tasks: list[asyncio.Task[None]] = []
    try:
        for side in two.sides:
            await side.transport.open()
            tasks.append(asyncio.create_task(side.run()))
        yield two
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*(side.transport.close() for side in two.sides))
        two.relay.close()


def _heard_since_pairing(side: Talker, kind: str) -> bool:
    times = side.arrivals.times_ns[kind]
    return side.paired_ns is not None and bool(times) and times[-1] > side.paired_ns


def _free_udp_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]
