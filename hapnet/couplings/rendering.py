"""The rendering of set-position couplings: the stages before PSPM, and the rule for each of their numbers.

``rendering = "paper"``: the newest set-position goes to PSPM unchanged, every `device.pspm_period_s`.
``rendering = "hapnet"``: the rules below; ``rendering = "auto"``: either, depending on the law. The stages only choose
y or add dissipation, so Theorem 1 holds with both.

| what | rule | source |
|---|---|---|
| damping b, added in free motion | 2 zeta sqrt(K m) - B, zeta = `contact_model.damping_ratio` | critical at zeta = 1 |
| PSPM | at every tick, harvest measured; positions are sent every `device.pspm_period_s` | minimum delay |
| lead | g K^-1 (B + b) v, g = `contact_model.lead`: a part of the drag is cancelled in free motion | (2) |
| the world's prediction | age of the sample + B'/K' + T/2, T the mean step | lag of the integrator on a ramp |
| trust | the share of the predicted travel that has proved right | least squares, prediction.py |
| in free space | the proxy is carried: no spring, no energy | carrying.py |
| behind a plane | predicted motion v t shrinks to v t/(1 + t/tau), tau = `contact_model.stop_s` | a wall stops a hand |
| planes sent | within `contact_model.reach_m` + `device.greatest_speed` times (round trip + step) | (below) |
| planes kept | until an answer that covers their place no longer contains them | a wall mostly stands still |
| a tool in contact | y is near the tool, and the hand's motion is not predicted | set_position_steps.py |
| the lead yields | below the level `contact_model.yields_below` of the world's reservoir, over 3 s | (below) |

A world that cannot send planes is felt through its delayed proxy, with `contact_model.delayed_stiffness` at most (100
N/m): a stiffer spring rings.
A plane must be sent before a hand of any speed reaches it. If the world's reservoir stays low for seconds, the hand
pays for the energy that the walls dissipate: the lead shrinks in proportion. In contact the hand feels only the wall.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from hapnet import checks
from hapnet.checks import Array
from hapnet.control.added_damping import AddedDamping
from hapnet.control.contact_model import ContactModel
from hapnet.control.predicted_device import PredictedDevice
from hapnet.control.prediction import MotionPredictor
from hapnet.control.self_motion import SelfMotion
from hapnet.control.set_position_steps import ToolInContact
from hapnet.couplings.link_delays import Delays
from hapnet.couplings.spec import RENDERED_DAMPING, Between, CouplingStart
from hapnet.params import Params
from hapnet.units import POSE_AXES

SEARCHED: Mapping[str, Between | tuple[Any, ...]] = {
    "contact_model.damping_ratio": Between(0.05, 1.0, log=True),
    "contact_model.lead": Between(0.0, 1.0),
    "contact_model.lead_s": Between(0.01, 0.2, log=True),
    "contact_model.fade_s": Between(0.002, 0.05, log=True),
    "contact_model.shift_s": Between(0.01, 0.2, log=True),
    "contact_model.window_s": Between(0.02, 0.2, log=True),
    "contact_model.longest_s": Between(0.05, 0.4, log=True),
    "contact_model.curve_s": Between(0.0, 0.2),
    "contact_model.stop_s": Between(0.005, 0.1, log=True),
}
"""`CouplingSpec.searched` of both couplings with this rendering."""

STRETCHED = 1.5
"""The stretch of a world's spring to a tool in contact, beside that at which the device's saturates: it also slides."""

PREDICT_S = (
    "the world predicts the device if delay and lag are at most this [s]; 0, or with the paper's rendering: never"
)
"""The help of a law's parameter for `predicts`."""


@dataclass(frozen=True)
class RenderingTuning:
    """The tuning of the contact model.

    contact_model : whether the device computes y from the planes that the world sends; if not, the other fields are 0.
    lag_s : B'/K'. damping_Ns_m : b. lead_s : factor of the velocity in y. reach_m : planes up to this far are sent.
    reach_speed_mps : so are planes that a device of this speed could reach before it receives them.
    """

    contact_model: bool = False
    lag_s: float = 0.0
    damping_Ns_m: float = 0.0
    lead_s: float = 0.0
    reach_m: float = 0.0
    reach_speed_mps: float = 0.0


