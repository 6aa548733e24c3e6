"""Lines with a rate, many at once (`netem.link`), and which links can be vectorised at all."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np

from hapnet.params import Params
from hapnet.side.packet import FRAME_OVERHEAD
from hapnet.simulation.batch.channels import NEVER, Whole
from hapnet.simulation.batch.couplings import Index
from hapnet.wire.energy_channel import ACK_DELAY_NS
from hapnet.wire.messages import Position, encode
from hapnet.wire.numbering import EARLY_NS
from netem import LinkProfile, models

_HANDSHAKE = 100
"""Positions that are as much as the handshake's messages that may be under way when it is loaded, and some to spare."""


class Lines:
    """The lines of one direction; those without a rate are left alone."""

    def __init__(self, profiles: Sequence[LinkProfile]) -> None:
        self.timed = any(profile.rate_bit_s for profile in profiles)
        self._rate_bit_s = np.array([profile.rate_bit_s for profile in profiles])
        self._overhead = np.array([profile.overhead for profile in profiles])
        self._cell_size = np.array([profile.cell_size for profile in profiles])
        self._cell_bytes = self._cell_size + np.array([profile.cell_overhead for profile in profiles])

    def release(self, at: Index, due_ns: Whole, last_ns: Whole, size: Whole) -> Whole:
        """When messages leave that are due at the line's end, if it is free: after the last, and each in its time.

        `NEVER` where there is no rate.
        """
        rate = self._rate_bit_s[at]
        length = np.maximum(0, size + self._overhead[at])
        cell = self._cell_size[at]
        if cell.any():
            cells = -(-length // np.maximum(cell, 1)) * self._cell_bytes[at]
            length = np.where(cell > 0, cells, length)
        released: Whole = np.maximum(due_ns, last_ns) + length * 8_000_000_000 // np.maximum(rate, 1)
        return np.where(rate > 0, released, NEVER)


@cache
def shortest_ns(profile: LinkProfile) -> int:
    """No delay of this link is shorter."""
    if profile.reorder:
        return 0
    if profile.jitter_ns and profile.distribution != "uniform":
        return int(models.delay_quantiles(profile)[0])
    return max(0, profile.delay_ns - profile.jitter_ns)


@cache
def longest_ns(profile: LinkProfile) -> int:
    """No delay of this link is longer, but for the time in which its line is busy."""
    resends_ns = profile.resend.times * profile.resend.after_ns if profile.resend is not None else 0
    if profile.jitter_ns and profile.distribution != "uniform":
        return resends_ns + int(models.delay_quantiles(profile)[-1])
    return resends_ns + profile.delay_ns + profile.jitter_ns


def vectorisable(params: Params, dof: int, up: LinkProfile, down: LinkProfile) -> bool:
    """Can the links of a scenario be vectorised? No slots, no traces, and never full, whatever happens.

    With resends nothing that is sent ahead, and no line that unordered ones reach later than what was sent after them.
    Nor one that sends messages ahead of many others: a receiver may doubt them (`hapnet.wire.numbering`).
    """
    if any(profile.slot or profile.trace or profile.csv for profile in (up, down)):
        return False
    if any(profile.reorder and longest_ns(profile) > EARLY_NS for profile in (up, down)):
        return False
    if any(p.resend and (p.reorder or (p.rate_bit_s and not p.resend.ordered)) for p in (up, down)):
        return False
    # Each side sends energy once a spacing at most, an acknowledgement once in its delay, and a position a step or a
    # PSPM instant. PSPM runs every period, and once for all that a tick finds arrived.
    largest = FRAME_OVERHEAD + len(encode(Position(2**63, 2**63, 2**63, (0.0,) * dof)))
    energy_hz = 1.0 / params.wire.energy_spacing_s + 1e9 / ACK_DELAY_NS
    down_hz = 1.0 / params.world.step_min_s + energy_hz
    under_way = _most_under_way(down, largest, down_hz, _HANDSHAKE)
    if under_way >= down.limit:
        return False
    up_hz = 1.0 / params.device.pspm_period_s + down_hz + energy_hz
    return _most_under_way(up, largest, up_hz, _HANDSHAKE + under_way) < up.limit


def _most_under_way(profile: LinkProfile, size: int, most_hz: float, burst: float) -> float:
    """How many messages are under way at most, if in every interval T no more than ``most_hz T + burst`` are sent.

    They have `size` bytes at most. A line that keeps up is busy for a burst's time at most after
    the last delay is over.
    """
    busy_s = 0.0
    if profile.rate_bit_s:
        busy_s = models.transmission_ns(size, profile) * 1e-9
        if most_hz * busy_s > 1.0:
            return np.inf
    return most_hz * (longest_ns(profile) * 1e-9 + burst * busy_s) + burst
