"""The rule for K if `device.stiffness` is 0: as stiff as the device renders well; and the stiffness felt at a wall.

A held spring K on a device with own damping b is passive if (Colgate and Schenkel 1997)

    K < 2 (b - B) / T,      T: the servo's period

The rule takes half of this bound, or half of the largest stiffness that the device declares, because at the bound
there is no margin for late ticks. A simulated device's b is known, and the smaller of the two counts. A real device's
b is unknown, or a lower bound measured by `hapnet doctor --device --damping`. The declaration alone gives at most
350 N/m; a measured b may only raise this limit, so measuring never makes the spring softer.

Encoders: a count of r changes the force by K r, and the device oscillates if that is large. Half of K r = 0.1 N is the
limit. (The usual bound is 2 f / r (Abbott, Okamura 2005), but the device's dry friction f is not known.)

Measured harvest keeps PSPM passive for any K, so the rule only affects the rendering. A device that declares too
little, and the paper's rendering, get the paper's 100 N/m.

A wall is felt through the springs of the coupling, over an ideal link, at rest, as

    felt = 1 / (1/K + K'/(K K_w))

The wall K_w is in series with the world's spring K', as the proxy moves into the wall. K/K' scales this force at the
device. Its own spring K is in series too, so no wall feels stiffer than K. With one spring: ``1 / (1/K + 1/K_w)``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypedDict

from hapnet.param_sections import Matrix

SHARE = 0.5
"""The share of the bound, and of the declared stiffness, that the rule uses."""

PAPERS = 100.0
"""K of the paper's Section 4, reconstructed [N/m]: the rule's minimum, if the device can render it."""

MOST = 350.0
"""The largest K if damping or declaration is missing [N/m]: half of a Phantom Omni's stiffness (700 N/m, from CHAI3D's
device table)."""

COUNT_N = 0.1
"""The largest change of the force by one encoder count, at the bound [N]."""


def colgate_bound(own_damping: float, damping: float, servo_hz: float) -> float:
    """The stiffness below which a held spring is passive by itself [N/m]; 0 or less: no spring is.

    own_damping, damping : b of the device, B of the coupling [Ns/m]. servo_hz : 1/T [Hz].
    """
    return 2.0 * (own_damping - damping) * servo_hz


def default_stiffness(
    own_damping: float,
    damping: float,
    servo_hz: float,
    declared: tuple[float, float] | None = None,
    *,
    resolution_m: float = 0.0,
    exact: bool = True,
) -> float:
    """K by the rule [N/m].

    own_damping : the device's own damping [Ns/m]; 0: unknown. damping, servo_hz : as `colgate_bound`.
    declared : the smallest and the largest stiffness that the device declares [N/m]; None: it declares none.
    resolution_m : of its encoders [m]; 0: unknown, or exact. exact : whether `own_damping` is the true damping, not a
        lower bound.
    """
    bound = SHARE * colgate_bound(own_damping, damping, servo_hz) if own_damping else 0.0
    minimum, maximum = declared or (0.0, MOST)
    if declared is None:
        wanted = bound
    elif exact and own_damping:
        wanted = min(bound, SHARE * maximum)
    else:
        wanted = min(max(bound, MOST), SHARE * maximum)
    if resolution_m:
        wanted = min(wanted, SHARE * COUNT_N / resolution_m)
    return round(min(max(wanted, PAPERS, minimum), maximum), 3)


class Felt(TypedDict):
    """The stiffest wall, the stiffness that a hand feels there, and the springs between them, K and K' or K [N/m]."""

    stiffness_N_m: float | None
    felt_stiffness_N_m: float | None
    springs_N_m: list[float] | None


def felt(springs: Sequence[Matrix] | None, wall: float | None) -> Felt:
    """Return how a wall of this stiffness [N/m] is felt; None: no wall. With a spring that is no scalar: None.

    springs : the result of `CouplingSpec.springs`.
    """
    scalars = [spring for spring in springs or () if isinstance(spring, float)]
    return of_springs(scalars if scalars and len(scalars) == len(springs or ()) else None, wall)


def of_springs(springs: list[float] | None, wall: float | None) -> Felt:
    """Return how a wall is felt through these springs [N/m]; None: not known."""
    stiffness = None if springs is None or wall is None else through(springs, wall)
    return {"stiffness_N_m": wall, "felt_stiffness_N_m": stiffness, "springs_N_m": None if wall is None else springs}


def through(springs: Sequence[float], wall: float) -> float:
    """The stiffness that is felt of a wall through K and K', or through K alone [N/m]."""
    K, *rest = springs
    return K * wall / ((rest[0] if rest else K) + wall)
