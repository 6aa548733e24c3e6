"""A secret that only the two sides of a pair have, and the tags that it puts under frames.

Each process has a key pair of X25519 (RFC 7748). Its public half is in its hello and its welcome; both sides derive
the same key from it (RFC 5869). A tag is HMAC-SHA-256 (RFC 2104) of all the frame's bytes before it, cut to 8 bytes.

An attacker who only listens learns no key, and cannot make a tag. An attacker who sends while the two pair may offer
keys of his own in their names, and so stand between them. A word that both users know prevents this: it is part of
each key and of each proof. Without a word he is detected by two keys in one name, or by fingerprints that differ.
"""

from __future__ import annotations

import base64
import hashlib
import hmac
from collections.abc import Mapping
from typing import Any, Literal, NamedTuple, get_args

import msgspec

from hapnet.errors import BadMessage
from hapnet.wire.encryption import Cipher
from hapnet.wire.fields import ENCRYPTS, KEY, TAG
from hapnet.wire.messages import (
    Account,
    Bye,
    Encrypted,
    Energy,
    Hello,
    Message,
    Refuse,
    Signals,
    Stream,
    Welcome,
    decode,
    encode,
)

TAG_BYTES = 8
_NO_TAG = bytes(TAG_BYTES)
_PROTOCOL = b"hapnet, version 2"

OfPeer = Energy | Signals | Account | Bye | Refuse
"""The messages of a peer that must be sealed where the two share a key."""

Sealed = OfPeer | Hello | Welcome

Proof = Literal["word", "certificate", "socket"]
"""The proof of the peer's identity: a word that both users know; a certificate that each side requires; or a link over
a socket that only this machine's user can open."""

MOST_OFFERS = 4096
"""The first offered key is kept for this many incarnations; any further incarnation is disputed."""

MOST_KEYS = 256
"""This many keys of strangers are kept; an older one is derived again when it is needed."""

FINGERPRINT_BYTES = 10
"""The length of a fingerprint: 80 bits. To give two pairs the same, an attacker must try 2^40 keys of his own against
each side, after both have sent a hello and before they pair."""

OF_PAIR: tuple[type[Message], ...] = (*get_args(Stream), Energy, Signals, Account)
"""The messages between the sides of a pair, except those that begin and end it."""


class Secret:
    """This side's half of the keys that it shares with its peers.

    private : 32 bytes of the system's generator, drawn when the process starts.
    word : the word that both users know; empty: none. Guessing it takes some 50 ms a try.
    encrypts : whether this side pairs only with a side that can encrypt.
    proof : another proof of the peer's identity; None: none. A word is a proof in any case.
    """

    def __init__(self, private: bytes, word: str = "", *, encrypts: bool = False, proof: Proof | None = None) -> None:
        from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey  # here, since it loads OpenSSL

        self._private = X25519PrivateKey.from_private_bytes(private)
        self.public: bytes = self._private.public_key().public_bytes_raw()
        self.has_word: bool = bool(word)
        self.encrypts: bool = encrypts
        self.proof: Proof | None = "word" if word else proof
        self._word = hashlib.scrypt(word.encode(), salt=_PROTOCOL, n=2**14, r=8, p=1) if word else b""

    def key(self, mine: int, theirs: int, public: bytes) -> bytes:
        """Derive the key of a pair. mine, theirs : the incarnations. public : the peer's public key.

        Raises BadMessage: `public` is no valid public key.
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
        """The cipher of a side's telemetry, for viewers with the word; None: there is no word."""
        return Cipher(self._word, incarnation, incarnation, "telemetry") if self.has_word else None


def sealed(message: Sealed, key: bytes) -> bytes:
    """The frame of `message`, with the tag of `key` at its end."""
    more = {**(message.more or {}), TAG: _NO_TAG}
    signed = encode(msgspec.structs.replace(message, more=more))[:-TAG_BYTES]
    return signed + _tag(key, signed)


def is_sealed(key: bytes, more: Mapping[str, Any] | None, data: bytes) -> bool:
    """Whether the frame `data`, whose further entries are `more`, ends with the tag of `key`."""
    tag = (more or {}).get(TAG)
    return (
        type(tag) is bytes
        and len(tag) == TAG_BYTES
        and data.endswith(tag)
        and hmac.compare_digest(tag, _tag(key, data[:-TAG_BYTES]))
    )


