"""The proxy's resting place among planes with friction.

Beside the push f_i along its normal, each plane holds the proxy with a tangential traction t_i, |t_i| <= mu_i f_i:

    s = x - K'^-1 sum (f_i n_i + t_i)

t_i keeps s from moving tangentially, away from its last resting place; beyond the cone it is mu_i f_i in that direction
(Coulomb's law, a god-object with a friction cone: Harwin, Melder 2002). The last resting place is the whole state. A
surface that sticks has a second, wider cone: beyond it the proxy slips at once, until mu_i f_i holds it again. In free
motion the resting place is the device's position: contact begins without strain, and a sticking proxy does not drift.

The world's proxy sticks and slides by the same law, but later, and near the predicted hand. So the two proxies may
stick at slightly different places. If these are far apart, as on an object that moves along its surface, the place
here follows the world's. The uncertainty of a moving proxy's place is its travel since the answer.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from hapnet.checks import Vector
from hapnet.control.contact_plane import SAME_COSINE, ContactPlane, no_planes, now, see_from
from hapnet.records.record import (
    PLANES,
    FloatRows,
    Floats,
    MatrixOfAxes,
    OfAxes,
    OfPlanes,
    Reals,
    Record,
    VectorsOfPlanes,
    equation,
)
from hapnet.records.vectors import added, copy, dot, length, times

SWEEPS = 8
"""The most Gauss-Seidel sweeps over the planes in a tick; the next tick continues from there."""

SETTLED_N = 1e-4
"""A sweep that changes no force by more than this [N] is the last."""

AGREE_M, AGREE_S = 2e-3, 0.3
"""The largest accepted distance between the two places [m], and the time constant with which any excess fades [s]."""

ROUNDS = 2
"""The number of times that tangent planes of curved surfaces are computed at the proxy's new resting place."""


class RubbingProxy(Record):
    """The proxy of the local contact model, if any of the planes has friction.

    compliance : K'^-1 of the world's virtual coupling, (n, n) [m/N]. position : its place at the start [m].

    give : an upper bound of the compliance's eigenvalues [m/N]; is_isotropic : whether all eigenvalues are the same.
    place : its last resting place: s of the last tick [m]. has_friction : whether any of the planes has friction.
    worlds : resting place of the world's proxy [m], if it touched a plane (`has_worlds`). travel : its travel since
        [m].
    count, normals, forces, tractions : of the planes, from the last tick. before to yielded: temporary memory.
    seen : the tangent planes.
    """

    compliance: MatrixOfAxes
    give: float
    is_isotropic: int
    place: OfAxes
    has_friction: int
    has_worlds: int
    worlds: OfAxes
    travel: float
    count: int
    normals: VectorsOfPlanes
    forces: OfPlanes
    tractions: VectorsOfPlanes
    seen: Annotated[Sequence[ContactPlane], (PLANES,)]
    before: OfPlanes
    before_tractions: VectorsOfPlanes
    away: OfAxes
    wanted: OfAxes
    yielded: OfAxes

    def __init__(self, compliance: FloatRows, position: Vector) -> None:
        super().__init__()
        n = len(position)
        self.worlds, self.away, self.wanted, self.yielded = ([0.0] * n for _ in range(4))
        self.normals = [[0.0] * n for _ in range(PLANES)]
        self.tractions = [[0.0] * n for _ in range(PLANES)]
        self.before_tractions = [[0.0] * n for _ in range(PLANES)]
        self.seen = no_planes(compliance, n)
        self.compliance = compliance
        self.give = max([added(map(abs, row)) for row in compliance])
        softest = compliance[0][0]
        self.is_isotropic = int(
            all(part == (softest if i == j else 0.0) for i, row in enumerate(compliance) for j, part in enumerate(row))
        )
        self.reset(position)

    def reset(self, position: Vector) -> None:
        """Start again at `position` [m], without contact."""
        self.place = list(position)
        self.has_friction = self.has_worlds = self.count = 0
        self.travel = 0.0


@equation
def take_planes(
    proxy: RubbingProxy, planes: Sequence[ContactPlane], count: int, n: int, touched: bool, place: Reals, travel: float
) -> None:
    """Take in the world's planes. If the world's proxy touched anything, it rested at `place` [m], and has moved by at
    most `travel` [m] since."""
    proxy.has_friction, proxy.has_worlds, proxy.travel = 0, int(touched), travel
    copy(n, place, proxy.worlds)
    copy(proxy.count, proxy.forces, proxy.before)
    for k in range(proxy.count):
        copy(n, proxy.tractions[k], proxy.before_tractions[k])
    for i in range(count):
        one = planes[i]
        if one.friction + one.grip != 0.0:
            proxy.has_friction = 1
        proxy.forces[i] = 0.0
        for j in range(n):
            proxy.tractions[i][j] = 0.0
        for k in range(proxy.count):
            if dot(n, proxy.normals[k], one.normal) > SAME_COSINE:
                proxy.forces[i] = proxy.before[k]
                copy(n, proxy.before_tractions[k], proxy.tractions[i])
    proxy.count = count
    for i in range(count):
        copy(n, planes[i].normal, proxy.normals[i])


