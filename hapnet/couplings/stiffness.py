"""The rule for K if `device.stiffness` is 0: as stiff as the device renders; and the stiffness felt at a wall.

The device's local limit is the stiffest wall that it renders without a network. A held spring on a device with own
damping b is passive whatever holds it if (Colgate and Schenkel 1997)

    K < 2 b / T,      T: the servo's period

A simulated device's b is known. A real device declares the stiffness that it renders; its b is unknown, or a lower
bound measured by `hapnet doctor --device --damping`, and counts only if it declares none. K is the local limit, but

* at most K' + K_w, so that no wall feels stiffer than it is (see below);
* with encoders of r at most half of 0.1 N / r: a count changes the force by K r, and the device oscillates if that is
  large. (The usual bound is 2 f / r (Abbott, Okamura 2005), but the device's dry friction f is not known.)

Measured harvest keeps PSPM passive for any K, so the rule only affects the rendering. A device that declares too
little, and the paper's rendering, get the paper's 100 N/m.

A wall is felt through the springs of the coupling, over an ideal link, at rest, as

    felt = 1 / (1/K + K'/(K K_w))

The wall K_w is in series with the world's spring K', as the proxy moves into the wall. K/K' scales this force at the
device. Its own spring K is in series too, so no wall feels stiffer than K. With one spring: ``1 / (1/K + 1/K_w)``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypedDict

from hapnet.param_sections import Matrix

PAPERS = 100.0
"""K of the paper's Section 4, reconstructed [N/m]: the rule's minimum, if the device can render it."""

COUNT_N = 0.1
"""The largest change of the force by one encoder count, at the bound [N]."""

COUNT_SHARE = 0.5
"""The share of that bound that the rule uses."""


def colgate_bound(own_damping: float, damping: float, servo_hz: float) -> float:
    """The stiffness below which a held spring is passive by itself [N/m]; 0 or less: no spring is.

    own_damping, damping : b of the device, B of the coupling [Ns/m]. servo_hz : 1/T [Hz].
    """
    return 2.0 * (own_damping - damping) * servo_hz


def local_limit(
    own_damping: float, servo_hz: float, declared: tuple[float, float] | None = None, *, exact: bool = True
) -> float:
    """The stiffest wall that a device renders without a network [N/m]; 0: unknown.

    own_damping : the device's own damping [Ns/m]; 0: unknown. exact : whether it is true, not a lower bound.
    servo_hz : as `colgate_bound`. declared : the smallest and the largest stiffness that the device declares [N/m].
    """
    bound = colgate_bound(own_damping, 0.0, servo_hz)
    if declared is None:
        return bound
    return min(bound, declared[1]) if exact and own_damping else declared[1]


def default_stiffness(
    limit: float, most: float, declared: tuple[float, float] | None = None, *, resolution_m: float = 0.0
) -> float:
    """K by the rule [N/m].

    limit : the device's local limit [N/m]; 0: unknown. most : K' + K_w [N/m]. declared : as in `local_limit`.
    resolution_m : of its encoders [m]; 0: unknown, or exact.
    """
    wanted = min(limit, most)
    if resolution_m:
        wanted = min(wanted, COUNT_SHARE * COUNT_N / resolution_m)
    minimum, maximum = declared or (0.0, math.inf)
    return round(min(max(wanted, PAPERS, minimum), maximum), 3)


class Felt(TypedDict):
    """The stiffest wall, the stiffness that a hand feels there, the springs between them, K and K' or K, and the
    stiffest wall that the device renders without a network [N/m]."""

    stiffness_N_m: float | None
    felt_stiffness_N_m: float | None
    springs_N_m: list[float] | None
    local_limit_N_m: float | None


def felt(springs: Sequence[Matrix] | None, wall: float | None, limit: float = 0.0) -> Felt:
    """Return how a wall of this stiffness [N/m] is felt; None: no wall. With a spring that is no scalar: None.

    springs : the result of `CouplingSpec.springs`. limit : the device's local limit [N/m]; 0: unknown.
    """
    scalars = [spring for spring in springs or () if isinstance(spring, float)]
    return of_springs(scalars if scalars and len(scalars) == len(springs or ()) else None, wall, limit or None)


def of_springs(springs: list[float] | None, wall: float | None, limit: float | None) -> Felt:
    """Return how a wall is felt through these springs [N/m]; None: not known. limit : the device's [N/m]."""
    return {
        "stiffness_N_m": wall,
        "felt_stiffness_N_m": None if springs is None or wall is None else through(springs, wall),
        "springs_N_m": None if wall is None else springs,
        "local_limit_N_m": limit,
    }


def through(springs: Sequence[float], wall: float) -> float:
    """The stiffness that is felt of a wall through K and K', or through K alone [N/m]."""
    K, *rest = springs
    return K * wall / ((rest[0] if rest else K) + wall)
