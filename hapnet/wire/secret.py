"""A secret that only the two sides of a pair know, and the tags that it puts under frames.

Each process has a key pair of X25519 (RFC 7748). Its public half is in its hello and its welcome; both sides derive
the same key from it (RFC 5869). A tag is HMAC-SHA-256 (RFC 2104) of all the frame's bytes before it, cut to 8 bytes.

Whoever can only listen, and add frames, learns no key, and cannot make a tag. Who can also take frames away may put
himself between the sides while they pair; only a word that both users know keeps him out.
"""

from __future__ import annotations

import dataclasses
import hashlib
import hmac
from collections.abc import Mapping
from typing import Any

from hapnet.errors import BadMessage
from hapnet.wire.fields import KEY, TAG
from hapnet.wire.messages import Account, Bye, Energy, Message, Refuse, Signals, Welcome, encode

TAG_BYTES = 8
_NO_TAG = bytes(TAG_BYTES)
_PROTOCOL = b"hapnet, version 2"

OfPeer = Energy | Signals | Account | Bye | Refuse
"""The messages of a peer that must be sealed where the two share a key."""

Sealed = OfPeer | Welcome


class Secret:
    """This side's half of the keys that it shares with its peers.

    private : 32 bytes of the system's generator, drawn when the process starts.
    word : what both users know; empty: nothing. Guessing it takes some 50 ms a try.
    """

    def __init__(self, private: bytes, word: str = "") -> None:
        from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey  # here, since it loads OpenSSL

        self._private = X25519PrivateKey.from_private_bytes(private)
        self.public: bytes = self._private.public_key().public_bytes_raw()
        self.has_word: bool = bool(word)
        self._word = hashlib.scrypt(word.encode(), salt=_PROTOCOL, n=2**14, r=8, p=1) if word else b""

    def key(self, mine: int, theirs: int, public: bytes) -> bytes:
        """The key of a pair. mine, theirs : the incarnations. public : the peer's public key.

        Raises
        ------
        BadMessage : `public` is no key of a side that keeps to the protocol.
        """
        from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PublicKey

        try:
            shared = self._private.exchange(X25519PublicKey.from_public_bytes(public))
        except ValueError as error:
            raise BadMessage("forged", f"no public key of X25519 ({error})") from None
        parties = sorted(((mine, self.public), (theirs, public)))
        info = b"".join(number.to_bytes(8, "big") + each for number, each in parties)
        extracted = hmac.digest(_PROTOCOL, shared + self._word, "sha256")
        return hmac.digest(extracted, info + b"\x01", "sha256")


def sealed(message: Sealed, key: bytes) -> bytes:
    """The frame of `message`, with the tag of `key` at its end."""
    more = {**(message.more or {}), TAG: _NO_TAG}
    if isinstance(message, Energy):
        data = encode(message._replace(more=more))
    else:
        data = encode(dataclasses.replace(message, more=more))
    signed = data[:-TAG_BYTES]
    return signed + _tag(key, signed)


def is_sealed(key: bytes, more: Mapping[str, Any] | None, data: bytes) -> bool:
    """Does the frame `data`, whose further entries are `more`, end with the tag of `key`?"""
    tag = (more or {}).get(TAG)
    return (
        type(tag) is bytes
        and len(tag) == TAG_BYTES
        and data.endswith(tag)
        and hmac.compare_digest(tag, _tag(key, data[:-TAG_BYTES]))
    )


class Keys:
    """The keys that one side shares with others, by their incarnations. Without a secret there are none.

    mine : this side's incarnation.
    """

    def __init__(self, secret: Secret | None, mine: int) -> None:
        self.offer: dict[str, Any] | None = None if secret is None else {KEY: secret.public}
        """Further entries of this side's hellos and welcomes."""
        self._secret, self._mine = secret, mine
        self._kept: dict[int, tuple[bytes, bytes]] = {}  # of all peers so far: public key, shared key
        self._met: tuple[int, bytes, bytes] | None = None  # the same of who may be the next

    @property
    def met(self) -> int:
        """Who may be the next peer, and may take this side for its peer already; 0: nobody."""
        return 0 if self._met is None else self._met[0]

    def shared_with(self, other: int) -> bytes | None:
        """The key for frames to `other`; None: there is none."""
        if other in self._kept:
            return self._kept[other][1]
        return self._met[2] if self._met is not None and self._met[0] == other else None

    def require_seal(self, message: Message, data: bytes) -> None:
        """Check that a message of someone who shares a key with this side is sealed with it.

        Streams are not sealed: a set-position costs what it costs, whoever tells it. Nor are hellos, which are to
        nobody; and welcomes are judged by `prove`.

        Raises
        ------
        BadMessage : it is not.
        """
        if not isinstance(message, OfPeer) or message.incarnation not in self._kept:
            return
        if not is_sealed(self._kept[message.incarnation][1], message.more, data):
            raise BadMessage("forged", f"a message in the name of {message.incarnation:#x} without its seal")

    def is_other(self, peer: int, more: Mapping[str, Any] | None) -> bool:
        """Does a hello in the peer's name offer another key than the peer did?"""
        return peer in self._kept and self._kept[peer][0] != _offered(more)

    def misfit(self, name: str, more: Mapping[str, Any] | None) -> str:
        """Why a side that offers this cannot be the peer; empty if it may be."""
        wants = self._secret is not None and self._secret.has_word
        return f"{name} has no secret, and this side has one" if wants and _offered(more) is None else ""

    def meet(self, other: int, more: Mapping[str, Any] | None) -> bytes | None:
        """The key shared with `other`, who said hello or welcome; None: one of the two has no secret.

        Raises
        ------
        BadMessage : what `other` offers is no key, or it offered one before and does not now.
        """
        public, met = _offered(more), self._met if self._met is not None and self._met[0] == other else None
        if self._secret is None:
            return None
        if public is None:
            if met is not None:
                raise BadMessage("forged", f"incarnation {other:#x} offered a key before")
            return None
        if met is None or met[1] != public:
            self._met = met = other, public, self._secret.key(self._mine, other, public)
        return met[2]

    def prove(self, name: str, other: int, more: Mapping[str, Any] | None, data: bytes) -> str:
        """Why the welcome `data` of `other` does not count; empty if it does.

        Raises
        ------
        BadMessage : it is not sealed with the key that it offers. With a word on this side that is no fault of the
            network, but another word.
        """
        key = self.meet(other, more)
        if self._secret is None or key is None or is_sealed(key, more, data):
            return ""
        if not self._secret.has_word:
            raise BadMessage("forged", f"the welcome of {other:#x} is not sealed with its key")
        return f"{name} has another secret"

    def keep(self, peer: int) -> None:
        """`peer` is the peer from now on."""
        if self._met is not None and self._met[0] == peer:
            self._kept[peer] = self._met[1:]
        self._met = None


def _offered(more: Mapping[str, Any] | None) -> bytes | None:
    """The public key in a hello or a welcome; None: there is none."""
    key: bytes | None = (more or {}).get(KEY)
    return key


def _tag(key: bytes, data: bytes) -> bytes:
    return hmac.digest(key, data, "sha256")[:TAG_BYTES]
