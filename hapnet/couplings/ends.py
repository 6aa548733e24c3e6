"""Makes the ends of a coupling from laws, with the stages before them where ``rendering = "hapnet"``
(control/staged.py)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

from hapnet.control.coupling import DeviceCoupling, DeviceLaw, LawServo, LawSteps, WorldCoupling, WorldLaw
from hapnet.control.reporter import Teller
from hapnet.control.staged import StagedDevice, StagedSteps, StagedWorld, Takes
from hapnet.couplings import rendering
from hapnet.couplings.rendering import RenderingTuning
from hapnet.couplings.spec import CouplingStart
from hapnet.params import Params

T = TypeVar("T")
Springs = Callable[[CouplingStart[T]], Params]
"""The parameters in which `device` and `world` have the law's own springs and dampers."""


def held_law(
    law: Callable[[CouplingStart[T]], DeviceLaw],
    *,
    takes: Takes = lambda set_position: set_position,
    springs: Springs[T] = lambda start: start.params,
) -> Callable[[CouplingStart[T]], DeviceCoupling]:
    """Makes the device's end of a coupling from a law that holds its force.

    law : makes it. takes : what the law is given as a set-position, where that is not just the vector.
    springs : says what its spring is, where that is not `device`'s; the stages choose set-positions for that spring.
    """

    def make(start: CouplingStart[T]) -> DeviceCoupling:
        device, made = start.params.device, law(start)
        model = rendering.at_device(_staged(start, springs))
        staged = None if model is None else StagedDevice(made, model, takes)
        return LawServo(
            staged or made,
            period=device.pspm_period_s,
            position=start.position,
            initial_energy=start.initial_energy,
            force_limit=device.force_limit_N or math.inf,
            stamped=None if staged is None else staged.stamped,
        )

    return make


def stepped_law(
    law: Callable[[CouplingStart[T]], WorldLaw],
    *,
    takes: Takes = lambda set_position: set_position,
    springs: Springs[T] = lambda start: start.params,
) -> Callable[[CouplingStart[T]], WorldCoupling]:
    """Makes the world's end of a coupling from a law; the arguments are as those of `held_law`."""

    def make(start: CouplingStart[T]) -> WorldCoupling:
        staged = _staged(start, springs)
        if not staged.tuning.contact_model:
            return LawSteps(law(start), start.initial_energy)
        predicted = rendering.at_world(staged)
        ahead = StagedWorld(law(start), predicted, takes)
        return StagedSteps(ahead, start.initial_energy, Teller(start.position, predicted, *rendering.reach(staged)))

    return make


def _staged(start: CouplingStart[T], springs: Springs[T]) -> CouplingStart[RenderingTuning]:
    """The start of the stages before a law."""
    params = springs(start)
    tuning = rendering.tuned(params) if params.rendering == "hapnet" else RenderingTuning()
    return replace(start, params=params, tuning=tuning)  # type: ignore[arg-type,return-value]
