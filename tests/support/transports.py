"""Both sides' Zenoh transports in one process: what the tests of connections share."""

import asyncio
import contextlib
import json
from collections.abc import AsyncIterator
from pathlib import Path

from hapnet.transport.config import ZenohSettings, zenoh_config
from hapnet.transport.security import Security
from hapnet.transport.zenoh import KINDS, ZenohTransport
from hapnet.wire.messages import Role

WAIT_S = 30.0


class Side:
    """A transport, and the messages it got, in asyncio's hands."""

    def __init__(self, role: Role, settings: ZenohSettings, **names: str) -> None:
        self.loop = asyncio.get_running_loop()
        self.received: asyncio.Queue[tuple[str, bytes]] = asyncio.Queue()
        self.changed = asyncio.Event()
        self.transport = ZenohTransport(settings, self._on_message, role=role, on_change=self.changed.set, **names)

    def _on_message(self, kind: str, data: bytes, now_ns: int) -> None:
        self.loop.call_soon_threadsafe(self.received.put_nowait, (kind, data))

    async def until_partners(self, count: int) -> None:
        while self.transport.partners != count:
            self.changed.clear()
            await asyncio.wait_for(self.changed.wait(), WAIT_S)


@contextlib.asynccontextmanager
async def opened(*sides: Side) -> AsyncIterator[None]:
    try:
        for side in sides:
            await asyncio.wait_for(side.transport.open(), WAIT_S)
        yield
    finally:
        for side in reversed(sides):
            assert await side.transport.close()


async def paired(*sides: Side) -> None:
    for side in sides:
        while not side.transport.partners:
            side.changed.clear()
            await asyncio.wait_for(side.changed.wait(), WAIT_S)


async def assert_exchange(a: Side, b: Side) -> None:
    for sender, receiver in ((a, b), (b, a)):
        expected = [(kind, f"{kind} from the {sender.transport.role}".encode()) for kind in KINDS]
        for kind, data in expected:
            assert sender.transport.put(kind, data)
        got = sorted([await asyncio.wait_for(receiver.received.get(), WAIT_S) for _ in KINDS])
        assert got == sorted(expected)  # each kind has a priority of its own, so one may overtake another
        assert receiver.received.empty()
        assert sender.received.empty()


def value(settings: ZenohSettings, key: str) -> object:
    """What Zenoh's configuration for these settings has under that key."""
    return json.loads(zenoh_config(settings).get_json(key))


def own(certificates: Path, name: str, *, ca: str = ".", mutual: bool = False) -> Security:
    """What a side of that name shows and trusts, of the files that the fixture `certificates` made."""
    files = (certificates / ca / "ca.pem", certificates / f"{name}.pem", certificates / f"{name}.key")
    return Security(*files, mutual_tls=mutual)