def decrypted(message: Encrypted, cipher: Cipher | None) -> Message:
    """Decrypt a message of the peer. cipher : that of the pair; None: the pair does not encrypt.

    Raises BadMessage: the peer has not encrypted it, or its content is no message of a pair, or of another sender.
    """
    if cipher is None:
        raise BadMessage("forged", "an encrypted message; this pair does not encrypt")
    inside = decode(cipher.decrypt(message))
    if inside.incarnation != message.incarnation or not isinstance(inside, OF_PAIR):
        raise BadMessage("forged", f"a {type(inside).__name__} of {inside.incarnation:#x}, encrypted by its peer")
    return inside


def fingerprint(key: bytes) -> str:
    """The fingerprint of a pair's key, for people to compare: 16 letters and digits in groups of four."""
    short = hmac.digest(key, b"fingerprint\x01", "sha256")[:FINGERPRINT_BYTES]
    letters = base64.b32encode(short).decode().lower()
    return "-".join(letters[k : k + 4] for k in range(0, len(letters), 4))


class _Shared(NamedTuple):
    """The data shared with a peer: its public key, the shared key, the cipher, and whether either requires secrecy."""

    public: bytes
    key: bytes
    cipher: Cipher | None = None
    secret: bool = False


class Keys:
    """The keys that one side shares with others, by their incarnations. Without a secret there are none.

    mine : this side's incarnation.

    Attributes
    ----------
    disputed : incarnations in whose name two keys were offered, or one and none.
    """

    def __init__(self, secret: Secret | None, mine: int) -> None:
        self.offer: dict[str, Any] | None = None if secret is None else {KEY: secret.public, ENCRYPTS: secret.encrypts}
        """Further entries of this side's hellos and welcomes."""
        self.disputed: set[int] = set()
        self._secret, self._mine = secret, mine
        self._encrypts = secret is not None and secret.encrypts
        self._kept: dict[int, _Shared] = {}  # by the incarnations of all peers so far
        self._first: dict[int, bytes | None] = {}  # the key that each incarnation offered first
        self._derived: dict[tuple[int, bytes], bytes] = {}
        self._met: tuple[int, bytes | None] = 0, None  # the incarnation that was welcomed last, and its key

    @property
    def met(self) -> tuple[int, bytes | None]:
        """The side that was welcomed last, which may be paired with this side already, and the shared key; 0: none."""
        return self._met

    def meet(self, other: int, key: bytes | None) -> None:
        """Enter that `other` is welcomed, with that key."""
        self._met = other, key

    @property
    def proof(self) -> Proof | Literal["nobody"] | None:
        """The proof of the identity of this side's peer; None: this side shares no keys."""
        return None if self._secret is None else (self._secret.proof or "nobody")

    def shared_with(self, other: int) -> bytes | None:
        """The key for frames to `other`, which is or was the peer; None: there is none."""
        return self._kept[other].key if other in self._kept else None

    def fingerprint(self, peer: int) -> str:
        """The fingerprint of the key that is shared with a peer; empty: there is none."""
        return fingerprint(self._kept[peer].key) if peer in self._kept else ""

    def cipher(self, peer: int) -> Cipher | None:
        """The cipher that encrypts for a peer, and decrypts its messages; None: one of the two cannot encrypt."""
        return self._kept[peer].cipher if peer in self._kept else None

    @property
    def must_encrypt(self) -> bool:
        """Whether this side must encrypt all that it sends, even without a peer."""
        return self._encrypts

    def is_secret(self, peer: int) -> bool:
        """Whether a side of this pair requires that all is encrypted."""
        return self._encrypts or (peer in self._kept and self._kept[peer].secret)

    def require_seal(self, message: Message, data: bytes) -> None:
        """Check that a message is sealed, if its sender shares a key with this side.

        In a pair that encrypts, only byes and refusals are sealed. If the peer cannot encrypt, streams are not sealed:
        PSPM pays for each set-position, from any sender. `is_proven` checks hellos and welcomes.

        Raises BadMessage: it is not.
        """
        if not isinstance(message, OfPeer | Stream) or message.incarnation not in self._kept:
            return
        shared = self._kept[message.incarnation]
        if shared.cipher is not None and not isinstance(message, Bye | Refuse):
            raise BadMessage("forged", f"a message in the name of {message.incarnation:#x} that is not encrypted")
        if isinstance(message, OfPeer) and not is_sealed(shared.key, message.more, data):
            raise BadMessage("forged", f"a message in the name of {message.incarnation:#x} without its seal")

    def note(self, other: int, more: Mapping[str, Any] | None) -> bool:
        """Remember the key that `other` offers in a hello or a welcome; True if it offered another one before."""
        offered = _offered(more)
        if self._secret is None or other == self._mine:
            return False
        if other not in self._first and len(self._first) >= MOST_OFFERS:
            return False
        if self._first.setdefault(other, offered) == offered:
            return False
        if len(self.disputed) < MOST_OFFERS:
            self.disputed.add(other)
        return True

    def is_disputed(self, peer: int) -> bool:
        """Whether more than one key was offered in the peer's name, or this is no longer known."""
        return self._secret is not None and (peer in self.disputed or peer not in self._first)

    def is_other(self, peer: int, more: Mapping[str, Any] | None) -> bool:
        """Whether a hello in the peer's name offers another key than the peer's."""
        return peer in self._kept and self._kept[peer].public != _offered(more)

    def misfit(self, name: str, more: Mapping[str, Any] | None) -> str:
        """Return why a side with these further entries cannot be the peer; empty if it can."""
        return f"{name} cannot encrypt, and this side must" if self._encrypts and _must_encrypt(more) is None else ""

    def must_prove(self, more: Mapping[str, Any] | None) -> bool:
        """Whether a side with these further entries must prove itself: if it offers a key, or if this side has a
        word.
        """
        return self._secret is not None and (self._secret.has_word or _offered(more) is not None)

    def has_key(self, more: Mapping[str, Any] | None) -> bool:
        """Whether these further entries offer a key."""
        return _offered(more) is not None

    def key_for(self, other: int, more: Mapping[str, Any] | None) -> bytes | None:
        """The key shared with `other`, whose further entries these are; None: one of the two offers no key.

        Raises BadMessage: `other` offers an invalid key.
        """
        public = _offered(more)
        if self._secret is None or public is None:
            return None
        key = self._derived.get((other, public))
        if key is None:
            if len(self._derived) >= MOST_KEYS:
                del self._derived[next(iter(self._derived))]
            key = self._derived[other, public] = self._secret.key(self._mine, other, public)
        return key

    def is_proven(self, other: int, more: Mapping[str, Any] | None, data: bytes) -> bool:
        """Whether the hello or welcome `data` is sealed with the key that it offers, and so with the word.

        Raises BadMessage: `other` offers an invalid key.
        """
        key = self.key_for(other, more)
        return key is not None and is_sealed(key, more, data)

    def may_refuse(self, other: int, more: Mapping[str, Any] | None, data: bytes) -> bool:
        """Whether a stranger's refusal counts: it must be sealed if the stranger has offered a key, or if this side has
        a word.
        """
        if self._secret is None:
            return True
        if not self._secret.has_word and self._first.get(other) is None:
            return True
        return any(is_sealed(key, more, data) for (who, _), key in self._derived.items() if who == other)

    def keep(self, peer: int, more: Mapping[str, Any] | None) -> None:
        """Keep the key of a new peer. more : the further entries of its welcome."""
        if (key := self.key_for(peer, more)) is not None:
            public, required = _offered(more), _must_encrypt(more)
            assert public is not None
            cipher = None if required is None else Cipher(key, self._mine, peer)
            self._kept[peer] = _Shared(public, key, cipher, bool(required) or self._encrypts)
        self._met = 0, None


def _offered(more: Mapping[str, Any] | None) -> bytes | None:
    """The public key in a hello or a welcome; None: there is none."""
    key: bytes | None = (more or {}).get(KEY)
    return key


def _must_encrypt(more: Mapping[str, Any] | None) -> bool | None:
    """Whether a hello or a welcome requires encryption. None: its sender cannot encrypt."""
    required: bool | None = (more or {}).get(ENCRYPTS)
    return required


def _tag(key: bytes, data: bytes) -> bytes:
    return hmac.digest(key, data, "sha256")[:TAG_BYTES]
