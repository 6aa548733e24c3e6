"""What a summary says of motion and margin, kept up sample by sample while a side runs."""

from __future__ import annotations

import math

from hapnet.metrics.position import Motion
from hapnet.recording.samples import DeviceSample, Sample, WorldSample


class LiveFigures:
    """The peaks of `motion` and the least of the account, of one side's samples.

    Attributes
    ----------
    margin_J, slack_J : the least so far. margin_end_J : the newest [J]. All are None before the first sample.
    """

    def __init__(self) -> None:
        self.margin_J: float | None = None
        self.slack_J: float | None = None
        self.margin_end_J: float | None = None
        self._force_N: float | None = None
        self._depth_m: float | None = None
        self._contacts: int | None = None
        self._inside = False

    def see(self, sample: Sample) -> None:
        """Take one more sample, on any thread; samples come in the order of their times."""
        if isinstance(sample, DeviceSample):
            self._force_N = _more(self._force_N, math.hypot(*sample.force_N))
        elif isinstance(sample, WorldSample):
            inside = sample.penetration_m > 0.0
            self._depth_m = _more(self._depth_m, max(sample.penetration_m, 0.0))
            self._contacts = (self._contacts or 0) + (inside and not self._inside)
            self._inside = inside
        else:
            return
        self.margin_J, self.slack_J = _less(self.margin_J, sample.margin_J), _less(self.slack_J, sample.slack_J)
        self.margin_end_J = sample.margin_J

    def motion(self) -> Motion:
        """What is known so far; tracking errors need both sides."""
        return {
            "free_rms_m": None,
            "contact_rms_m": None,
            "peak_force_N": self._force_N,
            "peak_penetration_m": self._depth_m,
            "contacts": self._contacts,
        }


def _more(most: float | None, value: float) -> float | None:
    return value if math.isfinite(value) and (most is None or value > most) else most


def _less(least: float | None, value: float) -> float | None:
    return value if math.isfinite(value) and (least is None or value < least) else least
