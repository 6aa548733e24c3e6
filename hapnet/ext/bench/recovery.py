"""How long shuffled energy takes until it is credited, over round trip and loss: in virtual time, exact for a seed."""

from __future__ import annotations

from hapnet.ext.bench.endpoints import pair
from hapnet.ext.bench.row import Distribution, Options, Row
from hapnet.wire.session import Session
from netem import Link, LinkProfile

_LUMP_J = 1e-3
_PAUSE_NS = 250_000_000
"""Time between a credit and the next lump [ns]: each lump is alone, so only its own retransmission repairs its loss."""
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
    """Nanoseconds from each of `count` lumps to its credit."""
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
