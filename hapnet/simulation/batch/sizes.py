"""Sizes of many messages on a link; in energy messages msgpack takes 1 to 9 bytes for an integer."""

from __future__ import annotations

import numpy as np

from hapnet.side.packet import FRAME_OVERHEAD
from hapnet.simulation.batch.arrays import Index, Whole
from hapnet.wire.messages import Energy, Position, encode
from hapnet.wire.session import Session

_BOUNDS = np.array([1 << 7, 1 << 8, 1 << 16, 1 << 32])
_BYTES = np.array([1, 2, 3, 5, 9])


class Sizes:
    """Sizes of the messages that one side sends in each scenario, with all headers [bytes].

    Parameters
    ----------
    sessions : of this side, paired. dof : coordinates of a position.
    """

    def __init__(self, sessions: list[Session], dof: int) -> None:
        position, energy = [], []
        for session in sessions:
            assert session.peer is not None
            me, peer = session.identity.incarnation, session.peer.incarnation
            position.append(FRAME_OVERHEAD + len(encode(Position(me, 0, 0, (0.0,) * dof))))
            energy.append(FRAME_OVERHEAD + len(encode(Energy(me, peer, 0, 0))) - 2)
        self._position, self._energy = np.array(position), np.array(energy)

    def position(self, at: Index) -> Whole:
        """Sizes of positions."""
        size: Whole = self._position[at]
        return size

    def energy(self, at: Index, total_nJ: Whole, acked_nJ: Whole) -> Whole:
        """Sizes of energy messages."""
        size: Whole = self._energy[at] + _width(total_nJ) + _width(acked_nJ)
        return size


def _width(values: Whole) -> Whole:
    return _BYTES.take(np.searchsorted(_BOUNDS, values, side="right"))
