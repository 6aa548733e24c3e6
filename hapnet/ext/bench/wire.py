"""Messages and links without a servo: encoding and decoding, lateness of a link, and time until energy is credited."""

from __future__ import annotations

from itertools import count
from typing import Any

import msgpack

from hapnet.ext.bench.row import Call, Distribution, Options, Row, cost
from hapnet.side.endpoint import Endpoint
from hapnet.wire.fields import TAG
from hapnet.wire.messages import Energy, Position, decode
from hapnet.wire.secret import TAG_BYTES, is_sealed, sealed
from hapnet.wire.session import Session
from hapnet.wire.stream_frames import echo_of, encode_position, start_of
from netem import Link, LinkProfile
from netem.bench import LATENESS_PROFILE, RATE, lateness_runs

_INCARNATION = 2**63 - 25
_ECHO = (123_450_000_000, 123_451_000_000)
_POSITION = (0.0123, -0.0045, 0.0307)


def codec_position(options: Options) -> Row:
    """Encode and decode with validation, beside msgpack with the same list without validation."""
    numbers = count()
    start, echo = start_of(Position.KIND, _INCARNATION, 1), echo_of(*_ECHO)

    def ours() -> object:
        return decode(encode_position(start, next(numbers), 123_456_789_012, _POSITION, echo))

    def theirs() -> Any:
        return msgpack.unpackb(msgpack.packb([2, 1, _INCARNATION, next(numbers), 123_456_789_012, _POSITION, *_ECHO]))

    subject, bare = cost(Call(ours), Call(theirs), options)
    what = "encode and decode of a 3-DOF position, validated"
    return Row("codec_position", "us", what, subject, "msgpack.packb and unpackb of the list", bare)


def codec_energy(options: Options) -> Row:
    """Seal, encode, decode with validation and check the seal, beside msgpack with the same list."""
    totals = count()
    key, peer = bytes(range(32)), _INCARNATION - 1

    def ours() -> object:
        data = sealed(Energy(_INCARNATION, peer, next(totals), 98_765), key)
        return is_sealed(key, decode(data).more, data)

    def theirs() -> Any:
        more = {TAG: bytes(TAG_BYTES)}
        return msgpack.unpackb(msgpack.packb([2, 2, _INCARNATION, peer, next(totals), 98_765, more]))

    subject, bare = cost(Call(ours), Call(theirs), options)
    what = "encode, seal, decode and check of an energy message"
    return Row("codec_energy", "us", what, subject, "msgpack.packb and unpackb of the list", bare)


_LUMP_J = 1e-3
_PAUSE_NS = 250_000_000
"""Time between a credit and the next lump [ns], so that only its own retransmission repairs the loss of a lump."""
_LUMPS = 300  # per second of a round's length


def energy_recovery(rtt_ms: float, loss: str, name: str, options: Options) -> Row:
    """Time from handing a lump of energy to the channel to its credit at the peer; only the links delay it."""
    profile = LinkProfile.parse(f"delay {rtt_ms / 2:g}ms loss {loss}")
    count = max(100, round(_LUMPS * options.seconds))
    rounds = [Distribution.of(credit_times(profile, count, seed), 1e-6) for seed in range(options.rounds)]
    one_way = [Distribution.of([rtt_ms / 2])] * options.rounds
    what = f"energy from sent to credited, RTT {rtt_ms:g} ms, loss {loss} in each direction, lumps one at a time"
    return Row(name, "ms", what, rounds, "the one-way delay", one_way, panel=name == "energy_recovery")


def credit_times(profile: LinkProfile, count: int, seed: int) -> list[int]:
    """The time from each of `count` lumps to its credit [ns]."""
    here = Session(role="device", dof=1, name="device", incarnation=1)
    there = Session(role="world", dof=1, name="world", incarnation=2)
    pair(here, there)
    directions: tuple[tuple[Session, Link[bytes], Session], ...] = (
        (here, Link(profile, seed=2 * seed), there),
        (there, Link(profile, seed=2 * seed + 1), here),
    )
    now_ns = given_ns = 0
    times: list[int] = []
    waiting = False
    next_ns = _PAUSE_NS
    while len(times) < count:
        due = [
            due for sender, link, _ in directions for due in (sender.next_due_ns, link.next_due_ns) if due is not None
        ]
        now_ns = max(now_ns, min(due if waiting else [*due, next_ns]))
        if not waiting and now_ns >= next_ns:
            here.shuffle(_LUMP_J)
            given_ns, waiting = now_ns, True
        for sender, link, receiver in directions:
            for message in sender.poll(now_ns)[0]:
                link.send(now_ns, message.data, size=len(message.data))
            for _, data in link.poll(now_ns):
                receiver.receive(now_ns, data)
        if waiting and there.credited_nJ == here.sent_nJ:
            times.append(now_ns - given_ns)
            waiting, next_ns = False, now_ns + _PAUSE_NS
    return times


def pair(device: Session | Endpoint, world: Session | Endpoint) -> None:
    """Deliver each side's hellos and welcomes to the other side until none are left."""
    for _ in range(4):
        for sender, receiver in ((device, world), (world, device)):
            for message in sender.poll(0)[0]:
                receiver.receive(0, message.data)


def link_release(options: Options) -> Row:
    """Time from a packet's due time to its release, 2,000 packets a second, beside a bare timerfd (netem measures)."""
    runs = lateness_runs(options.rounds, options.seconds)
    subject, bare = ([Distribution.of(run[i], 1e-3) for run in runs] for i in (0, 1))
    what = f"release lateness of a link with {LATENESS_PROFILE.split(' limit')[0]}, {RATE} a second"
    return Row("link_release", "us", what, subject, "bare timerfd on an asyncio loop", bare)
