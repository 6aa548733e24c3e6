"""Zenoh between the two sides: bytes out on three keys, bytes in on three, without blocking a servo.

Keys are ``hapnet/<session>/<device>/{up,down}/{position,energy,control}``; up is from the device. All are best effort,
express, and dropped on congestion: the energy channel itself repeats its messages. Each kind has its own
priority, because Zenoh numbers the messages of each priority and drops one that comes after a later one: with a common
priority, over udp with jitter, most energy messages would be lost among the positions. Also, each side publishes
``.../telemetry`` with the lowest priority, for viewers, and answers probes on ``.../probe`` (probe.py).

A key without other messages carries a message without payload, at least every 0.2 s. If nothing arrives on one of the
three keys, although a side is connected over a link without retransmission, it declares its subscription again
(keys.py).

Threads: any thread may call `ZenohTransport.put`. Arriving messages are delivered on Zenoh's own receiving threads,
where no call may block.
"""

from __future__ import annotations

import asyncio
import atexit
import contextlib
import json
import threading
import time
from collections.abc import Callable

import zenoh

from hapnet.errors import InvalidParameter, TransportError
from hapnet.transport.config import ZenohSettings, may_lose, reason, where, zenoh_config
from hapnet.transport.entities import (
    KINDS,
    POSITION,
    SIGNALS,
    TELEMETRY,
    RateLimiter,
    call,
    check_name,
    direct,
    publisher,
)
from hapnet.transport.keys import WATCH_NS, KeyWatch, any_node, key_expressions
from hapnet.transport.probe import PROBE, answer_probes
from hapnet.transport.sampled import Putting, SampledPublisher, channels_of, sample_every
from hapnet.wire.messages import Role

EXIT_TIMEOUT_S = 2.0
"""An interpreter that exits without `close` waits for this time until Zenoh is closed [s]."""

KEEP_ALIVE = b""
"""The payload that is put on a quiet key."""

REPORT_AFTER_NS = 1_000_000_000
"""A key that is silent for longer is reported [ns]: a new declaration repairs a key sooner."""

LOOK_EVERY_NS = 1_000_000_000
"""The period with which a side that does not detect the other side looks for processes with its own role [ns]."""

_MOST_ANSWERS, _ALL = 16, (*KINDS, SIGNALS, TELEMETRY)

REOPEN_EVERY_S = 0.5
"""Time between two attempts to reopen a lost session [s]."""

KILOHERTZ = 1_000.0
MOST_HZ, MOST_AT_ONCE = 10_000, 2_000
"""Messages beyond this rate or burst are dropped unread, at rates up to 1 kHz; both grow with a faster rate. A side
sends a tenth of this rate; a link that comes back after seconds may deliver such a burst."""

DIRECTIONS = {"device": "up", "world": "down"}  # the part of the keys on which each role publishes
_OTHER: dict[Role, Role] = {"device": "world", "world": "device"}


