"""What the plots draw: values held in time, and depths in walls."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("viser", reason="the live page's library is not installed")

from hapnet.ext.page.force import force_now, force_of, parts_of, stacked
from hapnet.ext.page.history import Snapshot, Track
from hapnet.ext.page.plots import Plots, depth_of, held, piled
from hapnet.plant.worlds.registry import make_scene


def test_a_value_is_held_until_the_next() -> None:
    times, values = np.array([-3.0, -1.0]), np.array([5.0, 7.0])
    at = np.array([-4.0, -3.0, -1.1, -1.0, 0.0])
    assert held(times, values, at).tolist() == [5.0, 5.0, 5.0, 7.0, 7.0]


def track(force: list[list[float]], parts: list[list[list[float]]]) -> Track:
    n, count = len(force[0]), len(force)
    still, none = np.zeros((count, n)), np.zeros(count)
    return Track(np.arange(count) - count + 1.0, still, still, np.array(force), np.array(parts), none, none, none)


def test_the_parts_add_up_to_the_force_and_stand_on_each_other() -> None:
    """Spring -1, of which the model is -1.2 and added damping 0.1; damper 0.2."""
    shown = track([[-0.8], [0.0]], [[[-1.0], [0.2], [-1.2], [0.1]], [[math.nan]] * 4])
    parts = stacked(shown)
    np.testing.assert_allclose(parts, [[-1.2, 0.1, 0.1, 0.2], [0.0] * 4], atol=1e-15)
    assert parts[0].sum() == pytest.approx(force_of(shown)[0])
    edges = np.array(piled(parts))[:, 0]
    np.testing.assert_allclose(edges, [0.4, 0.2, 0.1, 0.0, -1.2, -1.2, -1.2, -1.2], atol=1e-15)
    assert [value for _, value in force_now(shown)] == ["0.00 N", *["not known"] * 4]


def test_with_several_axes_the_parts_are_those_along_the_force() -> None:
    shown = track([[3.0, 4.0], [0.0, 0.0]], [[[3.0, 0.0], [0.0, 4.0], [1.0, 0.0], [0.0, 0.0]]] * 2)
    np.testing.assert_allclose(parts_of(shown)[0], [1.8, 3.2, 0.6, 0.0], atol=1e-15)
    assert force_of(shown).tolist() == [5.0, 0.0]
    assert parts_of(shown)[1].tolist() == [0.0] * 4
    assert [value for _, value in force_now(shown)] == ["0.00 N"] * 5
    assert force_now(None) == []


@pytest.mark.parametrize("name", ["wall", "box", "paper", "free"])
def test_depth_is_that_of_the_scenes_walls(name: str) -> None:
    scene = make_scene(name)
    places = np.random.default_rng(3).uniform(-0.06, 0.06, size=(200, scene.dof))
    surfaces = [surface._asdict() for surface in scene.surfaces]
    expected = [max([0.0, *(wall.penetration(tuple(p)) for wall in scene.walls)]) for p in places]
    np.testing.assert_allclose(depth_of(places, surfaces), expected, atol=1e-15)


class Gui:
    """Keeps the plots that it is asked for, by title."""

    def __init__(self) -> None:
        self.plots: dict[str, SimpleNamespace] = {}

    def add_html(self, content: str, visible: bool) -> SimpleNamespace:
        return SimpleNamespace(content=content, visible=visible)

    def add_uplot(self, data: object, series: object, title: str, **more: object) -> SimpleNamespace:
        self.plots[title] = SimpleNamespace(data=data, **more)
        return self.plots[title]


@pytest.mark.parametrize("known", [True, False])
def test_the_depth_of_the_handle_is_drawn_where_it_is_known_else_the_proxys_covers_it(known: bool) -> None:
    """The handle is 7 mm behind a wall at 10 mm, the proxy 1 mm deep in it."""
    gui = Gui()
    device = track([[-1.0]] * 2, [[[math.nan]] * 4] * 2)
    device = replace(device, position_m=np.full((2, 1), 0.017))
    world = replace(device, parts_N=np.zeros((2, 0, 1)), penetration_m=np.full(2, 0.001))
    walls = [{"axis": 0, "position_m": 0.01, "solid": 1}]
    shown = Snapshot(device, world, None, None, True, (), 2)
    Plots(gui, 10.0).update(shown, walls if known else [])  # type: ignore[arg-type]
    *_, of_handle, of_proxy = gui.plots["depth in the wall [mm]"].data
    np.testing.assert_allclose(of_proxy, 1.0, rtol=1e-12)
    np.testing.assert_allclose(of_handle, 7.0 if known else 1.0, rtol=1e-12)


def test_a_plot_is_shown_only_while_there_is_something_in_it() -> None:
    gui, none = Gui(), Snapshot(None, None, None, None, True, (), 0)
    plots = Plots(gui, 10.0)  # type: ignore[arg-type]
    still = track([[-1.0]] * 2, [[[math.nan]] * 4] * 2)
    for snapshot, shown in ((none, False), (replace(none, device=still, world=still), True), (none, False)):
        plots.update(snapshot, [])
        assert {plot.visible for title, plot in gui.plots.items() if "reservoirs" not in title} == {shown}
        assert plots._legend.visible is shown
