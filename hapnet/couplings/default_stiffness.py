"""K by rule: as stiff as the device renders well, where `device.stiffness` is 0.

A held spring K on a device with own damping b is passive up to (Colgate and Schenkel 1997)

    K < 2 (b - B) / T,      T: the servo's period

Half of that is taken, or half of the greatest stiffness that the device declares, whichever is less: at the bound
itself nothing is left for encoders and late ticks. Where b is not known, the declaration alone counts. Measured harvest
keeps PSPM passive for any K, so the rule is about feel. A device that says nothing of itself, or too little, and the
paper's feel, get the paper's 100 N/m.
"""

from __future__ import annotations

SHARE = 0.5
"""Of the bound, and of the declared stiffness."""

PAPERS = 100.0
"""K of the paper's Section 4, reconstructed [N/m]. It is also the least that the rule chooses, if the device has it."""

MOST = 350.0
"""The most for a device that does not declare its stiffness [N/m]: half of what a Phantom Omni renders (700 N/m, from
CHAI3D's device table)."""


def colgate_bound(own_damping: float, damping: float, servo_hz: float) -> float:
    """The stiffness below which a held spring is passive by itself [N/m]; 0 or less: there is none.

    Parameters
    ----------
    own_damping, damping : b of the device, B of the coupling [Ns/m]. servo_hz : 1/T [Hz].
    """
    return 2.0 * (own_damping - damping) * servo_hz


def default_stiffness(
    own_damping: float, damping: float, servo_hz: float, declared: tuple[float, float] | None = None
) -> float:
    """K [N/m].

    Parameters
    ----------
    own_damping : a lower bound of the device's own damping [Ns/m]; 0: unknown. damping, servo_hz : as `colgate_bound`.
    declared : the least and the greatest stiffness that the device renders, as it says [N/m]; None: it does not.
    """
    least, greatest = declared or (0.0, 2.0 * MOST)
    bounds = [colgate_bound(own_damping, damping, servo_hz)] if own_damping else []
    found = [SHARE * each for each in (*bounds, *([greatest] if declared else []))]
    wanted = max(PAPERS, least, min(found, default=PAPERS))
    return round(min(wanted, greatest if declared else MOST), 3)