class ZenohTransport:
    """One side's connection: `put` sends a message of a kind, and `on_message` is called with each that arrives.

    More than twenty attributes: one thread opens, monitors and reopens the session while others use it, so all
    attributes of a session are replaced in one place, under one lock.

    settings : how to reach the other side.
    on_message : called as ``on_message(kind, data, now_ns)`` on one of Zenoh's threads, with the time of arrival on
        the clock `time.monotonic_ns`; must not block.
        Its exceptions are counted in `callback_errors`, and `warn` is called for the first.
    session, device : names in the keys, without any of ``/ # ? $ *``; the same on both sides.
    role : this side's role.
    rate_hz : how often either side sends at most [Hz]. stream_hz : how often this side sends its position [Hz].
    on_change : called on the loop when a link or the other side appears or disappears.
    warn : called with the text of a warning, on any thread. also : further kinds of message that it receives.

    Attributes
    ----------
    failed_puts : messages that Zenoh did not accept (not open yet, closed).
    callback_errors : exceptions from `on_message`.
    rate_limiter : limits the rate of incoming messages.
    sampled : nothing overtakes a position whose number is a multiple of it (sampled.py).
    reopened : how many times Zenoh's whole session was lost and opened again.
    declared_again : how many times a subscription was declared again because a key was silent.
    doubled : another process runs this same side, and none runs the other side.

    Raises InvalidParameter, TransportError: as `zenoh_config`, and for names that no key can contain.
    """

    def __init__(
        self,
        settings: ZenohSettings,
        on_message: Callable[[str, bytes, int], None],
        *,
        session: str = "default",
        device: str = "device",
        role: Role = "device",
        rate_hz: float = KILOHERTZ,
        stream_hz: float = 200.0,
        on_change: Callable[[], None] | None = None,
        warn: Callable[[str], None] = lambda text: None,
        also: tuple[str, ...] = (),
    ) -> None:
        if role not in DIRECTIONS:
            raise InvalidParameter("role", role, "one of " + ", ".join(DIRECTIONS))
        prefix = f"hapnet/{check_name('session', session)}/{check_name('device', device)}"
        self.role: Role = role
        self._mine = f"{prefix}/{DIRECTIONS[role]}"
        self._theirs = f"{prefix}/{DIRECTIONS[_OTHER[role]]}"
        self._config = zenoh_config(settings)
        self._lossy = may_lose(self._config)
        self._doubles = any_node(self._mine, lossy=self._lossy)
        self._channels = channels_of(self._config)
        self.sampled: int = sample_every(self._channels, stream_hz)
        self._watch = KeyWatch(KINDS)
        self._spares: list[zenoh.Subscriber[zenoh.handlers.Handler[zenoh.Sample]]] = []
        self._on_message, self._on_change, self._warn, self._also = on_message, on_change, warn, also
        self._lock = threading.Lock()
        self._closing = threading.Event()
        self._session: zenoh.Session | None = None
        self._publishers: dict[str, Putting] = {}
        self._token: zenoh.LivelinessToken | None = None
        self._partners: set[str] = set()
        self._clients: set[str] = set()
        self._keeper: threading.Thread | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self.failed_puts = self.callback_errors = self.reopened = self.declared_again = 0
        self.doubled: bool = False
        self._answers: zenoh.handlers.Handler[zenoh.Reply] | None = None
        self._look_ns = 0
        scale = min(max(1.0, rate_hz / KILOHERTZ), 20.0)  # no servo is faster than 20 kHz
        self.rate_limiter = RateLimiter(round(scale * MOST_HZ), round(scale * MOST_AT_ONCE))

    async def open(self) -> None:
        """Open, once. A peer returns within a second, connected or not; a client returns when its router answers.

        Raises TransportError: Zenoh cannot be opened: an address is in use, a certificate is missing, and so on.
        """
        loop = self._loop = asyncio.get_running_loop()
        opened: asyncio.Future[None] = loop.create_future()
        self._keeper = threading.Thread(target=self._keep_session, args=(opened,), name="zenoh", daemon=True)
        self._keeper.start()
        try:
            await opened
        except asyncio.CancelledError:
            self._closing.set()
            raise

    async def close(self, timeout_s: float = 2.0) -> bool:
        """Close for good; False if Zenoh did not finish in time (with loss it can take 10 s, in the background)."""
        return await asyncio.to_thread(self.shut, timeout_s)

    def shut(self, timeout_s: float = 2.0) -> bool:
        """Close as `close` does, for a thread that may wait."""
        self._closing.set()
        if self._keeper is not None:
            self._keeper.join(timeout_s)
            if self._keeper.is_alive():
                self._warn(f"Zenoh did not close within {timeout_s:g} s")
                return False
        return True

    def put(self, kind: str, data: bytes) -> bool:
        """Send; from any thread. Never blocks, and never raises for a lost link. False if Zenoh did not accept it."""
        publisher = self._publishers.get(kind)
        if publisher is not None:
            try:
                publisher.put(data)
                if kind in KINDS:
                    self._watch.sent(kind, time.monotonic_ns())
                return True
            except zenoh.ZError:
                pass
        elif kind not in _ALL:
            raise InvalidParameter("kind", kind, "one of " + ", ".join(_ALL))
        with self._lock:
            self.failed_puts += 1
        return False

    @property
    def peers(self) -> int:
        """The number of Zenoh nodes connected to this one now: the other side, a router, or strangers."""
        session = self._session
        if session is None or session.is_closed():
            return 0
        # not info.transports(), which panics with transport/unicast/lowlatency
        return len(session.info.peers_zid()) + len(session.info.routers_zid()) + len(self._clients)

    @property
    def through_router(self) -> str:
        """This node's mode if it is connected to routers only; empty if not. Peers do not meet through a router."""
        session, mode = self._session, json.loads(self._config.get_json("mode"))
        if session is None or session.is_closed() or mode not in ("peer", "client"):
            return ""
        return mode if session.info.routers_zid() and not session.info.peers_zid() else ""

    @property
    def silent(self) -> list[str]:
        """The kinds of message that do not arrive, although a node is connected and other kinds do."""
        silent = self._watch.silent(time.monotonic_ns(), REPORT_AFTER_NS)
        return [] if len(silent) == len(KINDS) else silent

    @property
    def partners(self) -> int:
        """The number of processes that run the other side under these names now: 1 if all is well."""
        return len(self._partners)

    @property
    def status(self) -> str:
        """The state of the connection in words."""
        if self._closing.is_set():
            return "closed"
        other = _OTHER[self.role]
        if self._partners:
            return f"connected to the {other}" if self.partners == 1 else f"{self.partners} {other}s answer"
        if self.peers and self.doubled:
            return f"connected to another {self.role} and to no {other}: one of the two must be a {other}"
        if self.peers:
            return f"connected to {self.peers} Zenoh node{'s' * (self.peers > 1)}, no {other} on {self._theirs} yet"
        return where(self._config) + ", no peer yet"

    # On the keeper's thread, since opening and closing block. It is a daemon: an exit would wait for any other thread.

    def _keep_session(self, opened: asyncio.Future[None]) -> None:
        # A callback into an interpreter that is shutting down aborts the process: close before that.
        atexit.register(self._at_exit)
        try:
            self._connect()
        except BaseException as error:
            self._post(_settle, opened, error)
        else:
            self._post(_settle, opened, None)
            while not self._closing.wait(WATCH_NS * 1e-9):
                if self._session is not None and (self._session.is_closed() or not self._keep_keys(self._session)):
                    self._reopen()
                self._look_for_doubles(time.monotonic_ns())
            self._disconnect()
        atexit.unregister(self._at_exit)

    def _keep_keys(self, session: zenoh.Session) -> bool:
        """Send keep-alives, and declare again if a key is silent; False if only another session can help."""
        now_ns = time.monotonic_ns()
        for kind in self._watch.quiet(now_ns):
            with contextlib.suppress(zenoh.ZError):
                self._publishers[kind].put(KEEP_ALIVE)
            self._watch.sent(kind, now_ns)
        if not self._lossy:
            return True
        self._watch.connected(now_ns, is_connected=self.peers > 0)
        if self._watch.dead(now_ns):
            return False
        if self._watch.declare_now(now_ns):
            with contextlib.suppress(zenoh.ZError):
                self._declare_again(session)
        return True

    def _declare_again(self, session: zenoh.Session) -> None:
        """Declare one more subscription to the same keys, only for its declaration: the first subscriber receives all.

        Earlier ones stay, since undeclaring one could overtake or be overtaken; at the end of the list all are removed.
        """
        expressions = key_expressions(self._theirs)
        if len(self._spares) == len(expressions):
            for spare in self._spares:
                call(spare.undeclare)
            self._spares.clear()
            return
        spare = session.declare_subscriber(expressions[len(self._spares)], zenoh.handlers.RingChannel(1))
        self._spares.append(spare)
        self.declared_again += 1

    def _reopen(self) -> None:
        """Open another session as soon as possible: Zenoh has closed the last one, or it is unusable."""
        self._disconnect()
        self._partners.clear()
        self.reopened += 1
        self._notify()
        try:
            self._connect()
        except TransportError as error:
            self._warn(f"Zenoh's session is lost, and {error}; trying again")
            while not self._closing.wait(REOPEN_EVERY_S):
                with contextlib.suppress(TransportError):
                    self._connect()
                    return

    def _look_for_doubles(self, now_ns: int) -> None:
        """Check whether a connected node that is not the other side runs this same side."""
        session = self._session
        if self._partners or session is None or now_ns < self._look_ns or not self.peers:
            return
        self._look_ns = now_ns + LOOK_EVERY_NS
        own = f"{self._mine}/{session.zid()}"
        # Answers wait for the next look, since keys need keep-alives meanwhile. A Python callback would run under a
        # lock of the session, for which other threads wait while they hold the interpreter's lock.
        answers, self._answers = self._answers, None
        with contextlib.suppress(zenoh.ZError):
            keys = set()
            while answers is not None and (reply := answers.try_recv()) is not None:
                keys.add(own if reply.ok is None else str(reply.ok.key_expr))
                self.doubled = bool(keys - {own})
        with contextlib.suppress(zenoh.ZError):
            look: zenoh.handlers.FifoChannel[zenoh.Reply] = zenoh.handlers.FifoChannel(_MOST_ANSWERS)
            self._answers = session.liveliness().get(self._doubles, look, timeout=LOOK_EVERY_NS * 1e-9)

    def _at_exit(self) -> None:
        self.shut(EXIT_TIMEOUT_S)

    def _connect(self) -> None:
        session = self._open_session()
        try:
            # no history: it would panic with transport/unicast/lowlatency
            session.info.declare_transport_events_listener(direct(self._on_link), history=False)
            publishers: dict[str, Putting] = {k: publisher(session, f"{self._mine}/{k}", k) for k in _ALL}
            if self._channels:
                publishers[POSITION] = SampledPublisher(
                    session, f"{self._mine}/{POSITION}", self._channels, self.sampled
                )
            for kind in (*KINDS, SIGNALS, *self._also):
                session.declare_subscriber(f"{self._theirs}/{kind}", direct(self._receiver(kind)))
            answer_probes(session, f"{self._theirs}/{PROBE}", f"{self._mine}/{PROBE}")
            with self._lock:
                self._session, self._publishers = session, publishers
            # the token comes after the subscribers: a node that receives it has received their declarations
            session.liveliness().declare_subscriber(f"{self._theirs}/*", direct(self._on_token), history=True)
            self._token = session.liveliness().declare_token(f"{self._mine}/{session.zid()}")
            self._notify()
        except zenoh.ZError as error:
            self._disconnect()
            if not session.is_closed():
                call(session.close)
            raise TransportError(f"cannot use Zenoh ({where(self._config)}): {reason(error)}") from None

    def _open_session(self) -> zenoh.Session:
        while True:
            try:
                return zenoh.open(self._config)
            except zenoh.ZError as error:
                # A client, unlike a peer, gives up when its router isn't there yet.
                if "Unable to connect" not in str(error) or self._closing.wait(0.1):
                    raise TransportError(f"cannot open Zenoh ({where(self._config)}): {reason(error)}") from None

    def _disconnect(self) -> None:
        with self._lock:
            session, self._session, self._publishers = self._session, None, {}
        self._spares.clear()
        self._clients.clear()
        self._watch.connected(0, is_connected=False)
        if session is not None and not session.is_closed():
            call(session.close)

    # On Zenoh's threads

    def _receiver(self, kind: str) -> Callable[[zenoh.Sample], None]:
        on_message, clock = self._on_message, time.monotonic_ns
        admit, heard = self.rate_limiter.admit, self._watch.heard

        def receive(sample: zenoh.Sample) -> None:
            now_ns = clock()
            if not admit(now_ns):
                return
            heard(kind, now_ns)
            data = sample.payload.to_bytes()
            if data == KEEP_ALIVE:
                return
            try:
                on_message(kind, data, now_ns)
            except Exception as error:
                with self._lock:
                    self.callback_errors += 1
                    first = self.callback_errors == 1
                if first:
                    what = f"{type(error).__name__}: {error}"
                    self._warn(f"on_message failed for a {kind} message, further failures are only counted: {what}")

        return receive

    def _on_link(self, event: zenoh.TransportEvent) -> None:
        if event.transport.whatami == zenoh.WhatAmI.CLIENT:  # peers and routers are counted by Zenoh
            change = self._clients.add if event.kind == zenoh.SampleKind.PUT else self._clients.discard
            change(str(event.transport.zid))
        self._notify()

    def _on_token(self, sample: zenoh.Sample) -> None:
        key = str(sample.key_expr)
        if sample.kind == zenoh.SampleKind.PUT:
            self._partners.add(key)
        else:
            self._partners.discard(key)
        self._notify()

    def _notify(self) -> None:
        if self._on_change is not None:
            self._post(self._on_change)

    def _post(self, call: Callable[..., object], *args: object) -> None:
        assert self._loop is not None
        with contextlib.suppress(RuntimeError):  # the loop is closed: no callback is left
            self._loop.call_soon_threadsafe(call, *args)


def _settle(future: asyncio.Future[None], error: BaseException | None) -> None:
    if future.cancelled():
        return
    if error is None:
        future.set_result(None)
    else:
        future.set_exception(error)
