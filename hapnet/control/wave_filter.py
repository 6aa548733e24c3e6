"""A low-pass filter of waves, which keeps the steps of a slow sender and what reflections ring from the hand.

Filtering in the wave domain is passive where the filter's gain is at most 1 (G. Niemeyer, J.-J. E. Slotine, 2004). The
discretisation is derived here: with z the filtered wave, ``tau (z - z_before) = (w - z) T`` obeys, for any T,

    z^2/2 T <= w^2/2 T - tau/2 (z^2 - z_before^2)

so less energy comes out than went in, but for what the filter holds; and of the displacement only ``tau z`` is behind.
"""

from __future__ import annotations

from hapnet.checks import Vector
from hapnet.control.coupling import Wave
from hapnet.control.wave_port import Line


class WaveFilter:
    """A line behind whose receiving end the waves are smoothed.

    Parameters
    ----------
    line : what is smoothed. dof : of a wave. time : tau [s].
    """

    def __init__(self, line: Line, dof: int, time: float) -> None:
        self._line = line
        self._tau = time
        self._silence = self._wave = (0.0,) * dof

    def clear(self) -> None:
        self._line.clear()
        self._wave = self._silence

    def push(self, wave: Wave) -> None:
        self._line.push(wave)

    def take(self, dt: float) -> Vector:
        share = dt / (self._tau + dt)
        self._wave = tuple([z + share * (w - z) for z, w in zip(self._wave, self._line.take(dt), strict=True)])
        return self._wave
