"""Anchors: published settings and figures, run here, so that the figures of a comparison have a known scale.

Each anchor is a row of `ANCHORS`: its source, the runs that repeat its setting, its published figures beside the same
figures of these runs, and why they differ. People and robots took part in most of the publications; here a simulated
hand and a simulated world do, so no figure can agree exactly.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from hapnet.assembly.links import link_profile
from hapnet.errors import InvalidParameter
from hapnet.ext.study.case import Measures, measure
from hapnet.ext.study.plans import BASE
from hapnet.params import Params

Find = Callable[[Sequence[Measures]], float | None]
"""Computes a figure from the measures of an anchor's runs, in the order of `Anchor.runs`."""


class PublishedFigure(NamedTuple):
    """A published figure beside ours: its name, the text of the publication, and how ours is found, with its unit."""

    name: str
    theirs: str
    ours: Find
    unit: str
    digits: int = 1


@dataclass(frozen=True)
class Anchor:
    """A published setting.

    about : one line. source : authors, year, and where the figure is. fixed : parameters of all runs. runs : parameters
    of each run. figures : see `PublishedFigure`. why : why theirs and ours differ.
    """

    about: str
    source: str
    fixed: Mapping[str, object]
    runs: Sequence[Mapping[str, object]]
    figures: Sequence[PublishedFigure]
    why: str


class Threshold(NamedTuple):
    """A perceptual threshold: the smallest value that people notice, its source, and how ours is found."""

    name: str
    noticed: float
    unit: str
    source: str
    ours: Callable[[Measures, Params], float | None]


def _metric(run: int, name: str) -> Find:
    return lambda found: found[run][name]


def _more(run: int, name: str) -> Find:
    """The value of a run less that of the first."""

    def find(found: Sequence[Measures]) -> float | None:
        first, later = found[0][name], found[run][name]
        return None if first is None or later is None else later - first

    return find


def _saved(name: str) -> Find:
    """The share of the first run's packets that the second did not send [%]."""

    def find(found: Sequence[Measures]) -> float | None:
        every, sent = found[0][name], found[1][name]
        return None if not every or sent is None else 100.0 * (1.0 - sent / every)

    return find


def _millijoules(run: int, name: str) -> Find:
    return lambda found: None if (value := found[run][name]) is None else 1e3 * value


def _both(words: str) -> dict[str, object]:
    """The same link in both directions."""
    return {"link.up": words, "link.down": words}


def _trips(*round_trips_ms: float) -> list[dict[str, object]]:
    """Links with these round trips, half in each direction."""
    return [_both(f"delay {trip / 2.0:g}ms" if trip else "") for trip in round_trips_ms]


_KILOHERTZ = {"device.pspm_period_s": 0.001, "world.step_min_s": 0.001, "world.step_max_s": 0.001}
"""Both sides send a thousand samples a second, as in most publications."""

_ERROR, _FREE = "true_force_error_percent", "free_rms_mm"
_DELAYS_MS = (0.0, 70.0, 100.0, 150.0, 300.0)

