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
from typing import Any, NamedTuple, get_args

from hapnet.errors import BadMessage
from hapnet.wire.encryption import Cipher, Encrypted
from hapnet.wire.fields import ENCRYPTS, KEY, TAG
from hapnet.wire.messages import Account, Bye, Energy, Message, Refuse, Signals, Stream, Welcome, decode, encode

TAG_BYTES = 8
_NO_TAG = bytes(TAG_BYTES)
_PROTOCOL = b"hapnet, version 2"

OfPeer = Energy | Signals | Account | Bye | Refuse
"""The messages of a peer that must be sealed where the two share a key."""

Sealed = OfPeer | Welcome

OF_PAIR: tuple[type[Message], ...] = (*get_args(Stream), Energy, Signals, Account)
"""What the sides of a pair say to each other, beside what begins and ends it."""


class Secret:
    """This side's half of the keys that it shares with its peers.

    private : 32 bytes of the system's generator, drawn when the process starts.
    word : what both users know; empty: nothing. Guessing it takes some 50 ms a try.
    encrypts : pair with nobody who cannot encrypt, and encrypt. If the peer does so, this side does it in any case.
    """

    def __init__(self, private: bytes, word: str = "", *, encrypts: bool = False) -> None:
        from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey  # here, since it loads OpenSSL

        self._private = X25519PrivateKey.from_private_bytes(private)
        self.public: bytes = self._private.public_key().public_bytes_raw()
        self.has_word: bool = bool(word)
        self.encrypts: bool = encrypts
        self._word = hashlib.scrypt(word.encode(), salt=_PROTOCOL, n=2**14, r=8, p=1) if word else b""

    def key(self, mine: int, theirs: int, public: bytes) -> bytes:
        """The key of a pair. mine, theirs : the incarnations. public : the peer's public key.

        Raises BadMessage: `public` is no key of a side that keeps to the protocol.
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

    def for_watchers(self, incarnation: int) -> Cipher | None:
        """What encrypts the telemetry of a side, for whoever knows the word; None: there is no word."""
        return Cipher(self._word, incarnation, incarnation, "telemetry") if self.has_word else None


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


def decrypted(message: Encrypted, cipher: Cipher | None) -> Message:
    """What the peer has encrypted. cipher : of the pair; None: it does not encrypt.

    Raises BadMessage: somebody else has encrypted it, or it is no message of a pair, or of another sender.
    """
    if cipher is None:
        raise BadMessage("forged", "an encrypted message; this pair does not encrypt")
    inside = decode(cipher.decrypt(message))
    if inside.incarnation != message.incarnation or not isinstance(inside, OF_PAIR):
        raise BadMessage("forged", f"a {type(inside).__name__} of {inside.incarnation:#x}, encrypted by its peer")
    return inside


class _Shared(NamedTuple):
    """What is shared with another side: its public key, the shared key, and the cipher if the two encrypt."""

    public: bytes
    key: bytes
    cipher: Cipher | None = None


class Keys:
    """The keys that one side shares with others, by their incarnations. Without a secret there are none.

    mine : this side's incarnation.
    """

    def __init__(self, secret: Secret | None, mine: int) -> None:
        self.offer: dict[str, Any] | None = None if secret is None else {KEY: secret.public, ENCRYPTS: secret.encrypts}
        """Further entries of this side's hellos and welcomes."""
        self._secret, self._mine = secret, mine
        self._encrypts = secret is not None and secret.encrypts
        self._kept: dict[int, _Shared] = {}  # of all peers so far
        self._met: tuple[int, _Shared] | None = None  # of who may be the next
        self._asked = False  # its welcome, which was sealed, asks for encryption

    @property
    def met(self) -> int:
        """Who may be the next peer, and may take this side for its peer already; 0: nobody."""
        return 0 if self._met is None else self._met[0]

    def shared_with(self, other: int) -> bytes | None:
        """The key for frames to `other`; None: there is none."""
        if other in self._kept:
            return self._kept[other].key
        return self._met[1].key if self._met is not None and self._met[0] == other else None

    def cipher(self, peer: int) -> Cipher | None:
        """What encrypts for a peer, and decrypts what it sends; None: the two do not encrypt."""
        return self._kept[peer].cipher if peer in self._kept else None

    @property
    def must_encrypt(self) -> bool:
        """Must this side send nothing that others can read, not even without a peer?"""
        return self._encrypts

    def require_seal(self, message: Message, data: bytes) -> None:
        """Check that a message of someone who shares a key with this side is sealed with it.

        Streams are not sealed: a set-position costs what it costs, whoever sends it. Nor are hellos, which are to
        nobody; and welcomes are judged by `prove`. Of a pair that encrypts only byes and refusals come so.

        Raises BadMessage: it is not.
        """
        if not isinstance(message, OfPeer | Stream) or message.incarnation not in self._kept:
            return
        shared = self._kept[message.incarnation]
        if shared.cipher is not None and not isinstance(message, Bye | Refuse):
            raise BadMessage("forged", f"a message in the name of {message.incarnation:#x} that is not encrypted")
        if isinstance(message, OfPeer) and not is_sealed(shared.key, message.more, data):
            raise BadMessage("forged", f"a message in the name of {message.incarnation:#x} without its seal")

    def is_other(self, peer: int, more: Mapping[str, Any] | None) -> bool:
        """Does a hello in the peer's name offer another key than the peer did?"""
        return peer in self._kept and self._kept[peer].public != _offered(more)

    def misfit(self, name: str, more: Mapping[str, Any] | None) -> str:
        """Why a side that offers this cannot be the peer; empty if it may be."""
        offered = _offered(more) is not None
        if self._secret is not None and self._secret.has_word and not offered:
            return f"{name} has no secret, and this side has one"
        return f"{name} cannot encrypt, and this side must" if self._encrypts and _asks(more) is None else ""

    def meet(self, other: int, more: Mapping[str, Any] | None) -> bytes | None:
        """The key shared with `other`, who said hello or welcome; None: one of the two has no secret.

        Raises BadMessage: what `other` offers is no key, or it offered one before and does not now.
        """
        public, met = _offered(more), self._met if self._met is not None and self._met[0] == other else None
        if self._secret is None:
            return None
        if public is None:
            if met is not None:
                raise BadMessage("forged", f"incarnation {other:#x} offered a key before")
            return None
        if met is None or met[1].public != public:
            self._met = met = other, _Shared(public, self._secret.key(self._mine, other, public))
        return met[1].key

    def prove(self, name: str, other: int, more: Mapping[str, Any] | None, data: bytes) -> str:
        """Why the welcome `data` of `other` does not count; empty if it does.

        Raises BadMessage: it is not sealed with the key that it offers. With a word on this side that is no fault of
        the network, but another word.
        """
        key = self.meet(other, more)
        if self._secret is None or key is None:
            return ""
        if is_sealed(key, more, data):
            self._asked = bool(_asks(more))
            return ""
        if not self._secret.has_word:
            raise BadMessage("forged", f"the welcome of {other:#x} is not sealed with its key")
        return f"{name} has another secret"

    def keep(self, peer: int) -> None:
        """`peer` is the peer from now on."""
        if self._met is not None and self._met[0] == peer:
            shared = self._met[1]
            if self._encrypts or self._asked:
                shared = shared._replace(cipher=Cipher(shared.key, self._mine, peer))
            self._kept[peer] = shared
        self._met, self._asked = None, False


def _offered(more: Mapping[str, Any] | None) -> bytes | None:
    """The public key in a hello or a welcome; None: there is none."""
    key: bytes | None = (more or {}).get(KEY)
    return key


def _asks(more: Mapping[str, Any] | None) -> bool | None:
    """Does a hello or a welcome ask for encryption? None: its sender cannot encrypt."""
    asks: bool | None = (more or {}).get(ENCRYPTS)
    return asks


def _tag(key: bytes, data: bytes) -> bytes:
    return hmac.digest(key, data, "sha256")[:TAG_BYTES]
