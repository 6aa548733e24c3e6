"""hapnet: passive haptics over bad networks.

>>> from hapnet import Params, simulate
>>> result = simulate(Params().set({"link.up": "4g", "link.down": "4g"}), seed=1)
>>> result.summary["theorem"]["margin_J"] > 0.0
True

The public names, which stay stable:

* `Params`: every parameter of a run. `HapnetError` and, where a value is not allowed, `InvalidParameter`.
* `simulate`, `simulate_batch`: both sides in virtual time, once (a `Result`) or many times. `read_recording` reads the
  file of a run as a `Recording`: numpy arrays, or a pandas table. Make an emulated link of your own with `netem.Link`.
* `report`, `export`: a recording as a page with pictures (a `Report`), and as tables in files.
* `compare`, `sweep`, `tune`: many runs with the same metrics, like the commands of these names. They return a
  `Comparison`, a `SweepResult` and a `Tuning`; pandas accepts their `rows`.
* `connect_device`, `connect_world`: one side in real time, in your asyncio program. ``async with`` gives a
  `ConnectedDevice` or a `ConnectedWorld`: its `SideEvent`s, samples and `SetPosition`s, and a way to change its link.
  Calls after the end raise `Ended`.
* `RealtimeSide`: the side inside of both, made from the result of `prepare` and from `ZenohSettings`, which define how
  to reach the other side. It reports `Notice`s.
* `Scene`, `Wall`: for your own world of walls. `ForceWorld`, `Obstacle`: for a world of any forces, and of obstacles
  that move. `Plane`: a surface as the device receives it, with `Effects` and their `Grain`. `Sphere`, `Cuboid`: solids
  for pictures.
  `Engine`: the protocol of a physics engine that integrates the body in the hand; `EngineWorld`: a world with one.
  `World` and its `Surroundings`: the protocols of any other world.
* `Device`: the protocol of your own device. It needs no base class; `Driver` is one, with a default for each part
  that is optional. A device raises `DeviceSilent` if there is no reading. `PositionRobot`: the same for a robot that
  takes positions.
* `CouplingSpec`: your own coupling. `held_law` and `stepped_law` make its two ends from your functions of a
  `CouplingStart` (`hapnet.control.coupling` defines a law's methods); `parameter`s make its own section.
* `SetPositionModulator`, `PassiveIntegrator`: the paper's two laws, for your own servo or world loop.

`examples/` has a short program for each.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hapnet.assembly.build import prepare as prepare
    from hapnet.control.pspm import SetPositionModulator as SetPositionModulator
    from hapnet.couplings.ends import held_law as held_law, stepped_law as stepped_law
    from hapnet.couplings.spec import CouplingSpec as CouplingSpec, CouplingStart as CouplingStart
    from hapnet.devices.driver import Driver as Driver
    from hapnet.errors import (
        DeviceSilent as DeviceSilent,
        Ended as Ended,
        HapnetError as HapnetError,
        InvalidParameter as InvalidParameter,
    )
    from hapnet.ext.engines.engine import Engine as Engine
    from hapnet.ext.engines.engine_world import EngineWorld as EngineWorld
    from hapnet.ext.engines.force_world import ForceWorld as ForceWorld
    from hapnet.ext.engines.obstacle import Obstacle as Obstacle
    from hapnet.ext.pictures.report import Report as Report, report as report
    from hapnet.ext.robots.position_robot import PositionRobot as PositionRobot
    from hapnet.ext.solids.shapes import Cuboid as Cuboid, Sphere as Sphere
    from hapnet.ext.study.comparison import Comparison as Comparison, compare as compare
    from hapnet.ext.study.sweep import SweepResult as SweepResult, sweep as sweep
    from hapnet.ext.study.tune import Tuning as Tuning, tune as tune
    from hapnet.mechanics.contacts import Surroundings as Surroundings
    from hapnet.mechanics.effects import Effects as Effects, Grain as Grain
    from hapnet.mechanics.plane import Plane as Plane
    from hapnet.param_values import parameter as parameter
    from hapnet.params import Params as Params
    from hapnet.plant.device import Device as Device
    from hapnet.plant.integrator import PassiveIntegrator as PassiveIntegrator
    from hapnet.plant.worlds.protocol import World as World
    from hapnet.plant.worlds.scene import Scene as Scene
    from hapnet.plant.worlds.walls import Wall as Wall
    from hapnet.realtime.connect import connect_device as connect_device, connect_world as connect_world
    from hapnet.realtime.connected import (
        ConnectedDevice as ConnectedDevice,
        ConnectedWorld as ConnectedWorld,
        SetPosition as SetPosition,
    )
    from hapnet.realtime.runner import RealtimeSide as RealtimeSide
    from hapnet.realtime.side_events import SideEvent as SideEvent
    from hapnet.recording.export import export as export
    from hapnet.recording.mcap import read_recording as read_recording
    from hapnet.recording.samples import Recording as Recording
    from hapnet.side.notices import Notice as Notice
    from hapnet.simulation.batch import simulate_batch as simulate_batch
    from hapnet.simulation.result import Result as Result
    from hapnet.simulation.simulation import simulate as simulate
    from hapnet.transport.config import ZenohSettings as ZenohSettings

_NAMES = {
    "hapnet.assembly.build": "prepare",
    "hapnet.control.pspm": "SetPositionModulator",
    "hapnet.couplings.ends": "held_law stepped_law",
    "hapnet.couplings.spec": "CouplingSpec CouplingStart",
    "hapnet.devices.driver": "Driver",
    "hapnet.errors": "DeviceSilent Ended HapnetError InvalidParameter",
    "hapnet.mechanics.contacts": "Surroundings",
    "hapnet.mechanics.effects": "Effects Grain",
    "hapnet.mechanics.plane": "Plane",
    "hapnet.param_values": "parameter",
    "hapnet.params": "Params",
    "hapnet.plant.device": "Device",
    "hapnet.plant.integrator": "PassiveIntegrator",
    "hapnet.ext.engines.engine": "Engine",
    "hapnet.ext.engines.engine_world": "EngineWorld",
    "hapnet.ext.engines.force_world": "ForceWorld",
    "hapnet.ext.engines.obstacle": "Obstacle",
    "hapnet.plant.worlds.protocol": "World",
    "hapnet.plant.worlds.scene": "Scene",
    "hapnet.ext.solids.shapes": "Cuboid Sphere",
    "hapnet.plant.worlds.walls": "Wall",
    "hapnet.realtime.connect": "connect_device connect_world",
    "hapnet.realtime.connected": "ConnectedDevice ConnectedWorld SetPosition",
    "hapnet.realtime.runner": "RealtimeSide",
    "hapnet.realtime.side_events": "SideEvent",
    "hapnet.recording.export": "export",
    "hapnet.recording.mcap": "read_recording",
    "hapnet.recording.samples": "Recording",
    "hapnet.ext.pictures.report": "Report report",
    "hapnet.ext.robots.position_robot": "PositionRobot",
    "hapnet.side.notices": "Notice",
    "hapnet.simulation.batch": "simulate_batch",
    "hapnet.simulation.result": "Result",
    "hapnet.simulation.simulation": "simulate",
    "hapnet.ext.study.comparison": "Comparison compare",
    "hapnet.ext.study.sweep": "SweepResult sweep",
    "hapnet.ext.study.tune": "Tuning tune",
    "hapnet.transport.config": "ZenohSettings",
}
_HOMES = {name: module for module, names in _NAMES.items() for name in names.split()}
__all__ = sorted(_HOMES)


def __dir__() -> list[str]:
    return sorted({*__all__, *(name for name in globals() if name.startswith("__"))})


def __getattr__(name: str) -> Any:
    """Load a public name on first use: a command's --help needs neither numpy nor Zenoh."""
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    if name == "__version__":
        from hapnet.installing import versions

        return versions()["hapnet-haptics"]
    raise AttributeError(f"module 'hapnet' has no attribute {name!r}")
