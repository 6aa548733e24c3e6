"""The histograms of a report: everything that was counted is drawn where it was counted."""

from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.patches import StepPatch

from hapnet.ext.pictures.histograms import lateness_histogram, link_histogram
from hapnet.records.histogram import Histogram
from netem import Link, LinkProfile
from netem.profile import PRESETS
from tests.conftest import mostly_slow


def measured(words: str, count: int = 2000) -> dict[str, Any]:
    """What a link says of messages sent a millisecond apart."""
    link: Link[int] = Link(LinkProfile.parse(words), seed=5)
    for i in range(count):
        link.send(i * 1_000_000, i)
    link.poll(10**15)
    return link.stats.as_dict()


def drawn(panel: Axes) -> tuple[Any, Any]:
    """Heights and edges."""
    patch = next(patch for patch in panel.patches if isinstance(patch, StepPatch))
    values, edges, _ = patch.get_data()
    return np.asarray(values), np.asarray(edges)


def marks(panel: Axes) -> dict[str, float]:
    return {str(line.get_label()): float(np.asarray(line.get_xdata())[0]) for line in panel.get_lines()}


def test_delays_are_drawn_in_bars_of_one_width() -> None:
    """Uniform between 30 and 50 ms: a hundred a ms. In a bar are 70 or so: 5 standard deviations are 60 %."""
    up, down = measured("delay 40ms 10ms"), measured("delay 5ms loss 50%")
    fig = link_histogram({"links": {"up": up, "down": down}})
    first, second = fig.axes
    heights, edges = drawn(first)
    assert heights.sum() == pytest.approx(2000, rel=1e-9)
    (width,) = set(np.round(np.diff(edges), 9))
    inside = heights[(edges[:-1] > 30.0) & (edges[1:] < 50.0)]
    assert len(inside) > 15
    np.testing.assert_allclose(inside, 100.0 * width, rtol=0.6)
    assert first.get_title(loc="left") == "uplink: delay 40ms 10ms"
    low, high = first.get_xlim()
    assert low < 5.0 < 50.0 < high
    assert next(x for label, x in marks(first).items() if "p50" in label) == pytest.approx(40.0, abs=1.5)
    heights, edges = drawn(second)
    assert heights.tolist() == [down["delivered"]]
    assert edges.tolist() == [pytest.approx(5.0, rel=0.011)] * 2
    assert second.get_xlabel() == "delay in the link [ms]"


@pytest.mark.parametrize(
    "words",
    mostly_slow([(one,) for one in [PRESETS["4g"], PRESETS["worst"], "delay 35ms loss 0.25% rate 6mbit " * 3]], 1),
)
@pytest.mark.long
def test_a_link_in_words_does_not_reach_into_the_legend(words: str) -> None:
    link = {**measured("delay 40ms 10ms", 100), "profile": words}
    fig = link_histogram({"links": {"up": link, "down": link}})
    fig.canvas.draw()
    for panel in fig.axes:
        legend = panel.get_legend()
        assert panel._left_title.get_window_extent().x1 < legend.get_window_extent().x0  # type: ignore[attr-defined]


def test_those_sent_ahead_do_not_hide_the_others() -> None:
    link = measured("delay 40ms 10ms reorder 20%")
    fig = link_histogram({"links": {"up": link}})
    heights, edges = drawn(fig.axes[0])
    assert heights[0] == pytest.approx(link["sent_ahead"])
    assert heights[edges[:-1] > 25.0].sum() == pytest.approx(link["delivered"] - link["sent_ahead"])
    assert fig.axes[0].get_ylim()[1] < 2 * heights[0]


@pytest.mark.long
def test_a_long_tail_gets_a_logarithmic_axis_on_which_bins_are_counts() -> None:
    up = {"profile": "", "delay_histogram_ms": [[0.0, 0], [0.001, 5], [10.0, 0], [11.0, 90], [990.0, 0], [999.0, 2]]}
    fig = link_histogram({"links": {"up": up, "down": None}})
    (panel,) = fig.axes
    assert panel.get_xscale() == "log"
    assert panel.get_title(loc="left") == "uplink: nothing emulated"
    heights, edges = drawn(panel)
    assert heights.tolist() == [5, 0, 90, 0, 2]
    assert edges[1:].tolist() == [0.001, 10.0, 11.0, 990.0, 999.0]
    assert 0.0 < edges[0] < 0.001
    fig.canvas.draw()


@pytest.mark.long
def test_lateness_counts_every_tick_once_and_where_it_was() -> None:
    counted = Histogram()
    late = np.random.default_rng(2).lognormal(10.0, 1.5, 3000).astype(int).tolist()
    for value in late:
        counted.add(value)
    servo = {"late_histogram_us": [[edge / 1e3, count] for edge, count in counted.bins()], "late_p99_us": 700.0}
    fig = lateness_histogram({"device": {"servo": servo}})
    heights, edges = drawn(fig.axes[0])
    expected, _ = np.histogram(np.array(late) * 1e-3, bins=edges)
    assert heights.tolist() == expected.tolist()
    assert heights.sum() == 3000
    assert marks(fig.axes[0]) == {"p99 700 µs": 700.0}
    assert fig.axes[0].get_ylim()[1] > heights.max()
    fig.canvas.draw()


@pytest.mark.parametrize(
    "histogram",
    [None, [], [[1.0, 0]], "x", [[1.0]], [["a", "b"]], [[2.0, 1], [1.0, 1]], [[1.0, -2]], {"a": 1}, [[None, 1]]],
)
def test_what_is_no_histogram_is_not_drawn(histogram: Any) -> None:
    links = {"up": {"delay_histogram_ms": histogram}, "down": {"delay_histogram_ms": histogram}}
    assert link_histogram({"links": links}) is None
    assert lateness_histogram({"device": {"servo": {"late_histogram_us": histogram}}}) is None
    assert link_histogram({}) is None
