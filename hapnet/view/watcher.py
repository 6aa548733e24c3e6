"""Receives a pair's telemetry over Zenoh, and takes no part in the protocol."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import replace

import zenoh

from hapnet.errors import BadMessage
from hapnet.recording.telemetry import Telemetry, decode
from hapnet.transport.config import ZenohSettings, reason, where, zenoh_config
from hapnet.transport.zenoh import TELEMETRY

LOOK_S = 0.2
"""How often the connection is checked [s]."""

LOST_S = 1.0
"""After this time without any connection, Zenoh is opened again [s]."""

GONE_S = 5.0
"""A pair that is not heard for this time is given up, and the next one heard is watched [s]."""


class Watcher:
    """Hands each message of one pair's telemetry to `take`, on one of Zenoh's threads, where nothing may block.

    Of several pairs it watches the first that is heard. It dials as a Zenoh client: the process that it dials then
    forwards what the other one publishes.

    Parameters
    ----------
    settings : how to reach the pair. take : called with each message.
    session, name : of the pair; None: of any.

    Attributes
    ----------
    others : other pairs that were heard. unreadable : messages that could not be read.
    problem : why Zenoh is not open, if it is not.

    Raises
    ------
    InvalidParameter, TransportError : as `zenoh_config`.
    """

    def __init__(
        self,
        settings: ZenohSettings,
        take: Callable[[Telemetry], None],
        *,
        session: str | None = None,
        name: str | None = None,
    ) -> None:
        if settings.mode is None and settings.connect:
            settings = replace(settings, mode="client")
        self._config = zenoh_config(settings)
        self._take = take
        # two keys: under access control a subscription must lie within what may be read
        self._keys = [f"hapnet/{session or '*'}/{name or '*'}/{way}/{TELEMETRY}" for way in ("up", "down")]
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._main, name="watcher", daemon=True)
        self._pair: tuple[str, str] | None = None
        self._heard_s = 0.0
        self.others: set[tuple[str, str]] = set()
        self.unreadable = 0
        self.problem = ""

    @property
    def pair(self) -> tuple[str, str] | None:
        """(session, name) of the pair that is watched; None: none was heard lately."""
        return self._pair if time.monotonic() - self._heard_s < GONE_S else None

    @property
    def where(self) -> str:
        """How the pair is reached, in words."""
        return where(self._config)

    def open(self) -> None:
        """Start listening in the background; returns at once."""
        self._thread.start()

    def close(self) -> None:
        """Stop listening."""
        self._stopping.set()
        if self._thread.ident is not None:
            self._thread.join()

    def _main(self) -> None:
        while not self._stopping.is_set():
            try:
                with zenoh.open(self._config) as session:
                    self.problem = ""
                    for key in self._keys:
                        session.declare_subscriber(key, zenoh.handlers.Callback(self._hear, indirect=False))
                    self._keep(session)
            except zenoh.ZError as error:
                self.problem = reason(error)
            self._stopping.wait(LOOK_S)

    def _keep(self, session: zenoh.Session) -> None:
        """Listen until the session is lost, or has had no connection for `LOST_S`."""
        alone_s = 0.0
        while not self._stopping.wait(LOOK_S) and not session.is_closed():
            alone_s = 0.0 if session.info.transports() else alone_s + LOOK_S
            if alone_s > LOST_S:
                return

    def _hear(self, sample: zenoh.Sample) -> None:
        _, session, name, *_ = str(sample.key_expr).split("/")
        if self.pair not in (None, (session, name)):
            self.others.add((session, name))
            return
        if self._pair != (session, name):
            self._pair = session, name
            self.others.clear()
        self._heard_s = time.monotonic()
        try:
            message = decode(sample.payload.to_bytes())
        except BadMessage:
            self.unreadable += 1
            return
        self._take(message)
