"""A Zenoh relay: samples published in one network arrive in another through a link, in both directions.

    network A  <->  session that listens  == up link ==>    session that dials  <->  network B
                                          <== down link ==

Relayed through the link: puts and deletes under one key expression, each with its key, payload, encoding, attachment,
timestamp, priority, congestion control and express flag. Liveliness tokens are relayed at once and without loss,
because a token states that something exists. Not relayed: queries and their replies, whether there are subscribers
(`matching`), a publisher's reliability (everything is put as reliable), and the publisher (`source_info`).

The relay makes no loops: each session receives samples from others in its network, but never those that the relay put
there. If two networks have another connection too, for example by a second relay, samples circulate for ever.

Zenoh's threads call back with each sample; they only append it to a queue and wake the loop.
"""

from __future__ import annotations

import asyncio
import json
import re
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import partial
from queue import SimpleQueue
from typing import Any, Literal, NamedTuple

import zenoh
from numpy.random import SeedSequence

from netem.aio import AsyncLink
from netem.errors import NetemError
from netem.link import Link
from netem.profile import LinkProfile
from netem.stats import LinkStats

Mode = Literal["peer", "client"]

MAX_BACKLOG = 65_536
"""Most messages that wait for the loop, or for a blocking network, in each direction; more are dropped and counted."""

CLOSE_TIMEOUT_S = 3.0
"""The longest wait of `close`; under loss Zenoh can take 10 s, and then closes in the background."""

_SETTINGS: dict[str, object] = {
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,
    "connect/timeout_ms": 1000,
    "connect/exit_on_failure": False,  # keeps trying in the background until the other side runs
    "connect/retry": {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 1.5},
    "transport/shared_memory/enabled": False,
    "transport/unicast/open_timeout": 1000,
    "transport/unicast/accept_timeout": 1000,
    "transport/link/tx/lease": 2000,
    "transport/link/tx/queue/size/real_time": 16,  # with 2, express messages are lost when the processor is busy
}


@dataclass(frozen=True, slots=True)
class ZenohRelayStats:
    """A snapshot of a relay.

    `up` and `down` are the links' statistics. `dropped` counts messages that the relay itself could not forward: Zenoh
    refused them, or the backlog was full. `tokens` counts the liveliness tokens that the relay holds now, `nodes` the
    Zenoh nodes that each session is connected to (listening, dialling).
    """

    up: LinkStats
    down: LinkStats
    dropped: int
    tokens: int
    nodes: tuple[int, int]

    def as_dict(self) -> dict[str, object]:
        """All fields by name, as JSON has them."""
        return asdict(self)


class _Message(NamedTuple):
    put: bool
    key: str
    payload: bytes
    options: dict[str, Any]


def _flip(message: _Message, corrupted: Callable[[bytes], bytes]) -> _Message:
    return message._replace(payload=corrupted(message.payload))


