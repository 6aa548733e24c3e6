"""Lines with a rate, many at once (`netem.link`), and which links can be vectorised at all."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray

from hapnet.params import Params
from hapnet.side.packet import FRAME_OVERHEAD, Packet
from hapnet.simulation.batch.arrays import LONG_AGO, Index, Whole
from hapnet.wire.energy_channel import ACK_DELAY_NS
from hapnet.wire.messages import Position, encode
from hapnet.wire.numbering import EARLY_NS
from netem import Link, LinkProfile, models
from netem.line import RateLine

_HANDSHAKE = 100
"""As many positions as the handshake messages that may be in flight when a scenario is loaded, and some to spare."""


class Lines:
    """The rate-limited lines of one direction; links without a rate are not changed.

    Parameters
    ----------
    links : the scenarios' own. shift_ns : time on their clocks when the batch's clock shows 0.
    """

    def __init__(self, links: Sequence[Link[Packet]], shift_ns: Whole) -> None:
        profiles = [link.profile for link in links]
        self.timed = any(profile.rate_bit_s for profile in profiles)
        self._rate_bit_s = np.array([profile.rate_bit_s for profile in profiles])
        self._overhead = np.array([profile.overhead for profile in profiles])
        self._cell_size = np.array([profile.cell_size for profile in profiles])
        self._cell_bytes = self._cell_size + np.array([profile.cell_overhead for profile in profiles])
        free_ns = [max(link.line.free_ns, LONG_AGO) if isinstance(link.line, RateLine) else LONG_AGO for link in links]
        self._free_ns = np.maximum(np.array(free_ns) - shift_ns, LONG_AGO)
        self._shift_ns = shift_ns

    def release(self, at: Index, due_ns: Whole, size: Whole, arriving: NDArray[np.bool_]) -> Whole:
        """When messages leave the line that would be due at `due_ns` if it were free: after the last, one at a time.

        Only messages that are `arriving` occupy the line.
        """
        rate = self._rate_bit_s[at]
        length = np.maximum(0, size + self._overhead[at])
        cell = self._cell_size[at]
        if cell.any():
            cells = -(-length // np.maximum(cell, 1)) * self._cell_bytes[at]
            length = np.where(cell > 0, cells, length)
        released: Whole = np.maximum(due_ns, self._free_ns[at]) + length * 8_000_000_000 // np.maximum(rate, 1)
        timed = arriving & (rate > 0)
        self._free_ns[at[timed]] = released[timed]
        return np.where(timed, released, due_ns)

    def write_back(self, i: int, link: Link[Packet]) -> None:
        """Write scenario i's state back."""
        if isinstance(link.line, RateLine) and self._free_ns[i] > LONG_AGO:
            link.line.free_ns = int(self._free_ns[i] + self._shift_ns[i])


@cache
def shortest_ns(profile: LinkProfile) -> int:
    """Lower bound of this link's delay [ns]."""
    if profile.reorder:
        return 0
    if profile.jitter_ns and profile.distribution != "uniform":
        return int(models.delay_quantiles(profile)[0])
    return max(0, profile.delay_ns - profile.jitter_ns)


@cache
def longest_ns(profile: LinkProfile) -> int:
    """Upper bound of this link's delay [ns], without the time in which its line is busy."""
    resends_ns = profile.resend.times * profile.resend.after_ns if profile.resend is not None else 0
    if profile.jitter_ns and profile.distribution != "uniform":
        return resends_ns + int(models.delay_quantiles(profile)[-1])
    return resends_ns + profile.delay_ns + profile.jitter_ns


def vectorisable(params: Params, dof: int, up: LinkProfile, down: LinkProfile) -> bool:
    """Can the links of a scenario be vectorised?

    Links with slots or traces cannot, nor links that could ever be full. Links with resends may not send messages
    ahead, and with a rate the resends must be ordered: otherwise a resent message reaches the line after later ones.
    Links may not send a message ahead of many others, because a receiver may doubt it (`hapnet.wire.numbering`).
    """
    if any(profile.slot or profile.trace or profile.csv for profile in (up, down)):
        return False
    if any(profile.reorder and longest_ns(profile) > EARLY_NS for profile in (up, down)):
        return False
    if any(p.resend and (p.reorder or (p.rate_bit_s and not p.resend.ordered)) for p in (up, down)):
        return False
    # Each side sends at most one energy message per spacing, one acknowledgement per acknowledgement delay, and one
    # position per step or PSPM instant. PSPM runs every period, and once for all that a tick finds arrived.
    largest = FRAME_OVERHEAD + len(encode(Position(2**63, 2**63, 2**63, (0.0,) * dof)))
    energy_hz = 1.0 / params.wire.energy_spacing_s + 1e9 / ACK_DELAY_NS
    down_hz = 1.0 / params.world.step_min_s + energy_hz
    under_way = _most_under_way(down, largest, down_hz, _HANDSHAKE)
    if under_way >= down.limit:
        return False
    up_hz = 1.0 / params.device.pspm_period_s + down_hz + energy_hz
    return _most_under_way(up, largest, up_hz, _HANDSHAKE + under_way) < up.limit


def _most_under_way(profile: LinkProfile, size: int, most_hz: float, burst: float) -> float:
    """Most messages in flight, if at most ``most_hz T + burst`` messages are sent in every interval T.

    They have at most `size` bytes. A line that keeps up is busy for at most a burst's time after the last delay ends.
    """
    busy_s = 0.0
    if profile.rate_bit_s:
        busy_s = models.transmission_ns(size, profile) * 1e-9
        if most_hz * busy_s > 1.0:
            return np.inf
    return most_hz * (longest_ns(profile) * 1e-9 + burst * busy_s) + burst
