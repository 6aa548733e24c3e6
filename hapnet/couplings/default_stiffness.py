"""K by rule: as stiff as the device renders well, where `device.stiffness` is 0.

A held spring K on a device with own damping b is passive up to (Colgate and Schenkel 1997)

    K < 2 (b - B) / T,      T: the servo's period

The rule takes half of that, or half of the largest stiffness that the device declares, because at the bound itself
nothing is left for late ticks. A simulated device's b is known, and the smaller of the two counts. A real device's b is
unknown, or a lower bound that `hapnet doctor --device --damping` measured. The declaration alone gives at most 350 N/m;
a measured b may only raise that: nobody who measures gets a softer spring.

Encoders: a count of r changes the force by K r, and the device oscillates if that is large. Half of K r = 0.1 N is the
limit. (The usual bound, 2 f / r with f the device's dry friction (Abbott, Okamura 2005), needs an f that is not known.)

Measured harvest keeps PSPM passive for any K, so the rule only concerns the rendering. A device that declares too
little, and the paper's rendering, get the paper's 100 N/m.
"""

from __future__ import annotations

SHARE = 0.5
"""Of the bound, and of the declared stiffness."""

PAPERS = 100.0
"""K of the paper's Section 4, reconstructed [N/m]. The rule chooses no less, if the device can render it."""

MOST = 350.0
"""The most where damping or declaration is missing [N/m]: half of what a Phantom Omni renders (700 N/m, from CHAI3D's
device table)."""

COUNT_N = 0.1
"""What a count of the encoders may change the force by, at the bound [N]."""


def colgate_bound(own_damping: float, damping: float, servo_hz: float) -> float:
    """The stiffness below which a held spring is passive by itself [N/m]; 0 or less: there is none.

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
    """K [N/m].

    own_damping : the device's own damping [Ns/m]; 0: unknown. damping, servo_hz : as `colgate_bound`.
    declared : the smallest and the largest stiffness that the device renders, as it says [N/m]; None: it does not say.
    resolution_m : of its encoders [m]; 0: unknown, or none. exact : whether `own_damping` is the damping, not a lower
        bound.
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
