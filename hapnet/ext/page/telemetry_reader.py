"""Reads telemetry, encrypted or not."""

from __future__ import annotations

from collections.abc import Callable

from hapnet.errors import BadMessage
from hapnet.recording.telemetry import Telemetry, decode
from hapnet.wire.encryption import Cipher, read
from hapnet.wire.secret import Secret

_MOST_SIDES = 64
"""So many keys are kept, of sides that were heard; those of more are made for each message."""


class TelemetryReader:
    """Hands what it can read to `take`.

    word : the word of the pair's `--secret-file`; empty: none. take : called with each message.

    Attributes
    ----------
    unreadable : messages that could not be read. undecrypted : of these the ones that were encrypted with a word that
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
