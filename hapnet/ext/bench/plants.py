"""The cost of a tick of a simulated arm and of a handle that turns, and of a whole tick of the device's side.

Also the speed of simulations compared with real time, one scenario at a time and many at once.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from hapnet.assembly.build import compiled_ends, device_session, device_side, prepare, world_session, world_side
from hapnet.control.coupling import Ends
from hapnet.ext.arms.device import SimulatedArm
from hapnet.ext.arms.table import omni
from hapnet.ext.bench.references import plain_substeps
from hapnet.ext.bench.row import Call, Distribution, Limit, Options, Row, cost
from hapnet.ext.bench.wire import pair
from hapnet.ext.tools.device import SimulatedHandle, TurningHand
from hapnet.params import Params
from hapnet.plant.device import SimulatedDevice
from hapnet.plant.operator import Impedance, Rest, Sine
from hapnet.processes.pool import usable_cores
from hapnet.side.endpoint import DeviceEndpoint, WorldEndpoint
from hapnet.simulation.batch import simulate_batch
from hapnet.simulation.simulation import simulate


def arm_tick(options: Options) -> Row:
    """An arm of three joints in a hand that moves."""
    what = "tick of a simulated arm of three joints, four steps"
    return _beside_python("arm_tick", what, lambda: SimulatedArm(omni(), Sine(3, Impedance())), options)


def handle_tick(options: Options) -> Row:
    """A handle of six degrees of freedom in a hand that turns it."""
    what = "tick of a simulated handle that turns, 12 coordinates, four steps"
    return _beside_python(
        "handle_tick", what, lambda: SimulatedHandle(TurningHand(Rest(3, Impedance()), 0.3, 0.25)), options
    )


def side_tick_pose(options: Options) -> Row:
    """A whole tick of the device's side of a tool: hand, handle, servo, contact model, messages."""
    what = "tick of a device's side, simulated: six degrees of freedom, a box on a table"
    scene = {"scene": "tool:box + plane?normal=0,0,-1&at=0,0,-20mm", "operator_model.turn_rad": 0.3}
    return _of_a_side("side_tick_pose", what, scene, options)


def side_tick_joints(options: Options) -> Row:
    """A whole tick of the device's side of an arm that is coupled by its seven joints."""
    what = "tick of a device's side, simulated: seven joints, among stops"
    with TemporaryDirectory(prefix="hapnet-bench-") as directory:
        file = Path(directory) / "seven.urdf"
        file.write_text(seven_joints(), "utf-8")
        return _of_a_side("side_tick_joints", what, by_joints(file) | {"scene": "joints"}, options)


def by_joints(file: Path) -> dict[str, object]:
    """Parameters for `seven_joints` in a file, coupled joint by joint."""
    stiffness = (3.0, 2.0, 2.5, 2.0, 1.5, 1.0, 0.5)
    return {"hardware": f"arm:{file}?tip=l7&home=0,0.5,0,0.8,0,0.5,0&axes=joints", "device.stiffness": stiffness}


def seven_joints() -> str:
    """A URDF of seven joints in a row that turn about z, x, z, ..., as many arms have them."""
    links = "".join(
        f'<link name="l{k}"><inertial><origin xyz="0 0 0.08"/><mass value="0.4"/><inertia ixx="1e-3" iyy="1e-3" '
        f'izz="4e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        for k in range(8)
    )
    joints = "".join(
        f'<joint name="j{k}" type="revolute"><parent link="l{k - 1}"/><child link="l{k}"/><origin xyz="0 0 0.16"/>'
        f'<axis xyz="{k % 2} 0 {1 - k % 2}"/><limit lower="-2" upper="2" effort="12" velocity="6"/>'
        f'<dynamics damping="0.05"/></joint>'
        for k in range(1, 8)
    )
    return f'<robot name="seven">{links}{joints}</robot>'


