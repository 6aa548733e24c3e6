"""The wire half of one side in many scenarios at once: its channels, and the messages that it receives and sends."""

from __future__ import annotations

import numpy as np

from hapnet.checks import Array
from hapnet.simulation.batch.arrays import Index, Whole, place
from hapnet.simulation.batch.arrivals import EnergyQueue, Positions, Queues
from hapnet.simulation.batch.channels import Channels
from hapnet.simulation.batch.couplings import Couplings
from hapnet.simulation.batch.links import ENERGY, Links
from hapnet.simulation.batch.sizes import Sizes


class Wire:
    """One side.

    Parameters
    ----------
    channels, incoming, positions, couplings : of this side; its coupling gets what `incoming` and `positions` deliver.
    links : this side sends on them. sizes : of its messages. next_number : of its next position in each scenario.
    """

    def __init__(
        self,
        channels: Channels,
        incoming: EnergyQueue,
        positions: Positions,
        couplings: Couplings,
        links: Links,
        sizes: Sizes,
        next_number: Whole,
    ) -> None:
        self.channels, self.incoming, self.positions, self.couplings = channels, incoming, positions, couplings
        self.links, self._sizes, self.next_number = links, sizes, next_number
        self.peer = self
        self.deferring = False
        count, dof = len(next_number), len(couplings.received)
        self.deferred_energy = Queues(count, np.int64, np.int64, np.int64)
        self.deferred_updates = Queues(count, np.int64, np.float64, *[np.float64] * dof)

    def on_energy(self, at: Index, now_ns: Whole) -> None:
        """An energy message arrived in each of `at`."""
        total_nJ, acked_nJ = self.incoming.take(at)
        self.couplings.take(at, self.channels.receive(at, total_nJ, acked_nJ, now_ns))
        self.channels.plan(at)

    def on_timer(self, at: Index, now_ns: Whole) -> None:
        """The channels of `at` are due."""
        channels = self.channels
        self.couplings.take(at, channels.admit(at, now_ns))
        out, total_nJ, acked_nJ = channels.poll(at, now_ns)
        if out.size:
            which = at[out]
            size = self._sizes.energy(which, total_nJ, acked_nJ) if self.links.timed else None
            order, due_ns = self.links.send(which, now_ns[out], ENERGY, size)
            self.peer.incoming.put(which, order, due_ns, total_nJ, acked_nJ)
        channels.plan(at)

    def on_update(self, at: Index, now_ns: Whole, x: Array, sent_J: Array) -> None:
        """PSPM ran at positions x (n, M): send them, and shuffle the surplus through the channels."""
        number = self.next_number[at]
        self.next_number[at] = number + 1
        if self.deferring:
            self.deferred_updates.put(at, now_ns, number, sent_J, *x)
        else:
            self._send(at, now_ns, number, x, sent_J)

    def _send(self, at: Index, now_ns: Whole, number: Whole, x: Array, sent_J: Array) -> None:
        size = self._sizes.position(at) if self.links.timed else None
        _, due_ns = self.links.send(at, now_ns, number, size)
        self.peer.positions.put(at, number, due_ns, x)
        some = (sent_J > 0.0).nonzero()[0]
        if some.size:
            which = at[some]
            self.channels.shuffle(which, sent_J[some])
            self.channels.plan(which)
            due = (self.channels.next_due_ns[which] <= now_ns[some]).nonzero()[0]
            if due.size:
                self.on_timer(which[due], now_ns[some[due]])

    def look(self, at: Index, now_ns: Whole) -> None:
        """Hand over the newest position that has arrived by `now_ns`."""
        fresh, y = self.positions.look(at, now_ns)
        self.hand_over(at[fresh], y)

    def hand_over(self, at: Index, y: Array) -> None:
        """The coupling's next update uses y (n, M)."""
        if at.size:
            place(self.couplings.received, at, y)
            self.couplings.has_sample[at] = True

    # -- deferred ------------------------------------------------------------------------------------------------------

    def defer(self, period_ns: int, start: int, end: int) -> bool:
        """Defer the wire's work to the end of a window, from after tick `start` to tick `end`, in fewer, larger rounds.

        Returns False and does nothing if this is not possible. The link to this side must never be faster than the
        window is long. Then all messages that arrive in the window are in flight when it begins, so the credit of each
        tick is known, unless admission limits it. The rest of the wire's work affects only the other side, and only
        after the window.
        """
        incoming, channels = self.incoming, self.channels
        if not channels.plentiful(incoming.greatest_nJ()):
            return False
        self._credits = np.zeros((end - start, len(self.next_number)))
        self._window = start + 1
        until_ns = end * period_ns
        while (at := (incoming.next_due_ns <= until_ns).nonzero()[0]).size:
            now_ns = incoming.next_due_ns[at]
            total_nJ, acked_nJ = incoming.take(at)
            credit_nJ = channels.foresee(at, total_nJ, now_ns)
            self.deferred_energy.put(at, now_ns, total_nJ, acked_nJ, credit_nJ)
            self._credits[-(-now_ns // period_ns) - self._window, at] += credit_nJ * 1e-9
        self.deferring = True
        return True

    def bring_credit(self, tick: int) -> None:
        """Give the couplings the energy that is credited by this tick of the window."""
        credits = self._credits[tick - self._window]
        at = credits.nonzero()[0]
        self.couplings.credit[at] += credits[at]
        self.couplings.has_sample[at] = True

    def on_deferred_energy(self, at: Index, now_ns: Whole) -> None:
        """`on_energy`, deferred."""
        total_nJ, acked_nJ, credit_nJ = self.deferred_energy.take(at)
        self.channels.catch_up(at, total_nJ, acked_nJ, credit_nJ, now_ns)
        self.channels.plan(at)

    def on_deferred_update(self, at: Index, now_ns: Whole) -> None:
        """`on_update`, deferred."""
        number, sent_J, *x = self.deferred_updates.take(at)
        self._send(at, now_ns, number, np.array(x), sent_J)
