"""What holds for ten seconds must hold for as long as somebody holds the device: long runs, seen through windows.

``python -m tests.measure endurance`` prints every figure over the hands 21 to 40, on which nothing was tuned;
``python -m tests.measure endurance --without PART`` takes a part of the design away; test_endurance.py asserts some;
``--scene torus`` (or any text that hapnet takes) puts something else than the wall in front of the hand.
The figures are computed here from recordings, by none of hapnet's metrics.
"""

import statistics
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from hapnet.checks import Array
from hapnet.params import is_tool
from hapnet.recording.samples import Columns, Recording
from hapnet.simulation.simulation import simulate
from hapnet.summary.run import Summary
from tests.support.mesh_runs import ball, boxes
from tests.support.solids import torus, write_stl
from tests.support.undelayed import undelayed

LINKS = {
    "lan": "lan", "wifi": "wifi", "4g": "4g", "leo": "leo", "intercontinental": "wan-intercontinental",
}  # fmt: skip
HANDS = tuple(f"hand-{number}" for number in range(21, 41))
WALL_M, WALL_N_M = 0.02, 3000.0
FIRST_S, LAST_S = 10.0, 60.0
"""The windows: so much after the start, and before the end. What a soft body would have given is known in them only."""

SLOW_MPS, DRAG_MPS, FAST_MPS = 0.05, 0.067, 0.09
"""Drag is measured where the hand moves between the first and the last of these, and given at the one between."""

PARTS: Mapping[str, Mapping[str, object]] = {
    "nothing": {},
    "levels": {"device.shuffle": "harvested", "world.shuffle": "harvested"},
    "yielding": {"contact_model.yields_below": 0.0},
    "stopping": {"contact_model.stop_s": 0.0},
    "reach": {"device.greatest_speed": 1e-3, "contact_model.remembers": False},
    "memory": {"contact_model.remembers": False},
    "all": {
        "device.shuffle": "harvested", "world.shuffle": "harvested", "contact_model.yields_below": 0.0,
        "contact_model.stop_s": 0.0, "contact_model.remembers": False, "device.stiffness": 100.0,
        "device.ceiling_J": 0.05,
    },
}  # fmt: skip
"""What may be taken away, by setting these parameters."""


@dataclass(frozen=True)
class Long:
    """A long run with a generated hand.

    first_mm, last_mm : free motion's error (rms) over the first 10 s and over the last minute. drag_N, drag_p95_N : at
    67 mm/s, mean and 95th percentile. force_error : from the true wall's, rms, in % of that one's peak. contacts : of
    the proxy, per contact of the hand. modulated, modulated_device : in %.
    """

    first_mm: float
    last_mm: float
    drag_N: float
    drag_p95_N: float
    force_error: float
    contacts: float
    modulated: float
    modulated_device: float
    margin_J: float
    slack_J: float
    passive: bool


def long_run(link: str, hand: str, seconds: float, coupling: str, changes: Mapping[str, object]) -> Long:
    """One hand over one link; its seed is its number."""
    names = {"link.up": LINKS[link], "link.down": LINKS[link], "operator": hand, "coupling": coupling}
    result = simulate({**names, "scene": "wall", "duration_s": seconds, **changes}, seed=int(hand.split("-")[1]))
    return figures(result.recording, result.summary)


