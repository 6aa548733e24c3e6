"""A secret that only the two sides of a pair know, and the tags that it puts under frames.

Each process has a key pair of X25519 (RFC 7748). Its public half is in its hello and its welcome; both sides derive
the same key from it (RFC 5869). A tag is HMAC-SHA-256 (RFC 2104) of all the frame's bytes before it, cut to 8 bytes.

Whoever can only listen learns no key, and cannot make a tag. Who speaks while the two pair may offer keys of his own
in their names, and so stand between them. A word that both users know keeps him out: it is part of each key, and so of
each proof that a side has one. Without a word two keys in one name show him, or a fingerprint that the users compare.
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
"""What proves who the peer is: a word that both users know; a certificate that each side wants to see; or that the link
is a socket that only this machine's user can open."""

MOST_OFFERS = 4096
"""So many incarnations are remembered with the key that they offered first; who offers more hides one of them."""

MOST_KEYS = 256
"""So many keys of strangers are kept; the oldest is derived again when it is needed."""

FINGERPRINT_BYTES = 10
"""Of a pair's key: 80 bits. Who wants two pairs to show the same must try 2^40 keys of his own against each side, after
both have said hello and before they pair."""

OF_PAIR: tuple[type[Message], ...] = (*get_args(Stream), Energy, Signals, Account)
"""What the sides of a pair say to each other, beside what begins and ends it."""


class Secret:
    """This side's half of the keys that it shares with its peers.

    private : 32 bytes of the system's generator, drawn when the process starts.
    word : what both users know; empty: nothing. Guessing it takes some 50 ms a try.
    encrypts : pair with nobody who cannot encrypt.
    proof : what else proves who the peer is; None: nothing. A word does in any case.
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
        """The cipher of a side's telemetry, for whoever knows the word; None: there is no word."""
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
    """Decrypt a message of the peer. cipher : of the pair; None: it does not encrypt.

    Raises BadMessage: somebody else has encrypted it, or it is no message of a pair, or of another sender.
    """
    if cipher is None:
        raise BadMessage("forged", "an encrypted message; this pair does not encrypt")
    inside = decode(cipher.decrypt(message))
    if inside.incarnation != message.incarnation or not isinstance(inside, OF_PAIR):
        raise BadMessage("forged", f"a {type(inside).__name__} of {inside.incarnation:#x}, encrypted by its peer")
    return inside


def fingerprint(key: bytes) -> str:
    """Of a pair's key, for people to compare: 16 letters and digits in groups of four."""
    short = hmac.digest(key, b"fingerprint\x01", "sha256")[:FINGERPRINT_BYTES]
    letters = base64.b32encode(short).decode().lower()
    return "-".join(letters[k : k + 4] for k in range(0, len(letters), 4))


