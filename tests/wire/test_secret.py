"""Keys and tags: held against RFC 7748, against OpenSSL's HKDF, and against whoever has no key."""

import hashlib
import hmac
from typing import Any

import pytest
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey, X25519PublicKey
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.kdf.hkdf import HKDF
from hypothesis import given, strategies as st
from msgspec import structs

from hapnet.errors import BadMessage
from hapnet.wire.events import Contradiction, EnergyCredited, Mismatch, Paired, PeerRefused, Unproven
from hapnet.wire.messages import Bye, Energy, Hello, Refuse, Signals, decode, encode
from hapnet.wire.secret import TAG_BYTES, Secret, is_sealed, sealed
from hapnet.wire.session import Session
from tests.support.sessions import MS, Network

KEY = bytes(range(32))


def side(role: Any, incarnation: int, word: str | None = "") -> Session:
    secret = None if word is None else Secret(bytes([incarnation]) * 32, word)
    return Session(role=role, dof=1, name=role, incarnation=incarnation, secret=secret)


def pair(of_device: str | None, of_world: str | None) -> tuple[Network, Session, Session]:
    network = Network(device := side("device", 1, of_device), world := side("world", 2, of_world))
    network.run(300 * MS)
    return network, device, world


@pytest.mark.parametrize("word", ["", "correct horse"])
@pytest.mark.long
def test_the_key_is_that_of_the_page_by_another_library(word: str) -> None:
    """HKDF with salt and info as the page says; scrypt of the word behind the shared secret."""
    mine, theirs = Secret(b"m" * 32, word), Secret(b"t" * 32, word)
    shared = X25519PrivateKey.from_private_bytes(b"m" * 32).exchange(X25519PublicKey.from_public_bytes(theirs.public))
    stretched = hashlib.scrypt(word.encode(), salt=b"hapnet, version 2", n=2**14, r=8, p=1) if word else b""
    info = (7).to_bytes(8, "big") + theirs.public + (2**63).to_bytes(8, "big") + mine.public  # the lower one first
    expected = HKDF(SHA256(), 32, b"hapnet, version 2", info).derive(shared + stretched)
    assert mine.key(2**63, 7, theirs.public) == theirs.key(7, 2**63, mine.public) == expected


def test_a_public_key_that_gives_no_secret_is_refused() -> None:
    with pytest.raises(BadMessage):
        Secret(b"m" * 32).key(1, 2, bytes(32))  # RFC 7748, section 6.1: the result would be zero


SEALED = [
    Energy(1, 2, 10, 5, {"sums": (3, 10, 2)}),
    Energy(1, 2, 10, 5),
    Signals(1, 2, 4, {"stop": "now"}),
    Bye(1, 2, 10, "the end"),
    Refuse(1, 2, "no"),
]


@pytest.mark.parametrize("message", SEALED, ids=lambda message: type(message).__name__)
def test_a_seal_is_hmac_of_all_before_it(message: Any) -> None:
    data = sealed(message, KEY)
    assert data[-TAG_BYTES:] == hmac.new(KEY, data[:-TAG_BYTES], "sha256").digest()[:TAG_BYTES]
    read: Any = decode(data)
    assert is_sealed(KEY, read.more, data)
    assert not is_sealed(KEY[::-1], read.more, data)
    assert structs.replace(read, more=None) == structs.replace(message, more=None)


@given(st.sampled_from(SEALED), st.integers(0, 10**4), st.integers(1, 255))
def test_no_byte_of_a_sealed_frame_can_be_another(message: Any, place: int, flip: int) -> None:
    data = bytearray(sealed(message, KEY))
    data[place % len(data)] ^= flip
    try:
        read: Any = decode(bytes(data))
    except BadMessage:
        return
    assert not is_sealed(KEY, read.more, bytes(data))


@pytest.mark.parametrize("word", ["", "correct horse"])
def test_two_sides_agree_and_exchange_energy(word: str) -> None:
    network, device, world = pair(word, word)
    assert (device.peer, world.peer) == (world.identity, device.identity)
    device.shuffle(2e-3)
    world.shuffle(1e-3)
    network.run(600 * MS)
    assert (world.credited_nJ, device.credited_nJ) == (2_000_000, 1_000_000)
    assert (device.acked_nJ, world.acked_nJ) == (2_000_000, 1_000_000)
    assert not device.dropped
    assert not world.dropped
    device.close(600 * MS, "the end")
    network.run(700 * MS)
    assert world.peer is None


