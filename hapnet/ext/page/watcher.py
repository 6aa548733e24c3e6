"""Receives a pair's telemetry over Zenoh, encrypted or not, and takes no part in the protocol."""

from __future__ import annotations

import time
from collections.abc import Callable

from hapnet.errors import BadMessage
from hapnet.recording.telemetry import Telemetry, decode
from hapnet.transport.config import ZenohSettings
from hapnet.transport.entities import TELEMETRY
from hapnet.transport.subscription import Subscription
from hapnet.wire.encryption import Cipher, read
from hapnet.wire.secret import Secret

GONE_S = 5.0
"""After this time without a message from the watched pair, the next pair that sends is watched [s]."""


class Watcher:
    """Passes each message of one pair's telemetry to `take`, on one of Zenoh's threads, where nothing may block.

    If there are several pairs, it watches the first that sends.

    settings : how to reach the pair. take : called with each message.
    session, name : of the pair; None: any.

    Attributes
    ----------
    others : other pairs that sent messages. telemetry : reads the messages, and counts the unreadable ones.

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
        """(session, name) of the pair that is watched; None: no pair has sent for `GONE_S`."""
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


_MOST_SIDES = 64
"""The number of sides whose keys are kept; the key of a further side is made again for each message."""


class TelemetryReader:
    """Decrypts and decodes messages, and passes them to `take`.

    word : the word of the pair's `--secret-file`; empty: none. take : called with each message.

    Attributes
    ----------
    unreadable : messages that could not be read. undecrypted : those of them that were encrypted with a word that
        this reader does not have.
    """

    def __init__(self, word: str, take: Callable[[Telemetry], object]) -> None:
        self._secret = Secret(bytes(32), word) if word else None
        self._ciphers: dict[int, Cipher] = {}  # of the sides, by their incarnations
        self._take = take
        self.unreadable: int = 0
        self.undecrypted: int = 0

    def read(self, data: bytes) -> None:
        """Read one message."""
        try:
            message = decode(self._decrypted(data))
        except BadMessage:
            self.unreadable += 1
            return
        self._take(message)

    def _decrypted(self, data: bytes) -> bytes:
        encrypted = read(data)
        if encrypted is None:
            return data
        self.undecrypted += 1
        if self._secret is None:
            raise BadMessage("forged", "encrypted")
        side = encrypted.incarnation
        cipher = self._ciphers.get(side) or self._secret.for_watchers(side)
        assert cipher is not None  # since there is a word
        data = cipher.decrypt(encrypted)
        self.undecrypted -= 1
        if len(self._ciphers) < _MOST_SIDES:
            self._ciphers[side] = cipher
        return data
