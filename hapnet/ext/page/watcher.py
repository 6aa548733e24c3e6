"""Receives a pair's telemetry over Zenoh, and takes no part in the protocol."""

from __future__ import annotations

import time
from collections.abc import Callable

from hapnet.ext.page.telemetry_reader import TelemetryReader
from hapnet.recording.telemetry import Telemetry
from hapnet.transport.config import ZenohSettings
from hapnet.transport.entities import TELEMETRY
from hapnet.transport.subscription import Subscription

GONE_S = 5.0
"""A pair that is not heard for this time is given up, and the next one heard is watched [s]."""


class Watcher:
    """Hands each message of one pair's telemetry to `take`, on one of Zenoh's threads, where nothing may block.

    Of several pairs it watches the first that is heard.

    settings : how to reach the pair. take : called with each message.
    session, name : of the pair; None: of any.

    Attributes
    ----------
    others : other pairs that were heard. telemetry : reads their messages, and counts those that it cannot read.

    Raises InvalidParameter, TransportError: as `zenoh_config`.
    """

    def __init__(
        self,
        settings: ZenohSettings,
        take: Callable[[Telemetry], None],
        *,
        session: str | None = None,
        name: str | None = None,
    ) -> None:
        # two keys: under access control a subscription must lie within what may be read
        keys = [f"hapnet/{session or '*'}/{name or '*'}/{direction}/{TELEMETRY}" for direction in ("up", "down")]
        self._subscription = Subscription(settings, keys, self._receive)
        self.telemetry: TelemetryReader = TelemetryReader(settings.security.secret_word(), take)
        self._pair: tuple[str, str] | None = None
        self._heard_s = 0.0
        self.others: set[tuple[str, str]] = set()

    @property
    def pair(self) -> tuple[str, str] | None:
        """(session, name) of the pair that is watched; None: none was heard lately."""
        return self._pair if time.monotonic() - self._heard_s < GONE_S else None

    @property
    def problem(self) -> str:
        """Why Zenoh is not open; empty if it is."""
        return self._subscription.problem

    @property
    def where(self) -> str:
        """How the pair is reached, as text."""
        return self._subscription.where

    def open(self) -> None:
        """Start listening in the background; returns at once."""
        self._subscription.open()

    def close(self) -> None:
        """Stop listening."""
        self._subscription.close()

    def _receive(self, key: str, data: bytes) -> None:
        _, session, name, *_ = key.split("/")
        if self.pair not in (None, (session, name)):
            self.others.add((session, name))
            return
        if self._pair != (session, name):
            self._pair = session, name
            self.others.clear()
        self._heard_s = time.monotonic()
        self.telemetry.read(data)
