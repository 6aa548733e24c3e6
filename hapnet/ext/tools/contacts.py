"""Contact of a rigid tool with rigid solids: the secant planes of `rigid_contacts`, one for each touching point.

The points are points of the tool that touch solids, and points of solids' edges that touch the tool (`edges.py`).

A point p of the tool is linear in the pose's coordinates, so its plane is a plane there too, and the anchored energy of
`hapnet.ext.solids.rigid_contacts` applies unchanged: at an onset the depths are set to the true ones, if the
planes' energy and a small reservoir E_c can pay for them, else all are scaled; energy that dampers and friction
dissipate refills E_c.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import hypot, sqrt

import numpy as np

from hapnet.checks import MOST_TOOL_PLANES, Vector
from hapnet.errors import InvalidParameter
from hapnet.ext.solids.friction import tangential
from hapnet.ext.solids.mesh_contact import secants_of
from hapnet.ext.solids.rigid_contacts import SEARCHED_M, Solid
from hapnet.ext.solids.rigid_step import ANCHOR_CEILING_J
from hapnet.ext.solids.secant import GOOD_MPS, Secant, end_J, onset_J
from hapnet.ext.solids.shapes import Sphere, triple
from hapnet.ext.tools.body import MOST, RigidBody, Touched
from hapnet.ext.tools.body_step import step
from hapnet.ext.tools.edges import edge_points
from hapnet.ext.tools.tool import Tool, place
from hapnet.mechanics.contacts import Inverse, Surroundings
from hapnet.mechanics.plane import Plane
from hapnet.mechanics.pose import AXES, arms, in_world
from hapnet.records.record import zero
from hapnet.records.vectors import added, dot, inner

CORRECTIONS = 4
"""The greatest number of rounds that correct the secants; 1 is usual."""


CREEP = 1e-6
"""The viscosity of a resting point's friction, as a share of the body's own: a held force falls by 1 % in minutes."""

STOPS_M = 1e-5
"""A point that stops may slide this far in the step [m]; with more the step is divided."""

ALIKE = 0.9
"""Planes whose normals have a greater cosine are of one direction."""

Met = tuple[Vector, Secant, Vector]
"""A point of the tool, a solid near it, and the point's place at the step's start [m]."""


class BodyState:
    """A saved state of a body, to repeat a step from."""

    def __init__(self, body: RigidBody) -> None:
        self.v = list(body.v)
        self._rest = list(body.x), list(body.velocity), list(body.spin)

    def restore(self, body: RigidBody) -> None:
        body.x[:], body.velocity[:], body.spin[:] = self._rest
        body.v[:] = self.v


class ToolContacts(Surroundings):
    """The surroundings of a tool; they keep the state of one contact, so they belong to one tool.

    tool, solids : may touch each other. arm_m : the length of the pose's arms [m].
    """

    dof: int = AXES

    def __init__(self, tool: Tool, solids: Sequence[Solid], arm_m: float) -> None:
        self.tool, self.solids, self.arm_m = tool, tuple(solids), arm_m
        self._planes: Touched = zero(Touched)
        self._secants: list[tuple[Vector, Secant]] = [
            (point, secant)
            for point in tool.points
            for solid in self.solids
            if not (tool.closed and isinstance(solid.shape, Sphere))  # such a ball is a single point
            for secant in secants_of(solid.shape, solid.stiffness, solid.damping, solid.friction)
        ]
        self._stretch = hypot(1.0, max(hypot(*point) for point in tool.points) / arm_m)
        self._edges = edge_points(tool, self.solids, arm_m)
        self.energy_J: float = 0.0
        """The energy e + E_c after the last step [J]."""
        self.scale: float = 1.0
        """The scale s of the depths at the last onset; 1: the true depths."""
        self.at: Vector = (0.0,) * AXES
        """The tool's pose after the last step (12,) [m]."""

    def require_outside(self, position: Sequence[float]) -> None:
        deep = max((-secant.shape.near(x).distance_m for _, secant, x in self._pairs(position)), default=0.0)
        if deep > 0.0:
            allowed = f"a pose in which no point of the tool is inside (one is {deep:.3g} m deep)"
            raise InvalidParameter("start", tuple(position), allowed)

    def _pairs(self, position: Sequence[float]) -> list[Met]:
        """All pairs of a point and a solid that may touch, with the tool at `position` (12,) [m]."""
        points = [(point, secant, place(position, point, self.arm_m)) for point, secant in self._secants]
        return points + [(point, edge, x) for edge in self._edges for point, x in [edge.begin(position)]]

    def solve(
        self, dt: float, position: Sequence[float], velocity: list[float], inverse: Inverse
    ) -> tuple[Sequence[float], list[float]]:
        raise NotImplementedError("a tool is moved by its own mass")

    def stored_J(self, position: Sequence[float]) -> float:
        """Energy in the planes' springs and in the reservoir after the last step, for any `position` [J]."""
        return self.energy_J

    def penetration(self, position: Sequence[float]) -> float:
        depth = 0.0
        for _, secant, x in self._pairs(position):
            if not secant.farther_than(0.0, x):
                depth = max(depth, -secant.near(x).distance_m)
        return depth

    def clearance(self, position: Sequence[float]) -> float:
        """The distance of coordinates [m] within which nothing touches the tool, up to `SEARCHED_M`.

        If the coordinates move by d, a point a of the tool moves by at most d sqrt(1 + |a|^2/l^2).
        """
        least = SEARCHED_M * self._stretch
        for _, secant, x in self._pairs(position):
            if not secant.farther_than(least, x):
                least = min(least, secant.near(x).distance_m / secant.slope)
        return least / self._stretch

    def planes(self, position: Sequence[float], reach_m: float) -> tuple[Plane, ...]:
        """The deepest planes of different directions, in the pose's coordinates, as they act on a rigid body."""
        return different(
            rigid_plane(
                position, self.arm_m, in_world(position, self.arm_m, point), normal, distance, secant.stiffness,
                secant.damping,
            )
            for distance, point, normal, secant in self.within(position, reach_m)
        )  # fmt: skip

    def within(self, position: Sequence[float], reach_m: float) -> list[tuple[float, Vector, Vector, Secant]]:
        """Return the parts of the tool within `reach_m` of a solid, the deepest first: the distance [m], the point in
        the tool's axes, the unit normal into the solid, and the solid.
        """
        found = []
        for point, secant, x in self._pairs(position):
            if secant.farther_than(reach_m, x):
                continue
            distance, gradient = secant.near(x)
            if distance <= reach_m and (size := hypot(*gradient)):
                found.append((distance / size, point, tuple([-part / size for part in gradient]), secant))
        return sorted(found, key=lambda one: one[0])

    # -- a step -------------------------------------------------------------------------------------------------------

    def move(
        self, body: RigidBody, dt: float, ybar: Vector, push: Vector, shorter: bool
    ) -> tuple[Vector, float] | None:
        """Move the body by a step of `dt` [s] on the spring that holds it to `ybar`, under `push`, among the solids.

        shorter : the caller would do shorter steps instead.
        Returns the solids' force along the coordinates (12,) [N] and its work [J]; None: no step was found, or a point
        stops in it that should have stopped sooner, and nothing has changed.
        """
        state, planes = BodyState(body), self._planes
        start = self._pairs(body.x)
        planes.count = 0
        if not step(body, dt, push, ybar, planes):
            return None
        met: list[Met] = []
        if not self._meet(body, start, met):
            self.energy_J = min(self.energy_J, ANCHOR_CEILING_J)
            return _STILL, 0.0
        self._anchor(met)
        for left in range(CORRECTIONS, -1, -1):  # the last step stands, with its planes
            if not self._step(body, state, dt, ybar, push, met):
                state.restore(body)
                return None
            if not left:
                break
            wrong = False
            for point, secant, x in met:
                end = place(body.x, point, self.arm_m)
                wrong = secant.correct(x, _minus(end, x), end, dt * GOOD_MPS) or wrong
            if not (self._meet(body, start, met) or wrong):
                break
        if shorter and self._stops_late(dt):
            state.restore(body)
            return None
        force, work, held = [0.0] * AXES, 0.0, 0.0
        for k, (point, secant, x) in enumerate(met):
            delta = _minus(place(body.x, point, self.arm_m), x)
            held += end_J(secant, delta)
            pushed = self._force(k)
            work += dot(3, pushed, delta)
            for i in range(3):
                force[i] += pushed[i]
                for j in range(3):
                    force[3 + 3 * j + i] += point[j] / self.arm_m * pushed[i]
        self.energy_J = min(max(held, self.energy_J - work), held + ANCHOR_CEILING_J)
        return tuple(force), work

    def _meet(self, body: RigidBody, start: list[Met], met: list[Met]) -> bool:
        """Append to `met` the planes that the displacement meets for the first time; return whether there are any."""
        before, known = len(met), {id(secant) for _, secant, _ in met}
        for point, secant, x in start:
            if id(secant) in known or len(met) == MOST:
                continue
            delta = _minus(place(body.x, point, self.arm_m), x)
            if secant.meets(x, delta, hypot(*delta)):
                met.append((point, secant, x))
        return len(met) > before

    def _anchor(self, met: list[Met]) -> None:
        """Scale the depths down if the energy does not suffice for them."""
        true_J = added(onset_J(secant) for _, secant, _ in met)
        self.scale = 1.0
        if true_J > self.energy_J:
            self.scale = sqrt(self.energy_J / true_J)
            for _, secant, _ in met:
                if secant.depth > 0.0:
                    secant.depth *= self.scale

    def _step(self, body: RigidBody, state: BodyState, dt: float, ybar: Vector, push: Vector, met: list[Met]) -> bool:
        """Do the step against these planes, with their friction."""
        planes = self._planes
        planes.count = len(met)
        resistance = 2.0 * body.mass / dt + body.damping + 0.5 * body.stiffness * dt
        for k, (point, secant, _) in enumerate(met):
            planes.places[k][:], planes.normals[k][:] = point, secant.normal
            planes.depths[k], planes.stiffnesses[k] = secant.depth, secant.stiffness
            planes.dampings[k], planes.frictions[k] = secant.damping, secant.friction
            planes.creeps[k] = CREEP / resistance
            planes.rubs[k][:] = _STILL[:3]
            if secant.friction > 0.0:
                begun = place(state.v, point, self.arm_m, home=False)
                planes.least[k] = 0.5 * hypot(*tangential(begun, triple(secant.normal)))
        state.restore(body)
        return step(body, dt, push, ybar, planes)

    def _stops_late(self, dt: float) -> bool:
        """Whether friction stopped a point that slid: it then moves on by half of its speed until the step ends."""
        planes = self._planes
        for k in range(planes.count):
            if planes.least[k] * dt > STOPS_M and planes.pushes[k] < 0.0:
                grip = -planes.frictions[k] * planes.pushes[k] * hypot(*planes.normals[k])
                if grip > 0.0 and hypot(*planes.rubs[k]) < 0.999 * grip:
                    return True
        return False

    def _force(self, k: int) -> Vector:
        """The force of a plane on its point in the step: push along the normal, and friction across it [N]."""
        planes = self._planes
        push, n, rub = planes.pushes[k], planes.normals[k], planes.rubs[k]
        return (push * n[0] + rub[0], push * n[1] + rub[1], push * n[2] + rub[2])


