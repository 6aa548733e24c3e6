"""One side's energy channel: `hapnet.wire.energy_channel`, with its `rto` and its `token_bucket`."""

from __future__ import annotations

import math
from typing import Annotated

from hapnet.records.equation import equation
from hapnet.records.record import Record, Wholes
from hapnet.wire.energy_channel import ADMISSION_STEP_NS, MAX_TIMED
from hapnet.wire.rto import CEILING_NS, GRANULARITY_NS

NEVER = 2**63 - 1
"""A time that never comes."""

_AJ_PER_NJ = 1_000_000_000
_MAX_TIMED, _ADMISSION_STEP_NS, _CEILING_NS, _GRANULARITY_NS = MAX_TIMED, ADMISSION_STEP_NS, CEILING_NS, GRANULARITY_NS


class EnergyChannel(Record):
    """`EnergyChannel`; a time that is None there is `NEVER` here.

    asks : has `_asked` a value? first, timed : the queue of timed messages is a ring. srtt_ns : -1 where it is unknown.
    filled : was the bucket's level ever counted? total_nJ, message_acked_nJ : of the message that `poll` makes.
    """

    sent_nJ: int
    acked_nJ: int
    credited_nJ: int
    residue_J: float
    announced_nJ: int
    claimed_nJ: int
    most_waiting_nJ: int
    spacing_ns: int
    ack_delay_ns: int
    spaced_ns: int
    retransmit_ns: int
    ack_ns: int
    asks: int
    asked_ns: int
    asked_nJ: int
    first: int
    timed: int
    timed_nJ: Annotated[Wholes, (MAX_TIMED,)]
    timed_ns: Annotated[Wholes, (MAX_TIMED,)]
    base_ns: int
    backed_off: int
    srtt_ns: int
    rttvar_ns: int
    floor_ns: int
    ceiling_ns: int
    level_aJ: int
    filled: int
    filled_ns: int
    rate_nW: int
    burst_aJ: int
    total_nJ: int
    message_acked_nJ: int


@equation
def send(channel: EnergyChannel, energy_J: float) -> None:
    """`EnergyChannel.send`."""
    held_J = channel.residue_J + energy_J
    whole_nJ = math.floor(held_J * 1e9)
    if whole_nJ / 1e9 > held_J:
        whole_nJ -= 1
    channel.sent_nJ += whole_nJ
    channel.residue_J = held_J - whole_nJ / 1e9


@equation
def receive(channel: EnergyChannel, total_nJ: int, acked_nJ: int, now_ns: int) -> int:
    """`EnergyChannel.receive`: the energy credited now [nJ]."""
    _acknowledge(channel, acked_nJ, now_ns)
    if total_nJ > 0:
        _owe_ack(channel, now_ns)
    channel.claimed_nJ = max(channel.claimed_nJ, min(total_nJ, channel.credited_nJ + channel.most_waiting_nJ))
    return admit(channel, now_ns)


@equation
def admit(channel: EnergyChannel, now_ns: int) -> int:
    """`EnergyChannel.admit`."""
    waiting_nJ = channel.claimed_nJ - channel.credited_nJ
    if waiting_nJ == 0:
        return 0
    credit_nJ = _take(channel, waiting_nJ, now_ns)
    if credit_nJ:
        channel.credited_nJ += credit_nJ
        _owe_ack(channel, now_ns)
    return credit_nJ


@equation
def poll(channel: EnergyChannel, now_ns: int) -> bool:
    """`EnergyChannel.poll`: is there a message to send now?"""
    expired = now_ns >= channel.retransmit_ns
    news = channel.sent_nJ > channel.announced_nJ
    if expired or (news and now_ns >= channel.spaced_ns):
        if expired and rto_ns(channel) < channel.ceiling_ns:
            channel.backed_off += 1
        if news:
            channel.announced_nJ = channel.sent_nJ
            _time(channel, channel.sent_nJ, now_ns)
        elif channel.timed:
            last = (channel.first + channel.timed - 1) % _MAX_TIMED
            if channel.timed_nJ[last] == channel.announced_nJ:
                channel.timed -= 1
        channel.spaced_ns = now_ns + channel.spacing_ns
        channel.retransmit_ns = now_ns + rto_ns(channel)
        channel.ack_ns = NEVER
        if not channel.asks or channel.asked_nJ != channel.acked_nJ:
            channel.asks, channel.asked_ns, channel.asked_nJ = 1, now_ns, channel.acked_nJ
        channel.total_nJ = channel.announced_nJ
    elif now_ns >= channel.ack_ns:
        channel.ack_ns = NEVER
        channel.total_nJ = 0
    else:
        return False
    channel.message_acked_nJ = channel.credited_nJ
    return True