@equation
def agree(proxy: RubbingProxy, planes: Sequence[ContactPlane], n: int, dt: float) -> None:
    """If the world's proxy is far away along the surfaces, move the place towards it, for a tick of `dt` seconds."""
    if not (proxy.has_worlds and proxy.has_friction):
        return
    away, apart = proxy.away, AGREE_M + proxy.travel
    for i in range(n):
        away[i] = proxy.worlds[i] - proxy.place[i]
    for k in range(proxy.count):
        if proxy.forces[k] != 0.0:
            _take_across(n, away, proxy.normals[k])
            apart += planes[k].grip * proxy.forces[k] * proxy.give
    far = length(n, away)
    if far > apart:
        share = dt / (AGREE_S + dt) * (1.0 - apart / far)
        for i in range(n):
            proxy.place[i] = proxy.place[i] + share * away[i]


@equation
def rest(
    proxy: RubbingProxy, planes: Sequence[ContactPlane], n: int, x: Reals, shift: Reals, age: float, s: Floats
) -> bool:
    """Compute s [m] for the device at x [m]; returns whether the proxy touches anything there. shift : of all planes
    [m]. age : of the planes [s]. Tangent planes of curved surfaces are those at the last resting place."""
    bends = False
    for i in range(n):
        proxy.away[i] = proxy.place[i] - shift[i]
    for k in range(proxy.count):
        see_from(planes[k], n, proxy.compliance, proxy.away, age, proxy.seen[k])
        bends = bends or planes[k].bends.count > 0
        copy(n, proxy.seen[k].normal, proxy.normals[k])
    for _ in range(ROUNDS if bends else 1):
        _rest_on(proxy, n, x, shift, age, s)
    touches = False
    for k in range(proxy.count):
        touches = touches or proxy.forces[k] != 0.0
    return touches


@equation
def _rest_on(proxy: RubbingProxy, n: int, x: Reals, shift: Reals, age: float, s: Floats) -> None:
    """Solve `rest` on flat planes, starting from the last forces."""
    forces, tractions, wanted, yielded = proxy.forces, proxy.tractions, proxy.wanted, proxy.yielded
    copy(n, x, s)
    for k in range(proxy.count):
        if forces[k] != 0.0:
            times(n, proxy.compliance, tractions[k], yielded)
            for i in range(n):
                s[i] = s[i] + -forces[k] * proxy.seen[k].response[i] - yielded[i]
    for _ in range(1 if proxy.is_isotropic and proxy.count == 1 else SWEEPS):
        most = 0.0
        for k in range(proxy.count):
            one, known, held = proxy.seen[k], forces[k], tractions[k]
            along = 0.0
            for i in range(n):
                along += one.normal[i] * (s[i] - shift[i])
            force = max(0.0, known + (along - (now(one, age) - one.raised) - known / one.stiffness) / one.softness)
            if force != known:
                forces[k] = force
                for i in range(n):
                    s[i] = s[i] + (known - force) * one.response[i]
                most = max(most, abs(force - known))
            if one.friction + one.grip != 0.0 and (force != 0.0 or known != 0.0):
                for i in range(n):
                    wanted[i] = held[i] + (s[i] - proxy.place[i]) / proxy.give
                _take_across(n, wanted, one.normal)
                size, limit = length(n, wanted), one.friction * force
                slips = size > (one.friction + one.grip) * force
                for i in range(n):
                    if slips:
                        wanted[i] = limit / size * wanted[i]
                    proxy.away[i] = wanted[i] - held[i]
                    held[i] = wanted[i]
                times(n, proxy.compliance, proxy.away, yielded)
                for i in range(n):
                    s[i] = s[i] - yielded[i]
                most = max(most, length(n, proxy.away))
        if most <= SETTLED_N:
            break


@equation
def _take_across(n: int, vector: Floats, normal: Reals) -> None:
    """Remove the part of `vector` along `normal`."""
    along = dot(n, normal, vector)
    for i in range(n):
        vector[i] = vector[i] + -along * normal[i]
