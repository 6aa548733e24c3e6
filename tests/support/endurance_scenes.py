"""What else than a wall the long runs of `tests.support.endurance` have in front of the hand, by name."""

from collections.abc import Callable, Mapping
from pathlib import Path

from tests.support.mesh_runs import ball, boxes
from tests.support.solids import torus, write_stl

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
