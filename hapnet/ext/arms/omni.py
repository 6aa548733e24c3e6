"""A desktop arm like the Phantom Omni (now Touch): three motors, links of 0.134 and 0.1325 m.

Lengths and stops are those of github.com/fsuarez6/phantom_omni (omni_description); the force of 3.3 N is the maker's
data sheet's, as CHAI3D's table of devices has it. The maker publishes no masses. Ours are two thin bars and a turning
base, with moments of inertia such that the tip feels as heavy at home as the data sheet says, 45 g in all directions
(`apparent_masses`). They stand for the bars of the parallelogram and the motors too: with a serial elbow M has the same
form, cosines of the same angles. Each motor gives the torque that 3.3 N at home asks of it across its own bar. The
joints' damping gives the simulated point mass's 0.3 Ns/m at the tip at home, in the direction that feels least.
"""

from __future__ import annotations

import math
from dataclasses import replace

from hapnet.ext.arms.table import ArmTable, Joint

UPPER_M, FORE_M = 0.134, 0.1325
FORCE_N = 3.3
_UPPER_KG, _FORE_KG = 0.04, 0.03
_UPPER_CENTRE_M, _FORE_CENTRE_M = 0.05, 0.04
_BASE_KGM2, _UPPER_KGM2, _FORE_KGM2 = 6.369e-4, 2.6934e-4, 7.9003e-4
_BASE_KG, _ALONG_KGM2 = 0.1, 1e-6
_HOME = (0.0, 0.8, 1.5 - math.pi / 2.0)
"""The bars are at right angles."""

_DAMPING_NSPM = 0.3
_PLANE_NSPM = 0.778
"""Across the bars: shoulder and elbow both move when the tip does."""


def _bar(about_end: float, mass: float, centre: float) -> tuple[tuple[float, float, float], ...]:
    """The inertia about its centre of a thin bar along y, from that about its joint."""
    inertia = about_end - mass * centre * centre
    return (inertia, 0.0, 0.0), (0.0, _ALONG_KGM2, 0.0), (0.0, 0.0, inertia)


def omni() -> ArmTable:
    """The arm."""
    reach = UPPER_M * math.cos(_HOME[1]) + FORE_M * math.sin(_HOME[1])
    levers = (reach, UPPER_M, FORE_M)
    efforts = [FORCE_N * lever for lever in levers]
    damping = [b * lever * lever for b, lever in zip((_DAMPING_NSPM, _PLANE_NSPM, _PLANE_NSPM), levers, strict=True)]
    turning = ((_BASE_KGM2, 0.0, 0.0), (0.0, _BASE_KGM2, 0.0), (0.0, 0.0, _BASE_KGM2))
    x = (1.0, 0.0, 0.0)
    upper, fore = _bar(_UPPER_KGM2, _UPPER_KG, _UPPER_CENTRE_M), _bar(_FORE_KGM2, _FORE_KG, _FORE_CENTRE_M)
    joints = (
        Joint("waist", (0.0, 0.0, 0.09), mass=_BASE_KG, inertia=turning, lower=-0.98, upper=0.98),
        Joint("shoulder", (0.0, 0.0, 0.035), axis=x, mass=_UPPER_KG, centre=(0.0, _UPPER_CENTRE_M, 0.0), inertia=upper,
              lower=0.0, upper=1.75),
        Joint("elbow", (0.0, UPPER_M, 0.0), (-1.5, 0.0, 0.0), x, _FORE_KG, (0.0, _FORE_CENTRE_M, 0.0), fore, -0.81,
              1.25),
    )  # fmt: skip
    moved = [
        replace(joint, effort=effort, damping=b) for joint, effort, b in zip(joints, efforts, damping, strict=True)
    ]
    return ArmTable("omni", tuple(moved), (0.0, FORE_M, 0.0), _HOME)
