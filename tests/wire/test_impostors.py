"""Strangers who only add frames: what they can do with neither key nor word, with a key, and against a word.

Each cell of the table of strangers in `hapnet/wire/README.md` that is about adding frames is a test here or in
`tests/properties/test_forger.py` and `test_between.py`; listening is in `test_encryption.py` and
`test_eavesdropper.py`.
"""

import random
from collections.abc import Callable
from functools import cache
from typing import Any

import pytest

from hapnet.summary.structure import read
from hapnet.summary.verdict import contradicted, judge
from hapnet.wire.events import Contradiction, Mismatch, Paired, PeerLeft, PeerRefused, Unproven
from hapnet.wire.messages import Bye, Energy, Hello, Position, Refuse, Welcome, decode, encode
from hapnet.wire.secret import Secret, sealed
from hapnet.wire.session import Session
from tests.conftest import mostly_slow
from tests.support.sessions import MS, Network

WORD = "correct horse"
Says = Callable[["Noisy"], list[tuple[Session, bytes]]]


@cache
def secret_of(private: bytes, word: str = "") -> Secret:
    """A word takes 50 ms to stretch."""
    return Secret(private, word)


@cache
def key_of(private: bytes, mine: int, theirs: int, other: bytes) -> bytes:
    return secret_of(private).key(mine, theirs, secret_of(other).public)


def side(role: Any, incarnation: int, word: str | None = WORD, private: bytes | None = None) -> Session:
    secret = None if word is None else secret_of(private or bytes([incarnation]) * 32, word)
    return Session(role=role, dof=1, name=role, incarnation=incarnation, secret=secret)