class ZenohRelay:
    """Relays between two Zenoh networks; make it and call `open` on a running loop.

    listen, connect : Zenoh endpoints, such as ``tcp/127.0.0.1:17448``: one session listens, the other dials.
    up, down : the profiles from the listening side to the dialling side, and back.
    seed : the seed of both links, whose streams are independent.
    key : the key expression to relay.
    mode : that of the dialling session; ``client`` if it dials a router.

    Raises NetemError: an endpoint or a key expression is malformed, or both endpoints are the same.
    """

    def __init__(
        self,
        listen: str,
        connect: str,
        up: LinkProfile,
        down: LinkProfile,
        seed: int = 0,
        *,
        key: str = "**",
        mode: Mode = "peer",
    ) -> None:
        if listen == connect:
            raise NetemError(f"connect: {connect!r} is the endpoint that is listened on; give another")
        try:
            self._key = zenoh.KeyExpr(key)
        except zenoh.ZError as error:
            allowed = f"a Zenoh key expression ({_reason(error)})"
            raise NetemError(f"key: {key!r} is not allowed; allowed: {allowed}") from None
        self._loop = asyncio.get_running_loop()
        self._configs = (_config("listen", listen, "peer"), _config("connect", connect, mode))
        self._where = (f"listen on {listen}", f"connect to {connect}")
        self._worker = _Worker("zenoh")
        up_seed, down_seed = SeedSequence(seed).spawn(2)
        self._directions = (_Direction(self._loop, up, up_seed), _Direction(self._loop, down, down_seed))
        self._tokens: tuple[dict[str, zenoh.LivelinessToken], ...] = ({}, {})
        self._sessions: list[zenoh.Session] = []

    @property
    def up(self) -> AsyncLink[_Message]:
        """The link from the listening side to the dialling side."""
        return self._directions[0].link

    @property
    def down(self) -> AsyncLink[_Message]:
        """The link from the dialling side to the listening side."""
        return self._directions[1].link

    @property
    def stats(self) -> ZenohRelayStats:
        """A snapshot of the relay's statistics."""
        nodes = [len(session.info.transports()) if not session.is_closed() else 0 for session in self._sessions]
        listening, dialling = nodes or (0, 0)
        return ZenohRelayStats(
            up=self.up.link.stats,
            down=self.down.link.stats,
            dropped=sum(direction.dropped for direction in self._directions),
            tokens=sum(map(len, self._tokens)),
            nodes=(listening, dialling),
        )

    async def open(self) -> None:
        """Open both sessions and relay from now on, even if no other node is connected yet.

        Raises NetemError: a session cannot be opened: the address is in use, or a client finds no router.
        """
        await asyncio.to_thread(self._open)

    async def close(self) -> bool:
        """Stop; messages in flight are not delivered. Returns False if Zenoh takes longer than `CLOSE_TIMEOUT_S`."""
        for direction in self._directions:
            direction.close()
        closed = asyncio.Event()
        self._worker.submit(self._close)
        self._worker.submit(self._loop.call_soon_threadsafe, closed.set)
        self._worker.stop()
        try:
            await asyncio.wait_for(closed.wait(), CLOSE_TIMEOUT_S)
        except TimeoutError:
            return False
        return True

    def _open(self) -> None:
        for config, where in zip(self._configs, self._where, strict=True):
            try:
                self._sessions.append(zenoh.open(config))
            except zenoh.ZError as error:
                self._close()
                raise NetemError(f"zenoh: cannot {where}: {_reason(error)}") from None
        for index, (direction, session) in enumerate(zip(self._directions, self._sessions, strict=True)):
            direction.session = self._sessions[1 - index]
            session.declare_subscriber(self._key, _direct(direction.receive), allowed_origin=zenoh.Locality.REMOTE)
        # tokens after the subscribers: a node that sees a token may publish at once
        for index, session in enumerate(self._sessions):
            session.liveliness().declare_subscriber(self._key, _direct(self._token_receiver(index)), history=True)

    def _close(self) -> None:
        for session in self._sessions:
            _call(session.close)

    def _token_receiver(self, side: int) -> Callable[[zenoh.Sample], None]:
        def receive(sample: zenoh.Sample) -> None:
            self._worker.submit(self._mirror, side, str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT)

        return receive

    def _mirror(self, side: int, key: str, alive: bool) -> None:
        """Hold one network's tokens in the other. Runs on the worker, because Zenoh's callbacks must not declare."""
        own, mirrored = self._tokens[side], self._tokens[1 - side]
        if not alive:
            token = mirrored.pop(key, None)
            if token is not None:
                _call(token.undeclare)
        elif key not in own and key not in mirrored:  # a session also receives the tokens that it holds itself
            mirrored[key] = self._sessions[1 - side].liveliness().declare_token(key)


