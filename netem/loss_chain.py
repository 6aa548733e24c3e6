"""Loss models as Markov chains: the share of losses, and the length of their runs, in the long run."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from netem.effects import FourStateLoss, GilbertElliottLoss, Loss, RandomLoss

_Matrix = NDArray[np.float64]


def share_and_run(loss: Loss, kept: float = 1.0) -> tuple[float, float | None]:
    """The share lost, and the mean run of losses (None without losses); only a share `kept` of the losses stays lost.

    The mean run is the share lost, divided by the share of losses that do not follow a loss.
    """
    moves, loses = _chain(loss)
    loses = kept * loses
    stay = _long_run(moves)
    lost = float(stay @ loses)
    begins = float((stay * (1.0 - loses)) @ moves @ loses)
    return lost, lost / begins if begins else None


@lru_cache
def lost_again(loss: Loss | None, most: int) -> tuple[float, ...]:
    """The probabilities that 1, 2, ... `most` messages in a row are lost after a lost one."""
    if loss is None:
        return (0.0,) * most
    if isinstance(loss, RandomLoss):
        again = loss.probability + loss.correlation * (1.0 - loss.probability)
        return tuple(again**k for k in range(1, most + 1))
    moves, loses = _chain(loss)
    run = _long_run(moves) * loses
    lost, chances = float(run.sum()), []
    for _ in range(most):
        run = (run @ moves) * loses
        chances.append(min(1.0, float(run.sum()) / lost) if lost else 0.0)
    return tuple(chances)


def _chain(loss: RandomLoss | FourStateLoss | GilbertElliottLoss) -> tuple[_Matrix, _Matrix]:
    """A loss model as a Markov chain that starts in state 0: its transitions, and each state's loss probability."""
    if isinstance(loss, RandomLoss):
        after_loss = loss.probability + loss.correlation * (1.0 - loss.probability)
        after_none = loss.probability * (1.0 - loss.correlation)
        if loss.correlation == 1.0:  # the first decision repeats for ever: take the mean of many links
            after_loss = after_none = loss.probability
        return np.array([[1.0 - after_none, after_none], [1.0 - after_loss, after_loss]]), np.array([0.0, 1.0])
    if isinstance(loss, GilbertElliottLoss):
        moves = np.array([[1.0 - loss.p, loss.p], [loss.r, 1.0 - loss.r]])
        return moves, np.array([loss.good_loss, loss.bad_loss])
    moves = np.array(
        [
            [max(0.0, 1.0 - loss.p13 - loss.p14), 0.0, loss.p13, loss.p14],
            [0.0, 1.0 - loss.p23, loss.p23, 0.0],
            [loss.p31, loss.p32, max(0.0, 1.0 - loss.p31 - loss.p32), 0.0],
            [1.0, 0.0, 0.0, 0.0],
        ]
    )
    return moves, np.array([0.0, 0.0, 1.0, 1.0])


def _long_run(moves: _Matrix) -> _Matrix:
    """The long-run share of time in each state of a chain that starts in state 0."""
    # a chain that stays put half of the time has the same shares, and no period
    power = 0.5 * (moves + np.eye(len(moves)))
    for _ in range(100):
        power = power @ power
        power /= power.sum(axis=1, keepdims=True)
    shares: _Matrix = power[0]
    return shares
