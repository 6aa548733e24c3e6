"""The figure of a run: what is drawn of it, and what its title says."""

import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import imread

from hapnet.errors import RecordingError
from hapnet.ext.pictures.run import figure
from hapnet.ext.pictures.style import save_figure
from hapnet.recording.samples import DeviceSample, Event, MemoryRecorder, Recording, WorldSample
from tests.conftest import mostly_slow

TORN = "the device's recording is incomplete: the rest of its account is missing"
LINK = "delay 40ms 10ms distribution normal loss 2%"


def run(n: int = 1, sides: str = "device world", scene: str = "wall", seconds: int = 4) -> Recording:
    """A hand that presses along the last axis, 20 mm deep at most, and circles along the others."""
    meta = {"origin_ns": 0, "seed": 3, "coupling": "pspm", "params": {"scene": scene}, "links": {"up": LINK}}
    recorder = MemoryRecorder(meta)

    def hand(t: float) -> tuple[float, ...]:
        return (0.02 * math.cos(3 * t), 0.015 * math.sin(5 * t), 0.03 * math.sin(2 * t))[3 - n :]

    for i in range(seconds * 200 if "device" in sides else 0):
        x = hand(i / 200)
        force = tuple(-30 * a for a in x)
        recorder.write(DeviceSample(i * 5_000_000, x, x, x, force, None, 0.05, 0, 0, 0, 0, 0.05 + 1e-5 * i, 0.0))
    for i in range(seconds * 30 if "world" in sides else 0):
        x = hand(i / 30)
        depth = x[-1] - 0.02
        contact = (*(0.0 for _ in x[1:]), -300 * max(0.0, depth))
        recorder.write(WorldSample(i * 33_333_333, 1 / 30, x, x, x, x, x, contact, depth, 0.04, 0, 0, 0, 0.03, 0.0))
    return recorder.recording()


def lines(panel: Axes) -> dict[str, Any]:
    return {str(line.get_label()): line for line in panel.get_lines() if not str(line.get_label()).startswith("_")}


def test_four_panels_with_units_and_styles_that_differ_without_colour() -> None:
    fig = figure(run())
    position, force, reservoir, margin = fig.axes
    labels = [panel.get_ylabel() for panel in fig.axes]
    assert labels == ["position [mm]", "force [N]", "reservoir [mJ]", "passivity margin [mJ]"]
    assert margin.get_xlabel() == "time [s]"
    assert all(panel.get_shared_x_axes().joined(panel, position) for panel in (force, reservoir, margin))
    assert set(lines(position)) == {"device", "proxy", "device's set-position (modulated)"}
    for panel in fig.axes:
        drawn = lines(panel).values()
        assert len({line.get_linestyle() + str(line._unscaled_dash_pattern) for line in drawn}) == len(drawn)
    assert lines(force)["coupling on the device"].get_ydata()[20] == pytest.approx(
        -30 * 0.03 * math.sin(0.2), rel=1e-12
    )
    assert lines(margin)["sum"].get_ydata()[0] == pytest.approx(80.0, rel=1e-12)
    assert lines(reservoir)["world"].get_ydata()[0] == pytest.approx(40.0, rel=1e-12)
    assert margin.get_ylim()[0] < 0


def test_print_size_and_legends_clear_of_the_data(tmp_path: Path) -> None:
    fig = figure(run(3, scene="paper"))
    assert fig.get_figwidth() == pytest.approx(180 / 25.4)
    fig.canvas.draw()
    for panel in fig.axes:
        legend = panel.get_legend()
        box, frame = legend.get_window_extent(), panel.get_window_extent()
        assert box.y0 >= frame.y1
        assert box.x1 <= fig.bbox.x1
        texts = [panel.yaxis.label, panel.xaxis.label, *legend.get_texts(), *panel.get_xticklabels()]
        assert min(float(text.get_fontsize()) for text in texts) >= 8
    save_figure(fig, tmp_path / "run.png")
    image = imread(tmp_path / "run.png")
    assert image.shape[1] == pytest.approx(180 / 25.4 * 150, abs=1)
    assert [p.name for p in tmp_path.iterdir()] == ["run.png"]


@pytest.mark.parametrize("n", mostly_slow([3, 1, 2], 1))
@pytest.mark.parametrize("sides", mostly_slow(["device", "world", "device world", ""], 1))
def test_any_dimension_and_either_side_alone(n: int, sides: str) -> None:
    fig = figure(run(n, sides))
    assert len(fig.axes) == (5 if n > 1 and sides else 4)
    fig.canvas.draw()


def test_the_axis_of_contact_and_the_path_across_it() -> None:
    fig = figure(run(3))
    assert fig.axes[0].get_ylabel() == "position along z [mm]"
    assert (fig.axes[4].get_xlabel(), fig.axes[4].get_ylabel()) == ("x [mm]", "y [mm]")
    assert set(lines(fig.axes[4])) == {"device", "proxy"}
    ink = lines(figure(run(3, scene="paper")).axes[4])["proxy, where it touched"].get_ydata()
    world = run(3).world
    np.testing.assert_array_equal(np.isnan(ink), world["penetration_m"] <= 0)


@pytest.mark.slow
def test_a_long_run_keeps_its_extremes() -> None:
    recording = run(seconds=300)
    recording.device["force_N"][7001] = 99.0
    drawn = lines(figure(recording).axes[1])["coupling on the device"]
    assert len(drawn.get_ydata()) <= 20_002 < len(recording.device["time_s"])
    assert max(drawn.get_ydata()) == 99.0
    assert drawn.get_xdata()[0] == 0.0
    assert drawn.get_xdata()[-1] == recording.device["time_s"][-1]


