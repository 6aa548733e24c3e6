"""Wave variables as a delay line and as digital waves (hapnet/control/wave*.py, digital_wave.py): rules and ends.

Their known weakness is drift over links that lose messages. The remedy is the authors' own: wave integrals
(hapnet/control/wave_integral.py), unless `wave.recovery_s` is 0.

No predictor stands before them. The line is passive because no more comes out of it than has gone in: a wave that is
predicted has not gone in. A predictor needs a model of the far end, and a regulator that takes its energy away again
(S. Munir, W. J. Book, "Internet-Based Teleoperation Using Wave Variables with Prediction", T-Mech 7(2), 2002).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

from hapnet.control.digital_wave import Replay
from hapnet.control.wave import DelayLine
from hapnet.control.wave_filter import WaveFilter
from hapnet.control.wave_integral import IntegralLine
from hapnet.control.wave_port import Line, WaveDevice, WaveWorld
from hapnet.couplings.link_delays import Delays
from hapnet.couplings.spec import (
    RENDERED_DAMPING,
    Between,
    CouplingSpec,
    CouplingStart,
    held_law,
    scalar_stiffness,
    stepped_law,
)
from hapnet.params import Params
from hapnet.wire.messages import Wave

_LONGEST_JITTER_S = 0.25
"""Waves that wait longer do more harm than dropped ones, as measured on a recorded LTE link [s]."""


@dataclass(frozen=True)
class LineTuning:
    impedance_Ns_m: float
    stiffness_N_m: float
    damping_Ns_m: float
    smoothing_s: float
    longest_wait_s: float
    recovery_s: float = 0.0


@dataclass(frozen=True)
class DigitalTuning:
    impedance_Ns_m: float
    stiffness_N_m: float
    damping_Ns_m: float
    smoothing_s: float
    spread_s: float
    recovery_s: float = 0.0


T = TypeVar("T", LineTuning, DigitalTuning)


def tune_line(params: Params, link: Delays) -> LineTuning:
    """Choose the greatest wave impedance b that a device can render.

    In free motion a line of delay d acts as an inertia b d, in contact as a spring b/d (Niemeyer, Slotine 2004). A
    virtual world's slow steps make d so long that this spring is too soft. So the virtual coupling is made as stiff as
    needed for both in series to give device.stiffness; if the line alone is softer, it gets ten times that stiffness.
    Its damper is b, so that a wall does not reflect high frequencies.
    """
    wave, K = params.wave, scalar_stiffness(params)
    impedance = wave.impedance or RENDERED_DAMPING
    delay = link.one_way_s + params.world.step_max_s + _jitter_s(link)
    compliance = 1.0 / K - delay / impedance
    return LineTuning(
        impedance_Ns_m=impedance,
        stiffness_N_m=wave.stiffness or 1.0 / max(compliance, 0.1 / K),
        damping_Ns_m=wave.damping or impedance,
        smoothing_s=wave.smoothing_s,
        longest_wait_s=params.world.step_max_s + _LONGEST_JITTER_S,
        recovery_s=wave.recovery_s if wave.missing == "zero" else 0.0,
    )


def tune_digital(params: Params, link: Delays) -> DigitalTuning:
    """As `tune_line`. Waves that arrive are spread over the longest time between two arrivals."""
    line = tune_line(params, link)
    spread = params.world.step_max_s + _jitter_s(link)
    return DigitalTuning(
        line.impedance_Ns_m, line.stiffness_N_m, line.damping_Ns_m, line.smoothing_s, spread, params.wave.recovery_s
    )


def _jitter_s(link: Delays) -> float:
    """Bound of the jitter [s]: how much later than the fastest message another arrives; rarely exceeded."""
    return min(link.round_trip_bound_s - 2.0 * link.one_way_s, _LONGEST_JITTER_S)


def _delay_line(start: CouplingStart[LineTuning]) -> Line:
    hold, longest = start.params.wave.missing == "hold", start.tuning.longest_wait_s
    return _whole(start, DelayLine(len(start.position), longest, hold=hold, recovery=start.tuning.recovery_s))


def _replay(start: CouplingStart[DigitalTuning]) -> Line:
    return _whole(start, Replay(len(start.position), start.tuning.spread_s))


def _whole(start: CouplingStart[T], line: Line) -> Line:
    """The line with its lost waves made up for, unless the user wants it as it was first published."""
    return IntegralLine(line) if start.tuning.recovery_s else line


def _device(line: Callable[[CouplingStart[T]], Line]) -> Callable[[CouplingStart[T]], WaveDevice]:
    def make(start: CouplingStart[T]) -> WaveDevice:
        tuning, dof = start.tuning, len(start.position)
        return WaveDevice(tuning.impedance_Ns_m, start.position, WaveFilter(line(start), dof, tuning.smoothing_s))

    return make


def _world(line: Callable[[CouplingStart[T]], Line]) -> Callable[[CouplingStart[T]], WaveWorld]:
    def make(start: CouplingStart[T]) -> WaveWorld:
        tuning = start.tuning
        return WaveWorld(tuning.impedance_Ns_m, tuning.stiffness_N_m, tuning.damping_Ns_m, start.position, line(start))

    return make


_SEARCHED: Mapping[str, Between | tuple[Any, ...]] = {
    "wave.impedance": Between(0.5, RENDERED_DAMPING, log=True),
    "wave.stiffness": Between(50.0, 5000.0, log=True),
    "wave.damping": Between(0.5, 20.0, log=True),
    "wave.smoothing_s": Between(0.001, 0.05, log=True),
}

WAVE = CouplingSpec(
    name="wave",
    title="wave variables",
    source="Niemeyer, Slotine 2004, with wave integrals",
    claim="passive at both ports for any constant delay; on any link, if zero replaces missing waves",
    device=held_law(_device(_delay_line)),
    world=stepped_law(_world(_delay_line)),
    tuning=LineTuning,
    tune=tune_line,
    shared=("impedance_Ns_m",),
    device_sends=Wave,
    world_sends=Wave,
    covers=lambda params, tuning, virtual: params.wave.missing == "zero",
    searched={**_SEARCHED, "wave.recovery_s": Between(0.01, 1.0, log=True)},
)

DIGITAL_WAVE = CouplingSpec(
    name="digital-wave",
    title="digital waves",
    source="Berestesky, Chopra, Spong 2004",
    claim="passive at both ports, whatever the link does",
    device=held_law(_device(_replay)),
    world=stepped_law(_world(_replay)),
    tuning=DigitalTuning,
    tune=tune_digital,
    shared=("impedance_Ns_m",),
    device_sends=Wave,
    world_sends=Wave,
    covers=lambda params, tuning, virtual: True,
    searched=_SEARCHED,
)
