"""The acknowledged stream of nanojoules between one pair of incarnations, both directions.

As TCP numbers bytes, this channel numbers nanojoules. Every message states the total sent and the total credited. So a
later message repairs the loss of every earlier one, and neither loss, repetition nor reordering can create or lose
energy. The rules:

* New energy is sent at once, but not sooner than `spacing_ns` after the last message.
* What is not acknowledged is repeated when the timer of RFC 6298 expires. Every message restarts the timer, and so does
  every acknowledgement that advances, but never beyond the timer's ceiling.
* A message with `total_nJ` > 0 asks for an acknowledgement. It is sent with the next message of the other direction if
  there is one within `ack_delay_ns`; otherwise it is sent alone, with `total_nJ` = 0. Such a message is stale by the
  ordinary rule (0 is not above what was credited) and is never answered, so two quiet sides stay quiet.
* Credits pass a token bucket. Energy that finds no tokens waits, and `admit` credits it as tokens come. No more waits
  than the tokens can pay until the sender repeats its total: a total that is too high, by a flipped bit or a forger, is
  soon forgotten.

At every instant `sent_nJ == acked_nJ + in_flight_nJ + abandoned_nJ` here, and, since acknowledging follows crediting
follows sending, `acked_nJ (here) <= credited_nJ (peer) <= sent_nJ (here)`.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from math import floor
from typing import Final, NamedTuple

from hapnet.errors import BadMessage, InvalidParameter
from hapnet.wire.fields import MAX_TOTAL_NJ
from hapnet.wire.rto import CEILING_NS, RtoEstimator
from hapnet.wire.token_bucket import TokenBucket

ACK_DELAY_NS = 10_000_000  # the usual spacing: while energy flows both ways, no acknowledgement is sent alone
ADMISSION_STEP_NS = 10_000_000
MAX_TIMED = 256  # messages whose round trip is being measured: 2.5 s of them, above any timeout


class ChannelState(NamedTuple):
    """Of an open channel; its `rto` and its `admission` have states of their own."""

    sent_nJ: int
    acked_nJ: int
    credited_nJ: int
    residue_J: float
    announced_nJ: int
    """The highest total that was announced in a message."""
    claimed_nJ: int
    """The highest total that the peer has announced, as far as it may wait for tokens."""
    timed: tuple[tuple[int, int], ...]
    """(total, time of sending) of the messages whose round trip is being measured, oldest first."""
    spaced_ns: int
    """New energy may leave from then on."""
    retransmit_ns: int | None
    ack_ns: int | None
    """When an acknowledgement is sent alone; None: none is owed."""
    asked: tuple[int, int] | None
    """When energy was announced that waits for its acknowledgement, and what was acknowledged then."""


class EnergyChannel:
    """One side of the stream, for one pair. Nothing is ever reset: a new pair gets a new channel.

    Parameters
    ----------
    admission : the token bucket that credits pass.
    spacing_ns, ack_delay_ns : see the rules above.
    residue_J : the fraction of a nanojoule that the channel before could not send [J].
    """

    def __init__(
        self,
        admission: TokenBucket,
        *,
        spacing_ns: int,
        residue_J: float = 0.0,
        ack_delay_ns: int = ACK_DELAY_NS,
    ) -> None:
        self.sent_nJ: int = 0
        self.acked_nJ: int = 0
        self.abandoned_nJ: int = 0
        self.credited_nJ: int = 0
        self.residue_J: float = residue_J
        self.rto: RtoEstimator = RtoEstimator()
        self.admission: Final = admission
        self._most_waiting_nJ = admission.most_waiting_nJ
        self.spacing_ns: Final = spacing_ns
        self.ack_delay_ns: Final = ack_delay_ns
        self._announced_nJ = 0  # the highest total that was announced in a message
        self._claimed_nJ = 0  # the highest total that the peer has announced
        self._timed: deque[tuple[int, int]] = deque(
            maxlen=MAX_TIMED
        )  # (total, time of sending) of messages sent only once
        self._spaced_ns = 0  # new energy may leave from this time on
        self._retransmit_ns: int | None = None
        self._ack_ns: int | None = None
        self._closed = False
        self._asked: tuple[int, int] | None = None  # when announced, and what was acknowledged then

    @property
    def announced_nJ(self) -> int:
        """The highest total that was announced in a message."""
        return self._announced_nJ

    @property
    def in_flight_nJ(self) -> int:
        """Energy that was sent and is neither acknowledged nor abandoned."""
        return self.sent_nJ - self.acked_nJ - self.abandoned_nJ

    def send(self, energy_J: float) -> None:
        """Send `energy_J` [J] to the peer. `residue_J`, in [0, 1e-9], keeps the fraction of a nanojoule.

        Raises
        ------
        InvalidParameter : negative, not finite, or the total would reach 2^63 nJ.
        """
        if not 0.0 <= energy_J < MAX_TOTAL_NJ / 1e9:
            raise InvalidParameter("energy", energy_J, "a finite energy >= 0 J")
        held_J = self.residue_J + energy_J
        whole_nJ = floor(held_J * 1e9)
        if whole_nJ / 1e9 > held_J:  # the product was rounded up to the next integer
            whole_nJ -= 1
        if self.sent_nJ + whole_nJ >= MAX_TOTAL_NJ:
            raise InvalidParameter("energy", energy_J, "a total below 2^63 nJ")
        self.sent_nJ += whole_nJ
        self.residue_J = held_J - whole_nJ / 1e9

    def receive(self, total_nJ: int, acked_nJ: int, now_ns: int) -> int:
        """Process a message from the peer; returns the energy credited now [nJ].

        Raises
        ------
        BadMessage : it acknowledges energy that was never announced. Nothing changes then.
        """
        self.acknowledge(acked_nJ, now_ns)
        if total_nJ > 0:
            self._owe_ack(now_ns)
        self._claimed_nJ = max(self._claimed_nJ, min(total_nJ, self.credited_nJ + self._most_waiting_nJ))
        return self.admit(now_ns)

    def acknowledge(self, acked_nJ: int, now_ns: int) -> None:
        """The peer has credited `acked_nJ` in all; a lower value than before is stale and ignored."""
        if acked_nJ > self._announced_nJ:
            raise BadMessage("acknowledgement", f"{acked_nJ} nJ acknowledged of {self._announced_nJ} nJ announced")
        if self._closed or acked_nJ <= self.acked_nJ:
            return
        self.acked_nJ = acked_nJ
        total_nJ = sent_ns = 0
        while self._timed and self._timed[0][0] <= acked_nJ:
            total_nJ, sent_ns = self._timed.popleft()
        if total_nJ == acked_nJ:
            self.rto.sample(now_ns - sent_ns)
        else:  # credited in part: the messages under way would measure the peer's bucket, not the path
            self._timed.clear()
        if self._announced_nJ > acked_nJ:  # the peer credits slowly; it must still hear the total again
            last_ns = self._spaced_ns - self.spacing_ns
            self._retransmit_ns = min(now_ns + self.rto.rto_ns, last_ns + CEILING_NS)
        else:
            self._retransmit_ns = None

    def admit(self, now_ns: int) -> int:
        """Credit the waiting energy, as far as the bucket allows; returns what was credited [nJ]."""
        waiting_nJ = self._claimed_nJ - self.credited_nJ
        if self._closed or waiting_nJ == 0:
            return 0
        credit_nJ = self.admission.take(waiting_nJ, now_ns)
        if credit_nJ:
            self.credited_nJ += credit_nJ
            self._owe_ack(now_ns)
        return credit_nJ

    def poll(self, now_ns: int) -> tuple[int, int] | None:
        """(total_nJ, acked_nJ) of the message to send now, if one is due."""
        if self._closed:
            return None
        expired = self._retransmit_ns is not None and now_ns >= self._retransmit_ns
        if expired or (self.sent_nJ > self._announced_nJ and now_ns >= self._spaced_ns):
            if expired:
                self.rto.back_off()
            if self.sent_nJ > self._announced_nJ:
                self._announced_nJ = self.sent_nJ
                self._timed.append((self.sent_nJ, now_ns))
            elif self._timed and self._timed[-1][0] == self._announced_nJ:
                self._timed.pop()  # Karn: its acknowledgement could belong to either copy
            self._spaced_ns = now_ns + self.spacing_ns
            self._retransmit_ns = now_ns + self.rto.rto_ns
            self._ack_ns = None
            if self._asked is None or self._asked[1] != self.acked_nJ:
                self._asked = now_ns, self.acked_nJ
            return self._announced_nJ, self.credited_nJ
        if self._ack_ns is not None and now_ns >= self._ack_ns:
            self._ack_ns = None
            return 0, self.credited_nJ
        return None

    @property
    def next_due_ns(self) -> int | None:
        """When to call `admit` and `poll` next. A time in the past means now; None means that nothing is planned."""
        if self._closed:
            return None
        due = self._retransmit_ns
        if self._ack_ns is not None and (due is None or self._ack_ns < due):
            due = self._ack_ns
        if self.sent_nJ > self._announced_nJ and (due is None or self._spaced_ns < due):
            due = self._spaced_ns
        if self._claimed_nJ > self.credited_nJ:
            admission_ns = self.admission.due_ns(self._claimed_nJ - self.credited_nJ, ADMISSION_STEP_NS)
            due = admission_ns if due is None else min(due, admission_ns)
        return due

    def unanswered_ns(self, heard_ns: int | None) -> int:
        """How long the oldest message without an acknowledgement had waited at `heard_ns`; 0: there is none.

        heard_ns : when the peer's last position came, so that the peer's silence does not count.
        """
        if self._asked is None or heard_ns is None or not self._asked[1] == self.acked_nJ < self.sent_nJ:
            return 0
        return max(0, heard_ns - self._asked[0])

    def abandon(self) -> int:
        """End the pair: energy in flight is given up and never resent; returns it [nJ]. Nothing is credited afterwards.

        The peer may have credited a part whose acknowledgement was lost. So the abandoned energy is an upper bound of
        the energy lost.
        """
        self._closed = True
        given_up_nJ = self.in_flight_nJ
        self.abandoned_nJ += given_up_nJ
        return given_up_nJ

    def state(self) -> ChannelState:
        """What `restore` takes."""
        return ChannelState(
            self.sent_nJ, self.acked_nJ, self.credited_nJ, self.residue_J, self._announced_nJ, self._claimed_nJ,
            tuple(self._timed), self._spaced_ns, self._retransmit_ns, self._ack_ns, self._asked,
        )  # fmt: skip

    def restore(self, state: ChannelState) -> None:
        """Go on from there."""
        (
            self.sent_nJ, self.acked_nJ, self.credited_nJ, self.residue_J, self._announced_nJ, self._claimed_nJ,
            timed, self._spaced_ns, self._retransmit_ns, self._ack_ns, self._asked,
        ) = state  # fmt: skip
        self._timed = deque(timed, maxlen=MAX_TIMED)

    def _owe_ack(self, now_ns: int) -> None:
        if self._ack_ns is None:
            self._ack_ns = now_ns + self.ack_delay_ns


@dataclass(slots=True)
class Totals:
    """The sums over the channels of pairs that have ended [nJ]."""

    sent: int = 0
    acked: int = 0
    credited: int = 0
    abandoned: int = 0

    def add(self, channel: EnergyChannel) -> None:
        self.sent += channel.sent_nJ
        self.acked += channel.acked_nJ
        self.credited += channel.credited_nJ
        self.abandoned += channel.abandoned_nJ