def shaded(panel: Axes) -> list[tuple[float, float]]:
    """From when to when the silences are."""
    spans = [patch.get_extents().transformed(panel.transData.inverted()) for patch in panel.patches]
    hatched = [patch.get_hatch() for patch in panel.patches]
    return [(float(s.x0), float(s.x1)) for s, hatch in zip(spans, hatched, strict=True) if hatch == ".."]


def test_silences_are_shaded_each_from_its_notice_to_its_end() -> None:
    """Those of both sides overlap; the second of the device's ends with the recording; an end without begin is none."""
    texts = (
        (0.1, "heard", "data from the world again after 0.6 s"),
        (1.0, "silent", "no data from the world for 0.5 s; holding its last position"),
        (1.2, "silent", "no data from the device for 0.51 s; holding its last position"),
        (1.5, "heard", "data from the world again after 1 s, 40 ms after its first message; 9 positions are missing"),
        (1.9, "paired", "paired with the device (another process; pair 2)"),
        (2.0, "overrun", "the servo stalled for 30.1 ms (machine too busy): no force until it is on time again"),
        (3.0, "silent", "no data from the world for 0.5 s; releasing the spring"),
    )
    recording = run()
    recording.events.extend(Event(round(at * 1e9), kind, text) for at, kind, text in texts)
    fig = figure(recording)
    end = recording.device["time_s"][-1]
    for panel in fig.axes:
        assert shaded(panel) == [pytest.approx(s) for s in ((1.0, 1.5), (1.2, 1.9), (3.0, end))]
    legend = fig.axes[0].get_legend()
    assert [text.get_text() for text in legend.get_texts()].count("silence") == 1
    assert not shaded(figure(run()).axes[0])


def test_gaps_do_not_hide_extremes_and_a_single_sample_shows() -> None:
    recording = run(seconds=60)
    recording.device["force_N"][7001] = 99.0
    recording.device["force_N"][7002] = math.nan
    drawn = lines(figure(recording).axes[1])["coupling on the device"]
    assert np.nanmax(drawn.get_ydata()) == 99.0
    alone = Recording(recording.meta, {k: v[:1] for k, v in recording.device.items()}, None, [], None)
    assert lines(figure(alone).axes[0])["device"].get_marker() == "."


def title(fig: Figure) -> str:
    return fig.get_suptitle()


def test_the_title_tells_the_link_the_coupling_the_seed_and_the_verdict() -> None:
    torn = title(figure(run())).splitlines()
    assert torn[0] == f"uplink: {LINK}, coupling pspm, seed 3"
    assert torn[1].startswith(f"PASSIVITY NOT KNOWN: {TORN}")
    summary = {
        "links": {"up": {"profile": "lan"}, "down": {"profile": "lan"}},
        "coupling": "zoh",
        "seed": 8,
        "theorem": {"margin_J": -0.0125, "bound_J": 0.1, "energy_out_J": 0.1125, "margin_end_J": 0.3},
    }
    recording = run()
    reported = Recording(recording.meta, recording.device, recording.world, [], summary)
    why = "gave out 112.5 mJ, more than the 100 mJ allowed"
    assert title(figure(reported)) == f"link: lan, coupling zoh, seed 8\nNOT PASSIVE: {why}"
    assert "sum (112.5 mJ came out, 300 mJ at the end)" in lines(figure(reported).axes[-1])


def test_a_set_position_is_called_modulated_only_where_it_is() -> None:
    plain = run()
    plain.meta["coupling"] = "zoh"
    assert set(lines(figure(plain).axes[0])) == {"device", "proxy", "device's set-position (as received)"}


def of(coupling: str, sides: str = "device world") -> Recording:
    recording = run(sides=sides)
    recording.meta["coupling"] = coupling
    return recording


@pytest.mark.parametrize("coupling", ["zoh", "pd", "wave"])
def test_only_what_has_reservoirs_shows_them(coupling: str) -> None:
    assert [panel.get_ylabel() for panel in figure(of(coupling)).axes] == [
        "position [mm]", "force [N]", "passivity margin [mJ]",
    ]  # fmt: skip
    assert len(figure(of("one that is unknown")).axes) == 4


def test_of_ports_that_are_passive_together_only_their_sum_is_drawn() -> None:
    """One alone may go below 0, which is no fault: no red there, and no verdict."""
    assert set(lines(figure(of("wave")).axes[-1])) == {"sum"}
    alone = figure(of("wave", "device"))
    assert set(lines(alone.axes[-1])) == {"device's port"}
    assert alone.axes[-1].get_ylabel() == "energy put in + d² [mJ]"
    assert not alone.axes[-1].patches
    assert "only at both ports together" in " ".join(title(alone).split())


def test_a_long_title_is_not_broken_inside_a_setting() -> None:
    recording = run()
    link = "delay 500ms 100ms 25% distribution paretonormal loss gemodel 5% 15% 100% 0% rate 1mbit"
    meta = {**recording.meta, "links": {"up": link, "down": link}}
    reported = title(figure(Recording(meta, recording.device, recording.world, [], None)))
    assert "coupling pspm" in reported
    assert "seed 3" in reported
    assert max(map(len, reported.splitlines())) <= 100


def test_a_path_that_nobody_moved_along_is_not_drawn() -> None:
    """The scene `paper` has its path across z in any case, but for a hand that only presses."""
    recording = run(3, scene="paper")
    for columns in (recording.device, recording.world):
        columns["position_m"][:, :2] = 0.0
    assert len(figure(recording).axes) == 4


def test_a_figure_that_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"cannot write figure .*a\.png: No such file"):
        save_figure(figure(run(seconds=1)), tmp_path / "no" / "a.png")


def test_a_figure_needs_no_pyplot() -> None:
    code = (
        "import sys; from tests.plots.test_run import figure, run; "
        "figure(run(seconds=1)); print('matplotlib.pyplot' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
