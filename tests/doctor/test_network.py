"""What `hapnet doctor` says of a network: probes over links whose figures are known, and over Zenoh."""

import asyncio
import re

import pytest

from hapnet.ext.doctor import machine
from hapnet.ext.doctor.machine import OK, WARNING
from hapnet.ext.doctor.network import judged, probed
from hapnet.transport.config import ZenohSettings, free_address
from hapnet.transport.probe import EVERY_NS, MAX_LENGTH, MOST_AT_ONCE, MOST_HZ, Answering, Answers
from hapnet.transport.security import ANYBODY
from hapnet.transport.zenoh import ZenohTransport
from netem import Link, LinkProfile

MS = 1_000_000


def probe(number: int, sent_ns: int) -> bytes:
    return (number.to_bytes(8, "big") + sent_ns.to_bytes(8, "big")).ljust(76, b"\0")


def asked(up: str, down: str, count: int = 2000) -> Answers:
    """Probes over two links whose figures are known, in virtual time."""
    answers, said = Answers(), Link[bytes](LinkProfile.parse(down), seed=2)
    there = Link[bytes](LinkProfile.parse(up), seed=1)
    now = 0
    answering = Answering(lambda data: said.send(now, data), lambda: now)
    for tick in range(count * 5 + 1000):
        now = tick * MS
        if tick % 5 == 0 and tick < count * 5:
            there.send(now, probe(tick // 5, now))
        for _, data in there.poll(now):
            answering.answer(data)
        for _, data in said.poll(now):
            answers.take(now, data)
    return answers


def test_each_way_is_told_apart() -> None:
    answers = asked("delay 40ms loss 10%", "delay 20ms loss 3%")
    there, back = answers.losses
    assert there == pytest.approx(0.10, abs=0.02)
    assert back == pytest.approx(0.03, abs=0.012)
    assert answers.trips.quantile(0.5) == pytest.approx(60 * MS, rel=1 / 32)
    assert answers.stalls == 0
    assert asked("", "").losses == (0.0, 0.0)


def test_others_that_ask_do_not_look_like_loss() -> None:
    answers = Answers()
    for number in range(100):
        answers.take(number * 5 * MS + MS, (3 * number + 1).to_bytes(8, "big") + probe(number, number * 5 * MS))
    assert answers.losses[0] == 0.0


def test_what_is_no_answer_is_ignored() -> None:
    answers = Answers()
    good = (1).to_bytes(8, "big") + probe(5, 10 * MS)
    for data in (b"", good[:-1], good + b"x", (1).to_bytes(8, "big") + probe(5, 99 * MS)):  # from the future
        answers.take(20 * MS, data)
    assert answers.received == 0
    for _ in range(3):  # copies
        answers.take(20 * MS, good)
    assert answers.received == 1


def test_no_more_is_answered_than_is_allowed() -> None:
    answered: list[bytes] = []
    answering = Answering(answered.append, lambda: 10**12)
    for data in (b"", b"x" * (MAX_LENGTH + 1)):
        answering.answer(data)
    assert answered == []
    for _ in range(10 * MOST_AT_ONCE):
        answering.answer(b"x" * MAX_LENGTH)
    assert len(answered) == MOST_AT_ONCE
    assert answered[1] == (2).to_bytes(8, "big") + b"x" * MAX_LENGTH
    assert MOST_HZ > 1e9 / EVERY_NS, "a doctor is always answered"


@pytest.mark.parametrize(
    ("up", "state", "says", "advises"),
    [
        ("delay 5ms", OK, "good for fast motion", ""),
        ("delay 80ms", OK, "good for slow motion", ""),
        ("delay 250ms", WARNING, "slower than TR 22.847", "felt late"),
        ("delay 20ms loss 1%", WARNING, "good for fast motion", "99.99 %"),
        ("delay 20ms loss 12%", WARNING, "good for fast motion", "the proxy jumps"),
        ("delay 5ms slot 300ms 300ms", WARNING, "stalls, up to", "udp/ or quic/"),
    ],
)
def test_the_verdict_follows_the_figures(up: str, state: str, says: str, advises: str) -> None:
    check = judged(asked(up, ""))
    assert check.state == state
    assert says in check.value
    assert advises in check.advice
    assert (check.advice == "") == (state == OK)


@pytest.mark.slow
async def test_whoever_listens_answers_and_a_session_of_another_name_does_not() -> None:
    address = free_address()
    world = ZenohTransport(
        ZenohSettings(listen=(address,)), lambda kind, data, now_ns: None, session="s", device="d", role="world"
    )
    await world.open()
    try:
        known = await asyncio.to_thread(probed, address, ANYBODY, "s", "d", 0.3, 5.0)
        assert re.match(r"round trip \d+\.\d ms", known.value), known
        assert re.search(r"lost \d+\.\d\d % there, \d+\.\d\d % back", known.value)
        unknown = await asyncio.to_thread(probed, address, ANYBODY, "other", "d", 0.3, 0.3)
        assert unknown.state == WARNING
        assert "no answer to probes" in unknown.value
        assert "session other and the name d" in unknown.advice
    finally:
        await world.close()
    device = ZenohTransport(
        ZenohSettings(listen=(address,)), lambda kind, data, now_ns: None, session="s", device="d", role="device"
    )
    await device.open()  # a device may be the one that listens
    try:
        assert "round trip" in (await asyncio.to_thread(probed, address, ANYBODY, "s", "d", 0.3, 1.0)).value
    finally:
        await device.close()


@pytest.mark.slow
def test_where_zenoh_is_not_reached_nothing_is_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "REACH_S", 0.3)
    names = [check.name for check in machine.examine([free_address()])]
    assert "zenoh reachable" in names
    assert "network" not in names
