"""One direction of a link, without clock or I/O: items go in, and come out when and if the profile lets them.

The order of effects is tc-netem's: loss, corruption, limit, reordering, delay, rate, slot.

* What is resent (`netem.resend`) is delayed from when it is offered for the last time, and so is what waits for it
  (`netem.effects.Resend`); neither is sent ahead. Unordered resends come to a line (a rate or a trace) at that time, so
  others cross before them; jitter may reorder after the resends, as ever.
* A reordered message goes at once, ahead of what is still in flight, untouched by rate and slot; the gap counts the
  messages between two that may be. (The kernel also puts it ahead of what is due at the very same instant; here that
  has left already, so that the order does not depend on when somebody polls.)
* Without a rate, messages leave in the order of their release times, so jitter reorders them. With one, a message is
  released at ``max(now + delay, last release) + size/rate``, so the order is kept.
* A trace of delivery opportunities takes the rate's place (`netem.trace.TraceLine`) and keeps the order as well. A
  trace of conditions adds its delay to the one drawn, and its loss to that of the loss model.
* A slot that has opened lets out what was ready by then, to its limits; the next one is drawn when it is exhausted or
  when the next message finds it past.
* Nothing is ever released twice.
"""

from __future__ import annotations

from collections.abc import Callable, Sized
from heapq import heapify, heappop, heappush
from itertools import repeat
from typing import Generic, TypeVar, cast

import numpy as np
from numpy.random import Generator, SeedSequence

from netem import models
from netem.draws import Draws, Fates, changed, generators
from netem.effects import Slot
from netem.errors import NetemError
from netem.profile import LinkProfile
from netem.resend import Resends
from netem.stats import DelayHistogram, LinkStats
from netem.trace import ConditionTrace, TraceLine

T = TypeVar("T")

_LONG_AGO = -(2**63)


