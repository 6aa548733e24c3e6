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
    missed : the metric that counts how often a run missed this one; where it did and there is no value, medians and
        quartiles take it as infinite. "": nothing can be missed.
    """

    name: str
    label: str
    unit: str
    better: Better
    meaning: str
    missed: str = ""

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
                "hand_energy_out_J", "energy out at the hand", "J", "lower",
                "greatest energy over time that came out at the hand's port alone. A hand that is pushed back by a "
                "spring gets none that it has not put in before",
            ),
            Metric(
                "world_energy_out_J", "energy out at the world", "J", "lower",
                "greatest energy over time that came out at the virtual world's port alone, into its walls and "
                "bodies: what their damping takes. Where both ports together gave out more than d² and the hand's "
                "gave out nothing, this is where the energy went",
            ),
            Metric(
                "actuator_margin_J", "two-port margin at the actuator", "J", "higher",
                "as the two-port margin, but with the actuator's port as the device's port, so without the help of the "
                "device's own damping. Sampled servos only",
            ),
            Metric(
                "free_rms_mm", "position error, free", "mm", "lower",
                "root mean square of the distance between device and proxy at the same time, while the device is in no "
                "wall. (A run's summary, free_rms_m, asks whether the proxy is in none)",
            ),
            Metric(
                "free_first_mm", "position error, free, first 10 s", "mm", "lower",
                "the position error in free motion over the first 10 s of a run of 120 s or more",
            ),
            Metric(
                "free_last_mm", "position error, free, last minute", "mm", "lower",
                "the same over the last minute before the hand comes to rest, in a run of 120 s or more: if it is "
                "greater than that of the first 10 s, the coupling gets worse with time",
            ),
            Metric(
                "contact_rms_mm", "position error, contact", "mm", "lower",
                "that distance while the proxy is in a wall. A perfect coupling has this error too: its spring yields",
            ),
            Metric(
                "stiffness_percent", "rendered stiffness", "%", "nearer 100",
                "least-squares slope of the resisting force over the device's penetration, through the wall's surface, "
                "after a visit has settled (a round trip and two of the world's longest steps after it began). It is "
                "in % of the stiffness of the given springs and the wall in series: two springs for pspm, zoh, popc "
                "and eba, only device.stiffness for the others. If a law's rule makes its spring softer, this shows",
            ),
            Metric(
                "stiffness_worst_percent", "stiffness, worst tenth", "%", "nearer 100",
                "the stiffness that is rendered in each tenth of the run, in % of that of the springs and the wall in "
                "series; of the tenths with 0.1 s of settled contact the one farthest from 100. If none has that, as "
                "with taps shorter than a round trip, all contact counts. Walls may move",
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
                "true_force_error_N", "true force error", "N", "lower",
                "root mean square over time of the difference between the force on the device and that of the true "
                "environment at the device's place: the walls, rendered locally and at once through the given springs "
                "in series, and nothing in free space (transparency: Lawrence 1993). Drag, lag and softness all count. "
                "Where walls rub, no spring says their force: there it is the difference from the force at the same "
                "time in the same run over an ideal link, with a world that steps at 1 kHz",
            ),
            Metric(
                "true_force_error_percent", "true force error", "%", "lower",
                "the same in % of the true environment's peak force in this run",
            ),
            Metric(
                "true_force_error_last_percent", "true force error, last minute", "%", "lower",
                "the same over the last minute before the hand comes to rest, in a run of 120 s or more; in % of the "
                "whole run's peak",
            ),
            Metric(
                "drag_N", "drag at 67 mm/s", "N", "nearer 0",
                "force against the motion in free space, by linear regression on the device's velocity, at 67 mm/s; "
                "both are means over a third of a second, so that no swing hides it. Not within a round trip and two "
                "of the world's longest steps after a contact",
            ),
            Metric(
                "drag_p95_N", "drag, 95th percentile", "N", "nearer 0",
                "95th percentile of the force against the motion, over the thirds of a second of free motion with a "
                "mean speed of 50 to 90 mm/s",
            ),
            Metric(
                "drag_last_N", "drag, last minute", "N", "nearer 0",
                "drag at 67 mm/s over the last minute before the hand comes to rest, in a run of 120 s or more",
            ),
            Metric(
                "contact_to_drag", "contact to drag", "", "higher",
                "median resisting force in settled contact over the drag at 67 mm/s (0.01 N if the drag is less): at "
                "1, free motion feels as hard as the wall",
            ),
            Metric(
                "swing_N", "residual swing", "N", "lower",
                "root mean square of the force without its mean, from 1 to 3 s after the hand's reference has stopped; "
                "the greatest if it stops more than once. None: it never stops for 3 s (see operator_hand.end_hold_s)",
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
                "median delays of both links; below 0: felt before word of it could be back. Felt: the resisting force "
                "exceeds, by 10 % and by 0.1 N, the greatest one of the 100 ms before the crossing, also on average "
                "over the next 150 ms, as no swing does",
                missed="first_contact_missed",
            ),
            Metric(
                "first_contact_missed", "first contact missed", "", "lower",
                "1: the first contact was not felt before the device left, and a round trip more. 0: it was. None: no "
                "wall was entered deep enough for an ideal local spring to take 0.1 N",
            ),
            Metric(
                "later_contact_ms", "later contacts", "ms", "lower",
                "median over all contacts after the first of the time until they are felt, from when an ideal local "
                "spring would take 0.1 N. One that is not felt counts as infinite",
                missed="later_contacts_missed",
            ),
            Metric("later_contacts", "later contacts", "", "higher", "how many contacts followed the first"),
            Metric("later_contacts_missed", "later contacts missed", "", "lower", "how many of these were not felt"),
            Metric(
                "world_force_error_percent", "contact force error in the world", "%", "lower",
                "root mean square over time of the difference between the walls' force on the proxy and the force "
                "that they would have at rest with the device where it is in the middle of that step, through the "
                "spring between device and proxy and the wall in series; in % of that force's peak",
            ),
            Metric(
                "contacts_ratio", "contacts per contact", "", "lower",
                "visits of the proxy to a wall in the world, at its steps, per visit of the device, at each tick of "
                "the servo; neither is debounced. Above 1 the proxy chatters, and each impact costs energy",
            ),
            Metric(
                "modulated_percent", "modulated at the world", "%", "lower",
                "share of the world's updates whose set-position in use differs from the wanted one by more than 1 "
                "nm; for a coupling with energy reservoirs",
            ),
            Metric(
                "modulated_device_percent", "modulated at the device", "%", "lower",
                "the same share at the device, as the run's summary counts it (modulated_share)",
            ),
            Metric(
                "world_reservoir_min_J", "world's reservoir, least", "J", "higher",
                "least content of the reservoir at the world's side",
            ),
            Metric(
                "device_reservoir_min_J", "device's reservoir, least", "J", "higher",
                "the same at the device's side",
            ),
            Metric(
                "peak_force_N", "peak force", "N", "lower",
                "largest force on the device",
            ),
            Metric(
                "force_step_N", "largest force step", "N", "lower",
                "the largest change of the force on the device from one servo tick to the next",
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
