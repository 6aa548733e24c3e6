"""How stiff a wall is felt: through the springs of the coupling, over an ideal link, at rest.

    felt = 1 / (1/K + K'/(K K_w))

The wall K_w is in series with the world's spring K', as the proxy moves in it; K/K' scales that force at the device,
whose own spring K is in series too: no wall is felt stiffer than K. A law with one spring has ``1 / (1/K + 1/K_w)``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypedDict

from hapnet.param_sections import Matrix


class Felt(TypedDict):
    """The stiffest wall, the stiffness that a hand feels there, and the springs between them, K and K' or K [N/m]."""

    stiffness_N_m: float | None
    felt_stiffness_N_m: float | None
    springs_N_m: list[float] | None


def felt(springs: Sequence[Matrix] | None, wall: float | None) -> Felt:
    """Return how a wall of this stiffness [N/m] is felt; None: there is none. Springs that are no scalars are left out.

    springs : what the law says of them (`CouplingSpec.springs`).
    """
    known = [one for one in springs or () if isinstance(one, float)]
    return of_springs(known if known and len(known) == len(springs or ()) else None, wall)


def of_springs(springs: list[float] | None, wall: float | None) -> Felt:
    """Return how a wall is felt through these springs [N/m]; None: not known."""
    stiffness = None if springs is None or wall is None else through(springs, wall)
    return {"stiffness_N_m": wall, "felt_stiffness_N_m": stiffness, "springs_N_m": None if wall is None else springs}


def through(springs: Sequence[float], wall: float) -> float:
    """The stiffness that is felt of a wall through K and K', or through K alone [N/m]."""
    K, *rest = springs
    return K * wall / ((rest[0] if rest else K) + wall)