ANCHORS: Mapping[str, Anchor] = {
    "deadband": Anchor(
        "packets that a perceptual deadband saves",
        "Kammerl, Vittorias, Nitsch, Faerber, Steinbach, Hirche 2010, Presence 19(5), abstract; the plain deadband: "
        "Hinterseer, Hirche, Chaudhuri, Steinbach, Buss 2008, IEEE TSP 56(2), abstract",
        {**_KILOHERTZ, **_both(""), "operator": "press"},
        [{"wire.deadband": 0.0}, {"wire.deadband": 0.1}],
        (
            PublishedFigure("packets saved, up", "up to 96 %; up to 90 %", _saved("packets_up_per_s"), "%"),
            PublishedFigure("packets saved, down", "up to 96 %; up to 90 %", _saved("packets_down_per_s"), "%"),
            PublishedFigure("force error that it adds", "no effect on the task", _more(1, _ERROR), "points", 2),
        ),
        "Their deadband grows with the hand's velocity, and they count the best task. Here the fraction is 10 % at any "
        "speed, a hand presses a wall, and a sample is sent five times within a silence at least.",
    ),
    "pursuit": Anchor(
        "delay, deadband and loss at which a pursuit gets worse",
        "Chaudhari, Schuwerk, Nitsch, Steinbach, Faerber 2011, IEEE HAVE, abstract",
        {**_KILOHERTZ, "operator": "sine"},
        [
            _both(""), _both("delay 14ms"), _both("delay 50ms"), {**_both(""), "wire.deadband": 0.27},
            _both("delay 14ms loss 10%"),
        ],
        (
            PublishedFigure("position error, no delay", "the reference", _metric(0, _FREE), "mm", 2),
            PublishedFigure("more at 14 ms one way", "not significant", _more(1, _FREE), "mm", 2),
            PublishedFigure("more at 50 ms one way", "significant (above 14 ms)", _more(2, _FREE), "mm", 2),
            PublishedFigure("more with a deadband of 27 %", "not significant (above: it is)", _more(3, _FREE), "mm", 2),
            PublishedFigure("more at 14 ms with 10 % lost", "loss not significant", _more(4, _FREE), "mm", 2),
        ),
        "They measure how well people follow a target and use no control against the delay. Here the error is that "
        "between device and proxy, and the world predicts the device. Their loss rates are not in the abstract.",
    ),
    "telesurgery": Anchor(
        "delay at which surgeons get slower",
        "Nankaku et al. 2022, PLOS ONE 17(10) e0274328, abstract (34 people, four tasks)",
        {"operator": "hand-21"},
        _trips(*_DELAYS_MS),
        (
            PublishedFigure("force error, no delay", "the reference", _metric(0, _ERROR), "%"),
            PublishedFigure("more at 70 ms", "significantly slower", _more(1, _ERROR), "points"),
            PublishedFigure("more at 100 ms", "as at 70 ms, acceptable", _more(2, _ERROR), "points"),
            PublishedFigure("more at 150 ms", "slower", _more(3, _ERROR), "points"),
            PublishedFigure("more at 300 ms", "slower still", _more(4, _ERROR), "points"),
            PublishedFigure("position error more at 300 ms", "-", _more(4, _FREE), "mm"),
        ),
        "They measure the time of a task with delayed pictures. Here nothing is seen, and the wall is rendered from "
        "its local copy, so its force hardly depends on the delay; the position error does. A delay is a round trip.",
    ),
    "bilateral": Anchor(
        "two arms at 150 Hz over 120 +- 40 ms with 1 % lost",
        "Feng, Huang, Chen 2026, arXiv 2605.19255, abstract (Lite6 and FR3)",
        {
            **_both("delay 120ms 40ms loss 1%"), "device.pspm_period_s": 1.0 / 150.0, "world.step_min_s": 1.0 / 150.0,
            "world.step_max_s": 1.0 / 150.0, "operator": "press",
        },
        [{}],
        (
            PublishedFigure("energy out of both ports", "favourable", _millijoules(0, "energy_out_J"), "mJ"),
            PublishedFigure("residual oscillation", "stable", _metric(0, "swing_N"), "N", 3),
            PublishedFigure("stiffness, of the wanted", "matches", _metric(0, "stiffness_percent"), "%"),
            PublishedFigure("effective delay", "-", _metric(0, "effective_delay_ms"), "ms"),
        ),
        "Theirs are two arms with force sensors, and one delay that may be of the round trip. Here it is in each "
        "direction, the servo runs at 1 kHz and only the messages at 150 Hz, and the world is simulated.",
    ),
    "satellite": Anchor(
        "a satellite link of 632 ms with 2.8 % lost",
        "Zhang, Pan, Zhang, Wang, Ma, He, Li, Liu 2025, Intelligent Surgery, doi 10.1016/j.isurg.2025.05.001, "
        "abstract; 0.32 mm, 2 mm and 2.8 %: the publisher's release, EurekAlert 1088230",
        {**_both("delay 316ms loss 2.8%"), "operator": "hand-21"},
        [{}, {"coupling": "zoh", "rendering": "paper"}],
        (
            PublishedFigure(
                "tracking error at the effective delay", "0.32 +- 0.07 mm; conventional: more than 2 mm",
                _metric(0, "effective_error_mm"), "mm", 2,
            ),
            PublishedFigure("effective delay", "632 ms, end to end", _metric(0, "effective_delay_ms"), "ms"),
            PublishedFigure("position error at the same time", "-", _metric(0, _FREE), "mm", 2),
            PublishedFigure("without prediction: tracking error", "-", _metric(1, "effective_error_mm"), "mm", 2),
            PublishedFigure("without prediction: delay", "-", _metric(1, "effective_delay_ms"), "ms"),
            PublishedFigure("energy out of both ports", "-", _millijoules(0, "energy_out_J"), "mJ"),
        ),
        "Their arm tracks a surgeon's commands with a learnt prediction, at a speed and by a definition not in the "
        "abstract. Here a hand reaches and touches, and 632 ms is the round trip. A prediction trades delay for "
        "error: without it the proxy follows exactly, but later.",
    ),
    "etvo": Anchor(
        "effective delay and error (ETVO) over a constant delay",
        "Kroep, Gokhale, Verburg, Venkatesha Prasad 2024, IEEE TMC 23(3) 2054-2065, arXiv 2107.05343, abstract: the "
        "metrics match what theory gives; for a constant delay that is the delay, and no error",
        {**_KILOHERTZ, "operator": "sine", "scene": "free"},
        [
            *({"coupling": "zoh", "rendering": "paper", **_both(words)} for words in ("", "delay 50ms", "delay 100ms")),
            _both("delay 50ms"),
        ],
        (
            PublishedFigure("delay that 50 ms add", "50 ms", _more(1, "effective_delay_ms"), "ms"),
            PublishedFigure("delay that 100 ms add", "100 ms", _more(2, "effective_delay_ms"), "ms"),
            PublishedFigure("error that 100 ms add", "0 mm", _more(2, "effective_error_mm"), "mm", 3),
            PublishedFigure("delay of 50 ms with the prediction", "-", _metric(3, "effective_delay_ms"), "ms"),
            PublishedFigure("its error", "-", _metric(3, "effective_error_mm"), "mm", 3),
        ),
        "They find an offset for each sample by dynamic time warping; here one delay stands for the whole run. The "
        "proxy's lag behind the spring is 28 ms, which the difference of two runs leaves out.",
    ),
}  # fmt: skip