def figures(recording: Recording, summary: Summary) -> Long:
    """The figures of a recorded run, whichever clock it ran by."""
    device, world = _columns(recording)
    t, x, force = device["time_s"], device["position_m"], device["force_N"]
    proxy = np.stack([np.interp(t, world["time_s"], one) for one in world["position_m"].T], axis=1)
    known = np.ones(len(t), dtype=bool)
    if recording.meta["params"]["scene"] == "wall":
        true_force, touching, near = ideal_force(recording, x), x[:, 0] > WALL_M, x[:, 0] > WALL_M - 1e-3
    else:
        touching, true_force, known = undelayed(recording, ((0.0, FIRST_S), (t[-1] - LAST_S, t[-1])))
        near = touching | ~known
    free, error = known & ~touching, x - proxy
    pressed = (world["penetration_m"] > 0.0) & (np.interp(world["time_s"], t, known) > 0.5)
    drag, drag_p95 = drags(t, x, force, near)
    share = summary["world"]["modulated_share"], summary["device"]["modulated_share"]
    return Long(
        first_mm=1e3 * _rms(error[free & (t < FIRST_S)]),
        last_mm=1e3 * _rms(error[free & (t >= t[-1] - LAST_S)]),
        drag_N=drag,
        drag_p95_N=drag_p95,
        force_error=100.0 * _rms((force - true_force)[known]) / float(np.linalg.norm(true_force, axis=1).max()),
        contacts=visits(pressed) / max(1, visits(touching)),
        modulated=100.0 * (share[0] or 0.0),
        modulated_device=100.0 * (share[1] or 0.0),
        margin_J=float(summary["theorem"]["margin_J"] or 0.0),
        slack_J=min(float(summary[side]["ledger"]["slack_J"] or 0.0) for side in ("device", "world")),
        passive=summary["verdict"]["passive"] is True,
    )


def taps(link: str, start_m: float, speed_mps: float, seconds: float, changes: Mapping[str, object]) -> list[float]:
    """The rendered stiffness in each tenth of a run of taps from afar, in % of what springs and actuator can render.

    start_m : where the hand begins, along the wall's normal. speed_mps : the peak of its minimum-jerk motion, 1.875
    times the way over its duration.
    """
    reach_s = 1.875 * (0.04 - start_m) / speed_mps
    result = simulate(
        {
            "link.up": LINKS[link], "link.down": LINKS[link], "operator": "press", "operator_model.start_m": start_m,
            "operator_model.reach_s": reach_s, "duration_s": seconds, **changes,
        },
        seed=912,
    )  # fmt: skip
    device, _ = _columns(result.recording)
    t, x, force = device["time_s"], device["position_m"][:, 0], device["force_N"][:, 0]
    depth, true_force = np.maximum(x - WALL_M, 0.0), ideal_force(result.recording, x)
    found = []
    for tenth in range(10):
        within = (t >= t[-1] * tenth / 10.0) & (t < t[-1] * (tenth + 1) / 10.0)
        found.append(100.0 * float((force[within] @ depth[within]) / (true_force[within] @ depth[within])))
    return found


def largest_step(link: str, hand: str, stiffness: float, seconds: float, resolution_m: float) -> tuple[float, float]:
    """(the largest change of the force from tick to tick beyond what the spring makes of the device's own way [N], the
    largest change [N]), with this K [N/m].

    A spring K whose other end stands still changes its force by K |dx|. The rest is a step of the set-position.
    """
    result = simulate(
        {
            "link.up": LINKS[link], "link.down": LINKS[link], "operator": hand, "duration_s": seconds,
            "record_hz": 1000.0, "device.stiffness": stiffness, "device.resolution_m": resolution_m,
        },
        seed=int(hand.split("-")[1]),
    )  # fmt: skip
    device, _ = _columns(result.recording)
    changes, ways = np.abs(np.diff(device["force_N"][:, 0])), np.abs(np.diff(device["position_m"][:, 0]))
    return float(np.max(changes - stiffness * ways)), float(changes.max())


def ideal_force(recording: Recording, x: Array) -> Array:
    """What the wall would render at once through the springs, as far as the actuator's spring goes [N]."""
    params = recording.meta["params"]
    device, K, K_world = params["device"], params["device"]["stiffness"], params["world"]["stiffness"]
    felt = 1.0 / (1.0 / K + K_world / (K * WALL_N_M))  # the device's spring, and the wall's scaled by K/K', in series
    limit = device["force_limit_N"] * device["spring_share"] or np.inf
    return -np.minimum(felt * np.maximum(x - WALL_M, 0.0), limit)


