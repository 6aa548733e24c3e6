"""How long messages are on a link, many at once: msgpack takes 1 to 9 bytes for an integer, the rest does not vary."""

from __future__ import annotations

import numpy as np

from hapnet.runtime.batch.channels import Whole
from hapnet.runtime.batch.couplings import Index
from hapnet.runtime.parcel import FRAME_OVERHEAD
from hapnet.wire.messages import Energy, encode, encode_position
from hapnet.wire.session import Session

_BOUNDS = np.array([1 << 7, 1 << 8, 1 << 16, 1 << 32])
_BYTES = np.array([1, 2, 3, 5, 9])


class Sizes:
    """Of what one side sends in each scenario, bytes with all headers.

    Parameters
    ----------
    sessions : of this side, paired. dof : coordinates of a position.
    shift_ns : what a scenario's own clock shows when the batch's shows 0.
    """

    def __init__(self, sessions: list[Session], dof: int, shift_ns: Whole) -> None:
        self._shift_ns = shift_ns
        position, energy = [], []
        for session in sessions:
            assert session.peer is not None
            me, peer = session.identity.incarnation, session.peer.incarnation
            position.append(FRAME_OVERHEAD + len(encode_position(me, 0, 0, (0.0,) * dof)) - 2)
            energy.append(FRAME_OVERHEAD + len(encode(Energy(me, peer, 0, 0))) - 2)
        self._position, self._energy = np.array(position), np.array(energy)

    def position(self, at: Index, number: Whole, now_ns: Whole) -> Whole:
        """Of positions with these numbers, sent now."""
        size: Whole = self._position[at] + _width(number) + _width(now_ns + self._shift_ns[at])
        return size

    def energy(self, at: Index, total_nJ: Whole, acked_nJ: Whole) -> Whole:
        """Of energy messages."""
        size: Whole = self._energy[at] + _width(total_nJ) + _width(acked_nJ)
        return size


def _width(values: Whole) -> Whole:
    return _BYTES.take(np.searchsorted(_BOUNDS, values, side="right"))