def tune(params: Params, link: Delays) -> RenderingTuning:
    """The tuning of the laws that have these stages by default."""
    return RenderingTuning(contact_model=False) if params.rendering == "paper" else tuned(params)


def tuned(params: Params) -> RenderingTuning:
    """The tuning by the rules in the table above."""
    device = params.device
    wanted = 2.0 * params.contact_model.damping_ratio * math.sqrt(largest(device.stiffness) * device.mass)
    added = min(max(0.0, wanted - largest(device.damping)), RENDERED_DAMPING)
    return RenderingTuning(
        contact_model=True,
        lag_s=lag_s(params),
        damping_Ns_m=added,
        lead_s=params.contact_model.lead * (largest(device.damping) + added) / _smallest(device.stiffness),
        reach_m=params.contact_model.reach_m,
        reach_speed_mps=device.greatest_speed,
    )


def at_device(start: CouplingStart[RenderingTuning]) -> ContactModel | None:
    """Return the model that computes the device's y; None: y is the newest set-position."""
    if not start.tuning.contact_model:
        return None
    dof, b = len(start.position), start.tuning.damping_Ns_m
    stiffness = checks.spd("world.stiffness", start.params.world.stiffness, dof)
    K = checks.spd("device.stiffness", start.params.device.stiffness, dof)
    B = np.diag(checks.diagonal("device.damping", start.params.device.damping, dof)) + b * np.eye(dof)
    model = start.params.contact_model
    lead = model.lead * np.linalg.solve(K, B)
    return ContactModel(
        start.position,
        compliance=np.linalg.inv(stiffness).tolist(),
        lead=lead.tolist(),
        self_motion=SelfMotion(),
        added=AddedDamping(K.tolist(), np.linalg.inv(K).tolist(), b, RENDERED_DAMPING),
        lead_s=model.lead_s,
        fade_s=model.fade_s,
        shift_s=model.shift_s,
        yields_below=model.yields_below,
        remembers=model.remembers,
        share_without_planes=share_without_planes(start.params),
    )


def share_without_planes(params: Params) -> float:
    """The share of the device's stiffness with which a world that cannot send planes is felt."""
    return min(1.0, params.contact_model.delayed_stiffness / largest(params.device.stiffness))


def reach(start: CouplingStart[RenderingTuning]) -> tuple[float, float]:
    """The distance within which planes are sent [m], and the speed of the device that extends it [m/s]."""
    return start.tuning.reach_m, start.tuning.reach_speed_mps


def in_contact(start: CouplingStart[Any]) -> ToolInContact | None:
    """Return what limits the world's y while a tool touches something; None: the proxy is a point."""
    if len(start.position) != POSE_AXES:
        return None
    force_N, stiffness = start.params.device.spring_limit_N, _smallest(start.params.device.stiffness)
    return ToolInContact(STRETCHED * force_N / stiffness if force_N else math.inf)


def at_world(start: CouplingStart[Any]) -> PredictedDevice:
    """Return the predictor that computes the world's y, for laws that do not use the newest set-position."""
    params = start.params
    return PredictedDevice(start.position, lag_s(params), predictor(params), params.contact_model.stop_s)


def predicts(params: Params, link: Delays, longest_s: float) -> bool:
    """Whether the world predicts the device for a law at the device: if no prediction is longer than `longest_s`."""
    horizon_s = link.one_way_s + lag_s(params) + params.world.step_max_s / 2.0
    return params.rendering != "paper" and horizon_s <= longest_s


def predictor(params: Params) -> MotionPredictor:
    """The predictor of motion from the positions that arrive."""
    model = params.contact_model
    return MotionPredictor(model.window_s, model.longest_s, model.curve_s)


def lag_s(params: Params) -> float:
    """B'/K' [s]."""
    return largest(params.world.damping) / _smallest(params.world.stiffness)


def _eigenvalues(matrix: object) -> Array:
    values = np.asarray(matrix, dtype=float)
    return np.linalg.eigvalsh(values) if values.ndim == 2 else np.ravel(values)


def largest(matrix: object) -> float:
    """The largest eigenvalue; `matrix` is a number, one number for each axis, or a matrix."""
    return float(np.max(_eigenvalues(matrix)))


def _smallest(matrix: object) -> float:
    return float(np.min(_eigenvalues(matrix)))
