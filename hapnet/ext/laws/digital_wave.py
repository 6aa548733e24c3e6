"""Digital waves: replay over packets with jitter and loss (P. Berestesky, N. Chopra, M. W. Spong, 2004).

The discrete line is passive if the sum of u_out^2 never exceeds the sum of u_in^2. So it needs no jitter buffer: a wave
is played as soon as it arrives, over a time that is fixed at that moment. Parameters, terminations and the remedy
against drift are those of the wave variables (wave.py).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

from hapnet.checks import Vector
from hapnet.control.coupling import WaveSample
from hapnet.couplings.link_delays import Delays
from hapnet.couplings.spec import CouplingSpec, CouplingStart
from hapnet.ext.laws import wave
from hapnet.ext.laws.parts.wave_integral import WaveReceiver
from hapnet.ext.laws.wave import WaveParams
from hapnet.params import Params
from hapnet.records.record import Floats, OfAxes, Reals, Record, equation
from hapnet.wire import messages

LOUDEST = 2.0
"""Largest 1/n: it limits the energy that the hand receives at once from a burst."""


class Replay(Record):
    """The waves that have arrived but were not played yet, merged into a single wave over a single time span.

    New waves and the rest of the old ones are spread over the next N seconds: S seconds of waves with mean u are output
    as ``u/sqrt(n)``, ``n = N/S``. This is no more energy than they had (Cauchy-Schwarz). The energy is fixed when they
    are received; later some may be lost, but none is added. While waves arrive as fast as they are played, n tends to
    1. After a late or lost wave n > 1, and the missing energy is lost for good.

    Parameters
    ----------
    dof : components of a wave. spread : N [s]; nothing is lost if it is at least the maximum time between two arrivals
        and no shorter than a slot.

    Attributes
    ----------
    arrived, arrived_s : integral of the waves that have arrived since the last slot, and their time span [s].
    playing, left_s : the wave that is played, and its remaining time [s].
    """

    n: int
    spread: float
    arrived: OfAxes
    arrived_s: float
    playing: OfAxes
    left_s: float

    def __init__(self, dof: int, spread: float) -> None:
        self.n, self.spread = dof, spread
        self.clear()

    def clear(self) -> None:
        self.arrived, self.playing = [0.0] * self.n, [0.0] * self.n
        self.arrived_s = self.left_s = 0.0

    def push(self, wave: WaveSample) -> None:
        self.put(wave.value, wave.span)

    def take(self, dt: float) -> Vector:
        out = [0.0] * self.n
        self.draw(dt, out)
        return tuple(out)

    @equation
    def put(self, value: Reals, span: float) -> None:
        """Add a wave that arrived."""
        self.arrived_s += span
        for i in range(self.n):
            self.arrived[i] += value[i] * span

    @equation
    def draw(self, dt: float, out: Floats) -> None:
        """Compute `take` into `out`."""
        left = self.left_s
        if self.arrived_s > 0.0:
            content = self.arrived_s + left
            scale = sqrt(min(content / self.spread, LOUDEST)) / content
            for i in range(self.n):
                self.playing[i] = (self.arrived[i] + self.playing[i] * left) * scale
                self.arrived[i] = 0.0
            self.arrived_s, left = 0.0, self.spread
        played = min(left, dt)
        self.left_s = left - played
        share = played / dt
        for i in range(self.n):
            out[i] = self.playing[i] * share


@dataclass(frozen=True)
class Tuning:
    impedance_Ns_m: float
    stiffness_N_m: float
    damping_Ns_m: float
    smoothing_s: float
    spread_s: float
    recovery_s: float = 0.0


def tune(params: Params, link: Delays) -> Tuning:
    """Tune as the wave variables. Waves that arrive are spread over the maximum time between two arrivals."""
    line = wave.tune(params, link)
    spread, recovery_s = params.world.step_max_s + wave.jitter_s(link), params.of(WaveParams).recovery_s
    return Tuning(line.impedance_Ns_m, line.stiffness_N_m, line.damping_Ns_m, line.smoothing_s, spread, recovery_s)


def _line(start: CouplingStart[Tuning]) -> WaveReceiver:
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
    compiled=wave.compiled(Replay),
    springs=wave.springs,
    searched=wave.SEARCHED,
)
