"""Digital waves: replay over packets with jitter and loss (P. Berestesky, N. Chopra, M. W. Spong, 2004).

The discrete line is passive if the sum of u_out^2 never exceeds the sum of u_in^2. So it needs no jitter buffer: waves
are played as soon as they arrive, over a time that is fixed at that moment. Its parameters, terminations and remedy
against drift are those of the wave variables (wave.py).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

from hapnet.checks import Vector
from hapnet.control.coupling import Wave
from hapnet.control.wave_port import Line
from hapnet.couplings import wave
from hapnet.couplings.link_delays import Delays
from hapnet.couplings.spec import CouplingSpec, CouplingStart
from hapnet.couplings.wave import WaveParams
from hapnet.params import Params
from hapnet.wire import messages

LOUDEST = 2.0
"""Largest 1/n: a burst carries energy too, but the hand should not get it all at once."""


class Replay:
    """The waves that have arrived and were not played yet, merged into one wave over one time span.

    Waves that arrive are spread, with what is left to play, over the next N seconds: S seconds of waves with mean u go
    out as ``u/sqrt(n)``, ``n = N/S``. That is no more energy than they had (Cauchy-Schwarz). The energy is fixed when
    they are received; later some may be lost, but none is added. While waves arrive as fast as they are played, n tends
    to 1. After a late or lost wave n > 1, and the missing energy is lost for good.

    Parameters
    ----------
    dof : components of a wave. spread : N [s]; nothing is lost if it is at least the longest time between two arrivals
        and no shorter than a slot.
    """

    def __init__(self, dof: int, spread: float) -> None:
        self._zero = (0.0,) * dof
        self._spread = spread
        self.clear()

    def clear(self) -> None:
        self._arrived = list(self._zero)  # integral of the waves that have arrived since the last slot
        self._arrived_s = 0.0  # their total time span [s]
        self._playing = self._zero
        self._left_s = 0.0

    def push(self, wave: Wave) -> None:
        value, span = wave.value, wave.span
        self._arrived_s += span
        for i, component in enumerate(value):
            self._arrived[i] += component * span

    def take(self, dt: float) -> Vector:
        left, playing = self._left_s, self._playing
        if self._arrived_s > 0.0:
            content = self._arrived_s + left
            scale = sqrt(min(content / self._spread, LOUDEST)) / content
            playing = tuple([(new + old * left) * scale for new, old in zip(self._arrived, playing, strict=True)])
            self._arrived, self._arrived_s = list(self._zero), 0.0
            self._playing, left = playing, self._spread
        played = min(left, dt)
        self._left_s = left - played
        share = played / dt
        return tuple([wave * share for wave in playing])


@dataclass(frozen=True)
class Tuning:
    impedance_Ns_m: float
    stiffness_N_m: float
    damping_Ns_m: float
    smoothing_s: float
    spread_s: float
    recovery_s: float = 0.0


def tune(params: Params, link: Delays) -> Tuning:
    """As that of the wave variables. Waves that arrive are spread over the longest time between two arrivals."""
    line = wave.tune(params, link)
    spread, recovery_s = params.world.step_max_s + wave.jitter_s(link), params.of(WaveParams).recovery_s
    return Tuning(line.impedance_Ns_m, line.stiffness_N_m, line.damping_Ns_m, line.smoothing_s, spread, recovery_s)


def _line(start: CouplingStart[Tuning]) -> Line:
    return Replay(len(start.position), start.tuning.spread_s)


_DEVICE, _WORLD = wave.ends(_line)

LAW = CouplingSpec(
    name="digital-wave",
    title="digital waves",
    source="Berestesky, Chopra, Spong 2004",
    claim="passive at both ports, whatever the link does",
    device=_DEVICE,
    world=_WORLD,
    tuning=Tuning,
    tune=tune,
    parameters=WaveParams,
    section="wave",
    shared=("impedance_Ns_m",),
    device_sends=messages.Wave,
    world_sends=messages.Wave,
    covers=lambda params, tuning, virtual: True,
    searched=wave.SEARCHED,
)
