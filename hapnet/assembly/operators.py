"""The hand that the parameter `operator` names: simulated, recorded, or led by the user."""

from __future__ import annotations

import dataclasses
import math
import re
from functools import lru_cache
from math import isfinite
from pathlib import Path

import numpy as np

from hapnet.assembly.device_class import declared_range
from hapnet.assembly.units import LEVER_M
from hapnet.checks import Vector
from hapnet.errors import HapnetError, InvalidParameter
from hapnet.loading import extension, failure, load
from hapnet.params import RELAXED_HAND, Params, is_simulated
from hapnet.plant.generated_hand import GeneratedHand, Tremor
from hapnet.plant.live_hand import LiveHand
from hapnet.plant.natural_hands import Displaced, Strokes, Writing
from hapnet.plant.operating_range import in_millimetres
from hapnet.plant.operator import Followed, HeldAtEnd, Impedance, Operator, Press, Rest, Sine
from hapnet.plant.worlds.protocol import World
from hapnet.recording.hand import is_recording, recorded_hand
from hapnet.recording.motion import read_motion
from hapnet.units import POSE, RADIANS, units_of

GENERATED = 1985
"""Together with a hand's number, the seed of its generator."""

LIVE = "mouse"
"""The operator that the user leads during the run; in real time only."""


_NOT_ANGLES = "and the axes of this scene are angles; choose another operator"

_BLEND_S = 1.0
"""Time in which a recorded hand, or a user's own, comes to rest at the end [s]."""


def operator(params: Params, scene: World) -> Operator:
    """The hand in this scene; a recorded hand, or a user's own, turns a tool itself. Raises InvalidParameter."""
    if scene.units == POSE and not (is_recording(params.operator) or ":" in params.operator):
        motion, point = params.operator_model, extension("tools' worlds").seen_by_the_hand(scene)
        turning: Operator = extension("tools").TurningHand(operator(params, point), motion.turn_rad, motion.turn_hz)
        return turning
    hand = _intending(params, scene)
    amplitude = params.operator_model.tremor_m
    return Tremor(hand, amplitude) if amplitude and not isinstance(hand, LiveHand) else hand


def missing_of_the_hand(params: Params, scene: World) -> tuple[str, ...]:
    """One line if the hand follows a recording of which a part is missing."""
    if not is_simulated(params.hardware) or not is_recording(params.operator):
        return ()
    try:
        hand = _moving(params, scene)
    except HapnetError:
        return ()  # making the hand raises it
    line = hand.missing if isinstance(hand, Followed) else None
    return () if line is None else (f"the operator {line}",)


def _intending(params: Params, scene: World) -> Operator:
    hand = params.operator_model
    moving = _moving(params, scene)
    if not hand.end_hold_s or isinstance(moving, LiveHand | Rest):
        return moving
    # The sine ends as it begins, at rest in its centre; a press ends at its goal, in the wall.
    over_s, at = _BLEND_S, None
    if isinstance(moving, Sine):
        over_s, at = 0.5 / hand.frequency_hz if hand.frequency_hz else _BLEND_S, _rest(scene)
    elif isinstance(moving, Press):
        over_s, at = hand.reach_s, _along(scene, hand.goal_m)
    from_s = params.duration_s - hand.end_hold_s - over_s
    return HeldAtEnd(moving, from_s, over_s, at) if from_s >= hand.end_hold_s else moving


def _along(scene: World, distance: float) -> Vector:
    """The point at this distance from the hand's start, in the direction in which it presses [m]."""
    return tuple([x + distance * n for x, n in zip(_rest(scene), _pressed(scene), strict=True)])


def _rest(scene: World) -> Vector:
    return scene.rest or (0.0,) * scene.dof


def _pressed(scene: World) -> Vector:
    return scene.pressed or (1.0, *(0.0,) * (scene.dof - 1))