class Link(Generic[T]):
    """A link that carries items of any type under a `LinkProfile`.

    Times are integer ns on any clock, the caller's. Each effect draws from a stream of its own, and each message takes
    one draw of each, so changing one effect leaves the others' draws as they were. A `seed` in the profile takes the
    place of the one given here; a SeedSequence's spawn key counts in either case, so that spawned links stay
    independent. Traces start at `start_ns`, with the first message if it is None, and at the time of a `change` that
    puts them in force.

    `corrupt` flips a bit of items that are bytes. For others, `flip` says how: ``flip(item, corrupted)`` returns the
    item with its bytes put through `corrupted`.

    Not thread-safe: two users need a lock.
    """

    def __init__(
        self,
        profile: LinkProfile,
        seed: int | SeedSequence = 0,
        start_ns: int | None = None,
        flip: Callable[[T, Callable[[bytes], bytes]], T] | None = None,
    ) -> None:
        self._flip = flip
        self._seed = seed if isinstance(seed, SeedSequence) else SeedSequence(seed)
        # (due, order, item, sent, size); order is unique, so items are never compared
        self._queue: list[tuple[int, int, T, int, int]] = []
        self._ready: list[tuple[int, int, T, int, int]] = []
        # what comes to the line later than it was offered: (when, order, item, sent, size, delay)
        self._again: list[tuple[int, int, T, int, int, int]] = []
        self._offered = self._lost = self._lost_down = self._dropped_limit = 0
        self._loss_bursts, self._last_lost = 0, -1
        self._corrupted = self._reordered = self._sent_ahead = self._resent = self._recovered = 0
        self._latest_ns = 0
        self._newest = 0
        self._since_reorder = 0
        self._last_release_ns = self._in_order_ns = _LONG_AGO
        self._timed_size: int | None = None  # the last size that was timed, and its transmission time
        self._size_ns = 0
        self._slot_ns = _LONG_AGO
        self._slot_packets = self._slot_bytes = 0
        self._up = True
        self._slotted = self._needs_size = self._awaits_start = self._transparent = False
        self._lined = self._beside = False
        self._resends: Resends | None = None
        self._line: TraceLine | None = None
        self._conditions: ConditionTrace | None = None
        self._conditions_start_ns = 0
        self._words_seed: int | None = None
        self._delays = DelayHistogram()
        self._pending_delays = self._delays.pending
        self._generators: dict[str, Generator] = {}
        self._configure(profile, None, _LONG_AGO)
        self._start_traces(None, start_ns)

    @property
    def profile(self) -> LinkProfile:
        """The profile in force."""
        return self._profile

    @property
    def is_up(self) -> bool:
        """Whether the link takes messages."""
        return self._up

    @property
    def next_due_ns(self) -> int | None:
        """When to poll next; None if nothing is in flight.

        With slots, or with resends out of order that come to a line, a poll at that time may release nothing yet.
        """
        if self._ready:
            return self._ready[0][0]
        due = self._queue[0][0] if self._queue else None
        if due is not None and self._profile.slot is not None:
            due = max(due, self._slot_ns)
        if self._again and (due is None or self._again[0][0] < due):
            return self._again[0][0]
        return due

    @property
    def stats(self) -> LinkStats:
        """A snapshot of what the link did so far."""
        in_flight = len(self._queue) + len(self._ready) + len(self._again)
        gone = self._lost + self._lost_down + self._dropped_limit
        return LinkStats(
            profile=str(self._profile),
            offered=self._offered,
            delivered=self._offered - gone - in_flight,
            lost=self._lost,
            loss_bursts=self._loss_bursts,
            resent=self._resent,
            recovered=self._recovered,
            lost_down=self._lost_down,
            dropped_limit=self._dropped_limit,
            corrupted=self._corrupted,
            reordered=self._reordered,
            sent_ahead=self._sent_ahead,
            in_flight=in_flight,
            delay_mean_ms=self._delays.mean_ms(),
            delay_std_ms=self._delays.std_ms(),
            delay_p50_ms=self._delays.quantile_ms(0.50),
            delay_p99_ms=self._delays.quantile_ms(0.99),
            late_max_ms=self._latest_ns * 1e-6,
            delay_histogram_ms=self._delays.bins_ms(),
        )

    def passes(self) -> bool:
        """For a link without any effect and with nothing in flight, `send` and `poll` at once.

        True: a message has been offered and delivered; hand it on. False: nothing has happened, `send` it.
        """
        if not self._transparent or self._queue or self._ready or self._again or not self._up:
            return False
        self._offered = self._newest = self._offered + 1
        if len(self._pending_delays) >= DelayHistogram.PENDING:
            self._delays.fold()
        self._pending_delays.append(0)
        return True

    def send(self, now_ns: int, item: T, size: int | None = None) -> None:
        """Offer an item at `now_ns`; its `size` in bytes counts for a rate, a trace or a slot, ``len(item)`` if None.

        Raises
        ------
        NetemError : the profile needs a size, and the item has none or it is negative.
        """
        if self._needs_size and (size is None or size < 0):
            size = _size_of(item, size)
        self._offered = order = self._offered + 1
        if len(self._pending_delays) >= DelayHistogram.PENDING:  # here and not in `poll`: what is due should not wait
            self._delays.fold()
        lost, corrupt, ahead, delay, luck = self._next_draws()
        if self._awaits_start:
            self._start_traces(None, now_ns)
        if self._conditions is not None:
            more_delay, chance = self._conditions.at(now_ns - self._conditions_start_ns)
            delay += more_delay
            lost = self._next_chance() < chance or lost
        if not self._up:
            self._lost_down += 1
            return
        offered_ns = now_ns
        if self._resends is not None:
            lost, offered_ns = self._resend(self._resends, now_ns, lost, luck)
        if lost:
            self._lost += 1
            if self._last_lost != order - 1:
                self._loss_bursts += 1
            self._last_lost = order
            return
        if corrupt and (self._flip is not None or isinstance(item, bytes)):
            self._corrupted += 1
            item = self._corrupt(item, self._next_bit())
        profile = self._profile
        if self._slotted or self._again or len(self._queue) >= profile.limit:
            self._settle(now_ns)
            if len(self._queue) + len(self._again) >= profile.limit:
                self._dropped_limit += 1
                return
        self._since_reorder += 1
        if ahead and self._since_reorder >= profile.gap and offered_ns == now_ns:
            self._since_reorder = 0
            self._sent_ahead += 1
            entry = (now_ns, order, item, now_ns, 0)
            if self._slotted:
                self._ready.append(entry)
            else:
                heappush(self._queue, entry)
            return
        if self._beside and offered_ns > now_ns:
            heappush(self._again, (offered_ns, order, item, now_ns, cast(int, size), delay))
            return
        due = offered_ns + delay
        if profile.rate_bit_s and size == self._timed_size:  # as `_cross` does, for the many that are alike
            last = self._last_release_ns
            self._last_release_ns = due = (due if due > last else last) + self._size_ns
        elif self._lined:
            due = self._cross(due, cast(int, size))
        heappush(self._queue, (due, order, item, now_ns, size or 0))
        if self._slotted:
            self._look_at_slot(now_ns)

    def _resend(self, resends: Resends, now_ns: int, lost: bool, luck: float) -> tuple[bool, int]:
        """(is the message lost for good, when is it offered for the last time, or leaves if it waits for others?)."""
        offered_ns = now_ns
        if lost:
            if self._conditions is None:
                taken, lost = resends.taken(luck)
            else:
                taken, lost = resends.taken_under(luck, self._conditions, now_ns - self._conditions_start_ns)
            self._resent += taken
            self._recovered += not lost
            offered_ns += taken * resends.after_ns
        if resends.ordered:
            self._in_order_ns = offered_ns = max(offered_ns, self._in_order_ns)
        return lost, offered_ns

    def _cross(self, ready_ns: int, size: int) -> int:
        """When a message has crossed the line that comes to its end at `ready_ns`, behind all that came before."""
        profile = self._profile
        if profile.rate_bit_s:
            if size != self._timed_size:
                self._timed_size, self._size_ns = size, models.transmission_ns(size, profile)
            last = self._last_release_ns
            self._last_release_ns = due = (ready_ns if ready_ns > last else last) + self._size_ns
        elif self._line is not None:
            self._last_release_ns = due = self._line.release_ns(ready_ns, size)
        else:
            due = ready_ns
        return due

    def _corrupt(self, item: T, draw: float) -> T:
        if self._flip is None:
            return cast(T, models.flip_bit(cast(bytes, item), draw))
        return self._flip(item, lambda data: models.flip_bit(data, draw))

    def poll(self, now_ns: int) -> list[tuple[int, T]]:
        """Take out what is due by `now_ns`: (release time, item) in the order of release."""
        out: list[tuple[int, T]] = []
        self._settle(now_ns)
        if not self._ready:
            return out
        pending = self._pending_delays
        for due, order, item, sent, _ in self._ready:
            if order > self._newest:
                self._newest = order
            else:
                self._reordered += 1
            pending.append(due - sent)
            out.append((due, item))
        if now_ns - out[0][0] > self._latest_ns:
            self._latest_ns = now_ns - out[0][0]
        self._ready.clear()
        if len(pending) >= 16 * DelayHistogram.PENDING:  # a link that is only emptied, with nobody sending
            self._delays.fold()
        return out

    def change(self, profile: LinkProfile, now_ns: int) -> None:
        """Put another profile in force for what is offered from now on; what is in flight keeps its release times.

        Effects whose settings stay keep their streams; the others continue their own with the new settings.
        """
        self._settle(now_ns)
        previous = self._profile
        if previous.slot is not None and profile.slot is None:
            # what only a slot held back leaves now
            self._queue = [(max(due, now_ns), *rest) for due, *rest in self._queue]  # type: ignore[misc]
            heapify(self._queue)
        if profile.rate_bit_s or profile.trace is not None:
            self._last_release_ns = max((entry[0] for entry in self._queue), default=now_ns)
        self._configure(profile, previous, now_ns)
        self._start_traces(previous, now_ns)

    def draw(self, taken: int, count: int) -> Fates:
        """Take the draws of the next `count` messages out of the link, for a caller that carries many links at once.

        `taken` : how many messages' draws were taken so far, by `send` or in this way.
        """
        streams = (self._loss_draws, self._reorder_draws, self._delay_draws, self._luck_draws)
        return Fates(*(draws.many(taken, count) for draws in streams))

    def down(self) -> None:
        """From now on lose whatever is offered; what is in flight arrives."""
        self._up = False

    def up(self) -> None:
        """Take messages again."""
        self._up = True

    def _configure(self, profile: LinkProfile, previous: LinkProfile | None, now_ns: int) -> None:
        if previous is None or profile.seed not in (None, self._words_seed):
            previous = None
            self._words_seed = profile.seed
            self._generators = generators(self._seed, profile.seed)
            self._next_bit = Draws(models.fractions(self._generators["bit"]), 0).each.__next__
            self._next_chance = Draws(models.fractions(self._generators["csv"]), 0).each.__next__
        rng, offered = self._generators, self._offered
        if changed("delay", profile, previous):
            self._delay_draws = Draws(models.delays(rng["delay"], profile), offered)
        if changed("loss", profile, previous):
            self._loss_draws = Draws(models.losses(rng["loss"], profile.loss), offered)
        if changed("corrupt", profile, previous):
            blocks = models.decisions(rng["corrupt"], profile.corrupt, profile.corrupt_correlation)
            self._corrupt_draws = Draws(blocks, offered)
        if changed("reorder", profile, previous):
            blocks = models.decisions(rng["reorder"], profile.reorder, profile.reorder_correlation)
            self._reorder_draws = Draws(blocks, offered)
        if previous is None or (profile.resend is None) != (previous.resend is None):
            zeros = repeat(np.zeros(models.BLOCK))
            self._luck_draws = Draws(zeros if profile.resend is None else models.fractions(rng["resend"]), offered)
        if profile.slot is not None and changed("slot", profile, previous):
            self._next_slot = Draws(models.slot_intervals(rng["slot"], profile.slot), 0).each.__next__
            self._slot_ns, self._slot_packets, self._slot_bytes = now_ns, 0, 0
        self._next_draws = zip(
            self._loss_draws.each, self._corrupt_draws.each, self._reorder_draws.each, self._delay_draws.each,
            self._luck_draws.each, strict=False,
        ).__next__  # fmt: skip
        self._profile = profile
        self._timed_size = None
        self._resends = None if profile.resend is None else Resends(profile.resend, profile.loss)
        self._slotted = profile.slot is not None
        self._lined = bool(profile.rate_bit_s or profile.trace)
        self._beside = self._lined and profile.resend is not None and not profile.resend.ordered
        self._transparent = profile.limit > 0 and profile == LinkProfile(limit=profile.limit, seed=profile.seed)
        self._needs_size = bool(self._lined or (profile.slot and profile.slot.bytes))

    def _start_traces(self, previous: LinkProfile | None, start_ns: int | None) -> None:
        """Start the traces that `previous` did not have at `start_ns`, or with the next message if that is None."""
        trace, conditions = self._profile.trace, self._profile.csv
        if self._awaits_start:
            previous = None
        self._awaits_start = start_ns is None and (trace is not None or conditions is not None)
        if start_ns is None:
            return
        if previous is None or trace != previous.trace:
            self._line = TraceLine(trace, start_ns, self._last_release_ns) if trace is not None else None
        if previous is None or conditions != previous.csv:
            self._conditions, self._conditions_start_ns = conditions, start_ns

    def _settle(self, now_ns: int) -> None:
        """Move what is due by now from the queue to `_ready`."""
        while self._again and self._again[0][0] <= now_ns:
            offered_ns, order, item, sent_ns, size, delay = heappop(self._again)
            if self._slotted:
                self._run_slots(offered_ns)
            heappush(self._queue, (self._cross(offered_ns + delay, size), order, item, sent_ns, size))
            if self._slotted:
                self._look_at_slot(offered_ns)
        if self._slotted:
            self._run_slots(now_ns)
            return
        queue, ready = self._queue, self._ready
        while queue and queue[0][0] <= now_ns:
            ready.append(heappop(queue))

    def _run_slots(self, now_ns: int) -> None:
        slot = cast(Slot, self._profile.slot)
        while self._queue:
            due = self._queue[0][0]
            release = max(due, self._slot_ns)
            if release > now_ns:
                return
            if self._slot_ns < due:
                self._open_slot(release)
                continue
            _, order, item, sent, size = heappop(self._queue)
            self._ready.append((release, order, item, sent, size))
            self._slot_packets += 1
            self._slot_bytes += size
            if self._slot_packets == slot.packets or 0 < slot.bytes <= self._slot_bytes:
                self._open_slot(release)
            self._look_at_slot(release)

    def _look_at_slot(self, now_ns: int) -> None:
        """As the kernel does after each arrival and release: give up a slot too early for the head of the queue."""
        if self._queue and self._slot_ns < self._queue[0][0]:
            self._open_slot(now_ns)

    def _open_slot(self, now_ns: int) -> None:
        self._slot_ns = now_ns + self._next_slot()
        self._slot_packets = self._slot_bytes = 0


def _size_of(item: object, given: int | None) -> int:
    if given is not None:
        raise NetemError(f"size: {given} is not allowed; allowed: a number of bytes from 0")
    if not isinstance(item, Sized):
        raise NetemError(
            f"size of {type(item).__name__}: a rate or a slot's bytes need one; give send() a size in bytes"
        )
    return len(item)
