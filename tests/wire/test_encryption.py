"""Frames that only the other side of a pair can read: held against the page by OpenSSL, and against who has no key."""

from pathlib import Path
from typing import Any

import pytest
from cryptography.hazmat.primitives.ciphers.aead import ChaCha20Poly1305
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.kdf.hkdf import HKDFExpand
from hypothesis import given, strategies as st
from msgspec import structs

from hapnet.errors import BadMessage
from hapnet.ext.page.watcher import Watcher
from hapnet.side.endpoint import DeviceEndpoint
from hapnet.side.link_port import LinkPort, Packet
from hapnet.transport.config import ZenohSettings
from hapnet.transport.sampled import sequence_of
from hapnet.transport.security import Security
from hapnet.wire.encryption import FIRST_OTHER, Cipher, Encrypted, read
from hapnet.wire.events import Contradiction, Mismatch, Paired, PositionReceived
from hapnet.wire.messages import (
    Account,
    Bye,
    Energy,
    Hello,
    Message,
    Position,
    Refuse,
    Signals,
    Welcome,
    decode,
    encode,
)
from hapnet.wire.secret import Secret
from hapnet.wire.session import Session
from netem import Link, LinkProfile
from tests.support.sessions import MS, Network

KEY = bytes(range(32))
WORD = "correct horse"


def side(role: Any, incarnation: int, encrypts: bool | None, word: str = "") -> Session:
    secret = None if encrypts is None else Secret(bytes([incarnation]) * 32, word, encrypts=encrypts)
    return Session(role=role, dof=2, name=role, incarnation=incarnation, secret=secret)


def pair(of_device: bool | None, of_world: bool | None, loss: float = 0.0) -> tuple[Network, Session, Session]:
    network = Network(device := side("device", 1, of_device), world := side("world", 2, of_world), loss=loss)
    network.run(300 * MS)
    return network, device, world


def sent(session: Session, now_ns: int, position: tuple[float, ...]) -> bytes:
    frame = session.outward(session.position(now_ns, position))
    assert frame is not None
    return frame


def test_a_frame_is_what_the_page_says_by_another_library() -> None:
    inside = encode(Position(7, 42, 10**9, (0.01, -0.25)))
    frame = Cipher(KEY, 7, 9).encrypt(inside, 42)
    message = decode(frame)
    assert isinstance(message, Encrypted)
    assert (message.incarnation, message.number) == (7, 42)
    own = HKDFExpand(SHA256(), 32, b"frames" + (7).to_bytes(8, "big")).derive(KEY)
    head = frame[:21]
    assert ChaCha20Poly1305(own).decrypt((42).to_bytes(12, "big"), message.content, head) == inside
    assert Cipher(KEY, 9, 7).decrypt(message) == inside
    assert read(frame) == message


def test_the_page_s_example_is_what_is_sent() -> None:
    lines = (Path(__file__).parents[1] / "data" / "frames.txt").read_text().splitlines()
    frames = {name: bytes.fromhex(frame) for name, frame in (line.split() for line in lines if line[0] != "#")}
    a, b = 0x1122334455667788, 0xFEDCBA9876543210
    example = decode(frames["encrypted"])
    assert example == decode(Cipher(KEY, a, b).encrypt(frames["position"], 7))
    assert isinstance(example, Encrypted)
    assert Cipher(KEY, b, a).decrypt(example) == frames["position"]


@given(st.binary(min_size=1, max_size=200), st.integers(0, 2**63 - 1), st.integers(0, 10**4), st.integers(1, 255))
def test_no_byte_of_it_can_be_another(inside: bytes, number: int, place: int, flip: int) -> None:
    data = bytearray(Cipher(KEY, 7, 9).encrypt(inside, number))
    data[place % len(data)] ^= flip
    try:
        message = decode(bytes(data))
    except BadMessage:
        return
    if isinstance(message, Encrypted):
        with pytest.raises(BadMessage, match="encrypted by another"):
            Cipher(KEY, 9, 7).decrypt(message)


