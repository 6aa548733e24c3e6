"""Makes the ends of a coupling from laws; with ``rendering = "hapnet"`` the stages precede them (control/staged.py)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

from hapnet.control.coupling import DeviceCoupling, DeviceLaw, LawServo, LawSteps, WorldCoupling, WorldLaw
from hapnet.control.reporter import SampleReporter
from hapnet.control.staged import StagedDevice, StagedSteps, StagedWorld, Takes
from hapnet.couplings import rendering
from hapnet.couplings.rendering import RenderingTuning
from hapnet.couplings.spec import CouplingStart
from hapnet.params import Params

T = TypeVar("T")
Springs = Callable[[CouplingStart[T]], Params]
"""Returns parameters in which `device` and `world` have the law's own springs and dampers."""


def held_law(
    law: Callable[[CouplingStart[T]], DeviceLaw],
    *,
    takes: Takes = lambda set_position: set_position,
    springs: Springs[T] = lambda start: start.params,
) -> Callable[[CouplingStart[T]], DeviceCoupling]:
    """Makes the device's end of a coupling from a law that holds its force.

    law : makes the law. takes : converts a set-position for the law, if the law does not take the plain vector.
    springs : returns the law's spring, if it is not `device`'s; the stages choose set-positions for that spring.
    """

    def make(start: CouplingStart[T]) -> DeviceCoupling:
        device, device_law = start.params.device, law(start)
        model = rendering.at_device(_staged(start, springs))
        staged = None if model is None else StagedDevice(device_law, model, takes)
        return LawServo(
            staged or device_law,
            period=device.pspm_period_s,
            position=start.position,
            initial_energy=start.initial_energy,
            force_limit=device.force_limit_N or math.inf,
            step_limit=device.step_limit_N or math.inf,
            stiffness=rendering.largest(device.stiffness),
            speed=device.greatest_speed,
            inertia=device.mass * device.servo_hz,
            stamped=None if staged is None else staged.stamped,
        )

    return make


def stepped_law(
    law: Callable[[CouplingStart[T]], WorldLaw],
    *,
    takes: Takes = lambda set_position: set_position,
    springs: Springs[T] = lambda start: start.params,
) -> Callable[[CouplingStart[T]], WorldCoupling]:
    """Makes the world's end of a coupling from a law; the arguments are like those of `held_law`."""

    def make(start: CouplingStart[T]) -> WorldCoupling:
        staged = _staged(start, springs)
        if not staged.tuning.contact_model:
            return LawSteps(law(start), start.initial_energy)
        predicted = rendering.at_world(staged)
        staged_law = StagedWorld(law(start), predicted, takes)
        reporter = SampleReporter(start.position, predicted, *rendering.reach(staged))
        return StagedSteps(staged_law, start.initial_energy, reporter)

    return make


def _staged(start: CouplingStart[T], springs: Springs[T]) -> CouplingStart[RenderingTuning]:
    """The `CouplingStart` for the stages before a law."""
    params = springs(start)
    tuning = rendering.tuned(params) if params.rendering == "hapnet" else RenderingTuning()
    return replace(start, params=params, tuning=tuning)  # type: ignore[arg-type,return-value]
