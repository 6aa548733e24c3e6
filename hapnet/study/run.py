"""A simulated run, and what its true environment is: what `hapnet.study.case` and its like measure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hapnet.checks import Array
from hapnet.couplings.registry import coupling, ideal_stiffness
from hapnet.metrics.environment import environment_force, standing_force
from hapnet.metrics.obstacles import Obstacle, obstacles
from hapnet.metrics.windows import Mask
from hapnet.params import Params
from hapnet.plant.worlds.moving_wall import MovingWall
from hapnet.plant.worlds.protocol import World
from hapnet.recording.samples import Columns, Recording
from hapnet.simulation.simulation import Result, Simulation
from hapnet.summary.structure import LinkPart, SidePart

Measures = dict[str, float | None]
"""Values by the names of their metrics; None where a run does not give one."""


@dataclass(frozen=True)
class Run:
    """A simulated run with the motion of each tick of the servo recorded, and its scene."""

    params: Params
    result: Result
    scene: World

    @cached_property
    def walls(self) -> tuple[Obstacle, ...] | None:
        """The walls and solids of the scene; None: they are not known, and no metric that needs them is."""
        moves = isinstance(self.scene, MovingWall) and self.scene.schedule.changes
        return () if moves else obstacles(self.scene)

    @property
    def recording(self) -> Recording:
        return self.result.recording

    @property
    def device(self) -> Columns:
        """The device's samples."""
        found = self.recording.device
        assert found is not None, "a simulated run has both sides"
        return found

    @property
    def world(self) -> Columns | None:
        """The world's samples; None if the run ended before its first step."""
        return self.recording.world

    @property
    def sides(self) -> tuple[SidePart, SidePart]:
        """The device's and the world's part of the summary."""
        device, world = self.result.summary["device"], self.result.summary["world"]
        assert device is not None, "a simulated run has both sides"
        assert world is not None, "a simulated run has both sides"
        return device, world

    @property
    def links(self) -> tuple[LinkPart, LinkPart]:
        """The uplink's and the downlink's part of the summary."""
        up, down = self.result.summary["links"]["up"], self.result.summary["links"]["down"]
        assert up is not None, "a simulated run has both links"
        assert down is not None, "a simulated run has both links"
        return up, down

    @property
    def delay_s(self) -> float | None:
        """The median delays of both links together [s]; None: nothing came through one of them."""
        up_ms, down_ms = (way["delay_p50_ms"] for way in self.links)
        return None if up_ms is None or down_ms is None else (up_ms + down_ms) / 1e3

    @property
    def scalar(self) -> bool:
        """Are both springs scalars, so that one number says how stiff they are in series with a wall?"""
        return isinstance(self.params.device.stiffness, float) and isinstance(self.params.world.stiffness, float)

    @cached_property
    def wanted(self) -> Array | None:
        """The force of the true environment on the device (N, n) [N]; None: its walls are not known.

        With springs that are no scalars the walls are taken as rigid, which tells no more than where they are.
        """

        def stiffness(wall: Obstacle) -> float:
            return ideal_stiffness(self.params, wall.stiffness) if self.scalar else wall.stiffness

        return self._force_at(self.device["position_m"], self.device["time_s"], stiffness)

    @cached_property
    def inside(self) -> Mask | None:
        """(N,) is the device in a wall? None: they are not known."""
        return None if self.wanted is None else np.asarray((self.wanted != 0.0).any(axis=1))

    def proxy_force(self, positions: Array, times: Array) -> Array | None:
        """The walls' force on a proxy at rest (N, n) [N] while the device is at `positions` (N, n) [m]; None: as above.

        It is that of the spring between device and proxy and the wall in series: the world's spring K', or the device's
        for a coupling that has one only. `times` (N,) : since the recording's origin [s].
        """
        springs = self.params.world if coupling(self.params.coupling).scaled else self.params.device
        if not isinstance(spring := springs.stiffness, float):
            return None
        return self._force_at(positions, times, lambda wall: spring * wall.stiffness / (spring + wall.stiffness))

    def _force_at(self, positions: Array, times: Array, stiffness: Callable[[Obstacle], float]) -> Array | None:
        """The force of the walls that stood at each time, of such a stiffness; zero in none of them."""
        scene = self.scene
        if isinstance(scene, MovingWall) and scene.schedule.changes:
            moving = scene.schedule
            late_s = ((self.result.world.origin_ns or 0) - int(self.recording.meta["origin_ns"])) / 1e9
            return environment_force(
                positions,
                (times - late_s).tolist(),
                lambda t: () if (wall := moving.at(t)) is None else (wall,),
                stiffness,
            )
        return None if self.walls is None else standing_force(positions, self.walls, stiffness)


def simulated(params: Params, seed: int) -> Run:
    """The run of a case, each tick recorded."""
    simulation = Simulation(params.set({"record_hz": params.device.servo_hz}), seed, motion_only=True)
    return Run(simulation.setup.params, simulation.run(), simulation.setup.scene)
