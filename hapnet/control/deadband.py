"""Perceptual deadband: of what a side would send, only that is sent which its receiver's user could notice.

After P. Hinterseer, S. Hirche, S. Chaudhuri, E. Steinbach, M. Buss, "Perception-based data reduction and transmission
of haptic data in telepresence and teleaction systems" (IEEE Trans. Signal Processing 56, 2008): by Weber's law a change
of a stimulus is noticed when it exceeds a fixed share k of the stimulus, so a sample is sent when

    |s - s_sent| > k |s_sent|                                     s_sent: the last that was sent

Of force people notice 7 to 10 %. What is compared here (derived here), by what a sample says:

* A position x is no stimulus; the force is that it makes. The receiver's spring K is tied to x_sent, and its other end
  is, delays apart, where this side's own spring is tied, at ybar: the force is K |ybar - x_sent|, and x in place of
  x_sent would change it by K |x - x_sent|. K cancels: send if |x - x_sent| > k |ybar - x_sent|.
* A motion is sent if its position is to be by that rule, or its velocity by Weber's: a velocity makes a force too.
* A port shows a position or a force; its energy is a total, which waits without loss.
* Each wave carries energy of its own, so none may be dropped. Those held back are merged with the next: the mean over
  the sum of their spans, whose energy |u|^2 T is at most the sum of theirs (Cauchy, Schwarz). So it stays passive.

Near zero, where Weber's law ends, changes below the `LEAST_...` are not noticed either. Vectors have a ball for a
deadband. Passivity of set-position modulation needs nothing of this: there y is any sequence.
"""

from __future__ import annotations

from math import dist, hypot
from typing import Literal

from hapnet.checks import Vector
from hapnet.control.coupling import TICK_SLACK_S, CouplingSample, Motion, Port, Wave, vector_of
from hapnet.errors import InvalidParameter

LONGEST_S = 0.1
"""Longest time between two data [s], of what rests too; they are sent at the first instant after. So several find room
in the 0.5 s of silence after which a peer counts as gone, and a last change that was lost stays unknown no longer."""

LONGEST_WAVE_S = 0.02
"""The same of waves: what is merged over a time is late by as much, and a delay is what waves pay for dearly."""

LEAST_N = 0.005
"""A change of force that nobody feels [N]: of any force tens of millinewtons are the least that is felt."""
LEAST_M = 6e-5
"""The same of a position [m]: with 100 N/m it makes some such force. A common encoder counts 0.055 mm, and a count is
no news."""
LEAST_MPS = 1e-3
"""The same of a velocity [m/s], with 5 Ns/m."""
LEAST_WAVE = 2e-3
"""The same of a wave [sqrt(W)], u = f/sqrt(2b), with an impedance of 3 Ns/m."""


class Deadband:
    """What of one side's data is sent, and what held back.

    Parameters
    ----------
    fraction : k, Weber's fraction; above 0, at most 1.
    longest_s : longest time between two data that are sent [s].
    port : what this side's ports show.

    Raises
    ------
    InvalidParameter : no such fraction or time.
    """

    def __init__(
        self, fraction: float, *, longest_s: float = LONGEST_S, port: Literal["position", "force"] = "position"
    ) -> None:
        if not 0.0 < fraction <= 1.0:
            raise InvalidParameter("deadband", fraction, "a fraction above 0, at most 1")
        if not 0.0 < longest_s < float("inf"):
            raise InvalidParameter("longest_s", longest_s, "a time above 0 s")
        self.held_back = 0
        """How many data were not sent; of waves, not sent by themselves."""
        self._fraction = fraction
        self._longest_s = longest_s - TICK_SLACK_S
        self._port = port
        self.on_peer_changed()

    def on_peer_changed(self) -> None:
        """Another peer, which knows nothing yet: the next sample is sent."""
        self._sent_s: float | None = None
        self._value: Vector = ()
        self._velocity: Vector = ()
        self._waiting: Wave | None = None

    def offer(self, now_s: float, sample: CouplingSample, opposite: Vector) -> CouplingSample | None:
        """What to send in place of `sample` at the time `now_s` [s], if anything.

        opposite : ybar, where this side's spring is tied, or else where the other side is taken to be [m].
        """
        due = self._sent_s is None or now_s - self._sent_s >= self._longest_s
        sent = due or self._noticed(sample, opposite)
        if isinstance(sample, Wave):
            sample = self._waiting = _merged(self._waiting, sample)
        if not sent:
            self.held_back += 1
            return None
        self._sent_s, self._waiting = now_s, None
        self._value = vector_of(sample)
        if isinstance(sample, Motion):
            self._velocity = sample.velocity
        return sample

    def _noticed(self, sample: CouplingSample, opposite: Vector) -> bool:
        match sample:
            case Motion(position, velocity):
                return self._moved(position, opposite) or self._changed(velocity, self._velocity, LEAST_MPS)
            case Port(value, _) if self._port == "force":
                return self._changed(value, self._value, LEAST_N)
            case Port(value, _):
                return self._moved(value, opposite)
            case Wave(value, _):
                return self._changed(value, self._value, LEAST_WAVE)
            case _:
                return self._moved(sample, opposite)

    def _moved(self, x: Vector, opposite: Vector) -> bool:
        return dist(x, self._value) > max(self._fraction * dist(opposite, self._value), LEAST_M)

    def _changed(self, value: Vector, last: Vector, least: float) -> bool:
        return dist(value, last) > max(self._fraction * hypot(*last), least)


def _merged(waiting: Wave | None, wave: Wave) -> Wave:
    """One wave in place of two: their mean over both spans."""
    if waiting is None:
        return wave
    span = waiting.span + wave.span
    if span == 0.0:  # of a world that stands still
        return wave
    share = wave.span / span
    return Wave(tuple([u + share * (new - u) for u, new in zip(waiting.value, wave.value, strict=True)]), span)