def drags(t: Array, x: Array, force: Array, near: Array) -> tuple[float, float]:
    """(drag at 67 mm/s by regression, 95th percentile of the resisting force from 50 to 90 mm/s) [N].

    x, force : (N, n). near : (N,) whether the device is in contact, or less than 1 mm in front of the wall. Both from
    means over a third of a second in which it was not, nor within the 0.3 s before.
    """
    count = round(1.0 / 3.0 / (t[1] - t[0]))
    v = (x[count:] - x[:-count]) / (t[count:] - t[:-count])[:, None]
    total = np.cumsum(force, axis=0)
    mean = (total[count:] - total[:-count]) / count
    free = np.convolve(near, np.ones(2 * count, dtype=int))[count : len(x)] == 0
    squared, power = np.sum(v * v, axis=1), np.sum(mean * v, axis=1)
    speed = np.sqrt(squared)
    moving = free & (speed >= SLOW_MPS) & (speed <= FAST_MPS)
    resisting = -power[moving] / speed[moving]
    return -DRAG_MPS * float(power[free].sum() / squared[free].sum()), float(np.percentile(resisting, 95.0))


def visits(inside: Array) -> int:
    """How often a flag becomes true."""
    return int(np.count_nonzero(inside[1:] & ~inside[:-1])) + int(inside[0])


def _columns(recording: Recording) -> tuple[Columns, Columns]:
    device, world = recording.device, recording.world
    assert device is not None
    assert world is not None
    return device, world


def _rms(values: Array) -> float:
    """Of numbers (N,), or of vectors (N, n)."""
    return float(np.sqrt(np.sum(values * values) / len(values)))


def over_hands(
    link: str,
    hands: Sequence[str],
    seconds: float,
    coupling: str,
    changes: Mapping[str, object],
    pool: ProcessPoolExecutor,
) -> list[Long]:
    """A run a hand."""
    return list(pool.map(partial(_long, link, seconds, coupling, dict(changes)), hands))


def _long(link: str, seconds: float, coupling: str, changes: Mapping[str, object], hand: str) -> Long:
    return long_run(link, hand, seconds, coupling, changes)


def row(runs: Sequence[Long]) -> str:
    """Medians over the hands, and behind a slash the worst hand's, where each has to keep it."""
    shown = [f"{statistics.median(getattr(one, name) for one in runs):.2f}" for name in ("first_mm", "last_mm")]
    shown.append(f"{statistics.median(one.last_mm / one.first_mm for one in runs):.2f}")
    for name, digits in (("drag_N", 3), ("drag_p95_N", 3), ("force_error", 2), ("contacts", 2), ("modulated", 2)):
        values = [getattr(one, name) for one in runs]
        shown.append(f"{statistics.median(values):.{digits}f}/{max(values):.{digits}f}")
    shown.append(f"{max(one.modulated_device for one in runs):.2f}")
    shown.append(f"{sum(one.passive for one in runs)} of {len(runs)}")
    shown.append(f"{min(one.margin_J for one in runs) * 1e3:.1f}")
    shown.append(f"{min(one.slack_J for one in runs):.0e}")
    return " ".join(f"{cell:>{width}}" for cell, width in zip(shown, WIDTHS, strict=True))


COLUMNS = (
    "first mm", "last mm", "ratio", "drag N", "p95 N", "force err. %", "contacts", "modulated %", "device %", "passive",
    "margin mJ", "slack J",
)  # fmt: skip
WIDTHS = (8, 8, 6, 12, 12, 12, 10, 11, 8, 9, 9, 8)
HEADING = f"{'link':17}{'coupling':9}" + " ".join(
    f"{name:>{width}}" for name, width in zip(COLUMNS, WIDTHS, strict=True)
)

_DRAWER = """<mujoco><option timestep="0.002" integrator="implicitfast"/>
<default><geom solref="0.006 1" condim="1" priority="1"/></default>
<worldbody><body pos="0.035 0 0"><joint type="slide" axis="1 0 0" stiffness="1000" damping="{damping}"/>
<geom type="box" size="0.01 0.08 0.08" mass="{mass}"/></body></worldbody></mujoco>"""


def _mesh(file: Path, scene: str) -> dict[str, object]:
    return {"scene": scene.format(file)}


def _ball(directory: Path) -> dict[str, object]:
    """Of 20,480 triangles."""
    return _mesh(write_stl(directory / "ball.stl", *ball(5, 0.03, (0.05, 0.0, 0.0))), "mesh:{}?unit=mm&at=file")


def _torus(directory: Path) -> dict[str, object]:
    """Of 10,000 triangles; the hand slides over the tube, off it, and through the hole."""
    return _mesh(write_stl(directory / "torus.stl", *torus()), "mesh:{}?unit=mm&at=file")


