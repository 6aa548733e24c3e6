"""The cost of a mesh: a step at 10,000 triangles, in contact and in free space, beside a query of the library."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import cycle
from statistics import median
from typing import Any

import numpy as np

from hapnet.checks import Array, Vector
from hapnet.errors import MissingLibrary
from hapnet.ext.bench.row import Call, Distribution, Limit, Options, RoundFigures, Row, cost
from hapnet.ext.solids.mesh import Mesh
from hapnet.ext.solids.rigid_contacts import RigidContacts, Solid
from hapnet.plant.integrator import PassiveIntegrator

STEP_S = 1e-3
_CENTRE, _RING_M, _TUBE_M = (0.062, 0.0, 0.0), 0.03, 0.012
_AROUND, _ACROSS = 100, 50
_REACH_M = 0.05


def world_step_mesh(options: Options) -> Row:
    """Integrator and contact, pressed against a torus and moved along it at 20 mm/s, with steps of 1 ms.

    fast_ratio : at 100 mm/s. free_ratio : 5 mm in front of the torus. told_ratio : with the planes for the device.
    """
    what = f"world step of 1 ms, {2 * _AROUND * _ACROSS} triangles (fast: 100 mm/s, free: 5 mm away, told: with planes)"
    against = "libigl's nearest point, one call"
    try:
        mesh = Mesh(*torus())
    except MissingLibrary as error:
        return Row("world_step_mesh", "us", what, against=against, note=str(error))
    subject, bare = _beside(LedMass(mesh, goals(0.030)), mesh, options)
    others = {"fast_ratio": goals(0.030, 0.64), "free_ratio": goals(0.015)}
    more = {"mean_ratio": median(map(_mean, subject)) / median(map(_mean, bare))}
    for name, path in others.items():
        other, beside = _beside(LedMass(mesh, path), mesh, options)
        more[name] = RoundFigures.of(other).median / RoundFigures.of(beside).median
    other, beside = _beside(LedMass(mesh, goals(0.030), sends_planes=True), mesh, options)
    more["told_ratio"] = RoundFigures.of(other).median / RoundFigures.of(beside).median
    limits = tuple([Limit(name, 4.0) for name in ("ratio", "mean_ratio", "fast_ratio", "free_ratio")])
    return Row("world_step_mesh", "us", what, subject, against, bare, more=more, limits=limits)


def _beside(mass: LedMass, mesh: Mesh, options: Options) -> tuple[list[Distribution], list[Distribution]]:
    search = BareQuery(mesh, mass.visited(1600))
    return cost(Call(mass.step, mass.prepare), Call(search.call, search.prepare), options)


def _mean(times: Distribution) -> float:
    return float(np.average(times.values, weights=times.counts))


class LedMass:
    """A virtual mass in front of a mesh that follows `goals` [m], a closed path. sends_planes : compute planes too."""

    def __init__(self, mesh: Mesh, goals: Sequence[Vector], *, sends_planes: bool = False) -> None:
        self._sends_planes = sends_planes
        self._contacts = RigidContacts([Solid(mesh)], 3)
        self.mass: PassiveIntegrator = PassiveIntegrator(0.02, 14.0, 500.0, (0.0, 0.0, 0.0))
        self._goals = cycle(goals)
        for _ in range(300):
            self.prepare()
            self.step()

    def prepare(self) -> None:
        self._goal = next(self._goals)

    def visited(self, steps: int) -> list[Vector]:
        """The positions after each of the next steps."""
        places = []
        for _ in range(steps):
            self.prepare()
            self.step()
            places.append(self.mass.position)
        return places

    def step(self) -> None:
        self.mass.step(STEP_S, self._goal, self._contacts)
        if self._sends_planes:
            self._contacts.planes(self.mass.position, _REACH_M)


class BareQuery:
    """Queries of the library alone, at the same places."""

    def __init__(self, mesh: Mesh, places: Sequence[Vector]) -> None:
        import igl

        self._mesh = mesh.vertices, mesh.triangles
        tree = igl.AABB()
        tree.init(*self._mesh)
        self._search = tree.squared_distance
        self._places = cycle([np.array([place]) for place in places])

    def prepare(self) -> None:
        self._place = next(self._places)

    def call(self) -> None:
        self._search(*self._mesh, self._place)


def goals(depth_m: float, turn_s: float = 3.2) -> list[Vector]:
    """Set-positions on an ellipse across x, one for each step of a turn; the surface is at a depth of 20 mm."""
    steps = round(turn_s / STEP_S)
    turns = [2.0 * math.pi * k / steps for k in range(steps)]
    return [(depth_m, 0.006 * math.sin(turn), 0.005 * math.cos(turn)) for turn in turns]


def torus() -> tuple[Array, Any]:
    """Vertices [m] and triangles of a torus about z."""
    u, v = np.meshgrid(
        2.0 * np.pi * np.arange(_AROUND) / _AROUND, 2.0 * np.pi * np.arange(_ACROSS) / _ACROSS, indexing="ij"
    )
    ring = _RING_M + _TUBE_M * np.cos(v)
    vertices = np.stack([ring * np.cos(u), ring * np.sin(u), _TUBE_M * np.sin(v)], axis=-1).reshape(-1, 3) + _CENTRE
    i, j = np.meshgrid(np.arange(_AROUND), np.arange(_ACROSS), indexing="ij")
    a, b = i * _ACROSS + j, (i + 1) % _AROUND * _ACROSS + j
    c, d = (i + 1) % _AROUND * _ACROSS + (j + 1) % _ACROSS, i * _ACROSS + (j + 1) % _ACROSS
    return vertices, np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)]).reshape(-1, 3)
