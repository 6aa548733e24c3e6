"""The cost of control: a tick of the device's endpoint, and a PSPM update by dimension."""

from __future__ import annotations

import math
from itertools import cycle

import numpy as np

from hapnet.assembly.build import compiled_ends
from hapnet.checks import Array, Vector
from hapnet.control.limits import Silence
from hapnet.control.pspm import SetPositionModulator
from hapnet.control.reserve import ForceGuard
from hapnet.control.set_position_coupling import SetPositionCoupling
from hapnet.control.set_position_servo import SampledServo
from hapnet.control.smoothing import Pipeline
from hapnet.ext.bench.references import NumpyPspm, PlainPD
from hapnet.ext.bench.row import Call, Limit, Options, Row, cost
from hapnet.ext.compiled.names import SERVO
from hapnet.ext.compiled.sources import are_compiled
from hapnet.side.endpoint import DeviceEndpoint
from hapnet.wire.session import Session

_K, _B = 100.0, 0.1
_NEVER_S = 1e9


def device_tick(options: Options) -> Row:
    """A tick of `DeviceEndpoint` with three axes without a PSPM update: PD, force limit, harvest and ledger. As in
    real time it is compiled if there is machine code (`hapnet compile`)."""
    origin = (0.0, 0.0, 0.0)
    modulator = SetPositionModulator(stiffness=_K, position=origin, force_limit=3.0)
    coupling = SetPositionCoupling(modulator, stages=Pipeline([]), silence=Silence("hold", _NEVER_S))
    servo = SampledServo(coupling, damping=(_B,) * 3, period=_NEVER_S, position=origin, guard=ForceGuard(limit=3.3))
    endpoint = DeviceEndpoint(Session(role="device", dof=3, name="bench", incarnation=1))
    endpoint.start(compiled_ends().servo(servo))
    plain = PlainPD(_K, _B)
    moving = _circle(1000)
    tick = endpoint.tick_sampled
    now_ns = 0
    x: Vector = origin
    v: Vector = origin

    def move() -> None:
        nonlocal now_ns, x, v
        now_ns += 1_000_000
        x, v = next(moving)

    subject, bare = cost(
        Call(lambda: tick(now_ns, 1e-3, x, v), move), Call(lambda: plain.force(x, origin, v), move), options
    )
    what = "tick of the device's endpoint, 3-DOF, PSPM not due"
    return Row(
        "device_tick", "us", what, subject, "3-axis PD in plain floats, nothing else", bare,
        limits=(Limit("median", 5.0 if are_compiled(SERVO) else 15.0),),
    )  # fmt: skip


def pspm_update(n: int, options: Options) -> Row:
    """A PSPM update with a general K in `n` dimensions, and the constraint (9) active."""
    K, x, y = pspm_case(n)
    ours = SetPositionModulator(stiffness=K, position=np.zeros(n))
    theirs = NumpyPspm(K, np.zeros(n), 0.05)
    here, wanted = tuple(x.tolist()), tuple(y.tolist())

    def drain() -> None:
        ours.energy, ours.set_position = 0.01, here

    def drain_theirs() -> None:
        theirs.energy, theirs.set_position = 0.01, x

    subject, bare = cost(
        Call(lambda: ours.modulate(wanted, here, 0.0, 0.0), drain),
        Call(lambda: theirs.modulate(y, x, 0.0, 0.0), drain_theirs),
        options,
    )
    what = f"PSPM update, {n}-DOF{', general K' if n > 1 else ''}, constraint active"
    limits = (Limit("median", 15.0),) if n == 3 else ()
    return Row(
        f"pspm_update_{n}dof", "us", what, subject, "Newton in numpy, K factored once", bare,
        limits=limits, panel=n == 3,
    )  # fmt: skip


def pspm_case(n: int) -> tuple[Array, Array, Array]:
    """K, x and y: a full matrix, and a position and set-position for which 10 mJ are not enough."""
    rng = np.random.default_rng(n)
    root = rng.normal(size=(n, n))
    return root @ root.T * 50.0 + 10.0 * np.eye(n), rng.uniform(-0.01, 0.01, n), rng.uniform(0.05, 0.1, n)


def _circle(count: int) -> cycle[tuple[Vector, Vector]]:
    """Positions [m] and velocities [m/s] on a circle of radius 10 mm, one turn per second at 1 kHz."""
    w = 2.0 * math.pi
    points = []
    for k in range(count):
        c, s = math.cos(w * k * 1e-3), math.sin(w * k * 1e-3)
        points.append(((0.01 * c - 0.01, 0.01 * s, 0.005 * s), (-0.01 * w * s, 0.01 * w * c, 0.005 * w * c)))
    return cycle(points)
