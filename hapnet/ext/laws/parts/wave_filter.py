"""A low-pass filter of waves: it keeps a slow sender's steps and ringing reflections away from the hand.

Filtering in the wave domain is passive if the filter's gain is at most 1 (G. Niemeyer, J.-J. E. Slotine, 2004). The
discretisation is derived here: with z the filtered wave, ``tau (z - z_before) = (w - z) T`` obeys, for any T,

    z^2/2 T <= w^2/2 T - tau/2 (z^2 - z_before^2)

so the energy output never exceeds the input plus the filter's stored energy, and the displacement lags by ``tau z``.
"""

from __future__ import annotations

from typing import cast

from hapnet.checks import Vector
from hapnet.control.samples import WaveSample
from hapnet.ext.laws.parts.wave_integral import IntegralLine, WaveReceiver, take_from
from hapnet.records.record import Floats, OfAxes, Record, compiled_as, equation


class WaveFilter(Record):
    """A line with smoothed output waves.

    line : the line to smooth. dof : components of a wave. time : tau [s].

    Attributes
    ----------
    wave : z. arrived : w.
    """

    line: Record
    n: int
    tau: float
    wave: OfAxes
    arrived: OfAxes

    def __init__(self, line: WaveReceiver, dof: int, time: float) -> None:
        self.line = cast(Record, line)  # plain Python takes any line
        self.n, self.tau = dof, time
        self.wave, self.arrived = [0.0] * dof, [0.0] * dof

    def clear(self) -> None:
        cast(WaveReceiver, self.line).clear()
        self.wave[:] = [0.0] * self.n

    def push(self, wave: WaveSample) -> None:
        cast(WaveReceiver, self.line).push(wave)

    def take(self, dt: float) -> Vector:
        draw(self, dt)
        return tuple(self.wave)


def _through(line: IntegralLine, dt: float, out: Floats) -> None:
    take_from(line.line, dt, out)


@compiled_as(_through)
def _take(line: Record, dt: float, out: Floats) -> None:
    out[:] = cast(WaveReceiver, line).take(dt)


@equation
def draw(smooth: WaveFilter, dt: float) -> None:
    """Take the output of the line and filter it into `wave`: `WaveFilter.take`."""
    share = dt / (smooth.tau + dt)
    _take(smooth.line, dt, smooth.arrived)
    for i in range(smooth.n):
        smooth.wave[i] = smooth.wave[i] + share * (smooth.arrived[i] - smooth.wave[i])