THRESHOLDS = (
    Threshold(
        "stiffness off by", 10.0, "%",
        "a tenth of the force (Hinterseer et al. 2008), and of stiffness if the depth is known (Fu et al. 2017)",
        lambda found, params: None if (value := found["stiffness_percent"]) is None else abs(value - 100.0),
    ),
    Threshold(
        "force step in a tick", 10.0, "% of the peak",
        "a click: a tenth of the force, and less the faster it changes (Bhardwaj, Chaudhuri 2014)",
        lambda found, params: _share(found["force_step_N"], found["peak_force_N"]),
    ),
    Threshold(
        "felt late by", 50.0, "ms",
        "a touch less than 50 ms after the view of it seems to be at the same time (Di Luca, Mahnan 2019)",
        lambda found, params: _late_ms(found["first_contact_ms"], params),
    ),
)  # fmt: skip


def _late_ms(felt_ms: float | None, params: Params) -> float | None:
    """The time from the touch until it is felt; the metric counts from when an answer could arrive at the earliest."""
    links = [link_profile(f"link.{way}", words) for way, words in (("up", params.link.up), ("down", params.link.down))]
    return None if felt_ms is None else felt_ms + sum(link.delay_ns for link in links) / 1e6


def _share(part: float | None, whole: float | None) -> float | None:
    return None if part is None or not whole else 100.0 * part / whole


def anchor(name: str) -> Anchor:
    """The anchor of that name. Raises InvalidParameter."""
    if name not in ANCHORS:
        raise InvalidParameter("--anchor", name, f"one of {', '.join(ANCHORS)}, or list", ("list", *ANCHORS))
    return ANCHORS[name]


def run(name: str, params: Params, seed: int = 0, report: Callable[[int], None] = lambda done: None) -> list[Measures]:
    """The measures of each run of the anchor, over these parameters. Raises as `measure`, and InvalidParameter if
    the parameters set what the anchor sets.

    report : called with the number of runs that are done.
    """
    setting, found = anchor(name), []
    for word in sorted({*setting.fixed}.union(*setting.runs)):
        if params.get(word) != BASE.get(word):
            raise InvalidParameter(word, params.get(word), "", why="--anchor sets it; leave it out")
    for number, own in enumerate(setting.runs):
        report(number)
        found.append(measure(params.set({**setting.fixed, **own}), seed))
    return found


def as_dict(name: str, found: Sequence[Measures]) -> dict[str, Any]:
    """The anchor for JSON: its source and setting, each figure with theirs and ours, and the thresholds beside the
    largest value of all runs with hapnet's own coupling.
    """
    setting = anchor(name)
    params = [Params().set({**setting.fixed, **own}) for own in setting.runs]

    def ours(threshold: Threshold) -> float | None:
        hapnets = Params().coupling
        pairs = zip(found, params, strict=True)
        values = [threshold.ours(one, given) for one, given in pairs if given.coupling == hapnets]
        return max((value for value in values if value is not None), default=None)

    return {
        "anchor": name,
        "about": setting.about,
        "source": setting.source,
        "runs": [{**setting.fixed, **own} for own in setting.runs],
        "figures": [
            {"name": one.name, "theirs": one.theirs, "ours": one.ours(found), "unit": one.unit}
            for one in setting.figures
        ],
        "why": setting.why,
        "thresholds": [
            {
                "name": one.name,
                "noticed": one.noticed,
                "unit": one.unit,
                "ours": ours(one),
                "source": one.source,
            }
            for one in THRESHOLDS
        ],
    }
