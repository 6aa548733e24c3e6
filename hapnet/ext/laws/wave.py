"""Wave variables over a delaying line (G. Niemeyer, J.-J. E. Slotine, 2004).

Waves wait in a queue. Each is used once, for its own time span, whatever the periods of the two sides. So the energy
output never exceeds the energy that has arrived. With irregular periods the queue grows to the longest of them and is
then an exact delay, a jitter buffer. Displacement that the queue later drops, to become shorter again, may come out
later (`Recovery`). The line's two terminations are in hapnet/ext/laws/parts/wave_port.py.

Its known weakness is drift over links that lose messages. The remedy is the authors' own: wave integrals
(hapnet/ext/laws/parts/wave_integral.py), unless `wave.recovery_s` is 0.

No predictor precedes the line. The line is passive because its output never exceeds its input, and a predicted wave is
not input. A predictor needs a model of the far end, and a regulator that removes its energy again
(S. Munir, W. J. Book, "Internet-Based Teleoperation Using Wave Variables with Prediction", T-Mech 7(2), 2002).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import sqrt
from typing import Annotated, Any, Protocol, TypeVar

from hapnet.checks import Vector
from hapnet.control.coupling import DeviceCoupling, WaveSample, WorldCoupling
from hapnet.control.law import DeviceEnd, WorldEnd
from hapnet.couplings.ends import held_law, stepped_law
from hapnet.couplings.link_delays import Delays
from hapnet.couplings.spec import (
    RENDERED_DAMPING,
    Between,
    CouplingSpec,
    CouplingStart,
    scalar_stiffness,
)
from hapnet.ext.laws.parts.wave_filter import WaveFilter
from hapnet.ext.laws.parts.wave_integral import IntegralLine, Recovery, WaveReceiver, lose, recover
from hapnet.ext.laws.parts.wave_port import WaveDevice, WaveWorld
from hapnet.param_sections import Matrix
from hapnet.param_values import NOT_NEGATIVE, parameter
from hapnet.params import Params
from hapnet.records.record import AXES, FloatRows, Floats, OfAxes, Reals, Record, equation, holding
from hapnet.records.vectors import copy
from hapnet.wire import messages

WINDOW_S = 2.0
"""A queue that is longer than needed for this time is shortened [s]."""
SLACK_S = 0.005
"""The shortest queue that is shortened [s]."""
MOST = 1024
"""The largest number of waiting waves."""
_RING = MOST + 1


class DelayLine(Record):
    """A queue of waves.

    Parameters
    ----------
    dof : components of a wave.
    maximum : the longest wait [s]; when the queue grows beyond it, the oldest waves are dropped.
    hold : a missing wave is replaced by the last wave, which is not passive; if false, by zero, which is passive.
    recovery : time constant with which displacement that the queue has lost is output later [s]; 0: never.

    Attributes
    ----------
    values, spans : a ring of the waiting waves, `count` from `first` on; waiting : their total time span [s].
    last : the wave that was played last. pace : speed of playing in this window; minimum : the shortest queue in the
        window [s]; watched : time since the window began [s]. total, squares : integrals of the waves played last.
    """

    n: int
    maximum: float
    holds: int
    recovery: Recovery
    values: Annotated[FloatRows, (_RING, AXES)]
    spans: Annotated[Floats, (_RING,)]
    first: int
    count: int
    last: OfAxes
    waiting: float
    pace: float
    minimum: float
    watched: float
    squares: OfAxes
    total: OfAxes

    def __init__(self, dof: int, maximum: float, *, hold: bool = False, recovery: float = 0.0) -> None:
        self.n, self.maximum, self.holds = dof, maximum, int(hold)
        self.recovery = Recovery(dof, recovery)
        self.values, self.spans = [[0.0] * dof for _ in range(_RING)], [0.0] * _RING
        self.squares, self.total = [0.0] * dof, [0.0] * dof
        self.clear()

    def clear(self) -> None:
        self.recovery.clear()
        self.first = self.count = 0
        self.last = [0.0] * self.n
        self.pace = 1.0
        self.waiting = self.minimum = self.watched = 0.0

    def push(self, wave: WaveSample) -> None:
        self.put(wave.value, wave.span)

    def take(self, dt: float) -> Vector:
        """The mean wave over the next `dt` seconds.

        A queue that was too long for a whole window is played faster during the next window, at most twice as fast.
        Waves of S seconds played in dt < S are output as their mean times sqrt(S/dt): no more energy than they had, by
        the Cauchy-Schwarz inequality.
        """
        out = [0.0] * self.n
        self.draw(dt, out)
        return tuple(out)

    @equation
    def put(self, value: Reals, span: float) -> None:
        """Add a wave that arrived."""
        at = (self.first + self.count) % _RING
        copy(self.n, value, self.values[at])
        self.spans[at] = span
        self.count += 1
        self.waiting += span
        while self.waiting > self.maximum or self.count > MOST:
            self.waiting -= self.spans[self.first]
            lose(self.recovery, self.values[self.first], self.spans[self.first])
            _drop(self)

    @equation
    def draw(self, dt: float, out: Floats) -> None:
        """Compute `take` into `out`."""
        took = _next(self, dt * self.pace)
        if took < dt and self.holds:
            for i in range(self.n):
                self.total[i] = self.total[i] + self.last[i] * (dt - took)
        _watch(self, dt)
        scale = 1.0 / (dt if took <= dt else sqrt(took * dt))
        for i in range(self.n):
            out[i] = self.total[i] * scale
        recover(self.recovery, dt, out, self.total, self.squares)


@equation
def _drop(line: DelayLine) -> None:
    """Remove the oldest wave."""
    line.first = (line.first + 1) % _RING
    line.count -= 1


@equation
def _next(line: DelayLine, wanted: float) -> float:
    """Integrate the oldest waves and their squares over at most `wanted` seconds; returns the time that they cover."""
    n, total, squares, took = line.n, line.total, line.squares, 0.0
    for i in range(n):
        total[i] = squares[i] = 0.0
    while line.count and took < wanted:
        value, span = line.values[line.first], line.spans[line.first]
        part = wanted - took
        copy(n, value, line.last)
        if span > part:
            line.spans[line.first] = span - part
            span = part
        else:
            _drop(line)
        took += span
        for i in range(n):
            total[i] += value[i] * span
            squares[i] += value[i] * value[i] * span
    line.waiting = line.waiting - took if line.count else 0.0
    return took


@equation
def _watch(line: DelayLine, dt: float) -> None:
    """Choose the pace of the next window."""
    line.minimum = min(line.minimum, line.waiting)
    line.watched += dt
    if line.watched >= WINDOW_S:
        excess = max(0.0, line.minimum - SLACK_S)
        line.pace = 1.0 + min(1.0, excess / WINDOW_S)
        line.minimum, line.watched = line.waiting, 0.0


_MAX_JITTER_S = 0.25
"""Waves that wait longer do more harm than dropped waves, as measured on a recorded LTE link [s]."""


@dataclass(frozen=True)
class WaveParams:
    """Wave variables (Niemeyer, Slotine 2004), and digital waves (Berestesky, Chopra, Spong 2004)."""

    impedance: float = parameter(0.0, "wave impedance b [Ns/m]; 0: by a rule", NOT_NEGATIVE)
    stiffness: float = parameter(0.0, "stiffness of the virtual coupling at the world [N/m]; 0: by a rule",
                                 NOT_NEGATIVE)  # fmt: skip
    damping: float = parameter(0.0, "damping of this coupling [Ns/m]; 0: by a rule", NOT_NEGATIVE)
    smoothing_s: float = parameter(0.005, "time constant of the filter of the device's incoming waves [s]; 0: none",
                                   NOT_NEGATIVE)  # fmt: skip
    recovery_s: float = parameter(0.1, "time constant for making up lost displacement by wave integrals, as far as "
                                  "there is energy [s]; 0: never", NOT_NEGATIVE)  # fmt: skip
    missing: str = parameter("zero", "the replacement of a missing wave; hold (the last wave) is not passive",
                             ("zero", "hold"))  # fmt: skip


@dataclass(frozen=True)
class LineTuning:
    impedance_Ns_m: float
    stiffness_N_m: float
    damping_Ns_m: float
    smoothing_s: float
    longest_wait_s: float
    recovery_s: float = 0.0


class PortTuning(Protocol):
    """The parameters of the two terminations of a line; `recovery_s` is 0 for a line as it was first published."""

    @property
    def impedance_Ns_m(self) -> float: ...
    @property
    def stiffness_N_m(self) -> float: ...
    @property
    def damping_Ns_m(self) -> float: ...
    @property
    def smoothing_s(self) -> float: ...
    @property
    def recovery_s(self) -> float: ...


T = TypeVar("T", bound=PortTuning)

_STIFFEST = 10.0
"""The largest stiffness of the virtual coupling, as a multiple of device.stiffness."""


def tune(params: Params, link: Delays) -> LineTuning:
    """Choose the largest wave impedance b that a device can render.

    In free motion a line of delay d acts as an inertia b d, in contact as a spring b/d (Niemeyer, Slotine 2004). A
    virtual world's slow steps make d so long that this spring is soft. So the virtual coupling is as stiff as needed
    for both in series to have device.stiffness; if the line alone is softer, the coupling has ten times that stiffness.
    Its damper is b, so that a wall does not reflect high frequencies.
    """
    wave, K = params.of(WaveParams), scalar_stiffness(params)
    impedance = wave.impedance or RENDERED_DAMPING
    delay = link.one_way_s + params.world.step_max_s + jitter_s(link)
    compliance = 1.0 / K - delay / impedance
    return LineTuning(
        impedance_Ns_m=impedance,
        stiffness_N_m=wave.stiffness or 1.0 / max(compliance, 0.1 / K),
        damping_Ns_m=wave.damping or impedance,
        smoothing_s=wave.smoothing_s,
        longest_wait_s=params.world.step_max_s + _MAX_JITTER_S,
        recovery_s=wave.recovery_s if wave.missing == "zero" else 0.0,
    )


def springs(params: Params, tuning: PortTuning) -> tuple[Matrix] | None:
    """The stiffness of line and virtual coupling in series: device.stiffness, if the rule could achieve it."""
    K = scalar_stiffness(params)
    by_rule = params.of(WaveParams).stiffness == 0.0 and tuning.stiffness_N_m < _STIFFEST * K * (1.0 - 1e-9)
    return (K,) if by_rule else None


def jitter_s(link: Delays) -> float:
    """Bound of the jitter [s]: the delay of a message beyond that of the fastest message; rarely exceeded."""
    return min(link.round_trip_bound_s - 2.0 * link.one_way_s, _MAX_JITTER_S)


def _line(start: CouplingStart[LineTuning]) -> WaveReceiver:
    hold, maximum = start.params.of(WaveParams).missing == "hold", start.tuning.longest_wait_s
    return DelayLine(len(start.position), maximum, hold=hold, recovery=start.tuning.recovery_s)


def ends(
    line: Callable[[CouplingStart[T]], WaveReceiver],
) -> tuple[Callable[[CouplingStart[T]], DeviceCoupling], Callable[[CouplingStart[T]], WorldCoupling]]:
    """The device's and the world's end of a law over this line, which makes up for lost waves if tuned to."""

    def whole(start: CouplingStart[T]) -> WaveReceiver:
        return IntegralLine(line(start), uses_integrals=start.tuning.recovery_s != 0.0)

    def device(start: CouplingStart[T]) -> WaveDevice:
        tuning, dof = start.tuning, len(start.position)
        return WaveDevice(tuning.impedance_Ns_m, start.position, WaveFilter(whole(start), dof, tuning.smoothing_s))

    def world(start: CouplingStart[T]) -> WaveWorld:
        tuning = start.tuning
        return WaveWorld(tuning.impedance_Ns_m, tuning.stiffness_N_m, tuning.damping_Ns_m, start.position, whole(start))

    return held_law(device), stepped_law(world)


def compiled(line: type[Record]) -> tuple[type[DeviceEnd], type[WorldEnd]]:
    """`CouplingSpec.compiled` of a law over this kind of line."""
    whole = holding(IntegralLine, line=line)
    return holding(WaveDevice, line=holding(WaveFilter, line=whole)), holding(WaveWorld, line=whole)


SEARCHED: Mapping[str, Between | tuple[Any, ...]] = {
    "wave.impedance": Between(0.5, RENDERED_DAMPING, log=True),
    "wave.stiffness": Between(50.0, 5000.0, log=True),
    "wave.damping": Between(0.5, 20.0, log=True),
    "wave.smoothing_s": Between(0.001, 0.05, log=True),
}
"""`CouplingSpec.searched` for the parameters that all lines have."""

_DEVICE, _WORLD = ends(_line)

LAW = CouplingSpec(
    name="wave",
    title="wave variables",
    source="Niemeyer, Slotine 2004, with wave integrals",
    claim="passive at both ports for any constant delay; on any link, if zero replaces missing waves",
    device=_DEVICE,
    world=_WORLD,
    tuning=LineTuning,
    tune=tune,
    parameters=WaveParams,
    shared=("impedance_Ns_m",),
    device_sends=messages.Wave,
    world_sends=messages.Wave,
    covers=lambda params, tuning, virtual: params.of(WaveParams).missing == "zero",
    compiled=compiled(DelayLine),
    springs=springs,
    searched={**SEARCHED, "wave.recovery_s": Between(0.01, 1.0, log=True)},
)
