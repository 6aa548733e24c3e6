"""hapnet: passive haptics over bad networks.

>>> from hapnet import Params, simulate
>>> result = simulate(Params().set({"link.up": "4g", "link.down": "4g"}), seed=1)
>>> result.summary["theorem"]["margin_J"] > 0.0
True

The public names, which stay stable:

* `Params`: every parameter of a run. `HapnetError` and, where a value is not allowed, `InvalidParameter`.
* `simulate`, `simulate_batch`: both sides in virtual time, once (a `Result`) or many times. `read_recording`: what a
  run wrote, a `Recording`: numpy's arrays, or a table of pandas. An emulated link of your own is `netem.Link`.
* `report`, `export`: that as a page and pictures (a `Report`), and as tables in files.
* `compare`, `sweep`, `tune`: many runs measured alike, as the commands of these names make them. They give a
  `Comparison`, a `SweepResult` and a `Tuning`, whose `rows` are what pandas takes.
* `connect_device`, `connect_world`: one side in real time, in your asyncio program. ``async with`` gives a
  `ConnectedDevice` or a `ConnectedWorld`: its `SideEvent`s, samples and `SetPosition`s, and its link to be changed.
  What has ended raises `Ended`.
* `RealtimeSide`: what they are made of, from the result of `prepare` and from `ZenohSettings`, which say how to reach
  the other side. It reports `Notice`s.
* `Scene`, `Wall`: for your own world of walls. `ForceWorld`, `Obstacle`: of any forces, and of obstacles that move.
  `Plane`: what a device receives of them, with `Effects` of its surface and their `Grain`. `Sphere`, `Cuboid`:
  how pictures show them.
  `Engine`: the protocol of a physics engine that integrates what the hand holds, and `EngineWorld`, the world of one.
  `World`, and what is in one, `Surroundings`: the protocols of any other world.
* `Device`: the protocol of your own device. It needs no base class; `Driver` is one, with a default for each part
  that is optional. `DeviceSilent`: what it raises if there is no reading.
* `CouplingSpec`: your own coupling. `held_law` and `stepped_law` make its two ends from your functions of a
  `CouplingStart` (`hapnet.control.coupling` says what a law must do), of `parameter`s its own section.
* `SetPositionModulator`, `PassiveIntegrator`: the paper's two laws, for your own servo or world loop.

`examples/` has a short program for each.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hapnet.assembly.build import prepare
    from hapnet.control.pspm import SetPositionModulator
    from hapnet.couplings.ends import held_law, stepped_law
    from hapnet.couplings.spec import CouplingSpec, CouplingStart
    from hapnet.devices.driver import Driver
    from hapnet.errors import DeviceSilent, Ended, HapnetError, InvalidParameter
    from hapnet.mechanics.contacts import Surroundings
    from hapnet.mechanics.effects import Effects, Grain
    from hapnet.mechanics.plane import Plane
    from hapnet.param_values import parameter
    from hapnet.params import Params
    from hapnet.plant.device import Device
    from hapnet.plant.integrator import PassiveIntegrator
    from hapnet.plant.worlds.engine import Engine
    from hapnet.plant.worlds.engine_world import EngineWorld
    from hapnet.plant.worlds.force_world import ForceWorld
    from hapnet.plant.worlds.obstacle import Obstacle
    from hapnet.plant.worlds.protocol import World
    from hapnet.plant.worlds.scene import Scene
    from hapnet.plant.worlds.shapes import Cuboid, Sphere
    from hapnet.plant.worlds.walls import Wall
    from hapnet.realtime.connect import connect_device, connect_world
    from hapnet.realtime.connected import ConnectedDevice, ConnectedWorld, SetPosition
    from hapnet.realtime.runner import RealtimeSide
    from hapnet.realtime.side_events import SideEvent
    from hapnet.recording.export import export
    from hapnet.recording.mcap import read_recording
    from hapnet.recording.samples import Recording
    from hapnet.reports.report import Report, report
    from hapnet.side.notices import Notice
    from hapnet.simulation.batch import simulate_batch
    from hapnet.simulation.result import Result
    from hapnet.simulation.simulation import simulate
    from hapnet.study.comparison import Comparison, compare
    from hapnet.study.sweep import SweepResult, sweep
    from hapnet.study.tune import Tuning, tune
    from hapnet.transport.config import ZenohSettings

_HOMES = {
    "Comparison": "hapnet.study.comparison",
    "ConnectedDevice": "hapnet.realtime.connected",
    "ConnectedWorld": "hapnet.realtime.connected",
    "CouplingSpec": "hapnet.couplings.spec",
    "CouplingStart": "hapnet.couplings.spec",
    "Cuboid": "hapnet.plant.worlds.shapes",
    "Device": "hapnet.plant.device",
    "DeviceSilent": "hapnet.errors",
    "Driver": "hapnet.devices.driver",
    "Effects": "hapnet.mechanics.effects",
    "Ended": "hapnet.errors",
    "Engine": "hapnet.plant.worlds.engine",
    "EngineWorld": "hapnet.plant.worlds.engine_world",
    "ForceWorld": "hapnet.plant.worlds.force_world",
    "Grain": "hapnet.mechanics.effects",
    "HapnetError": "hapnet.errors",
    "InvalidParameter": "hapnet.errors",
    "Notice": "hapnet.side.notices",
    "Obstacle": "hapnet.plant.worlds.obstacle",
    "Params": "hapnet.params",
    "PassiveIntegrator": "hapnet.plant.integrator",
    "Plane": "hapnet.mechanics.plane",
    "RealtimeSide": "hapnet.realtime.runner",
    "Recording": "hapnet.recording.samples",
    "Report": "hapnet.reports.report",
    "Result": "hapnet.simulation.result",
    "Scene": "hapnet.plant.worlds.scene",
    "SetPosition": "hapnet.realtime.connected",
    "SetPositionModulator": "hapnet.control.pspm",
    "SideEvent": "hapnet.realtime.side_events",
    "Sphere": "hapnet.plant.worlds.shapes",
    "Surroundings": "hapnet.mechanics.contacts",
    "SweepResult": "hapnet.study.sweep",
    "Tuning": "hapnet.study.tune",
    "Wall": "hapnet.plant.worlds.walls",
    "World": "hapnet.plant.worlds.protocol",
    "ZenohSettings": "hapnet.transport.config",
    "compare": "hapnet.study.comparison",
    "connect_device": "hapnet.realtime.connect",
    "connect_world": "hapnet.realtime.connect",
    "export": "hapnet.recording.export",
    "held_law": "hapnet.couplings.ends",
    "parameter": "hapnet.param_values",
    "prepare": "hapnet.assembly.build",
    "read_recording": "hapnet.recording.mcap",
    "report": "hapnet.reports.report",
    "simulate": "hapnet.simulation.simulation",
    "simulate_batch": "hapnet.simulation.batch",
    "stepped_law": "hapnet.couplings.ends",
    "sweep": "hapnet.study.sweep",
    "tune": "hapnet.study.tune",
}

__all__ = [
    "Comparison",
    "ConnectedDevice",
    "ConnectedWorld",
    "CouplingSpec",
    "CouplingStart",
    "Cuboid",
    "Device",
    "DeviceSilent",
    "Driver",
    "Effects",
    "Ended",
    "Engine",
    "EngineWorld",
    "ForceWorld",
    "Grain",
    "HapnetError",
    "InvalidParameter",
    "Notice",
    "Obstacle",
    "Params",
    "PassiveIntegrator",
    "Plane",
    "RealtimeSide",
    "Recording",
    "Report",
    "Result",
    "Scene",
    "SetPosition",
    "SetPositionModulator",
    "SideEvent",
    "Sphere",
    "Surroundings",
    "SweepResult",
    "Tuning",
    "Wall",
    "World",
    "ZenohSettings",
    "compare",
    "connect_device",
    "connect_world",
    "export",
    "held_law",
    "parameter",
    "prepare",
    "read_recording",
    "report",
    "simulate",
    "simulate_batch",
    "stepped_law",
    "sweep",
    "tune",
]


def __dir__() -> list[str]:
    return sorted({*__all__, *(name for name in globals() if name.startswith("__"))})


def __getattr__(name: str) -> Any:
    """Public names are loaded on first use: a command's --help needs neither numpy nor Zenoh."""
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    if name == "__version__":
        from hapnet.versions import versions

        return versions()["hapnet-haptics"]
    raise AttributeError(f"module 'hapnet' has no attribute {name!r}")
