"""Whole runs with a soft body: over links both halves of the theorem hold, and runs repeat."""

from itertools import product
from pathlib import Path

import numpy as np
import pytest

from hapnet.errors import HapnetError
from hapnet.simulation.simulation import simulate
from tests.conftest import mostly_slow
from tests.measure.soft_figures import LTE, TRACES, felt

SMALL, SOFT = "soft?nodes=216", "soft"
ORGAN = "soft:organ?lump=8&lump_at=-12mm,10mm,0mm&lump_radius=12mm&friction=0.5"


def run(scene: str, link: str, operator: str = "press", seconds: float = 4.0, **given: float) -> dict[str, object]:
    names = {"scene": scene, "operator": operator, "duration_s": seconds, "link.up": link, "link.down": link}
    result = simulate({**names, **given}, seed=1)
    summary = result.summary
    assert summary["verdict"]["passive"]
    for side in ("device", "world"):
        assert summary[side]["ledger"]["slack_J"] >= -1e-9
    assert summary["environment"]["env_slack_J"] >= -1e-12
    return dict(summary["motion"])


@pytest.mark.parametrize(("link", "seconds"), mostly_slow([("4g", 1.5), ("4g", 3.0), ("wifi", 3.0)], 1))
def test_it_is_passive_over_links_and_repeats(link: str, seconds: float) -> None:
    motion = run(SMALL, link, seconds=seconds)
    assert motion["peak_force_N"] > 0.3  # type: ignore[operator]
    if link == "4g":
        assert run(SMALL, link, seconds=seconds) == motion


@pytest.mark.parametrize(
    ("scene", "link", "seconds"),
    mostly_slow(
        [(SOFT, "lte", 2.0), (ORGAN, "4g", 2.0), *product((SOFT, ORGAN), ("lte", "wifi", "4g"), (10.0,))], 0, 2
    ),
)
def test_whole_bodies_are_passive_over_links(scene: str, link: str, seconds: float) -> None:
    if link == "lte":
        link = "delay 35ms 12ms loss gemodel 1% 20% rate 20mbit"
    motion = run(scene, link, "hand-6", seconds)
    assert motion["contacts"] > 0  # type: ignore[operator]


@pytest.mark.parametrize(("link", "seconds"), mostly_slow([("wifi", 2.0), ("wifi", 10.0), ("4g", 10.0)], 0, 1))
def test_a_body_among_solids_is_passive_over_links(link: str, seconds: float) -> None:
    scene = "soft:organ?nodes=216&pin=none + plane?normal=0,0,-1&at=0,0,-30mm&friction=0.4 + plane?at=90mm,0,0"
    motion = run(scene, link, "hand-6", seconds)
    assert motion["contacts"] > 0  # type: ignore[operator]


FLEX = """
<mujoco><option timestep="0.0005" solver="CG"/><worldbody>
  <flexcomp name="soft" type="grid" dim="3" count="5 5 5" spacing=".015 .015 .015" pos=".06 0 0" mass=".216"
    radius=".002"><contact selfcollide="none" solref="0.01 1"/><edge damping="1"/>
    <elasticity young="20000" poisson=".2" damping="{damping}"/><pin gridrange="4 0 0 4 4 4"/></flexcomp>
</worldbody></mujoco>"""


@pytest.mark.slow
def test_mujocos_flex_of_this_material_runs_through_its_world(tmp_path: Path) -> None:
    """Passive, and drawn as it gives way, although MuJoCo makes energy of its own with it: that is damped or undone."""
    pytest.importorskip("mujoco")
    file = tmp_path / "flex.xml"
    file.write_text(FLEX.format(damping=0.0005))
    names = {"scene": f"mujoco:{file}", "operator": "press", "duration_s": 3.0, "link.up": "4g", "link.down": "4g"}
    result = simulate(names, seed=1)
    assert result.summary["verdict"]["passive"]
    for side in ("device", "world"):
        assert result.summary[side]["ledger"]["slack_J"] >= -1e-9
    assert result.summary["environment"]["env_slack_J"] >= -1e-12
    assert result.summary["motion"]["peak_force_N"] > 0.3
    shapes = np.array([sample.vertices() for sample in result.recording.scene])
    assert np.linalg.norm(shapes - shapes[0], axis=-1).max() > 1e-3
    file.write_text(FLEX.format(damping=0.01))
    with pytest.raises(HapnetError, match="diverges by itself"):
        simulate(names, seed=1)


@pytest.mark.parametrize("traces", mostly_slow([(TRACES[:1],), (TRACES,)], 0, 1), ids=["one", "all"])
def test_a_recorded_link_is_passive_and_its_pauses_are_hardly_felt(traces: tuple[str, ...]) -> None:
    """One stands still for most of a second while the hand comes and presses; the force is that without a link."""
    if not LTE.is_dir():
        pytest.skip("the recorded LTE links are not beside the project (../shared/data/links)")
    for _, of_peak, slack_J in felt("soft", "hand-24", traces, 6.0, 0.005).values():
        assert slack_J >= -1e-9
        assert of_peak <= 5.0
