"""Perceptual deadband: a side sends a sample only if the user at the other side could notice its change.

After P. Hinterseer, S. Hirche, S. Chaudhuri, E. Steinbach, M. Buss, "Perception-based data reduction and transmission
of haptic data in telepresence and teleaction systems" (IEEE Trans. Signal Processing 56, 2008): by Weber's law people
notice a change of a stimulus that exceeds a fixed fraction k of it. So a sample s is sent when

    |s - s_sent| > k |s_sent|                                     s_sent: the last sample sent

People notice changes of force of 7 to 10 %. The comparison depends on the kind of sample (derived here):

* A position x is not itself a stimulus, but the force that it causes is. The receiver's spring K is tied to x_sent. Its
  other end is, apart from delays, at ybar, to which this side's own spring is tied. So the force is K |ybar - x_sent|,
  and sending x would change it by K |x - x_sent|. K cancels: send if |x - x_sent| > k |ybar - x_sent|.
* A motion is sent if its position is due by that rule, or its velocity by Weber's law: a velocity causes a force too.
* A port's sample is a position or a force, and a total of energy. Holding back a total loses nothing.
* Each wave carries energy, so none may be dropped. A wave held back is merged with the next: their mean over the sum of
  their spans. Its energy |u|^2 T is at most the sum of both (Cauchy-Schwarz), so the line stays passive.

Near zero, where Weber's law ends, changes below the `LEAST_...` constants count as not noticed. A vector's deadband is
a ball. Set-position modulation stays passive with any deadband, because y may be any sequence.
"""

from __future__ import annotations

from math import dist, hypot
from typing import Literal

from hapnet.checks import Vector
from hapnet.control.coupling import (
    TICK_SLACK_S,
    CouplingSample,
    MotionSample,
    PortSample,
    PositionSample,
    ProxySample,
    WaveSample,
    vector_of,
)
from hapnet.errors import InvalidParameter
from hapnet.mechanics.plane import Plane

MAX_S = 0.1
"""Maximum time between two samples sent [s], even at rest; the next sample after it is sent. So several samples arrive
within the 0.5 s after which a peer counts as silent, and a lost last change is repaired within this time."""

MAX_WAVE_S = 0.02
"""The maximum time for waves [s]: merging delays waves by this time, and wave laws suffer most from delay."""

MIN_N = 0.005
"""A change of force that cannot be felt [N]: people feel tens of millinewtons at best."""
MIN_M = 6e-5
"""A change of position that causes about this force with 100 N/m [m]. A common encoder resolves 0.055 mm, so a single
count is not sent."""
MIN_MPS = 1e-3
"""A change of velocity that causes this force with 5 Ns/m [m/s]."""
MIN_WAVE = 2e-3
"""A change of a wave that causes about this force, u = f/sqrt(2b), with an impedance of 3 Ns/m [sqrt(W)]."""


class Deadband:
    """Decides which of one side's samples are sent and which are held back.

    fraction : k, Weber's fraction; above 0, at most 1.
    longest_s : maximum time between two samples sent [s].
    port : the quantity in this side's `PortSample` samples.

    Raises InvalidParameter: the fraction or the time is not allowed.
    """

    def __init__(
        self, fraction: float, *, longest_s: float = MAX_S, port: Literal["position", "force"] = "position"
    ) -> None:
        if not 0.0 < fraction <= 1.0:
            raise InvalidParameter("deadband", fraction, "a fraction above 0, at most 1")
        if not 0.0 < longest_s < float("inf"):
            raise InvalidParameter("longest_s", longest_s, "a time above 0 s")
        self.held_back: int = 0
        """Number of samples not sent; for waves, merged with a later one."""
        self._fraction = fraction
        self._longest_s = longest_s - TICK_SLACK_S
        self._port = port
        self.on_peer_changed()

    def on_peer_changed(self) -> None:
        """Send the next sample: a new peer has received nothing yet."""
        self._sent_s: float | None = None
        self._value: Vector = ()
        self._velocity: Vector = ()
        self._waiting: WaveSample | None = None
        self._planes: tuple[Plane, ...] | None = None

    def offer(self, now_s: float, sample: CouplingSample, opposite: Vector) -> CouplingSample | None:
        """Return the sample to send for `sample` at the time `now_s` [s]; None: send nothing.

        opposite : ybar, to which this side's spring is tied; without a spring, the assumed position of the other side
            [m].
        """
        due = self._sent_s is None or now_s - self._sent_s >= self._longest_s
        sent = due or self._noticed(sample, opposite)
        if isinstance(sample, WaveSample):
            sample = self._waiting = _merged(self._waiting, sample)
        if not sent:
            self.held_back += 1
            return None
        self._sent_s, self._waiting = now_s, None
        self._value = vector_of(sample)
        if isinstance(sample, MotionSample):
            self._velocity = sample.velocity
        elif isinstance(sample, ProxySample):
            self._planes = sample.planes
        return sample

    def _noticed(self, sample: CouplingSample, opposite: Vector) -> bool:
        match sample:
            case MotionSample(position, velocity):
                return self._moved(position, opposite) or self._changed(velocity, self._velocity, MIN_MPS)
            case PortSample(value, _) if self._port == "force":
                return self._changed(value, self._value, MIN_N)
            case PortSample(value, _):
                return self._moved(value, opposite)
            case PositionSample(position, _):
                return self._moved(position, opposite)
            case ProxySample(position, _, _, planes):
                return self._moved(position, opposite) or planes != self._planes
            case WaveSample(value, _, _, _):
                return self._changed(value, self._value, MIN_WAVE)
            case _:
                return self._moved(sample, opposite)

    def _moved(self, x: Vector, opposite: Vector) -> bool:
        return dist(x, self._value) > max(self._fraction * dist(opposite, self._value), MIN_M)

    def _changed(self, value: Vector, last: Vector, minimum: float) -> bool:
        return dist(value, last) > max(self._fraction * hypot(*last), minimum)


def _merged(waiting: WaveSample | None, wave: WaveSample) -> WaveSample:
    """Merge two waves into one: their mean over the sum of their spans."""
    if waiting is None:
        return wave
    span = waiting.span + wave.span
    if span == 0.0:  # both are from a paused world
        return wave
    share = wave.span / span
    return WaveSample(tuple([u + share * (new - u) for u, new in zip(waiting.value, wave.value, strict=True)]), span)