class _Shared(NamedTuple):
    """The data shared with a peer: its public key, the shared key, the cipher, and whether either wants it secret."""

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
        self._kept: dict[int, _Shared] = {}  # of all peers so far
        self._first: dict[int, bytes | None] = {}  # what each incarnation offered first
        self._derived: dict[tuple[int, bytes], bytes] = {}
        self._met: tuple[int, bytes | None] = 0, None  # who was welcomed last, and the key of that

    @property
    def met(self) -> tuple[int, bytes | None]:
        """Who may be the next peer, may take this side for its peer already, and the shared key; 0: nobody."""
        return self._met

    def meet(self, other: int, key: bytes | None) -> None:
        """`other` is welcomed, with that key."""
        self._met = other, key

    @property
    def proof(self) -> Proof | Literal["nobody"] | None:
        """The proof of who this side's peer is; None: it shares no keys."""
        return None if self._secret is None else (self._secret.proof or "nobody")

    def shared_with(self, other: int) -> bytes | None:
        """The key for frames to `other`, who was the peer; None: there is none."""
        return self._kept[other].key if other in self._kept else None

    def fingerprint(self, peer: int) -> str:
        """Of the key that is shared with a peer; empty: there is none."""
        return fingerprint(self._kept[peer].key) if peer in self._kept else ""

    def cipher(self, peer: int) -> Cipher | None:
        """The cipher that encrypts for a peer, and decrypts its messages; None: one of the two cannot encrypt."""
        return self._kept[peer].cipher if peer in self._kept else None

    @property
    def must_encrypt(self) -> bool:
        """Whether this side may send nothing that others can read, not even without a peer."""
        return self._encrypts

    def is_secret(self, peer: int) -> bool:
        """Whether a side of this pair may send nothing that others can read."""
        return self._encrypts or (peer in self._kept and self._kept[peer].secret)

    def require_seal(self, message: Message, data: bytes) -> None:
        """Check that a message of someone who shares a key with this side is sealed with it.

        Of a pair that encrypts only byes and refusals come so. Where the peer cannot encrypt, streams are not sealed: a
        set-position costs what it costs, whoever sends it. Hellos and welcomes are judged by `is_proven`.

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
        """Remember what `other` offers in a hello or a welcome. Did it offer something else before?"""
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
        """Whether more than one key was offered in the peer's name, or that is not known any more."""
        return self._secret is not None and (peer in self.disputed or peer not in self._first)

    def is_other(self, peer: int, more: Mapping[str, Any] | None) -> bool:
        """Whether a hello in the peer's name offers another key than the peer did."""
        return peer in self._kept and self._kept[peer].public != _offered(more)

    def misfit(self, name: str, more: Mapping[str, Any] | None) -> str:
        """Why a side that offers this cannot be the peer; empty if it may be."""
        return f"{name} cannot encrypt, and this side must" if self._encrypts and _asks(more) is None else ""

    def must_prove(self, more: Mapping[str, Any] | None) -> bool:
        """Whether a side that offers this must prove itself. All must who offer a key, and where there is a word
        everybody.
        """
        return self._secret is not None and (self._secret.has_word or _offered(more) is not None)

    def has_key(self, more: Mapping[str, Any] | None) -> bool:
        """Whether it offers a key."""
        return _offered(more) is not None

    def key_for(self, other: int, more: Mapping[str, Any] | None) -> bytes | None:
        """The key shared with `other`, who offers this; None: one of the two offers none.

        Raises BadMessage: what `other` offers is no key.
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

        Raises BadMessage: what `other` offers is no key.
        """
        key = self.key_for(other, more)
        return key is not None and is_sealed(key, more, data)

    def may_refuse(self, other: int, more: Mapping[str, Any] | None, data: bytes) -> bool:
        """Whether a stranger's refusal counts. It is sealed if it has offered a key; where there is a word, in any
        case.
        """
        if self._secret is None:
            return True
        if not self._secret.has_word and self._first.get(other) is None:
            return True
        return any(is_sealed(key, more, data) for (who, _), key in self._derived.items() if who == other)

    def keep(self, peer: int, more: Mapping[str, Any] | None) -> None:
        """`peer` is the peer from now on; `more` : of its welcome."""
        if (key := self.key_for(peer, more)) is not None:
            public, asks = _offered(more), _asks(more)
            assert public is not None
            cipher = None if asks is None else Cipher(key, self._mine, peer)
            self._kept[peer] = _Shared(public, key, cipher, bool(asks) or self._encrypts)
        self._met = 0, None


def _offered(more: Mapping[str, Any] | None) -> bytes | None:
    """The public key in a hello or a welcome; None: there is none."""
    key: bytes | None = (more or {}).get(KEY)
    return key


def _asks(more: Mapping[str, Any] | None) -> bool | None:
    """Whether a hello or a welcome asks for encryption. None: its sender cannot encrypt."""
    asks: bool | None = (more or {}).get(ENCRYPTS)
    return asks


def _tag(key: bytes, data: bytes) -> bytes:
    return hmac.digest(key, data, "sha256")[:TAG_BYTES]