class _Direction:
    """One direction: from Zenoh's threads to the loop, through the link, and into the other session."""

    def __init__(self, loop: asyncio.AbstractEventLoop, profile: LinkProfile, seed: SeedSequence) -> None:
        self.session: zenoh.Session | None = None
        self.dropped = 0
        self.link: AsyncLink[_Message] = AsyncLink(Link(profile, seed, flip=_flip), self._deliver)
        self._loop = loop
        self._arrived: list[_Message] = []
        self._lock = threading.Lock()
        self._waking = False
        # A put may block if its publisher requested this, so these puts have their own thread.
        self._blocker = _Worker("zenoh-block")
        self._blocked = 0

    def receive(self, sample: zenoh.Sample) -> None:
        """Take a sample; called on one of Zenoh's threads."""
        options = {
            "encoding": sample.encoding,
            "congestion_control": sample.congestion_control,
            "priority": sample.priority,
            "express": sample.express,
            "attachment": sample.attachment,
            "timestamp": sample.timestamp,
        }
        put = sample.kind == zenoh.SampleKind.PUT
        if not put:
            del options["encoding"]
        message = _Message(put, str(sample.key_expr), sample.payload.to_bytes(), options)
        with self._lock:
            if len(self._arrived) >= MAX_BACKLOG:
                self.dropped += 1
                return
            self._arrived.append(message)
            if self._waking:
                return
            self._waking = True
        try:
            self._loop.call_soon_threadsafe(self._drain)
        except RuntimeError:  # the loop is closed
            return

    def close(self) -> None:
        self.link.close()
        self._blocker.stop()

    def _drain(self) -> None:
        with self._lock:
            self._waking = False
            arrived, self._arrived = self._arrived, []
        now_ns = time.monotonic_ns()
        for message in arrived:
            self.link.link.send(now_ns, message, len(message.payload))
        self.link.release()

    def _deliver(self, message: _Message) -> None:
        if message.options["congestion_control"] == zenoh.CongestionControl.DROP:
            self._put(message)
        elif self._blocked < MAX_BACKLOG:
            with self._lock:
                self._blocked += 1
            self._blocker.submit(self._put_blocking, message)
        else:
            self._count_drop()

    def _put_blocking(self, message: _Message) -> None:
        self._put(message)
        with self._lock:
            self._blocked -= 1

    def _put(self, message: _Message) -> None:
        assert self.session is not None
        try:
            if message.put:
                self.session.put(message.key, message.payload, **message.options)
            else:
                self.session.delete(message.key, **message.options)
        except zenoh.ZError:
            self._count_drop()

    def _count_drop(self) -> None:
        with self._lock:
            self.dropped += 1


class _Worker:
    """A thread that runs its jobs one after another; unlike an executor's thread, it does not delay the exit."""

    def __init__(self, name: str) -> None:
        self._jobs: SimpleQueue[Callable[[], object] | None] = SimpleQueue()
        threading.Thread(target=self._work, name=name, daemon=True).start()

    def submit(self, job: Callable[..., object], *args: object) -> None:
        self._jobs.put(partial(job, *args))

    def stop(self) -> None:
        """End after the jobs already submitted."""
        self._jobs.put(None)

    def _work(self) -> None:
        while (job := self._jobs.get()) is not None:
            # RuntimeError: the loop is closed; ZError: the session is
            with suppress(RuntimeError, zenoh.ZError):
                job()


def _call(method: Callable[[], None]) -> None:
    """Call a method whose type is missing in zenoh's stubs."""
    method()


def _direct(f: Callable[[zenoh.Sample], None]) -> zenoh.handlers.Callback[zenoh.Sample]:
    """A callback on Zenoh's own thread: the default one has a thread that keeps the interpreter from exiting."""
    return zenoh.handlers.Callback(f, indirect=False)


def _config(side: str, endpoint: str, mode: Mode) -> zenoh.Config:
    config = zenoh.Config()
    settings = _SETTINGS | {"mode": mode, "listen/endpoints": [], "connect/endpoints": []}
    settings[f"{side}/endpoints"] = [endpoint]
    try:
        for name, value in settings.items():
            config.insert_json5(name, json.dumps(value))
    except zenoh.ZError:
        allowed = "PROTOCOL/ADDRESS:PORT, such as tcp/127.0.0.1:17448"
        raise NetemError(f"{side}: {endpoint!r} is not allowed; allowed: {allowed}") from None
    return config


def _reason(error: zenoh.ZError) -> str:
    """Zenoh's message in one line, without the places in its source code."""
    return " ".join(re.sub(r" at \S+\.rs:\d+\.?", "", str(error)).split())
