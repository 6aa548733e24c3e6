"""One direction of a link, without clock or I/O: items go in, and come out when the profile's effects release them.

The order of effects is tc-netem's: loss (and `netem.impairments`), corruption, limit, reordering, delay, rate, slot.

* A resent message (`netem.resend`) is delayed from the time of its last offer, and so are messages that wait for it
  (`netem.effects.Resend`); none of them is sent ahead. An unordered resend reaches the line (a rate or a trace) at that
  time, so other messages cross before it. With ordered ones a message waits for those before it, whatever the jitter.
* A reordered message leaves at once, ahead of all messages in flight, and skips rate and slot. The gap counts the
  messages between two that may be reordered. (The kernel also puts it ahead of messages due at the same instant; here
  these have left already, so that the order does not depend on the times of polling.)
* Without a rate, messages leave in the order of their release times, so jitter reorders them. With a rate, a message is
  released at ``max(now + delay, last release) + size/rate``, so the order is kept.
* A trace replaces the rate (`netem.trace.TraceLine`, `netem.rate_trace.RateTraceLine`) and keeps the order too. A
  trace of conditions adds its delay to the drawn one, and its loss to that of the loss model.
* An open slot releases the messages that are ready, up to its limits. The next slot is drawn when this one is
  exhausted, or when the next message comes after it.
* A message that `duplicate` offers twice is two messages, as in the kernel: each has its own draws and is counted, the
  first is always followed by the second, and a copy is not copied again. Nothing else is ever released twice.
"""

from __future__ import annotations

from collections.abc import Callable, Sized
from heapq import heapify, heappop, heappush
from typing import Generic, TypeVar, cast

from numpy.random import SeedSequence

from netem import models
from netem.draws import Streams
from netem.errors import NetemError
from netem.line import RateLine
from netem.offering import leave, offer, passes
from netem.profile import LinkProfile
from netem.rate_trace import RateTraceLine
from netem.resend import Resends, taken
from netem.slots import Entry, SlotGate
from netem.stats import Counters, DelayHistogram, LinkStats
from netem.trace import ConditionTrace, TraceLine

T = TypeVar("T")

_LONG_AGO = -(2**63)


