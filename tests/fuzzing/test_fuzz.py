"""Mutated messages into the decoder and into each endpoint: nothing raised, and every law kept after each of them."""

import hashlib
import random
import re
import sys
import tracemalloc
from typing import Any, get_args

import pytest

from hapnet.errors import BadMessage
from hapnet.wire.energy_channel import EnergyChannel
from hapnet.wire.handshake import Handshake
from hapnet.wire.messages import Message, decode
from hapnet.wire.session import SessionSettings
from tests.conftest import mostly_slow
from tests.fuzzing import corpus, coverage_guided, lives, storm
from tests.fuzzing.__main__ import main
from tests.fuzzing.decoder import allowed, decoded
from tests.fuzzing.invariants import Audited
from tests.fuzzing.mutator import Mutator
from tests.fuzzing.storm import TARGETS, run_many

DEFAULT = {"decoder": 8_000, "device": 3_000, "continuous": 3_000, "world": 3_000}
DEFAULT |= {"motion": 500, "port": 500, "wave": 1_000, "proxy": 1_000}  # 20,000 in all
SLOW = {"decoder": 150_000, "device": 100_000, "continuous": 75_000, "world": 100_000}
SLOW |= {"motion": 25_000, "port": 25_000, "wave": 25_000, "proxy": 25_000}  # 525,000 in all; more: -m tests.fuzzing
SLOW_STORM = 20_000


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.long
def test_twenty_thousand_messages_do_no_harm(target: str) -> None:
    run_many(target, 1, DEFAULT[target])


