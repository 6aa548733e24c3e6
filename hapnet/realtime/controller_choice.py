"""Chooses a side's control half in real time: a thread, or a servo in a process of its own."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hapnet.assembly.build import Setup, device_session, world_session
from hapnet.loading import extension
from hapnet.params import is_real_robot
from hapnet.realtime import servo_pipe
from hapnet.realtime.controllers import Control, ControlCallbacks, ThreadedDevice, ThreadedWorld
from hapnet.realtime.servo_process import ServoProcess
from hapnet.records.machine_code import no_compiler
from hapnet.wire.messages import Role
from hapnet.wire.secret import Secret


def control_of(
    setup: Setup,
    role: Role,
    incarnation: int,
    secret: Secret,
    callbacks: ControlCallbacks,
    clock: Callable[[], int],
    steps: np.random.SeedSequence,
    *,
    realtime: bool,
) -> Control:
    """The side's control, not started yet. `steps` seeds the random lengths of a world's steps."""
    if role == "world":
        session = world_session(setup, incarnation, secret=secret)
        if is_real_robot(setup.params):
            return ThreadedDevice(setup, session, callbacks, clock, realtime=realtime, follows=True)
        return ThreadedWorld(setup, session, callbacks, clock, rng=np.random.default_rng(steps))
    session = device_session(setup, incarnation, secret=secret)
    if realtime and servo_pipe.available():
        if no_compiler() is None:
            compiled = extension("compiled ends")
            for end in compiled.missing(setup.coupling, (compiled.SERVO,), setup.dof, setup.params):
                compiled.make_ready(end)  # the servo's process only loads it
        return ServoProcess(setup, session, callbacks)
    return ThreadedDevice(setup, session, callbacks, clock, realtime=realtime)
