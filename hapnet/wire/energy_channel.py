"""The acknowledged stream of nanojoules between one pair of incarnations, both directions.

As TCP numbers bytes, this channel numbers nanojoules. Every message states the total sent and the total credited. So a
later message repairs the loss of every earlier one, and neither loss, repetition nor reordering can create or lose
energy. The rules:

* New energy is sent at once, but not sooner than `spacing_ns` after the last message.
* An unacknowledged total is repeated when the timer of RFC 6298 expires. Every message restarts the timer, and so does
  every acknowledgement that advances, but never beyond the timer's ceiling.
* A message with `total_nJ` > 0 requires an acknowledgement. It is sent with the next message of the other direction if
  there is one within `ack_delay_ns`; otherwise it is sent alone, with `total_nJ` = 0. Such a message is stale by the
  ordinary rule (0 is not above the credited total) and is never answered, so two quiet sides stay quiet.
* Credits pass a token bucket. Energy without tokens waits, and `admit` credits it as tokens come. At most as much waits
  as the tokens can pay until the sender repeats its total: a total that is too high, by a flipped bit or a forger, is
  soon forgotten.

At every instant `sent_nJ == acked_nJ + in_flight_nJ + abandoned_nJ` here, and, since acknowledging follows crediting
follows sending, `acked_nJ (here) <= credited_nJ (peer) <= sent_nJ (here)`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from hapnet.errors import BadMessage, InvalidParameter
from hapnet.records.record import NEVER, Record, Wholes, equation
from hapnet.wire.fields import MAX_TOTAL_NJ
from hapnet.wire.rto import CEILING_NS, RtoEstimator, back_off, sample, timeout_ns
from hapnet.wire.token_bucket import TokenBucket, due_ns, take

ACK_DELAY_NS = 10_000_000  # the usual spacing: while energy flows in both directions, no acknowledgement is sent alone
ADMISSION_STEP_NS = 10_000_000
MAX_TIMED = 256  # messages whose round trip is being measured: 2.5 s of them, above any timeout


class EnergyChannel(Record):
    """One side of the stream, for one pair. Nothing is ever reset: a new pair gets a new channel.

    admission : the token bucket that credits pass.
    spacing_ns, ack_delay_ns : see the rules above.
    residue_J : the fraction of a nanojoule that the previous channel could not send [J].

    Attributes
    ----------
    announced_nJ : the highest total that was announced in a message.
    claimed_nJ : the highest total that the peer has announced, as far as it may wait for tokens.
    spaced_ns, retransmit_ns, ack_ns : when new energy may leave, when it is repeated, and when an acknowledgement is
        sent alone; `NEVER`: nothing is to be repeated, or acknowledged.
    asked_ns, asked_nJ : when the energy was announced that waits for an acknowledgement, and the energy acknowledged
        by then; below 0: none waits.
    timed_nJ, timed_ns, first, timed : the messages whose round trip is being measured, their totals and when they were
        sent: a ring, the place of the oldest, and how many there are.
    """

    sent_nJ: int
    acked_nJ: int
    credited_nJ: int
    residue_J: float
    announced_nJ: int
    claimed_nJ: int
    spacing_ns: int
    ack_delay_ns: int
    spaced_ns: int
    retransmit_ns: int
    ack_ns: int
    closed: int
    asked_ns: int
    asked_nJ: int
    first: int
    timed: int
    timed_nJ: Annotated[Wholes, (MAX_TIMED,)]
    timed_ns: Annotated[Wholes, (MAX_TIMED,)]
    rto: RtoEstimator
    admission: TokenBucket

    def __init__(
        self,
        admission: TokenBucket,
        *,
        spacing_ns: int,
        residue_J: float = 0.0,
        ack_delay_ns: int = ACK_DELAY_NS,
    ) -> None:
        self.sent_nJ = self.acked_nJ = self.credited_nJ = self.announced_nJ = self.claimed_nJ = 0
        self.abandoned_nJ: int = 0
        self.residue_J = residue_J
        self.spacing_ns, self.ack_delay_ns = spacing_ns, ack_delay_ns
        self.spaced_ns, self.retransmit_ns, self.ack_ns, self.closed = 0, NEVER, NEVER, 0
        self.asked_ns, self.asked_nJ = 0, -1
        self.first = self.timed = 0
        self.timed_nJ, self.timed_ns = [0] * MAX_TIMED, [0] * MAX_TIMED
        self.rto, self.admission = RtoEstimator(), admission

    @property
    def in_flight_nJ(self) -> int:
        """Energy that was sent and is neither acknowledged nor abandoned."""
        return self.sent_nJ - self.acked_nJ - self.abandoned_nJ

    def send(self, energy_J: float) -> None:
        """Send `energy_J` [J] to the peer. `residue_J`, in [0, 1e-9], keeps the fraction of a nanojoule.

        Raises InvalidParameter: negative, not finite, or the total would reach 2^63 nJ.
        """
        if not 0.0 <= energy_J < MAX_TOTAL_NJ / 1e9:
            raise InvalidParameter("energy", energy_J, "a finite energy >= 0 J")
        before = self.sent_nJ, self.residue_J
        send(self, energy_J)
        if self.sent_nJ >= MAX_TOTAL_NJ:
            self.sent_nJ, self.residue_J = before
            raise InvalidParameter("energy", energy_J, "a total below 2^63 nJ")

    def receive(self, total_nJ: int, acked_nJ: int, now_ns: int) -> int:
        """Process a message from the peer; returns the energy credited now [nJ].

        Raises BadMessage: it acknowledges energy that was never announced. Nothing changes then.
        """
        if acked_nJ > self.announced_nJ:
            raise self._never_announced(acked_nJ)
        return receive(self, total_nJ, acked_nJ, now_ns)

    def acknowledge(self, acked_nJ: int, now_ns: int) -> None:
        """Enter that the peer has credited `acked_nJ` in all; a lower value than before is stale and ignored."""
        if acked_nJ > self.announced_nJ:
            raise self._never_announced(acked_nJ)
        acknowledge(self, acked_nJ, now_ns)

    @equation
    def admit(self, now_ns: int) -> int:
        """Credit the waiting energy, as far as the bucket allows; returns the energy credited [nJ]."""
        waiting_nJ = self.claimed_nJ - self.credited_nJ
        if waiting_nJ == 0 or self.closed:
            return 0
        credit_nJ = take(self.admission, waiting_nJ, now_ns)
        if credit_nJ:
            self.credited_nJ += credit_nJ
            _owe_ack(self, now_ns)
        return credit_nJ

    def poll(self, now_ns: int) -> tuple[int, int] | None:
        """(total_nJ, acked_nJ) of the message to send now, if one is due."""
        total_nJ = poll(self, now_ns)
        return None if total_nJ < 0 else (total_nJ, self.credited_nJ)

    @property
    def next_due_ns(self) -> int | None:
        """The time to call `admit` and `poll` next. A time in the past means now; None: nothing is planned."""
        due = next_due_ns(self)
        return None if due == NEVER else due

    def unanswered_ns(self, heard_ns: int | None) -> int:
        """The time that the oldest message without an acknowledgement had waited at `heard_ns`; 0: there is none.

        heard_ns : when the peer's last position came, so that the peer's silence does not count.
        """
        if heard_ns is None or not self.asked_nJ == self.acked_nJ < self.sent_nJ:
            return 0
        return max(0, heard_ns - self.asked_ns)

    def abandon(self) -> int:
        """End the pair: energy in flight is given up and never resent; returns it [nJ]. Nothing is credited afterwards.

        The peer may have credited a part whose acknowledgement was lost. So the abandoned energy is an upper bound of
        the energy lost.
        """
        self.closed = 1
        given_up_nJ = self.in_flight_nJ
        self.abandoned_nJ += given_up_nJ
        return given_up_nJ

    def _never_announced(self, acked_nJ: int) -> BadMessage:
        return BadMessage("acknowledgement", f"{acked_nJ} nJ acknowledged of {self.announced_nJ} nJ announced")


@equation
def send(channel: EnergyChannel, energy_J: float) -> None:
    """Send an energy that was checked: `EnergyChannel.send`."""
    held_J = channel.residue_J + energy_J
    whole_nJ = math.floor(held_J * 1e9)
    if whole_nJ / 1e9 > held_J:  # the product was rounded up to the next integer
        whole_nJ -= 1
    channel.sent_nJ += whole_nJ
    channel.residue_J = held_J - whole_nJ / 1e9


@equation
def receive(channel: EnergyChannel, total_nJ: int, acked_nJ: int, now_ns: int) -> int:
    """Process a message that acknowledges at most the announced energy: `EnergyChannel.receive`."""
    acknowledge(channel, acked_nJ, now_ns)
    if total_nJ > 0:
        _owe_ack(channel, now_ns)
    claimed_nJ = min(total_nJ, channel.credited_nJ + channel.admission.most_waiting_nJ)
    if claimed_nJ > channel.claimed_nJ:
        channel.claimed_nJ = claimed_nJ
    return admit(channel, now_ns)


@equation
def acknowledge(channel: EnergyChannel, acked_nJ: int, now_ns: int) -> None:
    """Enter an acknowledgement of at most the announced energy: `EnergyChannel.acknowledge`."""
    if acked_nJ <= channel.acked_nJ or channel.closed:
        return
    channel.acked_nJ = acked_nJ
    total_nJ = sent_ns = 0
    while channel.timed and channel.timed_nJ[channel.first] <= acked_nJ:
        total_nJ, sent_ns = channel.timed_nJ[channel.first], channel.timed_ns[channel.first]
        _forget_oldest(channel)
    if total_nJ == acked_nJ:
        sample(channel.rto, now_ns - sent_ns)
    else:  # credited in part: the messages in flight would measure the peer's bucket, not the path
        channel.timed = 0
    if channel.announced_nJ > acked_nJ:  # the peer credits slowly; it must still receive the total again
        last_ns = channel.spaced_ns - channel.spacing_ns
        channel.retransmit_ns = min(now_ns + timeout_ns(channel.rto), last_ns + CEILING_NS)
    else:
        channel.retransmit_ns = NEVER


@equation
def poll(channel: EnergyChannel, now_ns: int) -> int:
    """The total of the message to send now [nJ], which acknowledges all that was credited; -1: none is due."""
    if channel.closed:
        return -1
    expired = now_ns >= channel.retransmit_ns
    news = channel.sent_nJ > channel.announced_nJ
    if expired or (news and now_ns >= channel.spaced_ns):
        if expired:
            back_off(channel.rto)
        if news:
            channel.announced_nJ = channel.sent_nJ
            _time(channel, channel.sent_nJ, now_ns)
        elif channel.timed:
            last = (channel.first + channel.timed - 1) % MAX_TIMED
            if channel.timed_nJ[last] == channel.announced_nJ:
                channel.timed -= 1  # Karn: its acknowledgement could belong to either copy
        channel.spaced_ns = now_ns + channel.spacing_ns
        channel.retransmit_ns = now_ns + timeout_ns(channel.rto)
        channel.ack_ns = NEVER
        if channel.asked_nJ != channel.acked_nJ:
            channel.asked_ns, channel.asked_nJ = now_ns, channel.acked_nJ
        return channel.announced_nJ
    if now_ns >= channel.ack_ns:
        channel.ack_ns = NEVER
        return 0
    return -1


@equation
def next_due_ns(channel: EnergyChannel) -> int:
    """The time of the next `admit` and `poll`: `EnergyChannel.next_due_ns`; `NEVER`: nothing is planned."""
    if channel.closed:
        return NEVER
    due = channel.retransmit_ns
    if channel.ack_ns < due:
        due = channel.ack_ns
    if channel.sent_nJ > channel.announced_nJ and channel.spaced_ns < due:
        due = channel.spaced_ns
    if channel.claimed_nJ > channel.credited_nJ:
        due = min(due, due_ns(channel.admission, channel.claimed_nJ - channel.credited_nJ, ADMISSION_STEP_NS))
    return due


@equation
def _owe_ack(channel: EnergyChannel, now_ns: int) -> None:
    if channel.ack_ns == NEVER:
        channel.ack_ns = now_ns + channel.ack_delay_ns


@equation
def _time(channel: EnergyChannel, total_nJ: int, now_ns: int) -> None:
    """Measure the round trip of a message; if the ring is full, the oldest is forgotten."""
    if channel.timed == MAX_TIMED:
        _forget_oldest(channel)
    at = (channel.first + channel.timed) % MAX_TIMED
    channel.timed_nJ[at], channel.timed_ns[at] = total_nJ, now_ns
    channel.timed += 1


@equation
def _forget_oldest(channel: EnergyChannel) -> None:
    channel.first = (channel.first + 1) % MAX_TIMED
    channel.timed -= 1


admit = EnergyChannel.admit
"""These methods as functions, for calls from equations."""


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