class Link(Generic[T]):
    """A link that carries items of any type under a `LinkProfile`.

    Times are integer ns on the caller's clock. Each effect has its own random stream, and each message takes one draw
    of each, so changing one effect does not change the others' draws. A `seed` in the profile replaces the `seed` given
    here. A SeedSequence's spawn key counts in both cases, so that spawned links stay independent. Traces start at
    `start_ns`, or with the first message if that is None. A `change` to a new trace starts it at that time.

    `corrupt` flips a bit of items that are bytes. For other items give `flip`: ``flip(item, corrupted)`` returns the
    item with its bytes passed through `corrupted`.

    Not thread-safe: two threads need a lock.

    More than twenty attributes: each effect keeps its own state, and `netem.offering` needs all of them.

    Attributes
    ----------
    Only `netem.offering` uses these, and a caller that simulates many links at once, which reads a link's state and
    writes it back.

    counters : the counts so far. streams : the draws. queue : messages in flight, a heap. line : the line of a rate or
    a trace (`lined`). is_up : if False, the link loses all messages offered to it.
    resends : see `netem.resend`. in_order_ns : with ordered resends, no message passes the loss before this time.
    last_due_ns : with ordered resends, no message arrives before this time.
    since_reorder : number of messages offered since the last one that was sent ahead.
    gate : the gate of slots; ready : due messages. later : messages that reach the line later than they were offered,
    if there may be any (`beside`): (when, number, item, sent, size, delay). acts : whether there are further
    impairments. has_traces : whether traces change the draws' results. limit, limit_bytes, gap : those of the profile.
    bytes_in_flight : of the messages in `queue` and `later`, if the profile limits them.
    """

    def __init__(
        self,
        profile: LinkProfile,
        seed: int | SeedSequence = 0,
        start_ns: int | None = None,
        flip: Callable[[T, Callable[[bytes], bytes]], T] | None = None,
    ) -> None:
        self.counters = Counters()
        self.streams = Streams(seed if isinstance(seed, SeedSequence) else SeedSequence(seed))
        self.queue: list[Entry[T]] = []
        self.since_reorder = 0
        self.in_order_ns = self.last_due_ns = _LONG_AGO
        self.line: RateLine | TraceLine | RateTraceLine | None = None
        self.ready: list[Entry[T]] = []
        self.later: list[tuple[int, int, T, int, int, int]] = []
        self.gate: SlotGate[T] | None = None
        self.is_up = True
        self._flip = flip
        self._conditions: tuple[ConditionTrace, int] | None = None  # the trace and its start
        self._pending_delays = self.counters.delays.pending
        self._awaits_start = False
        self._configure(profile, _LONG_AGO, _LONG_AGO)
        self._start_traces(None, start_ns, _LONG_AGO)

    @property
    def profile(self) -> LinkProfile:
        """The active profile."""
        return self._profile

    @property
    def next_due_ns(self) -> int | None:
        """The time to poll next [ns]; None if nothing is in flight.

        With slots, or with unordered resends on a line, a poll at that time may release nothing yet.
        """
        if self.ready:
            return self.ready[0][0]
        due = self.queue[0][0] if self.queue else None
        if due is not None and self.gate is not None:
            due = max(due, self.gate.opens_ns)
        if self.later and (due is None or self.later[0][0] < due):
            return self.later[0][0]
        return due

    @property
    def stats(self) -> LinkStats:
        """A snapshot of the link's statistics."""
        return self.counters.snapshot(str(self._profile), len(self.queue) + len(self.ready) + len(self.later))

    def passes(self) -> bool:
        """`send` and `poll` in one call, for a link without any effect and with nothing in flight.

        True: the message is counted as offered and delivered; deliver it. False: nothing was counted; use `send`.
        """
        if len(self._pending_delays) >= DelayHistogram.PENDING:
            self.counters.delays.fold()
        return passes(self)

    def send(self, now_ns: int, item: T, size: int | None = None) -> None:
        """Offer an item at `now_ns`. A rate, a trace, a slot or a limit uses its `size` in bytes; None: ``len(item)``.

        Raises NetemError: the profile needs a size, and the item has none or it is negative.
        """
        if self._needs_size and (size is None or size < 0):
            size = _size_of(item, size)
        if self.streams.twice:
            self._copy(now_ns, item, size)
        if len(self._pending_delays) >= DelayHistogram.PENDING:  # not in `poll`, where due messages would wait for it
            self.counters.delays.fold()
        offer(self, now_ns, item, size or 0)

    def _copy(self, now_ns: int, item: T, size: int | None) -> None:
        """Offer a copy of the item if an impairment requires it; the item itself is offered next."""
        twice, self.streams.twice = self.streams.twice, ()  # a copy is not copied again
        for again in [one() for one in twice]:
            if again:
                self.counters.duplicated += 1
                self.send(now_ns, item, size)
        self.streams.twice = twice

    def under_conditions(
        self, now_ns: int, lost: bool, corrupt: bool, ahead: bool, delay_ns: int, luck: float
    ) -> tuple[bool, bool, bool, int, float]:
        """A message's draws, with the delay and loss that a trace of conditions adds."""
        if self._awaits_start:
            self._start_traces(None, now_ns, _LONG_AGO)
        if self._conditions is not None:
            conditions, start_ns = self._conditions
            more_ns, chance = conditions.at(now_ns - start_ns)
            delay_ns += more_ns
            lost = self.streams.next_chance() < chance or lost
        return lost, corrupt, ahead, delay_ns, luck

    def taken_under_conditions(self, now_ns: int, luck: float) -> tuple[int, bool]:
        """The result of `netem.resend.taken`, with a trace of conditions if there is one."""
        if self._conditions is None:
            return taken(self.resends, luck)
        conditions, start_ns = self._conditions
        return self.resends.taken_under(luck, conditions, now_ns - start_ns)

    def corrupted(self, item: T) -> T:
        """The item with a bit flipped, if its bytes are known."""
        if self._flip is None and not isinstance(item, bytes):
            return item
        self.counters.corrupted += 1
        bit = self.streams.next_bit()
        if self._flip is None:
            return cast(T, models.flip_bit(cast(bytes, item), bit))
        return self._flip(item, lambda data: models.flip_bit(data, bit))

    def is_full(self, now_ns: int, size: int) -> bool:
        """Whether a message of `size` bytes is beyond the limit of what is in flight, after all due messages left."""
        self._settle(now_ns)
        if self.limit_bytes and self.bytes_in_flight + size > self.limit_bytes:
            return True
        return len(self.queue) + len(self.later) >= self.limit

    def poll(self, now_ns: int) -> list[tuple[int, T]]:
        """Remove the items due by `now_ns`. Returns (release time, item) in the order of release."""
        out: list[tuple[int, T]] = []
        self._settle(now_ns)
        if not self.ready:
            return out
        pending, counters = self._pending_delays, self.counters
        for due, order, item, sent, _ in self.ready:
            leave(self, due, order, sent)
            out.append((due, item))
        if now_ns - out[0][0] > counters.late_max_ns:
            counters.late_max_ns = now_ns - out[0][0]
        self.ready.clear()
        if len(pending) >= 16 * DelayHistogram.PENDING:  # the link is only polled, while no message is sent
            counters.delays.fold()
        return out

    def change(self, profile: LinkProfile, now_ns: int) -> None:
        """Use another profile for items offered from now on; items in flight keep their release times.

        Effects with unchanged settings keep their streams; the others continue their streams with the new settings.
        """
        self._settle(now_ns)
        previous = self._profile
        if previous.slot is not None and profile.slot is None:
            # messages that only the slot held back leave now
            self.queue = [(max(due, now_ns), *rest) for due, *rest in self.queue]  # type: ignore[misc]
            heapify(self.queue)
        free_ns = max((entry[0] for entry in self.queue), default=now_ns)
        self._configure(profile, now_ns, free_ns)
        self._start_traces(previous, now_ns, free_ns)

    def down(self) -> None:
        """Lose every item offered from now on; items in flight still arrive."""
        self.is_up = False

    def up(self) -> None:
        """Carry items again."""
        self.is_up = True

    def _configure(self, profile: LinkProfile, now_ns: int, free_ns: int) -> None:
        """Build the effects of `profile`. `free_ns`: when the line is free."""
        new = self.streams.configure(profile, self.counters.offered)
        if profile.slot is None:
            self.gate = None
        elif "slot" in new:
            self.gate = SlotGate(profile.slot, self.streams.next_slot, now_ns)
        if profile.rate_bit_s:
            self.line = RateLine(profile, free_ns)
        elif profile.trace is None or isinstance(self.line, RateLine):
            self.line = None
        self._profile = profile
        self.limit, self.limit_bytes = profile.limit, profile.limit_bytes
        self.gap, self.acts = profile.gap, bool(self.streams.others)
        self.resends = Resends(profile.resend, profile.loss)
        self.lined = lined = bool(profile.rate_bit_s or profile.trace)
        self.has_traces = profile.trace is not None or profile.csv is not None
        self.beside = lined and profile.resend is not None and not profile.resend.ordered
        self.transparent = profile.limit > 0 and profile == LinkProfile(limit=profile.limit, seed=profile.seed)
        self.bytes_in_flight = sum(entry[4] for entry in self.queue) + sum(entry[4] for entry in self.later)
        self._needs_size = bool(lined or profile.limit_bytes or (profile.slot and profile.slot.bytes))

    def _start_traces(self, previous: LinkProfile | None, start_ns: int | None, free_ns: int) -> None:
        """Start the traces that `previous` did not have: at `start_ns`, or with the next message if that is None."""
        trace, conditions = self._profile.trace, self._profile.csv
        if self._awaits_start:
            previous = None
        self._awaits_start = start_ns is None and (trace is not None or conditions is not None)
        if start_ns is None:
            return
        if trace is not None and (previous is None or trace != previous.trace):
            self.line = trace.line(start_ns, free_ns)
        if previous is None or conditions != previous.csv:
            self._conditions = None if conditions is None else (conditions, start_ns)

    def _settle(self, now_ns: int) -> None:
        """Move the messages due by now from the queue to `_ready`."""
        gate, queue, ready = self.gate, self.queue, self.ready
        before = len(ready)
        while self.later and self.later[0][0] <= now_ns:
            offered_ns, order, item, sent_ns, size, delay = heappop(self.later)
            if gate is not None:
                gate.run(queue, ready, offered_ns)
            due = offered_ns + delay
            if self.line is not None:
                due = self.line.release_ns(due, size)
            heappush(queue, (due, order, item, sent_ns, size))
            if gate is not None:
                gate.look(queue, offered_ns)
        if gate is not None:
            gate.run(queue, ready, now_ns)
        else:
            while queue and queue[0][0] <= now_ns:
                ready.append(heappop(queue))
        if self.limit_bytes:
            self.bytes_in_flight -= sum(entry[4] for entry in ready[before:])


def _size_of(item: object, given: int | None) -> int:
    if given is not None:
        raise NetemError(f"size: {given} is not allowed; allowed: a number of bytes from 0")
    if not isinstance(item, Sized):
        raise NetemError(
            f"size of {type(item).__name__}: a rate, a trace, a slot or a limit in bytes needs it; give send() a size"
        )
    return len(item)
