"""Encryption of a pair's messages, so that only the pair can read them: ChaCha20-Poly1305 (RFC 8439) over whole frames.

Each datagram can be decrypted alone, whatever was lost or overtaken before it. An encrypted stream over udp needs
this: TLS and QUIC hold back later data after a loss. The nonce is the message's number, which is never used twice:
each pair has keys of its own, and each direction has one.
"""

from __future__ import annotations

import hmac
from struct import Struct

from hapnet.errors import BadMessage
from hapnet.wire.messages import VERSION, Encrypted

FIRST_OTHER = 2**63
"""The first number of messages outside the stream; the stream's own numbers are below."""

_HEAD = Struct(">BBBBQBQ")  # as a stream's message begins, so that its number is at the same place
_BIN = Struct(">BL")
_NONCE = Struct(">LQ").pack
_ARRAY_OF_5, _U64, _BIN32 = 0x95, 0xCF, 0xC6
_BEFORE = _HEAD.size + _BIN.size


class Cipher:
    """Encrypts what one side of a pair sends, and decrypts what the other sends.

    key : 32 bytes or more that the two share. mine, theirs : their incarnations.
    what : a word for what is encrypted; another word gives other keys.
    """

    def __init__(self, key: bytes, mine: int, theirs: int, what: str = "frames") -> None:
        from cryptography.hazmat.primitives.ciphers.aead import ChaCha20Poly1305  # here, since it loads OpenSSL

        self._mine = mine
        self._encrypt = ChaCha20Poly1305(key_of(key, what, mine)).encrypt
        self._decrypt = ChaCha20Poly1305(key_of(key, what, theirs)).decrypt
        self._next_other = FIRST_OTHER

    def encrypt(self, frame: bytes, number: int | None = None) -> bytes:
        """The frame of an `Encrypted` with `frame` in it. number : that of a stream's message; None for others."""
        if number is None:
            number = self._next_other
            self._next_other += 1
        head = _head(self._mine, number)
        content = self._encrypt(_NONCE(0, number), frame, head)
        return head + _BIN.pack(_BIN32, len(content)) + content

    def decrypt(self, message: Encrypted) -> bytes:
        """The frame in `message`. Raises BadMessage: it was not made by the peer, or was changed."""
        from cryptography.exceptions import InvalidTag

        head = _head(message.incarnation, message.number)
        try:
            return self._decrypt(_NONCE(0, message.number), message.content, head)
        except InvalidTag:
            raise BadMessage("forged", f"message {message.number}, encrypted by another") from None


def key_of(key: bytes, what: str, sender: int) -> bytes:
    """Derive the key for what `sender` encrypts from a shared `key` (HKDF-Expand, RFC 5869)."""
    return hmac.digest(key, what.encode() + sender.to_bytes(8, "big") + b"\x01", "sha256")


def _head(incarnation: int, number: int) -> bytes:
    """The first bytes of an encrypted frame; its tag covers them too."""
    return _HEAD.pack(_ARRAY_OF_5, VERSION, Encrypted.KIND, _U64, incarnation, _U64, number)


def read(data: bytes) -> Encrypted | None:
    """Read the result of `Cipher.encrypt`, of any length; None: `data` is no such result."""
    if len(data) <= _BEFORE or data[:3] != bytes((_ARRAY_OF_5, VERSION, Encrypted.KIND)):
        return None
    *_, incarnation, _, number = _HEAD.unpack_from(data)
    return Encrypted(incarnation, number, data[_BEFORE:])