def _moving(params: Params, scene: World) -> Operator:
    name, hand, dof = params.operator, params.operator_model, scene.dof
    impedance = Impedance(hand.mass, hand.damping, hand.stiffness)
    reach = declared_range(params.device, dof).reach
    start = _along(scene, hand.start_m)
    if name == LIVE:
        if RADIANS in units_of(scene.units, dof):
            raise InvalidParameter("operator", name, "", why=f"a mouse leads to places in metres, {_NOT_ANGLES}")
        return LiveHand(start, impedance)
    if name == "rest":
        return Rest(dof, impedance, start)
    if name == "sine":
        start_s = hand.start_periods / hand.frequency_hz if hand.frequency_hz else 0.0
        return Sine(dof, impedance, hand.amplitude_m, hand.frequency_hz, _rest(scene), start_s)
    if name == "press":
        goal = _along(scene, hand.goal_m)
        return Press(start, goal, impedance, reach=hand.reach_s, hold=hand.hold_s, wait=hand.wait_s)
    if found := re.fullmatch(r"hand-([1-9]\d{0,8})", name):
        generated = _generated(int(found[1]), _pressed(scene), LEVER_M if params.units == RADIANS else 1.0)
        return Displaced(generated, scene.rest) if any(scene.rest) else generated
    if found := re.fullmatch(r"(strokes|writing)-([1-9]\d{0,8})", name):
        if RADIANS in units_of(scene.units, dof):
            raise InvalidParameter("operator", name, "", why=f"this hand moves to places in metres, {_NOT_ANGLES}")
        natural = _natural(found[1], int(found[2]), dof, impedance)
        return Displaced(natural, scene.rest) if any(scene.rest) else natural
    if is_recording(name):
        return recorded_hand(name, dof, impedance, reach)
    if name.endswith(".csv") or Path(name).exists():
        depths = {"press_depth": hand.press_depth_m, "hover": hand.hover_m}
        return read_motion(name, dof, impedance, **depths, reach=reach, columns=hand.columns)
    return UserOperator(name, dof, impedance, reach)


@lru_cache
def _generated(number: int, normal: Vector, lever: float) -> GeneratedHand:
    """The generated hand with this number; for joints, scaled by this lever [m]."""
    square = lever * lever
    loose = (RELAXED_HAND[f"operator_model.{part}"] for part in ("mass", "damping", "stiffness"))
    impedances = [Impedance(*[square * part for part in hand]) for hand in (loose, dataclasses.astuple(Impedance()))]
    rng = np.random.default_rng([number, GENERATED])
    return GeneratedHand(rng, normal, impedances[0], impedances[1], 1.0 / lever)


@lru_cache
def _natural(kind: str, number: int, dof: int, impedance: Impedance) -> Strokes | Writing:
    """The hand of this kind with this number; its strokes are fast."""
    rng = np.random.default_rng(number)
    if kind == "writing":
        return Writing(dof, impedance, rng)
    return Strokes(dof, impedance, rng, touches=0.5, slides=0.0, slowest=0.3, fastest=0.9)


ALLOWED = (
    "rest, sine, press, hand-N (N from 1), strokes-N, writing-N, a recording's path (.csv, .mcap), or module:Class "
    "taking dof and impedance"
)


class UserOperator:
    """The operator `name`, made with ``dof`` and ``impedance``; its reference is checked once.

    Later errors become one HapnetError that names the operator: any error that it raises, and a reference that has not
    as many finite numbers as the first, or is farther than `reach` [m] from the origin.

    Raises InvalidParameter: the operator cannot be made, has no impedance, or its first reference is not valid.
    """

    def __init__(self, name: str, dof: int, impedance: Impedance, reach: float = math.inf) -> None:
        self.name: str = name
        self._reach = reach
        make = load("operator", name, ALLOWED, ("rest", "sine", "press"))
        try:
            self._operator: Operator = make(dof=dof, impedance=impedance)
            self._axes = len(self._operator.reference(0.0))
        except BaseException as error:  # see `loading.failure`
            raise InvalidParameter("operator", name, f"{ALLOWED} ({failure(error)})") from error
        if not isinstance(getattr(self._operator, "impedance", None), Impedance):
            raise InvalidParameter("operator", name, f"{ALLOWED}; the made object has no impedance")
        self.impedance: Impedance = self._operator.impedance
        try:
            self.reference(0.0)
        except HapnetError as error:
            raise InvalidParameter("operator", name, f"{ALLOWED} ({error})") from error

    def reference(self, t: float) -> Vector:
        """x_d [m] at `t` [s]; HapnetError if the operator fails."""
        try:
            x = tuple(map(float, self._operator.reference(t)))
        except BaseException as error:  # see `loading.failure`
            raise HapnetError(f"the operator {self.name} failed: reference({t:g}) raised {failure(error)}") from error
        if len(x) != self._axes or not isfinite(sum(x)):
            wanted = f"{self._axes} finite numbers"
            raise HapnetError(f"the operator {self.name} failed: reference({t:g}) gave {x} instead of {wanted}")
        if (far := math.hypot(*x)) > self._reach:
            wanted = f"a place within the {self._reach:g} m that the device reaches (device.workspace_m)"
            hint = in_millimetres(far, self._reach)
            raise HapnetError(f"the operator {self.name} failed: reference({t:g}) gave {x} instead of {wanted}{hint}")
        return x