_STILL: Vector = (0.0,) * AXES


def rigid_plane(
    x: Sequence[float], arm_m: float, r: Sequence[float], normal: Vector, distance: float, stiffness: float,
    damping: float, speed: float = 0.0,
) -> Plane:  # fmt: skip
    """A plane in the coordinates of a pose, as it acts on a rigid body.

    It touches the body at r (3,) from the pose's point, with the unit `normal` n (3,) into the solid, `distance` [m]
    away. Its gradient there is ``(n, a_j n/l)``; only the part along rigid motions does work:
    ``(n, (r x n) x P_j/(2 l^2))``. stiffness [N/m], damping [Ns/m], speed [m/s] : along n.
    """
    turned = np.cross(np.cross(np.array(r), np.array(normal)), arms(x, arm_m)) / (2.0 * arm_m * arm_m)
    N = np.concatenate([normal, turned.ravel()])
    size = float(np.linalg.norm(N))
    unit = tuple((N / size).tolist())
    offset = dot(AXES, unit, x) + distance / size
    return Plane(unit, offset, stiffness * size * size, damping * size * size, speed / size)


def different(planes: Iterable[Plane]) -> tuple[Plane, ...]:
    """The first `MOST_TOOL_PLANES` planes of different directions, in their order; planes like these fill the rest.

    A peg in a hole touches with a dozen neighbouring points. If all planes were of one side, the device could leave by
    the others.
    """
    chosen, alike = list[Plane](), list[Plane]()
    for plane in planes:
        is_alike = any(inner(plane.normal, other.normal) > ALIKE for other in chosen)
        (alike if is_alike else chosen).append(plane)
        if len(chosen) == MOST_TOOL_PLANES:
            break
    return (*chosen, *alike[: MOST_TOOL_PLANES - len(chosen)])


def _minus(one: Vector, other: Vector) -> Vector:
    return (one[0] - other[0], one[1] - other[1], one[2] - other[2])