def _bracket(directory: Path) -> dict[str, object]:
    """As CAD programs write one: a base and a rib that overlap, two parts in a file."""
    parts = boxes(((0.04, 0.0, 0.0), (0.04, 0.16, 0.16)), ((0.0, 0.022, 0.0), (0.06, 0.02, 0.12)))
    return _mesh(write_stl(directory / "bracket.stl", *parts), "mesh:{}?unit=mm&at=file&friction=0.2")


def _moving(directory: Path) -> dict[str, object]:
    """A wall that moves by 3 mm within half a second, to and fro, every four seconds for ten minutes."""
    changes = [f"at {2 + 4 * k}s: shift {(-3, 3)[k % 2]}mm over 500ms" for k in range(150)]
    return {"scene": "moving", "world.wall.timeline": "; ".join(changes)}


def _drawer(mass: float, damping: float) -> Callable[[Path], dict[str, object]]:
    def made(directory: Path) -> dict[str, object]:
        """A slab on a spring that the hand pushes in, in MuJoCo; no plane describes it."""
        file = directory / f"drawer-{mass:g}.xml"
        file.write_text(_DRAWER.format(mass=mass, damping=damping))
        return {"scene": f"mujoco:{file}"}

    return made


SCENES: Mapping[str, Callable[[Path], dict[str, object]]] = {
    "ball": _ball, "torus": _torus, "bracket": _bracket, "moving": _moving, "drawer": _drawer(2.0, 30.0),
    "light-drawer": _drawer(0.2, 10.0),
}  # fmt: skip

TAPS = ((0.0, 0.2), (-0.02, 0.4), (-0.05, 0.6), (-0.1, 0.525), (-0.13, 0.8))
"""Where the hand begins [m], and its peak speed [m/s]: 20 to 150 mm from the wall."""


def main(
    seconds: float = 600.0,
    hands: int = len(HANDS),
    links: str = ",".join(LINKS),
    couplings: str = "pspm,zoh",
    without: str = "nothing",
    workers: int = 2,
    only: str = "",
    scene: str = "",
) -> None:
    """hands : how many. without : one of `PARTS`. only : long, taps or steps. scene : long runs with this one only."""
    changes = PARTS[without]
    with ProcessPoolExecutor(workers, get_context("spawn")) as pool, TemporaryDirectory() as directory:
        if scene:
            made = SCENES.get(scene, lambda _: {"scene": scene, "dof": 0 if is_tool(scene) else 3})
            only, changes = "long", made(Path(directory)) | changes
        if only in ("", "long"):
            print(HEADING)
            for line in long_lines(links.split(","), couplings.split(","), HANDS[:hands], seconds, changes, pool):
                print(line, flush=True)
        if only in ("", "taps"):
            print("rendered stiffness in each tenth of 60 s of taps, in % of what springs and actuator can render")
            for link in links.split(","):
                for start_m, speed in TAPS:
                    tenths = taps(link, start_m, speed, 60.0, changes)
                    shown = " ".join(f"{each:4.0f}" for each in tenths)
                    print(f"{link:17}{start_m * 1e3:5.0f} mm, {speed:5.3f} m/s: {shown}", flush=True)
        if only in ("", "steps"):
            print("largest step of the force from tick to tick, 60 s: beyond K times the device's way, and in all [N]")
            for stiffness in (700.0, 1500.0):
                for resolution_m in (0.0, 55e-6):
                    steps = [largest_step("4g", hand, stiffness, 60.0, resolution_m) for hand in hands[:5]]
                    print(f"K {stiffness:.0f} N/m, counts of {resolution_m * 1e6:.0f} um: {max(steps)[0]:.3f}, "
                          f"{max(each for _, each in steps):.3f}")  # fmt: skip


def long_lines(
    links: Sequence[str],
    couplings: Sequence[str],
    hands: Sequence[str],
    seconds: float,
    changes: Mapping[str, object],
    pool: ProcessPoolExecutor,
) -> Iterator[str]:
    """A line a link and coupling."""
    for link in links:
        for coupling in couplings:
            runs = over_hands(link, hands, seconds, coupling, changes, pool)
            yield f"{link:17}{coupling:9}{row(runs)}"
