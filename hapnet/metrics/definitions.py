"""What is measured of a run, in one place: commands, JSON, figures and documentation take names and units from here.

The values come from `measures` in hapnet/study/case.py, which must have one for each name here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

Better = Literal["higher", "lower", "nearer 0", "nearer 100"]


@dataclass(frozen=True)
class Metric:
    """One figure of merit.

    Parameters
    ----------
    name : its key in dictionaries and files; it ends in the unit, as in `margin_J` or `packets_per_s`.
    label : its name for people, short enough for a column.
    unit : of its values; "" for a bare number. better : which way. meaning : how it is defined, in a sentence or two.
    """

    name: str
    label: str
    unit: str
    better: Better
    meaning: str

    @property
    def heading(self) -> str:
        """Label and unit, for an axis or a column."""
        return f"{self.label} [{self.unit}]" if self.unit else self.label


METRICS: Mapping[str, Metric] = MappingProxyType(
    {
        metric.name: metric
        for metric in (
            Metric(
                "margin_J", "two-port margin", "J", "higher",
                "least value over time of d² plus the energy that hand and virtual world have put in at their ports. "
                "d² is the energy at the start with PSPM's reservoirs; every coupling is measured with the same d², "
                "though others start with nothing. Below 0: not passive",
            ),
            Metric(
                "energy_out_J", "energy out", "J", "lower",
                "greatest energy over time that has come out of both ports together beyond what has gone in: d² less "
                "the two-port margin. It is 0 for a passive coupling that starts with no energy",
            ),
            Metric(
                "margin_end_J", "margin at the end", "J", "higher",
                "d² plus the energy put in at both ports in the whole run",
            ),
            Metric(
                "margin_later_J", "margin after 1 s", "J", "higher",
                "least value of the two-port margin from one second after the start on; at the start it is always d²",
            ),
            Metric(
                "hand_margin_J", "hand's margin", "J", "higher",
                "least value over time of the hand's work plus the energy that the device's side starts with. Below 0: "
                "the hand got more energy than that",
            ),
            Metric(
                "actuator_margin_J", "two-port margin at the actuator", "J", "higher",
                "as the two-port margin, but with the actuator's port as the device's port, so without the help of the "
                "device's own damping. Sampled servos only",
            ),
            Metric(
                "free_rms_mm", "position error, free", "mm", "lower",
                "root mean square of the distance between device and proxy at the same time, while the proxy is in no "
                "wall",
            ),
            Metric(
                "contact_rms_mm", "position error, contact", "mm", "lower",
                "the same while the proxy is in a wall. A perfect coupling has this error too: its spring yields",
            ),
            Metric(
                "stiffness_percent", "rendered stiffness", "%", "nearer 100",
                "least-squares slope of the resisting force over the device's penetration, through the wall's surface, "
                "after a visit has settled (a round trip and two of the world's longest steps after it began). It is "
                "in % of the stiffness of the given springs and the wall in series: two springs for pspm, zoh, popc "
                "and eba, only device.stiffness for the others. If a law's rule makes its spring softer, this shows",
            ),
            Metric(
                "force_error_N", "force error", "N", "lower",
                "root mean square over time of the difference between the force on the device and the force in the "
                "same run over an ideal link without deadband",
            ),
            Metric(
                "force_error_percent", "force error", "%", "lower",
                "the same in % of the ideal run's peak force",
            ),
            Metric(
                "buzz_N2", "buzz", "N²", "lower",
                "power of the force on the device above 20 Hz, summed over the axes: Welch's spectrum with Hann "
                "windows of one second that overlap by three quarters, each without its mean",
            ),
            Metric(
                "drift_mm_per_min", "position drift", "mm/min", "nearer 0",
                "slope over time of device minus proxy along the motion while both are free, by least absolute "
                "deviations; a lag that depends on the device's last 0.4 s is fitted too and left out",
            ),
            Metric(
                "first_contact_ms", "first felt contact", "ms", "lower",
                "time from the device's first crossing of the wall's surface until the contact is felt, less the "
                "median delays of both links. Felt: the resisting force exceeds, by 10 % and by 0.1 N, the greatest "
                "one before the world's answer could arrive. None: not felt above the drag",
            ),
            Metric(
                "peak_force_N", "peak force", "N", "lower",
                "largest force on the device",
            ),
            Metric(
                "packets_per_s", "packets", "1/s", "lower",
                "messages of all kinds offered to both links per second",
            ),
            Metric("packets_up_per_s", "packets up", "1/s", "lower", "of these, from the device"),
            Metric("packets_down_per_s", "packets down", "1/s", "lower", "of these, from the virtual world"),
            Metric(
                "claim_kept", "claim kept", "", "higher",
                "0: the coupling claims to be passive on this link, and was not. 1: it was, or it claims nothing here",
            ),
            Metric(
                "slack_J", "slack", "J", "higher",
                "least value over time of the slack in either side's half of the theorem, for a coupling with energy "
                "reservoirs. Below 0 by more than rounding: the accounts are wrong",
            ),
        )
    }
)  # fmt: skip
"""Every metric, by its name."""
