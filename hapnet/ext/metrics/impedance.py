"""The mechanical impedance that a coupling transmits, from recorded positions and forces under a periodic motion.

The settled response of a device that follows a multisine contains only the frequencies of that signal, and noise.
Over whole periods the Fourier coefficients of position X and force F at a line give ``Z = F/X``
[N/m] with no leakage and no window (R. Pintelon, J. Schoukens: System Identification, a Frequency Domain Approach,
2012, chapter 2). Its real part is a stiffness; its imaginary part over the angular frequency is a damping. A coupling
is transparent as far as Z equals the impedance of the environment (D. A. Lawrence: Stability and transparency in
bilateral teleoperation, 1993).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hapnet.checks import Array

THREE_DB = 10.0 ** (3.0 / 20.0) - 1.0
"""The relative difference |Z/Z_true - 1| of an impedance that is 3 dB too great: 0.41."""


@dataclass(frozen=True)
class ImpedanceAtFrequency:
    """The transmitted impedance at one frequency.

    impedance : F/X [N/m], complex; F resists the motion. spread : standard deviation of this estimate [N/m], from the
        differences between periods; infinite with only one period.
    """

    frequency_hz: float
    impedance: complex
    spread: float

    @property
    def stiffness(self) -> float:
        """[N/m]."""
        return self.impedance.real

    @property
    def damping(self) -> float:
        """[Ns/m]."""
        return self.impedance.imag / (2.0 * math.pi * self.frequency_hz)


@dataclass(frozen=True)
class Quartiles:
    """Median, first and third quartile over runs."""

    median: float
    q1: float
    q3: float


@dataclass(frozen=True)
class Curve:
    """The transmitted impedance over several runs, at each frequency [Hz].

    stiffness [N/m], damping [Ns/m], magnitude [N/m] : of the transmitted impedance. truth : the true impedance [N/m].
    off_3dB_hz : infinite for a run that is nowhere 3 dB off up to 20 Hz. turns : of a rotation, in Nm/rad and Nms/rad.
    """

    frequency_hz: tuple[float, ...]
    stiffness: tuple[Quartiles, ...]
    damping: tuple[Quartiles, ...]
    magnitude: tuple[Quartiles, ...]
    truth: tuple[complex, ...]
    off_3dB_hz: Quartiles
    turns: bool = False

    @property
    def true_damping(self) -> list[float]:
        """[Ns/m]."""
        return [z.imag / (2.0 * math.pi * f) for z, f in zip(self.truth, self.frequency_hz, strict=True)]

    @property
    def off(self) -> float:
        """The largest difference of the median stiffness from the true one, as a share of the largest true |Z|."""
        greatest = max(map(abs, self.truth))
        pairs = zip(self.stiffness, self.truth, strict=True)
        return max(abs(stiffness.median - z.real) for stiffness, z in pairs) / greatest if greatest else math.inf


def transmitted(
    position: Array, resistance: Array, step_s: float, period_s: float, harmonics: Sequence[int]
) -> list[ImpedanceAtFrequency]:
    """The impedance at each of these harmonics of ``1 / period_s``.

    position : (N,) the device's [m], in the settled state. resistance : (N,) the force on it, against the motion [N].
    step_s : between samples; a period is a whole number of steps. Samples after the last whole period are left out.

    The estimate is the least-squares estimate over the periods, ``sum F X* / sum |X|^2``.
    """
    length = round(period_s / step_s)
    count = len(position) // length
    if count < 1 or abs(length * step_s - period_s) > 1e-6 * period_s:
        raise ValueError(f"{len(position)} samples of {step_s} s do not make a whole period of {period_s} s")
    X, F = (_coefficients(values, count, length)[:, list(harmonics)] for values in (position, resistance))
    power = np.sum(np.abs(X) ** 2, axis=0)
    Z = np.sum(F * X.conj(), axis=0) / power
    rest = np.sum(np.abs(F - Z * X) ** 2, axis=0)
    spread = np.sqrt(rest / (count - 1) / power) if count > 1 else np.full(len(power), np.inf)
    return [
        ImpedanceAtFrequency(k / period_s, complex(z), float(s))
        for k, z, s in zip(harmonics, Z.tolist(), spread.tolist(), strict=True)
    ]


def off_hz(
    lines: Sequence[ImpedanceAtFrequency], truth: Callable[[float], complex], allowed: float = THREE_DB
) -> float | None:
    """The lowest frequency of these lines at which ``|Z/Z_true - 1|`` exceeds `allowed` [Hz]; None: it never does.

    The default is 3 dB. The difference is taken between complex impedances: a delayed spring has the right magnitude,
    but a part of its stiffness has become a positive or negative damping.
    """
    off = (line.frequency_hz for line in lines if abs(line.impedance / truth(line.frequency_hz) - 1.0) > allowed)
    return min(off, default=None)


def harmonics_between(min_hz: float, most_hz: float, period_s: float, count: int) -> tuple[int, ...]:
    """About `count` harmonics of ``1 / period_s``, evenly spaced on a log scale, both ends included."""
    wanted = np.geomspace(min_hz, most_hz, count) * period_s
    return tuple(sorted({max(1, round(k)) for k in wanted.tolist()}))


def multisine(harmonics: Sequence[int], period_s: float, peak: float) -> Callable[[float], float]:
    """A signal with the same amplitude at each harmonic of ``1 / period_s``, and the largest value `peak`.

    Phases are Schroeder's (IEEE Trans. Information Theory, 1970), which keep the peak low.
    """
    count = len(harmonics)
    turns = [(2.0 * math.pi * k / period_s, -math.pi * i * (i - 1) / count) for i, k in enumerate(harmonics, start=1)]

    def plain(t: float) -> float:
        return sum(math.cos(omega * t + phase) for omega, phase in turns)

    samples = 16 * max(harmonics)
    scale = peak / max(abs(plain(i * period_s / samples)) for i in range(samples))
    return lambda t: scale * plain(t)


def _coefficients(values: Array, count: int, length: int) -> NDArray[np.complex128]:
    """Fourier coefficients of each period, (count, length // 2 + 1)."""
    return np.asarray(np.fft.rfft(np.reshape(values[: count * length], (count, length)), axis=1))