class Noisy(Network):
    """A network with somebody on it who hears all, and whose frames come at once. says : what he says, every 5 ms."""

    def __init__(self, *sessions: Session, says: Says, **words: Any) -> None:
        super().__init__(*sessions, **words)
        self.says = says

    def run(self, duration_ns: int) -> None:
        for _ in range(duration_ns // (5 * MS)):
            for to, data in self.says(self):
                self.events.setdefault(to.identity.incarnation, []).extend(to.receive(self.now, data))
            super().run(5 * MS)


def hello(incarnation: int, number: int, role: Any, private: bytes = b"h" * 32) -> bytes:
    return encode(Hello(incarnation, number, role, 1, "he", {}, {"key": secret_of(private).public, "encrypts": False}))


def hog(network: Noisy) -> list[tuple[Session, bytes]]:
    """He says hello to both, 200 times a second, in one name that he keeps."""
    return [(s, hello(99, network.now // MS + 1, "device" if s.identity.role == "world" else "world"))
            for s in network.sessions]  # fmt: skip


def crowd(network: Noisy) -> list[tuple[Session, bytes]]:
    """In another name each time."""
    return [(s, hello(1000 + network.now // MS, 1, "device" if s.identity.role == "world" else "world"))
            for s in network.sessions]  # fmt: skip


def welcomes(network: Noisy) -> list[tuple[Session, bytes]]:
    """He welcomes each side in the other's name, with his own key, and with a true seal of that key."""
    said = []
    for s in network.sessions:
        other = next(each.identity for each in network.sessions if each is not s)
        mine, theirs = other.incarnation, s.identity.incarnation
        key = key_of(b"h" * 32, mine, theirs, bytes([theirs]) * 32)
        more = {"key": secret_of(b"h" * 32).public, "encrypts": False}
        for number in range(1, 4):
            welcome = Welcome(other.incarnation, s.identity.incarnation, number, other.role, 1, other.name, {}, more)
            said.append((s, sealed(welcome, key)))
    return said


def refusals(network: Noisy) -> list[tuple[Session, bytes]]:
    """He refuses each in the other's name and in his own, sealed with what he likes, and says goodbye."""
    said = []
    for s in network.sessions:
        other = next(each.identity.incarnation for each in network.sessions if each is not s)
        for who in (other, 99):
            refusal, bye = Refuse(who, s.identity.incarnation, "go away"), Bye(who, s.identity.incarnation, 0, "done")
            said += [(s, frame) for each in (refusal, bye) for frame in (encode(each), sealed(each, bytes(32)))]
    return said


def other_version(network: Noisy) -> list[tuple[Session, bytes]]:
    return [(s, b"\x98\x01" + hello(99, 1, "device")[2:]) for s in network.sessions]


def misfit(network: Noisy) -> list[tuple[Session, bytes]]:
    """Hellos that fit nobody, with a key and without."""
    said = []
    for s in network.sessions:
        role: Any = "device" if s.identity.role == "world" else "world"
        said += [(s, encode(Hello(99, 1, role, 7, "he", {}, more))) for more in (None, {"key": bytes(32)})]
        said.append((s, encode(Hello(98, 1, role, 7, "he", {}, {"key": secret_of(b"h" * 32).public}))))
    return said


def recorded(network: Noisy) -> list[tuple[Session, bytes]]:
    """He repeats all that was ever said, to everybody, and what he recorded of an earlier run with the same word."""
    rng = random.Random(network.now)
    frames = EARLIER + network.sent
    return [(s, frame) for s in network.sessions for frame in rng.sample(frames, min(5, len(frames)))]


def run_before() -> list[bytes]:
    network = Network(side("device", 51), side("world", 52))
    network.run(300 * MS)
    return network.sent


EARLIER = run_before()
KINDS = (hog, crowd, welcomes, refusals, other_version, misfit, recorded)


def paired_within_a_second(network: Noisy, device: Session, world: Session) -> bool:
    while network.now < 1000 * MS and (device.peer is None or world.peer is None):
        network.run(20 * MS)
    return device.peer == world.identity and world.peer == device.identity


@pytest.mark.parametrize("seeds", [range(2), pytest.param(range(100), marks=pytest.mark.soak)], ids=["two", "all"])
@pytest.mark.parametrize("says", mostly_slow([(one,) for one in KINDS], 3), ids=lambda says: says.__name__)
@pytest.mark.long
def test_against_a_word_he_holds_no_place_and_ends_nothing(says: Says, seeds: range) -> None:
    """Paired within a second, a hundred of a hundred; and what he says changes nothing afterwards either."""
    for seed in seeds:
        device, world = side("device", 1), side("world", 2)
        network = Noisy(device, world, says=says, seed=seed, loss=0.1, jitter=10 * MS)
        assert paired_within_a_second(network, device, world), seed
        if seed == 0:
            device.shuffle(2e-3)
            network.run(600 * MS)
            assert world.credited_nJ == device.acked_nJ == 2_000_000
            assert len(network.happened(device, Paired)) == 1
        for s in (device, world):
            ended = (Mismatch, PeerRefused, PeerLeft, Contradiction)
            assert not network.happened(s, *ended), (seed, network.happened(s, *ended))
            assert not s.sums.contradictions


@pytest.mark.parametrize("says", [hog, crowd, other_version], ids=lambda says: says.__name__)
def test_who_only_says_hello_keeps_nobody_apart(says: Says) -> None:
    """Without a word too: he offers a key, so he has to prove that he holds it."""
    for seed in range(3):
        device, world = side("device", 1, ""), side("world", 2, "")
        network = Noisy(device, world, says=says, seed=seed, loss=0.1, jitter=10 * MS)
        assert paired_within_a_second(network, device, world), seed


def test_a_proof_counts_once_and_only_for_whom_it_is() -> None:
    """A hello that answers one of the world's is repeated, to the world and to the device: neither is a proof again."""
    device, world, other = side("device", 1), side("world", 2), side("device", 3)
    device.receive(0, world.poll(0)[0][0].data)
    answer = next(f.data for f in device.poll(0)[0] if (decode(f.data).more or {}).get("answers") == (2, 1))  # type: ignore[union-attr]
    world.receive(1, answer)
    assert next(type(decode(frame.data)) for frame in world.poll(1)[0]) is Welcome
    for k in range(1, 30):  # he repeats it, but the device is gone
        world.receive(k * 100 * MS, answer)
        kinds = [type(decode(frame.data)) for frame in world.poll(k * 100 * MS)[0]]
        assert Welcome not in kinds
    assert other.receive(0, answer) == ()  # both are devices
    assert not world.receive(2900 * MS, encode(Position(1, 0, 1, (0.0,))))


@pytest.mark.parametrize("key", [b"h" * 32, None], ids=["another key", "no key"])
@pytest.mark.parametrize("before", [True, False], ids=["before", "after"])
@pytest.mark.parametrize("word", [WORD, ""], ids=["word", "no word"])
def test_two_keys_in_one_name(word: str, before: bool, key: bytes | None) -> None:
    """Without a word the verdict is not known, whenever it happens; with one it is a stranger's frame and no more."""
    more = None if key is None else {"key": secret_of(key).public, "encrypts": False}
    forged = encode(Hello(2, 1, "world", 1, "world", {}, more))
    device, world = side("device", 1, word), side("world", 2, word)
    network = Network(device, world)
    if before:
        device.receive(0, forged)
    network.run(500 * MS)
    if not before:
        network.events[1] += device.receive(network.now, forged)
    assert device.peer == world.identity
    found = [event.kind for event in network.happened(device, Contradiction) if isinstance(event, Contradiction)]
    assert found == ([] if word else ["keys"])
    assert device.sums.contradictions["keys"] == (0 if word else 1)


def test_who_forgets_which_keys_were_offered_does_not_take_them_for_one() -> None:
    """Thousands of names are remembered; who offers more hides the true key, so whoever comes then is doubted."""
    device, world = side("device", 1, ""), side("world", 2, "")
    for k in range(4096):
        device._handshake.keys.note(100 + k, {"key": bytes(32)})
    network = Network(device, world)
    network.run(500 * MS)
    assert device.peer == world.identity
    assert [event.kind for event in network.happened(device, Contradiction)] == ["keys"]  # type: ignore[attr-defined]


@pytest.mark.parametrize(("word", "doubts"), [(WORD, False), ("", True)])
@pytest.mark.parametrize("message", [Energy(2, 1, 10**9, 0), Position(2, 9, 10**9, (0.0,)), Bye(2, 1, 0, "end")],
                         ids=lambda message: type(message).__name__)  # fmt: skip
def test_a_false_seal_in_the_peers_name(message: Any, word: str, doubts: bool) -> None:
    device, world = side("device", 1, word), side("world", 2, word)
    network = Network(device, world)
    network.run(300 * MS)
    events = device.receive(network.now, encode(message))
    assert [type(event) for event in events] == ([Contradiction] if doubts else [])
    assert device.peer == world.identity
    assert device.credited_nJ == 0


def test_both_show_the_same_fingerprint_and_with_a_stranger_between_not() -> None:
    shown = set()
    for private in (b"a" * 32, b"b" * 32):
        device, world = side("device", 1, "", private), side("world", 2, "")
        Network(device, world).run(300 * MS)
        assert device.fingerprint == world.fingerprint
        assert [len(group) for group in device.fingerprint.split("-")] == [4, 4, 4, 4]
        shown.add(device.fingerprint)
    assert len(shown) == 2


def test_who_has_no_key_is_a_peer_where_there_is_no_word_and_is_told_of_it_where_there_is() -> None:
    for word in ("", WORD):
        device, world = side("device", 1, word), side("world", 2, None)
        network = Network(device, world)
        network.run(500 * MS)
        assert (device.peer is None) == bool(word)
        assert bool(network.happened(device, Unproven)) == bool(word)
        if word:
            (event, *_) = network.happened(world, PeerRefused)
            assert isinstance(event, PeerRefused)
            assert event.reason == "world has no secret, and this side has one"


def summary(**peer: Any) -> dict[str, Any]:
    ledger = {"margin_J": 0.1, "slack_J": 0.0, "bound_J": 0.1}
    part = {"ledger": ledger, "sent_nJ": 0, "credited_nJ": 0, "abandoned_nJ": 0, "incarnations": 1}
    return {"coupling": "pspm", "device": part | peer, "world": part, "theorem": {"margin_J": 0.2, "bound_J": 0.2}}


@pytest.mark.parametrize("proof", ["word", "certificate", "socket", "nobody", None])
def test_the_verdict_says_that_nobody_proved_who_the_peer_is(proof: str | None) -> None:
    verdict = judge(summary(peer={"proof": proof}))
    assert verdict["passive"] is True
    assert ("the peer's identity is not proven" in verdict["reason"]) == (proof == "nobody")


@pytest.mark.parametrize("kind", ["keys", "seals"])
def test_the_verdict_is_not_known_where_somebody_else_spoke(kind: str) -> None:
    tree = summary(contradictions={kind: 3})
    assert judge(tree)["passive"] is None
    assert judge(tree)["reason"].startswith("another sender used the world's name: ")
    assert contradicted(tree)
    assert not contradicted(summary())
    assert read(tree)["device"] is not None