class PairedDevice:
    """A simulated device's side at 1 kHz, with a world that answers 50 times a second without a link.

    changes : of the parameters. ends : compiled, or in plain Python.
    """

    def __init__(self, changes: Mapping[str, object], ends: Ends) -> None:
        setup = replace(prepare(Params().set(changes), "sampled"), ends=ends)
        self._device, self._world = DeviceEndpoint(device_session(setup, 1)), WorldEndpoint(world_session(setup, 2))
        self.side = device_side(setup, self._device, lambda: self.now_ns, lambda sample: None)
        self._far = world_side(setup, self._world, np.random.default_rng(1), lambda sample: None)
        pair(self._device, self._world)
        self.now_ns: int = 0
        self._message: bytes | None = None

    def prepare(self) -> None:
        """Advance the time by a tick, deliver all messages, and make the world's step if it is due."""
        self.now_ns += 1_000_000
        if self._message is not None:
            self._world.receive(self.now_ns, self._message)
        if self.now_ns % 20_000_000 == 0 and (answer := self._far.step(self.now_ns)) is not None:
            self._device.receive(self.now_ns, answer)
        for sender, receiver in ((self._device, self._world), (self._world, self._device)):
            for message in sender.poll(self.now_ns)[0]:
                receiver.receive(self.now_ns, message.data)

    def tick(self) -> None:
        self._message = self.side.tick(self.now_ns)


def _of_a_side(name: str, what: str, changes: Mapping[str, object], options: Options) -> Row:
    ours, plain = (PairedDevice(changes, ends) for ends in (compiled_ends(), Ends()))
    subject, bare = cost(Call(ours.tick, ours.prepare), Call(plain.tick, plain.prepare), options)
    return Row(name, "us", what, subject, "the same in plain Python", bare, panel=False)


def _beside_python(name: str, what: str, make: Callable[[], SimulatedDevice], options: Options) -> Row:
    ours, plain = compiled_ends().simulated(make()), make()
    for device in (ours, plain):
        device.apply((0.1,) * device.dof)
    subject, bare = cost(Call(ours.advance), Call(plain.advance), options)
    return Row(name, "us", what, subject, "the same in plain Python", bare, panel=False)


_SIMULATED_S = 10.0
_SCENARIOS = 1000
_BATCH_S = 30.0
_WORDS: dict[int, dict[str, object]] = {1: {}, 3: {"scene": "box", "operator": "sine"}}


def simulate_ndof(axes: int, options: Options) -> Row:
    """`hapnet.simulate` with its defaults: continuous servo, 4 substeps, ledgers, recording."""
    seconds = max(_SIMULATED_S, options.seconds)
    params = Params().set({"duration_s": seconds, **_WORDS[axes]})
    runs = [
        (seconds / _elapsed(simulate, params, seed), seconds / _elapsed(plain_substeps, axes, seconds))
        for seed in range(max(5, options.rounds))
    ]
    subject, bare = ([Distribution.of(run[i] for run in runs)] for i in (0, 1))
    return Row(
        f"simulate_{axes}dof", "x real time", f"simulation with ledgers and recording, {axes}-DOF", subject,
        "the substeps alone, written out", bare,
        limits=(Limit("median", 100.0 if axes == 1 else 40.0, at_least=True),), higher_is_better=True,
    )  # fmt: skip


def batch_1000(options: Options) -> Row:
    """`simulate_batch` with a thousand seeds of the 1-DOF default on all cores, beside one seed at a time on one."""
    params, workers = Params().set({"duration_s": _BATCH_S}), usable_cores()
    subject, bare = [], []
    for _ in range(options.rounds):
        took_s = _elapsed(partial(simulate_batch, workers=workers), params, range(_SCENARIOS))
        subject.append(Distribution.of([_SCENARIOS * _BATCH_S / took_s]))
        bare.append(Distribution.of([_BATCH_S / _elapsed(simulate, params, seed) for seed in range(3)]))
    return Row(
        f"batch_{_SCENARIOS}", "scenario-s/s", f"{_SCENARIOS} scenarios at once, 1-DOF, {workers} workers", subject,
        "one scenario at a time", bare,
        limits=(Limit("median", 2000.0, at_least=True),), higher_is_better=True,
    )  # fmt: skip


def _elapsed(call: Callable[..., object], *args: object) -> float:
    began = time.perf_counter()
    call(*args)
    return time.perf_counter() - began