@given(st.lists(st.booleans(), max_size=50))
def test_no_number_is_used_twice(of_stream: list[bool]) -> None:
    session, cipher = side("device", 1, None), Cipher(KEY, 1, 2)
    numbers = []
    for is_stream in of_stream:
        frame = session.position(0, (0.0, 0.0)) if is_stream else encode(Energy(1, 2, 5, 5))
        message: Any = decode(cipher.encrypt(frame, sequence_of(frame) if is_stream else None))
        numbers.append(message.number)
        assert (message.number < FIRST_OTHER) == is_stream
    assert len(set(numbers)) == len(numbers)


@pytest.mark.parametrize(("of_device", "of_world"), [(True, True), (True, False), (False, True), (False, False)])
def test_all_who_can_encrypt_do_and_nothing_can_be_read(of_device: bool, of_world: bool) -> None:
    """Whether that must be so, and what watchers hear too, either side may ask for."""
    network, device, world = pair(of_device, of_world)
    assert device.encrypts is world.encrypts is (of_device or of_world)
    (paired,) = network.happened(device, Paired)
    assert isinstance(paired, Paired)
    assert paired == Paired(world.identity, 1, True, "nobody", device.fingerprint)
    assert device.fingerprint == world.fingerprint
    network.sent.clear()
    device.shuffle(2e-3)
    world.report("stop", "now")
    device.accounts.report({"ledger.margin_J": 0.125}, final=False)
    frame = sent(device, network.now, (0.0123, -0.5))
    (event,) = [e for e in world.receive(network.now + MS, frame) if isinstance(e, PositionReceived)]
    assert event.position == (0.0123, -0.5)
    network.run(300 * MS)
    assert world.credited_nJ == device.acked_nJ == 2_000_000
    assert world.accounts.heard is not None
    assert {type(decode(data)) for data in [*network.sent, frame]} == {Encrypted}
    assert not device.dropped
    assert not world.dropped
    device.close(network.now, "the end")
    network.run(100 * MS)
    assert world.peer is None
    assert type(decode(network.sent[-1])) is Bye


def test_energy_is_credited_exactly_once_over_a_bad_network() -> None:
    network, device, world = pair(True, True, loss=0.3)
    network.repeat, network.jitter = 0.2, 30 * MS
    for _ in range(50):
        device.shuffle(1e-3)
        network.run(20 * MS)
    network.loss = 0.0
    network.run(3000 * MS)
    assert world.credited_nJ == device.acked_nJ == device.sent_nJ == 50_000_000
    assert set(world.dropped) <= {"stale", "stranger", "forged"}


def test_a_side_that_cannot_encrypt_is_refused() -> None:
    network, device, _ = pair(True, None)
    assert device.peer is None
    assert device.outward(device.position(0, (0.0, 0.0))) is None
    why = [event.reason for event in network.happened(device) if isinstance(event, Mismatch)]
    assert why
    assert all("cannot encrypt, and this side must" in reason for reason in why)


def test_a_side_that_could_encrypt_sends_no_stream_without_a_peer() -> None:
    """It would come after the next peer has paired, which would report that another sender uses this one's name."""
    network, device, world = pair(False, False)
    assert world.outward(world.position(0, (0.0, 0.0))) is not None
    device.close(network.now, "done")
    network.run(300 * MS)
    assert world.peer is None
    assert world.outward(world.position(network.now, (0.0, 0.0))) is None
    alone = side("world", 3, None)
    frame = alone.position(0, (0.0, 0.0))
    assert alone.outward(frame) == frame  # without keys nothing is encrypted


def test_who_takes_the_wish_out_of_the_hellos_changes_nothing() -> None:
    """Only a welcome pairs, and a welcome is sealed."""

    class Stripping(Network):
        def put(self, sender: Session, data: bytes) -> None:
            message = decode(data)
            if isinstance(message, Hello):
                data = encode(structs.replace(message, more=(message.more or {}) | {"encrypts": False}))
            super().put(sender, data)

    network = Stripping(device := side("device", 1, True), world := side("world", 2, False))
    network.run(300 * MS)
    assert (device.peer, world.peer) == (world.identity, device.identity)
    assert world.encrypts


