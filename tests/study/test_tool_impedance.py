"""The impedance of a tool that turns, beside that of a rigid body on springs."""

import cmath
import math

import pytest

from hapnet.assembly.build import prepare
from hapnet.errors import InvalidParameter
from hapnet.ext.study.impedance import transmission
from hapnet.ext.study.tool_impedance import motions, path_of
from hapnet.mechanics.pose import ARM_M
from hapnet.params import Params
from tests.conftest import mostly_slow

K, FAR, MASS = 100.0, 500.0, 0.02
SPRINGS: dict[str, object] = {"device.stiffness": K, "world.stiffness": FAR, "world.mass": MASS}
TURN = 2.0 * ARM_M**2
"""Of a spring along the coordinates in N/m, the same in Nm/rad."""

BOX = "tool:box?size=120mm,60mm,40mm"
TABLE = "plane?normal=0,0,-1&at=0,0,-30mm"
KW, BW = 3000.0, 10.0


def truth(scene: str, motion: str, hz: float) -> complex:
    return path_of(prepare(Params().set({**SPRINGS, "scene": scene})), motion).truth(hz)


def in_series(solid: complex, near: float = K, far: float = FAR) -> complex:
    return near * solid / (far + solid)


@pytest.mark.parametrize("hz", mostly_slow([0.5, 6.0, 20.0], 1))
def test_a_free_tool_is_its_mass_and_its_inertia(hz: float) -> None:
    s = 2j * math.pi * hz
    assert truth(BOX, "along-y", hz) == pytest.approx(in_series(MASS * s * s), rel=1e-6)
    about = {  # of a box, m (a^2 + b^2)/12
        "about-x": MASS * (0.06**2 + 0.04**2) / 12.0,
        "about-z": MASS * (0.12**2 + 0.06**2) / 12.0,
    }
    for motion, inertia in about.items():
        assert truth(BOX, motion, hz) == pytest.approx(in_series(inertia * s * s, TURN * K, TURN * FAR), rel=1e-6)


@pytest.mark.parametrize("hz", mostly_slow([6.0, 0.5, 20.0], 0, 1))
def test_a_box_on_a_table_stands_on_its_corners(hz: float) -> None:
    """Four springs and dampers; turned, with their levers, and less by the weight that tips over: - h N."""
    s = 2j * math.pi * hz
    scene = f"{BOX} + {TABLE}"
    assert motions(Params().set({"scene": scene})) == ("along-z", "about-x")
    solid = 4.0 * (KW + BW * s) + MASS * s * s
    assert truth(scene, "along-z", hz) == pytest.approx(in_series(solid), rel=1e-6)
    pressed_N = 0.01 / (1.0 / FAR + 1.0 / (4.0 * KW))
    inertia = MASS * (0.06**2 + 0.04**2) / 12.0
    tipping = 4.0 * 0.03**2 * (KW + BW * s) + inertia * s * s - pressed_N * 0.02
    assert truth(scene, "about-x", hz) == pytest.approx(in_series(tipping, TURN * K, TURN * FAR), rel=1e-3)
    assert truth(scene, "about-z", hz) == pytest.approx(truth(BOX, "about-z", hz), abs=1e-6)


@pytest.mark.parametrize("motion", mostly_slow(["about-y", "along-x"], 0, 1))
def test_a_held_spring_transmits_mass_and_inertia_as_theory_says(motion: str) -> None:
    """``K (1 - H exp(-j w t)) + j w B`` as for a wall, with ``H = K'/(K' + j w B' - M w^2)``; in rotation springs and
    dampers are 2 l^2 of these, and the inertia is that of a box of 40 x 30 x 20 mm about its middle axis."""
    damping = 14.0
    scale, inertia = (TURN, MASS * (0.04**2 + 0.02**2) / 12.0) if motion.startswith("about") else (1.0, MASS)
    quick = {
        "world.step_min_s": 0.002, "world.step_max_s": 0.002, "device.pspm_period_s": 0.001,
        "device.step_limit_N": 0.0, "world.step_limit_N": 0.0, "device.damping": 0.1, "world.damping": damping,
        "rendering": "paper", "coupling": "zoh", "link.up": "delay 20ms", "link.down": "delay 20ms",
    }  # fmt: skip
    found = transmission(Params().set({**SPRINGS, **quick, "scene": "tool:box"}), 1, periods=1, motion=motion)
    assert found.turns == motion.startswith("about")
    for line in found.lines:
        s = 2j * math.pi * line.frequency_hz
        H = scale * FAR / (scale * (FAR + s * damping) + inertia * s * s)
        theory = scale * (K * (1.0 - H * cmath.exp(-s * 0.042)) + 0.1 * s)
        assert line.impedance == pytest.approx(theory, rel=0.03)


def test_another_world_is_refused() -> None:
    with pytest.raises(InvalidParameter, match="a tool among solids"):
        transmission(Params(), 0, 1, "along-z")
    with pytest.raises(InvalidParameter, match="motion"):
        transmission(Params().set({"scene": BOX}), 0, 1, "along-w")
