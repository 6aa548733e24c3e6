"""The stiffest stable K of a simulated device (`device.stiffness`), beside the bound from theory.

J. E. Colgate and G. Schenkel (Passivity of a class of sampled-data systems, 1997): a device with own damping b renders
a spring K and a damper B, held for T, passively if ``b > K T/2 + B``. So no hand can make it oscillate while
``K < 2 (b - B) / T``. Above that some hands can; without a hand the device is stable up to about ``2 (b + B) / T``.

K is found by trials. A hand that is only a spring, without damping or mass, presses the device with about a newton
into an ideal wall: stiff, damped, without a link, in a world of 1 kHz. The hand then holds still. `JUDGED` states the
criterion. With encoders an oscillation of one count may continue for ever; its force is K times the count.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from hapnet.assembly.build import Setup
from hapnet.assembly.choices import before_scene, choosing
from hapnet.couplings.registry import ideal_stiffness
from hapnet.couplings.stiffness import colgate_bound
from hapnet.errors import InvalidParameter
from hapnet.ext.metrics.force import limit_cycles
from hapnet.ext.pictures.impedance import Springs, stable_springs
from hapnet.ext.study.z_width import ZWidth, maximum
from hapnet.params import Params, is_arm
from hapnet.plant.worlds.walls import Wall
from hapnet.recording.samples import Recording
from hapnet.simulation.simulation import Simulation

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COUPLINGS = ("pspm", "zoh")
SERVO_HZ = (500.0, 1000.0, 4000.0)
OWN_DAMPING = (0.1, 0.3, 1.0)
ENCODERS_M = (0.0, 55e-6)
"""Resolution of the encoders [m]: exact positions, and the Phantom Omni."""

MINIMUM, MOST, RATIO = 10.0, 1e5, 1.03
"""The range of the search [N/m], and the ratio of the two bounds at its end."""

HELD_S = 8.0
RENDERED = 0.9
"""A wall rendered with a smaller share of its stiffness counts as lost, as without force nothing oscillates."""

JUDGED = (
    "stable: in the eighth second after the hand has stopped, the force oscillates by less than 0.02 N (rms), or less "
    "than half of its oscillation six seconds before; and at least 90 % of the wall's stiffness is rendered"
)

_IDEAL: dict[str, object] = {
    "scene": "wall", "dof": 1, "link.up": "", "link.down": "", "world.step_min_s": 1e-3, "world.step_max_s": 1e-3,
    "world.wall.stiffness": 1e5, "world.wall.damping": 1e3, "world.wall.position_m": 0.02, "device.servo": "sampled",
    "operator": "press", "operator_model.mass": 0.0, "operator_model.damping": 0.0, "operator_model.stiffness": 135.0,
    "operator_model.tremor_m": 0.0, "operator_model.start_m": 0.0, "operator_model.goal_m": 0.028,
    "operator_model.wait_s": 0.1, "operator_model.reach_s": 0.7, "operator_model.hold_s": HELD_S + 0.1,
    "operator_model.end_hold_s": 0.0, "duration_s": HELD_S + 0.9,
}  # fmt: skip


class StiffnessCase(NamedTuple):
    """A search for the stiffest stable K: coupling, servo rate [Hz], own damping b [Ns/m], encoders' resolution [m]."""

    coupling: str
    servo_hz: float
    own_damping: float
    resolution_m: float

    def of(self, params: Params) -> Params:
        """`params` with the values of this case."""
        return params.set({
            "coupling": self.coupling, "device.servo_hz": self.servo_hz, "device.own_damping": self.own_damping,
            "device.resolution_m": self.resolution_m,
        })  # fmt: skip

    @property
    def column(self) -> str:
        """Coupling and encoders, as text."""
        return f"{self.coupling}, {self.resolution_m * 1e6:g} µm" if self.resolution_m else f"{self.coupling}, exact"


