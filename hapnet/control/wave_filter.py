"""A low-pass filter of waves: it keeps a slow sender's steps and ringing reflections away from the hand.

Filtering in the wave domain is passive where the filter's gain is at most 1 (G. Niemeyer, J.-J. E. Slotine, 2004). The
discretisation is derived here: with z the filtered wave, ``tau (z - z_before) = (w - z) T`` obeys, for any T,

    z^2/2 T <= w^2/2 T - tau/2 (z^2 - z_before^2)

so the energy output never exceeds the energy put in plus what the filter holds, and the displacement lags by ``tau z``.
"""

from __future__ import annotations

from hapnet.checks import Vector
from hapnet.control.coupling import Wave
from hapnet.control.wave_port import Line


class WaveFilter:
    """A line whose output waves are smoothed.

    Parameters
    ----------
    line : the line to smooth. dof : components of a wave. time : tau [s].
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