@pytest.mark.parametrize(
    "message",
    [
        Position(2, 5, 10**9, (0.5, 0.5)),
        Energy(2, 1, 10**9, 0),
        Signals(2, 1, 9, {"stop": "now"}),
        Account(2, 1, 9, 0, True, True, {}),
        Bye(2, 1, 0, "the end"),
        Refuse(2, 1, "no"),
        Encrypted(2, 10**6, bytes(40)),
    ],
    ids=lambda message: type(message).__name__,
)
def test_what_a_stranger_says_in_the_peers_name_is_dropped(message: Message) -> None:
    network, device, _ = pair(True, True)
    (event,) = device.receive(network.now, encode(message))
    assert isinstance(event, Contradiction)  # without a word: perhaps the pair's key is a stranger's
    assert device.receive(network.now, encode(message)) == ()  # reported once
    assert device.dropped == {"forged": 2}
    assert device.peer is not None
    assert device.credited_nJ == 0


@pytest.mark.parametrize("inside", [Hello(2, 1, "world", 2, "world", {}), Welcome(2, 1, 1, "world", 2, "world", {}),
                                    Position(3, 5, 10**9, (0.5, 0.5)), Encrypted(2, 1, bytes(40))],
                         ids=lambda message: type(message).__name__)  # fmt: skip
def test_a_peer_encrypts_what_a_pair_says_and_nothing_else(inside: Message) -> None:
    network, device, world = pair(True, True)
    device.receive(network.now, world._cipher.encrypt(encode(inside)))
    assert device.dropped == {"forged": 1}
    assert device.peer == world.identity


def test_an_encrypted_message_to_a_pair_that_does_not_encrypt_is_dropped() -> None:
    network, device, _ = pair(None, None)
    assert device.receive(network.now, encode(Encrypted(2, 3, bytes(40)))) == ()
    assert device.dropped == {"forged": 1}
    assert sent(device, 0, (0.5, 0.5)) == encode(Position(1, 0, 0, (0.5, 0.5)))


def test_the_link_carries_encrypted_frames_and_none_before_there_is_a_peer() -> None:
    device = side("device", 1, True)
    port = LinkPort(DeviceEndpoint(device), Link[Packet](LinkProfile()))
    assert list(port.send(0, device.position(0, (0.1, 0.2)))) == []
    network = Network(device, side("world", 2, True))
    network.run(300 * MS)
    ((kind, data),) = port.send(network.now, device.position(network.now, (0.1, 0.2)))
    assert kind == "position"
    assert type(decode(data)) is Encrypted
    assert sequence_of(data) == 1  # what the transport samples by


@pytest.mark.parametrize(("word", "reads"), [(WORD, True), ("battery staple", False), ("", False)])
def test_telemetry_is_for_those_who_know_the_word(word: str, reads: bool, tmp_path: Any) -> None:
    file = tmp_path / "word"
    file.write_text(word + "\n")
    heard: list[Any] = []
    settings = ZenohSettings(connect=("tcp/127.0.0.1:1",), security=Security(secret_file=file if word else None))
    watcher = Watcher(settings, heard.append)
    cipher = Secret(b"s" * 32, WORD).for_watchers(5)
    from hapnet.recording.telemetry import KnownPlanes, encode as reported

    watcher._receive("hapnet/one/pen/up/telemetry", cipher.encrypt(reported(KnownPlanes(()))))
    assert heard == ([KnownPlanes(())] if reads else [])
    assert (watcher.telemetry.unreadable, watcher.telemetry.undecrypted) == ((0, 0) if reads else (1, 1))
    assert Secret(b"s" * 32).for_watchers(5) is None