def cases(params: Params) -> list[StiffnessCase]:
    """Both couplings, with and without encoders, over servo rates and own dampings, including those of `params`.

    An arm has only the damping of its links.

    Raises InvalidParameter: the device's B is not a number, so that there is no bound.
    """
    device = choosing(params, *before_scene(params)).device
    dampings = {device.own_damping} if is_arm(params.hardware) else {*OWN_DAMPING, device.own_damping}
    bound(1.0, 1.0, device.damping)
    return [
        StiffnessCase(coupling, hz, b, resolution)
        for hz in sorted({*SERVO_HZ, device.servo_hz})
        for b in sorted(dampings)
        for coupling in COUPLINGS
        for resolution in ENCODERS_M
    ]


def bound(own_damping: float, servo_hz: float, damping: object) -> float:
    """``2 (b - B) / T`` [N/m]; 0 if the device's own damping is not above B. InvalidParameter if B is not a number."""
    if not isinstance(damping, float):
        raise InvalidParameter("device.damping", damping, "a number, to compute the stiffest passive spring")
    return max(0.0, colgate_bound(own_damping, damping, servo_hz))


def stiffest(params: Params, ratio: float = RATIO) -> ZWidth:
    """The stiffest stable K, and the smallest tried unstable K [N/m], within a factor of `ratio`.

    Hand, world, link and duration are set here. This assumes that a spring is stable if a stiffer spring is.

    Raises HapnetError: the parameters do not make a run.
    """
    return maximum(lambda K: stable(params.set({"device.stiffness": K})), MINIMUM, MOST, ratio)


def stable(params: Params) -> bool:
    """Whether the force comes to rest at an ideal wall, and the wall is still rendered. See `JUDGED`."""
    simulation = Simulation(params.set({**_IDEAL, "record_hz": params.device.servo_hz}), 0)
    recording = simulation.run().recording
    return not limit_cycles(recording, HELD_S) and _rendered(recording, simulation.setup) >= RENDERED


def _rendered(recording: Recording, setup: Setup) -> float:
    """The share of the wall's stiffness that is rendered in the last second."""
    assert recording.device is not None, "a simulated run has both sides"
    device, (wall,) = recording.device, setup.scene.walls
    assert isinstance(wall, Wall)
    last = device["time_s"] >= device["time_s"][-1] - 1.0
    depth = float(np.mean(device["position_m"][last, 0])) - wall.offset
    force = -float(np.mean(device["force_N"][last, 0]))
    return force / depth / ideal_stiffness(setup.params, wall.stiffness) if depth > 0.0 else 0.0


# -- Output -----------------------------------------------------------------------------------------------------------


def as_dict(found: Mapping[StiffnessCase, ZWidth], params: Params) -> dict[str, Any]:
    """The results for JSON [N/m]; `stable` is the stiffest stable K, `unstable` the smallest tried unstable K."""
    return {
        "judged": JUDGED,
        "searches": [
            {
                **case._asdict(),
                "bound_N_per_m": bound(case.own_damping, case.servo_hz, params.device.damping),
                "stable_N_per_m": width.free,
                "unstable_N_per_m": width.cycles,
            }
            for case, width in found.items()
        ],
    }


def drawn(found: Mapping[StiffnessCase, ZWidth], params: Params) -> Figure:
    """The stiffest stable K over the device's own damping, beside the bound from theory."""
    B = params.device.damping
    assert isinstance(B, float), "else `cases` refuses it"
    springs = [
        Springs(
            column,
            hz,
            {
                case.own_damping: width.free
                for case, width in found.items()
                if (case.servo_hz, case.column) == (hz, column) and width.free is not None
            },
            "ox"[COUPLINGS.index(coupling)] + (":" if resolution_m else "-"),
        )
        for hz, column, coupling, resolution_m in dict.fromkeys(
            (case.servo_hz, case.column, case.coupling, case.resolution_m) for case in found
        )
    ]
    most = max(case.own_damping for case in found)
    return stable_springs(springs, lambda b, hz: bound(b, hz, B), (B, most))
