"""The effects of a surface that are rendered at the device's rate: grain, sticking, viscosity, snap. Forces in them
act on the proxy.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from hapnet.checks import GRAIN_FULL, Vector, wrong_effects
from hapnet.errors import InvalidParameter
from hapnet.records.vectors import inner


class Grain(NamedTuple):
    """Periodic heights of a surface along one direction.

    wave : (n,) periods per metre along each axis, as a wave vector. height_m : of the highest sample, up or down [m].
    shape : the heights of one period, evenly spaced; each a signed byte, in units of height_m/127.
    """

    wave: Vector
    height_m: float
    shape: bytes

    @classmethod
    def of(cls, heights: Sequence[float], length_m: float, along: Sequence[float]) -> Grain:
        """A grain of these heights [m], evenly spaced over a period of `length_m`, along a direction (n,).

        Raises InvalidParameter.
        """
        size = math.hypot(*along)
        wave = tuple([part / size / length_m if size > 0.0 < length_m else math.nan for part in along])
        if not all(map(math.isfinite, heights)):
            lost = len([one for one in heights if not math.isfinite(one)])
            raise InvalidParameter("grain", f"{len(heights)} heights, {lost} of them not finite", "finite heights [m]")
        height = max(map(abs, heights), default=0.0)
        grain = cls(wave, height, bytes([round(GRAIN_FULL * (one / (height or 1.0))) % 256 for one in heights]))
        if wrong := wrong_effects((0.0, 0.0, 0.0, 0.0, grain), len(along)):
            raise InvalidParameter("grain", f"{len(heights)} heights over {length_m:g} m", f"a valid grain ({wrong})")
        return grain

    @classmethod
    def sine(cls, height_m: float, wavelength_m: float, along: Sequence[float]) -> Grain:
        """A sine of this amplitude and wavelength [m]."""
        return cls.of([height_m * part for part in _SINE], wavelength_m, along)

    def at(self, place: Sequence[float]) -> float:
        """The height at a place (n,) [m], interpolated linearly between samples."""
        shape = self.shape
        phase: float = inner(self.wave, place) % 1.0 * len(shape)
        i = min(int(phase), len(shape) - 1)
        low, high = _signed(shape[i]), _signed(shape[(i + 1) % len(shape)])
        return self.height_m / GRAIN_FULL * (low + (phase - i) * (high - low))


class Effects(NamedTuple):
    """Effects of a surface that a device renders in contact with it, and just before.

    viscosity : drag along the surface [Ns/m]. sticking : mu of static friction, if it is above the friction; a sliding
        proxy slides until friction holds it. snap_N, snap_m : the largest attraction [N], and its range [m].

    A message contains these five fields in this order.
    """

    viscosity: float = 0.0
    sticking: float = 0.0
    snap_N: float = 0.0
    snap_m: float = 0.0
    grain: Grain | None = None

    @classmethod
    def of(cls, values: Sequence[Any] | None) -> Effects | None:
        """The effects from a message's five fields."""
        if values is None:
            return None
        made = cls(*values)
        return made if made.grain is None else made._replace(grain=Grain(*made.grain))

    def cut(self, n: int) -> Effects:
        """The effects in the section of a solid along its first n axes, where the other coordinates are 0."""
        grain = self.grain
        return self if grain is None else self._replace(grain=grain._replace(wave=grain.wave[:n]))

    def attraction(self, gap: float) -> float:
        """Force on a proxy at this distance from the surface [N]: 0 at the surface and at `snap_m`, largest midway."""
        if not 0.0 < gap < self.snap_m:
            return 0.0
        share = gap / self.snap_m
        return 4.0 * self.snap_N * share * (1.0 - share)


_SINE = [math.sin(2.0 * math.pi * i / 64) for i in range(64)]


def _signed(byte: int) -> int:
    return byte - 256 if byte > GRAIN_FULL else byte