@pytest.mark.parametrize(("of_device", "of_world"), [(None, ""), ("", None), (None, None)])
def test_a_side_without_a_secret_is_a_peer_as_ever(of_device: str | None, of_world: str | None) -> None:
    network, device, world = pair(of_device, of_world)
    device.shuffle(2e-3)
    network.run(600 * MS)
    assert world.credited_nJ == 2_000_000
    assert not device.dropped
    assert not world.dropped


@pytest.mark.parametrize(
    ("of_device", "of_world"),
    [("correct horse", "battery staple"), ("correct horse", ""), ("correct horse", None)],
)
@pytest.mark.long
def test_who_does_not_know_the_word_is_ignored_by_who_does(of_device: str, of_world: str | None) -> None:
    """Neither pairs, neither ends; whoever has the word says so."""
    network, device, world = pair(of_device, of_world)
    assert device.peer is world.peer is None
    assert len(network.happened(device, Unproven)) == 1
    assert not network.happened(device, Mismatch, PeerRefused)
    if of_world is not None:
        assert len(network.happened(world, Unproven)) == 1
    world.shuffle(1e-3)
    network.run(600 * MS)
    assert device.credited_nJ == 0


@pytest.mark.parametrize(
    "message",
    [
        Energy(2, 1, 10**9, 0),
        Signals(2, 1, 9, {"stop": "now"}),
        Bye(2, 1, 0, "the end"),
        Refuse(2, 1, "no"),
    ],
    ids=lambda message: type(message).__name__,
)
@pytest.mark.long
def test_what_is_not_sealed_changes_nothing(message: Any) -> None:
    """With a word it shows nothing either; without one it may be the true peer's, and this side's a stranger."""
    for word in ("correct horse", ""):
        _, device, world = pair(word, word)
        heard = dict(device.signals.heard)
        events = [
            event for frame in (encode(message), sealed(message, KEY)) for event in device.receive(301 * MS, frame)
        ]
        assert [type(event) for event in events] == ([] if word else [Contradiction])
        assert (device.peer, device.credited_nJ, device.signals.heard) == (world.identity, 0, heard)
        assert device.dropped == {"forged": 2}
        assert device.sums.contradictions == ({} if word else {"seals": 2})


def test_without_a_secret_a_forged_total_ends_no_stream() -> None:
    """One frame of 2^62 nJ: credited as far as the bucket allows, reported, and the true messages count as before."""
    _, device, world = pair(None, None)
    world.receive(301 * MS, encode(Energy(1, 2, 2**62, 0)))
    assert world.credited_nJ == 500_000_000  # the burst
    world.shuffle(3e-3)
    (frame,) = world.poll(302 * MS)[0]
    reported, credited = device.receive(303 * MS, frame.data)
    assert isinstance(reported, Contradiction)
    assert credited == EnergyCredited(3_000_000)


def test_a_hello_or_a_welcome_with_another_key_displaces_nobody() -> None:
    for word in ("correct horse", ""):
        _, device, world = pair(word, word)
        hello = Hello(2, 7, "world", 1, "world", {}, {"key": Secret(b"f" * 32).public})
        events = device.receive(301 * MS, encode(hello))
        assert [type(event) for event in events] == ([] if word else [Contradiction])
        assert device.peer == world.identity
        assert device.poll(301 * MS)[0] == []  # no answer to it


def test_a_welcome_that_is_not_sealed_pairs_nobody() -> None:
    """The forger answers first, with the world's own public key: but he cannot seal."""
    device, world = side("device", 1), side("world", 2)
    device.receive(0, world.poll(0)[0][0].data)
    answers = [frame.data for frame in device.poll(0)[0]]  # a hello to the world among them
    assert [decode(data).more.get("answers") for data in answers].count((2, 1)) == 1
    for data in answers:
        world.receive(0, data)
    true = next(frame.data for frame in world.poll(20 * MS)[0] if frame.data[2] == 4)
    forged = decode(true)
    assert device.receive(21 * MS, encode(forged)[:-TAG_BYTES] + bytes(TAG_BYTES)) == (Unproven(),)
    assert device.dropped == {"forged": 1}
    assert isinstance(device.receive(22 * MS, true)[0], Paired)