@equation
def next_due_ns(channel: EnergyChannel) -> int:
    """`EnergyChannel.next_due_ns`."""
    due = min(channel.retransmit_ns, channel.ack_ns)
    if channel.sent_nJ > channel.announced_nJ:
        due = min(due, channel.spaced_ns)
    if channel.claimed_nJ > channel.credited_nJ:
        due = min(due, _filled_ns(channel, channel.claimed_nJ - channel.credited_nJ))
    return due


@equation
def _acknowledge(channel: EnergyChannel, acked_nJ: int, now_ns: int) -> None:
    """`EnergyChannel.acknowledge`."""
    if acked_nJ <= channel.acked_nJ:
        return
    channel.acked_nJ = acked_nJ
    total_nJ = sent_ns = 0
    while channel.timed and channel.timed_nJ[channel.first] <= acked_nJ:
        total_nJ, sent_ns = channel.timed_nJ[channel.first], channel.timed_ns[channel.first]
        channel.first = (channel.first + 1) % _MAX_TIMED
        channel.timed -= 1
    if total_nJ == acked_nJ:
        _sample(channel, now_ns - sent_ns)
    else:
        channel.timed = 0
    if channel.announced_nJ > acked_nJ:
        last_ns = channel.spaced_ns - channel.spacing_ns
        channel.retransmit_ns = min(now_ns + rto_ns(channel), last_ns + _CEILING_NS)
    else:
        channel.retransmit_ns = NEVER


@equation
def _owe_ack(channel: EnergyChannel, now_ns: int) -> None:
    """`EnergyChannel._owe_ack`."""
    channel.ack_ns = min(channel.ack_ns, now_ns + channel.ack_delay_ns)


@equation
def _time(channel: EnergyChannel, total_nJ: int, now_ns: int) -> None:
    """Measure the round trip of a message; of too many the oldest is forgotten."""
    if channel.timed == _MAX_TIMED:
        channel.first = (channel.first + 1) % _MAX_TIMED
        channel.timed -= 1
    at = (channel.first + channel.timed) % _MAX_TIMED
    channel.timed_nJ[at], channel.timed_ns[at] = total_nJ, now_ns
    channel.timed += 1


@equation
def rto_ns(channel: EnergyChannel) -> int:
    """`RtoEstimator.rto_ns`."""
    return min(channel.base_ns << channel.backed_off, channel.ceiling_ns)


@equation
def _sample(channel: EnergyChannel, rtt_ns: int) -> None:
    """`RtoEstimator.sample`."""
    rtt_ns = max(0, rtt_ns)
    if channel.srtt_ns < 0:
        channel.srtt_ns, channel.rttvar_ns = rtt_ns, rtt_ns // 2
    else:
        channel.rttvar_ns = (3 * channel.rttvar_ns + abs(channel.srtt_ns - rtt_ns)) // 4
        channel.srtt_ns = (7 * channel.srtt_ns + rtt_ns) // 8
    timeout_ns = channel.srtt_ns + max(_GRANULARITY_NS, 4 * channel.rttvar_ns)
    channel.base_ns = min(max(timeout_ns, channel.floor_ns), channel.ceiling_ns)
    channel.backed_off = 0


@equation
def _take(channel: EnergyChannel, wanted_nJ: int, now_ns: int) -> int:
    """`TokenBucket.take`. A long time fills the bucket: its power times that time might not fit 64 bits."""
    if not channel.filled:
        channel.filled, channel.filled_ns = 1, now_ns
    if now_ns > channel.filled_ns:
        lacking_aJ = channel.burst_aJ - channel.level_aJ
        if now_ns - channel.filled_ns > lacking_aJ // channel.rate_nW:
            channel.level_aJ = channel.burst_aJ
        else:
            channel.level_aJ += channel.rate_nW * (now_ns - channel.filled_ns)
        channel.filled_ns = now_ns
    taken_nJ = min(wanted_nJ, channel.level_aJ // _AJ_PER_NJ)
    channel.level_aJ -= taken_nJ * _AJ_PER_NJ
    return taken_nJ


@equation
def _filled_ns(channel: EnergyChannel, wanted_nJ: int) -> int:
    """`TokenBucket.due_ns`. The burst is a whole number of nJ, so the least is found before it is multiplied."""
    step_nJ = max(1, channel.rate_nW * _ADMISSION_STEP_NS // _AJ_PER_NJ)
    lacking_aJ = min(wanted_nJ, min(channel.burst_aJ // _AJ_PER_NJ, step_nJ)) * _AJ_PER_NJ - channel.level_aJ
    since_ns = channel.filled_ns if channel.filled else 0
    return since_ns + max(0, -(-lacking_aJ // channel.rate_nW))
