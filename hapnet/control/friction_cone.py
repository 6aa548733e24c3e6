"""Where the proxy rests among planes that rub.

Beside the push f_i along its normal each plane holds the proxy with a traction t_i across it, |t_i| <= mu_i f_i:

    s = x - K'^-1 sum (f_i n_i + t_i)

t_i keeps s from moving across the normal, away from where it rested before; beyond the cone it is mu_i f_i in that
direction (Coulomb's law, a god-object with a friction cone: Harwin, Melder 2002). The place before is the whole state.
In free motion it is the device's own, so contact begins without strain, and a proxy that sticks does not drift.

The world's proxy sticks and slides by the same law, but later, and where the hand was predicted to be. So the two may
stick at places that are a little apart. If they are far apart, as on an object that moves along its surface, the place
here follows the world's.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import hypot
from operator import sub

from hapnet.checks import Vector
from hapnet.control.contact_plane import SAME_COSINE, ContactPlane, along
from hapnet.records.record import Reals
from hapnet.records.vectors import added, inner

SWEEPS = 8
"""The most Gauss-Seidel sweeps over the planes at a tick; the next tick goes on from there."""

SETTLED_N = 1e-4
"""A sweep that changes no force by more than this [N] is the last."""

AGREE_M, AGREE_S = 2e-3, 0.3
"""The places may be so far apart [m]; if they are farther, that goes with this time constant [s]."""


class RubbingProxy:
    """The proxy of the local contact model, among planes of which some rub.

    compliance : K'^-1 of the world's virtual coupling, (n, n) [m/N].
    """

    def __init__(self, compliance: Sequence[Reals]) -> None:
        self._give = max([added(map(abs, row)) for row in compliance])
        """At least the largest eigenvalue [m/N]."""
        softest = compliance[0][0]
        self._is_isotropic = all(
            part == (softest if i == j else 0.0) for i, row in enumerate(compliance) for j, part in enumerate(row)
        )
        self.reset((0.0,) * len(compliance))

    def reset(self, position: Vector) -> None:
        """It touches nothing, at `position` [m]."""
        self.place: Vector = position
        """Where it rested before: s of the last tick [m]."""
        self.rubs: bool = False
        """Does any of the planes rub?"""
        self._worlds: Vector | None = None
        self._forces: list[float] = []
        self._tractions: list[Vector] = []
        self._normals: tuple[Reals, ...] = ()

    def reported(self, planes: Sequence[ContactPlane], place: Vector | None) -> None:
        """The world's planes are these now, and its own proxy rested at `place` [m]; None: it touched nothing."""
        self.rubs = any(one.friction for one in planes)
        self._worlds = place
        known = list(zip(self._normals, self._forces, self._tractions, strict=True))
        self._forces, self._tractions = [0.0] * len(planes), [(0.0,) * len(self.place)] * len(planes)
        for i, one in enumerate(planes):
            for normal, force, traction in known:
                if inner(normal, one.normal) > SAME_COSINE:
                    self._forces[i], self._tractions[i] = force, traction
        self._normals = tuple([one.normal for one in planes])

    def agree(self, dt: float) -> None:
        """If the world's proxy was far away along the surfaces, come nearer to it for `dt` seconds."""
        if self._worlds is None or not self.rubs:
            return
        away = tuple(map(sub, self._worlds, self.place))
        for normal, force in zip(self._normals, self._forces, strict=True):
            if force:
                away = _across(away, normal)
        if (far := hypot(*away)) > AGREE_M:
            self.place = along(self.place, away, dt / (AGREE_S + dt) * (1.0 - AGREE_M / far))

    def rest(
        self, x: Vector, planes: Sequence[ContactPlane], shift: Vector, age: float, rounds: int
    ) -> tuple[Vector, bool]:
        """s [m] for the device at x [m], and whether it touches anything there.

        shift : of all planes [m]. age : of the planes [s]. rounds : how often surfaces that bend are seen anew, first
            from where the proxy was.
        """
        s = self.place
        for _ in range(rounds if any(one.curvatures for one in planes) else 1):
            place = tuple(map(sub, s, shift))
            planes = [one.seen_from(place, age) for one in planes]
            s = self._rest_on(x, planes, shift, age)
        self._normals = tuple([one.normal for one in planes])
        return s, any(self._forces)

    def _rest_on(self, x: Vector, planes: Sequence[ContactPlane], shift: Vector, age: float) -> Vector:
        """`rest` on flat planes, from the forces that were found last."""
        forces, tractions = self._forces, self._tractions
        s = x
        for one, force, traction in zip(planes, forces, tractions, strict=True):
            if force:
                s = tuple(map(sub, along(s, one.response, -force), one.given(traction)))
        for _ in range(1 if self._is_isotropic and len(planes) == 1 else SWEEPS):
            most = 0.0
            for i, one in enumerate(planes):
                known, held = forces[i], tractions[i]
                depth = inner(one.normal, map(sub, s, shift)) - one.now(age)
                force = max(0.0, known + (depth - known / one.stiffness) / one.softness)
                if force != known:
                    forces[i] = force
                    s = along(s, one.response, known - force)
                    most = max(most, abs(force - known))
                if one.friction and (force or known):
                    path = map(sub, s, self.place)
                    wanted = _across(tuple([t + d / self._give for t, d in zip(held, path, strict=True)]), one.normal)
                    if (size := hypot(*wanted)) > (limit := one.friction * force):
                        wanted = tuple([limit / size * part for part in wanted])
                    change = tuple(map(sub, wanted, held))
                    tractions[i] = wanted
                    s = tuple(map(sub, s, one.given(change)))
                    most = max(most, hypot(*change))
            if most <= SETTLED_N:
                break
        return s


def _across(vector: Vector, normal: Reals) -> Vector:
    return along(vector, normal, -inner(normal, vector))