@pytest.mark.parametrize("parts", mostly_slow([10, 1], 0, 1))
@pytest.mark.parametrize("target", TARGETS)
def test_half_a_million_messages_do_no_harm(target: str, parts: int) -> None:
    """A tenth of them among the slow tests."""
    run_many(target, 1_000, SLOW[target] // parts, SLOW_STORM // parts)


def test_a_storm_is_the_same_again() -> None:
    def frames(seed: int) -> list[bytes]:
        mutator = Mutator(random.Random(seed), storm.SEEDS, own=1, role="world", dof=2)
        mutator.peer = 2
        for frame in storm.SEEDS:
            mutator.overhear(frame)
        return [mutator.next() for _ in range(2000)]

    assert frames(7) == frames(7)
    assert frames(7) != frames(8)


@pytest.mark.long
def test_a_storm_reaches_every_kind_of_message_and_of_refusal() -> None:
    mutator = Mutator(random.Random(3), storm.SEEDS, own=corpus.DEVICE, role="world", dof=1)
    mutator.peer = corpus.WORLD
    kinds: set[str] = set()
    for _ in range(20_000):
        try:
            kinds.add(type(decode(mutator.next())).__name__)
        except BadMessage as error:
            kinds.add(error.kind)
    assert kinds == {cls.__name__ for cls in get_args(Message)} | {
        "size", "malformed", "version", "kind", "length", "type", "range", "dimension",
    }  # fmt: skip


def test_the_corpus_is_small_and_the_conversation_in_it_is_the_same_to_the_byte() -> None:
    assert len(corpus.seeds()) < 200
    assert sum(map(len, corpus.seeds().values())) < 200_000
    said = repr(sorted(corpus.conversation().items())).encode()
    assert hashlib.sha256(said).hexdigest() == "f4a5fd1f9ad5cf29c76a6d93bb36080033c74329563767bae9bff9f52c784c61"


@pytest.mark.parametrize("name", corpus.seeds())
def test_the_predicate_and_the_decoder_agree_on_the_corpus(name: str) -> None:
    data = corpus.seeds()[name]
    message = decoded(data)
    assert (message is not None) == (allowed(data) is not None)
    if name.startswith(("golden-", "session-")):
        assert message is not None


@pytest.mark.long
@pytest.mark.slow
def test_what_coverage_found_does_no_harm() -> None:
    """The lives that atheris begins with, and the deepest that it found, without atheris."""
    for life in [*lives.starts("session"), *corpus.found_lives()]:
        lives.one_life(life)
    assert lives.split(lives.joined([(3, b"frame"), (200, b"")])) == [(3, b"frame"), (200, b"")]


def test_a_frame_may_not_announce_more_than_it_brings() -> None:
    """4 kB of nested array headers once took 20 ms and 30 MB to refuse, and the servo's thread waited."""
    frame = b"\xdc\x0f\xff" * 1365
    tracemalloc.start()
    try:
        with pytest.raises(BadMessage):
            decode(frame)
        assert tracemalloc.get_traced_memory()[1] < 100_000
    finally:
        tracemalloc.stop()


def test_the_command_replays_a_storm(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--target", "decoder", "--seed", "5", "--count", "500"]) == 0
    assert "500 messages into the decoder" in capsys.readouterr().out


def test_without_atheris_one_line_says_so(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setitem(sys.modules, "atheris", None)
    assert coverage_guided.main(["--target", "decoder"]) == 2
    assert capsys.readouterr().err == "atheris is not installed: pip install -e '.[fuzz]'\n"


# -- the laws can fail: each of these breaks one thing, and a storm must notice --------------------------------------


def found(target: str, count: int = 6000) -> str:
    with pytest.raises(AssertionError) as caught:
        run_many(target, 1, count, 2000)
    return str(caught.value)


def test_a_failure_names_seed_frame_and_command(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("hapnet.wire.messages.MAX_FRAME_BYTES", 100)
    words = found("decoder")
    match = re.search(r"again: python -m tests\.fuzzing (.*)", words)
    assert match
    assert re.search(r"seed \d+: 9[0-9a-f]+", words)
    assert main(match[1].split()) == 1
    assert capsys.readouterr().err.strip() == words


@pytest.mark.long
def test_a_credit_given_twice_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    admit = EnergyChannel.admit

    def twice(self: EnergyChannel, now_ns: int) -> int:
        return 2 * admit(self, now_ns)

    monkeypatch.setattr(EnergyChannel, "admit", twice)
    assert "reported" in found("world")


def test_a_total_taken_for_an_amount_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    def trusting(self: EnergyChannel, total_nJ: int, acked_nJ: int, now_ns: int) -> int:
        self.acknowledge(acked_nJ, now_ns)
        self.claimed_nJ += total_nJ
        return self.admit(now_ns)

    monkeypatch.setattr(EnergyChannel, "receive", trusting)
    assert "claimed" in found("device")


def test_a_list_that_grows_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    is_peer = Handshake._is_peer

    def leaky(self: Handshake, sender: int) -> bool:
        self.__dict__.setdefault("_seen", []).append(sender)
        return is_peer(self, sender)

    monkeypatch.setattr(Handshake, "_is_peer", leaky)
    assert "_seen holds" in found("device")


@pytest.mark.long
def test_a_stale_position_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    def lenient(**words: Any) -> SessionSettings:
        return SessionSettings(**words | {"accept_stale": True})

    monkeypatch.setattr("hapnet.assembly.build.SessionSettings", lenient)
    assert "dropped: False" in found("continuous")


def test_a_wave_that_counts_twice_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hapnet.wire.path.accept", lambda window, number: True)
    assert "dropped: False" in found("wave")


def test_an_update_that_makes_energy_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    modulate = Audited.modulate

    def generous(self: Audited, y: Any, x: Any, dissipated: float, received: float, keep: float = 0.0) -> object:
        self.inner.energy += 1e-6  # type: ignore[misc]
        return modulate(self, y, x, dissipated, received, keep)

    monkeypatch.setattr(Audited, "modulate", generous)
    assert re.search("slack|energy", found("device"))


@pytest.mark.parametrize("target", ["device", "continuous", "world"])
def test_a_set_position_that_leaps_is_noticed(monkeypatch: pytest.MonkeyPatch, target: str) -> None:
    monkeypatch.setattr("hapnet.control.set_position_coupling.limit_step", lambda n, start, goal, maximum: None)
    assert "step" in found(target)


def test_an_exception_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    def fragile(self: Handshake, sender: int) -> None:
        assert sender != self.identity.incarnation

    monkeypatch.setattr(Handshake, "_never_a_peer", fragile)
    words = found("world")
    assert "AssertionError" in words
    assert "Traceback" in words
