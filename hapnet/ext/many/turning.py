"""Blocks that turn: their contacts are those of points with faces, solved together, exactly in energy.

R is a block's orientation, pi = I omega its angular momentum in its own axes, in which I is diagonal. With the mean
angular velocity W (in the block's axes) a step of length T is

    pi' - pi = T (I W x W + tau - b_r W),    pi' + pi = 2 I W
    R' = R C,    C = (1 - T/2 [W])^-1 (1 + T/2 [W])                                                 Cayley's map

Free, it keeps energy and angular momentum, R pi, for any T. A point at r from the block's centre has the place
q = R^T r in its axes. With Rm = (R + R')/2 and the mean rm of r, as R' - R = T Rm [W],

    (q' - q)/T = Rm^T dr/dt - W x pm,    pm = Rm^T rm

is exact, and linear in the velocities if Rm and pm are given. So the depth behind a face, and the way across it, obey
the same laws as those of blocks that do not turn (`hapnet.ext.many.balance`): a force g in the block's axes pushes the
point with Rm g and turns the block with -pm x g, and its work is g . (q' - q). Rm, pm, I W x W and the limits of
friction are found by one fixed point over these balances. A step in which it does not settle, and that would give out
energy, is made without turning: then all blocks stop turning, and its balance is exact.

The points are the proxies, and the corners of each block at the faces of the others; edges do not meet edges.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product
from math import inf
from typing import NamedTuple

import numpy as np

from hapnet.checks import Array, Vector
from hapnet.ext.many.balance import Contact, Firmness, Row, Rub, balance
from hapnet.ext.many.blocks import Block, BlockFace, Blocks, Free, depth_behind, face_of, gap_to, is_at, key_of
from hapnet.records.vectors import added

_ROUNDS = 40
"""The most rounds for Rm and pm; 4 to 10 are usual."""

_WHOLE = 20
"""So many rounds take the last round's velocities; after them the mean of the last two, for contacts that come and go
from round to round."""

_SETTLED = 1e-12
"""A change of the velocities or limits below this share of the largest counts as 0."""

_ROUNDING = 1e-13
"""Energy that is missing in a step below this share of what is stored, or so many joules, is rounding."""

_NEAR_M = 0.02
"""A corner that is farther from a face, beyond its way in a step, is left out [m]."""

_INSET_M = 1e-6
"""The corners are so far inside, so that those of equal blocks side by side are at each other's faces [m]."""

_NO_SIZE: Vector = (0.0, 0.0, 0.0)


class _Point(NamedTuple):
    """A point that may touch a block: its key in `Blocks._faces`, the number of its body, its place in that body's axes
    (3,) [m], the block's number, the face and the depth [m]."""

    key: tuple[int, ...]
    body: int
    place: Array
    block: int
    face: BlockFace
    depth: float


class TurningBlocks(Blocks):
    """`Blocks` of three axes, of which some turn (`Block.turns`).

    Attributes: quaternions, w, x, y, z of each block; spins, omega of each in its own axes (3,) [rad/s]; stopped, the
    number of steps without turning.
    """

    def __init__(self, blocks: Sequence[Block], stiffness: float, damping: float) -> None:
        super().__init__(blocks, stiffness, damping)
        self.quaternions: list[Vector] = [(1.0, 0.0, 0.0, 0.0)] * len(self.blocks)
        self.spins: list[Array] = [np.zeros(3) for _ in blocks]
        self.stopped = 0
        self._inertia = [_inertia(block) for block in self.blocks]
        self._corners = [
            [
                np.array([way * (half - _INSET_M) for way, half in zip(ways, block.half, strict=True)])
                for ways in product((-1.0, 1.0), repeat=3)
            ]
            for block in self.blocks
        ]

    def solve(self, dt: float, proxies: Mapping[int, Free]) -> dict[int, Vector]:
        before_J = self.stored_J({name: free.position for name, free in proxies.items()})
        was = self.x, self.v, self.quaternions, self._faces, self._stretches
        self.x, self.v, self.quaternions = list(self.x), list(self.v), list(self.quaternions)
        forces, work_J, after_J = self._attempt(dt, proxies, turns=True)
        if not work_J - (after_J - before_J) >= -_ROUNDING * (1.0 + before_J):  # also for NaN
            self.x, self.v, self.quaternions, self._faces, self._stretches = was
            self.spins = [np.zeros(3) for _ in self.blocks]
            self.stopped += 1
            forces, _, _ = self._attempt(dt, proxies, turns=False)
        return forces

    def _attempt(
        self, dt: float, proxies: Mapping[int, Free], *, turns: bool
    ) -> tuple[dict[int, Vector], float, float]:
        """Make a step, and return the forces on the proxies [N], their work, and what is stored afterwards [J]."""
        names, count = list(proxies), len(proxies)
        w, a = self._free(dt, proxies, turns=turns)
        frames = [_matrix(q) for q in self.quaternions]
        places = [np.array(free.position) for free in proxies.values()] + [np.array(x) for x in self.x]
        points = self._points(dt, names, places, frames)
        firm = Firmness(self.stiffness, self.damping, dt)
        guess, limits = self._guess(proxies), np.zeros(0)

        def law(contact: Contact, u: float) -> tuple[float, float]:
            return self._push(contact, u, dt)

        for number in range(_ROUNDS):
            self._gyrate(w, a, guess, dt, count)
            means = [np.eye(3)] * count
            means += [_mean(frame, guess[_spin(count + k)], dt) for k, frame in enumerate(frames)]
            rows = [self._rows(point, places, frames, means, guess, dt, count) for point in points]
            contacts, rubs = self._parts(points, rows, count)
            limits = limits if number else np.zeros(len(rubs))
            force, frictions, pushed = balance(w, a, contacts, law, rubs, firm, (guess, limits))
            vhat = w + force / a
            moved, changed = np.abs(vhat - guess).max(), np.abs(pushed - limits).max(initial=0.0)
            if moved <= _SETTLED * np.abs([vhat, w]).max() and changed <= _SETTLED * np.abs(force).max():
                break
            mixed = 1.0 if number < _WHOLE else 0.5
            guess, limits = guess + mixed * (vhat - guess), limits + mixed * (pushed - limits)
        self._faces = {point.key: point.face for point in points}
        self._stretches = {
            points[rub.contact].key: firm.stretched(rub.stretch, friction)
            for rub, friction in zip(rubs, frictions, strict=True)
        }
        self._move(vhat, dt, count)
        forces = {name: tuple(force[6 * k : 6 * k + 3].tolist()) for k, name in enumerate(names)}
        ways = [dt * vhat[6 * k : 6 * k + 3] for k in range(count)]
        after = {name: tuple((place + way).tolist()) for name, place, way in zip(names, places, ways, strict=False)}
        work_J = -added([float(np.dot(forces[name], way)) for name, way in zip(names, ways, strict=True)])
        return forces, work_J, self.stored_J(after)

    def _free(self, dt: float, proxies: Mapping[int, Free], *, turns: bool) -> tuple[Array, Array]:
        """w and a of all bodies, six degrees of freedom each; the turning of w is left to `_gyrate`."""
        total = 6 * (len(proxies) + len(self.blocks))
        w, a = np.zeros(total), np.full(total, inf)
        for k, free in enumerate(proxies.values()):
            w[6 * k : 6 * k + 3], a[6 * k : 6 * k + 3] = free.velocity, free.resistance
        for k, block in enumerate(self.blocks):
            if block.mass_kg:
                here = 6 * (len(proxies) + k)
                a[here : here + 3] = 2.0 * block.mass_kg / dt + block.drag_Ns_m + 0.5 * block.spring_N_m * dt
                moved = np.subtract(self.x[k], block.home)
                c = 2.0 * block.mass_kg / dt * np.array(self.v[k]) - block.spring_N_m * moved
                c[-1] -= block.mass_kg * block.gravity
                w[here : here + 3] = c / a[here : here + 3]
                if block.turns and turns:
                    a[here + 3 : here + 6] = 2.0 / dt * self._inertia[k] + _drag(block)
        return w, a

    def _guess(self, proxies: Mapping[int, Free]) -> Array:
        """The velocities at the step's start."""
        found = [np.array([*free.velocity, *_NO_SIZE]) for free in proxies.values()]
        found += [np.array([*v, *spin]) for v, spin in zip(self.v, self.spins, strict=True)]
        return np.concatenate(found)

    def _gyrate(self, w: Array, a: Array, vhat: Array, dt: float, count: int) -> None:
        """Set the angular velocities without contact, with I W x W of the last round."""
        for k, block in enumerate(self.blocks):
            if block.turns and block.mass_kg:
                here, inertia = _spin(count + k), self._inertia[k]
                mean = vhat[here]
                w[here] = (2.0 / dt * inertia * self.spins[k] + _skew(inertia * mean) @ mean) / a[here]

    def _points(
        self, dt: float, names: Sequence[int], places: Sequence[Array], frames: Sequence[Array]
    ) -> list[_Point]:
        """The points that may touch a block in the step."""
        found, count = [], len(names)
        for k, block in enumerate(self.blocks):
            for body, name in enumerate(names):
                found += self._point((name, k, 0), body, np.zeros(3), places[body], k, places[count + k], frames[k])
            for j, other in enumerate(self.blocks):
                if j == k or not (block.mass_kg or other.mass_kg):
                    continue
                speed = float(np.abs(np.array([self.v[k], self.v[j], self.spins[k], self.spins[j]])).sum())
                reach = _NEAR_M + 2.0 * dt * speed
                if gap_to(places[count + j].tolist(), self.x[k], _NO_SIZE) > reach + added(block.half) + added(
                    other.half
                ):
                    continue
                for number, corner in enumerate(self._corners[j]):
                    at = places[count + j] + frames[j] @ corner
                    key = (key_of(j), k, number)
                    near = self._point(key, count + j, corner, at, k, places[count + k], frames[k])
                    found += [one for one in near if one.depth > -reach]
        return found

    def _point(
        self, key: tuple[int, ...], body: int, place: Array, at: Array, k: int, centre: Array, frame: Array
    ) -> list[_Point]:
        q, half = tuple((frame.T @ (at - centre)).tolist()), self.blocks[k].half
        face = face_of(self._faces.get(key), q, _NO_SIZE, half)
        return [] if face is None else [_Point(key, body, place, k, face, depth_behind(face, q, _NO_SIZE, half))]

    def _rows(
        self,
        point: _Point,
        places: Sequence[Array],
        frames: Sequence[Array],
        means: Sequence[Array],
        vhat: Array,
        dt: float,
        count: int,
    ) -> list[Row]:
        """(q' - q)/T of a point along each axis of the block, as rows of the velocities."""
        body, block = point.body, count + point.block
        frame = frames[body - count] if body >= count else np.eye(3)
        start = places[body] + frame @ point.place - places[block]
        moved = means[body] @ (_skew(vhat[_spin(body)]) @ point.place)
        rate = vhat[6 * body : 6 * body + 3] + moved - vhat[6 * block : 6 * block + 3]
        middle = means[block].T @ (start + 0.5 * dt * rate)
        axes = means[block].T
        own = np.hstack([axes, -axes @ means[body] @ _skew(point.place)])  # as a row, r x u is -u [r]
        other = np.hstack([-axes, _skew(middle)])
        return [
            [
                *((6 * body + i, x) for i, x in enumerate(one) if x),
                *((6 * block + i, x) for i, x in enumerate(two) if x),
            ]
            for one, two in zip(own.tolist(), other.tolist(), strict=True)
        ]

    def _parts(
        self, points: Sequence[_Point], rows: Sequence[list[Row]], count: int
    ) -> tuple[list[Contact], list[Rub]]:
        contacts, rubs = [], []
        for number, (point, of_axes) in enumerate(zip(points, rows, strict=True)):
            block, axis, side = self.blocks[point.block], point.face.axis, point.face.side
            other = self.blocks[point.body - count] if point.body >= count else None
            approach = [(k, -side * x) for k, x in of_axes[axis]]
            contacts.append(Contact(approach, point.depth, block.limit_N if other is None else inf))
            if (mu := max(block.friction, 0.0 if other is None else other.friction)) > 0.0:
                across = [row for k, row in enumerate(of_axes) if k != axis]
                rubs.append(Rub(number, mu, across, self._stretch(point.key, point.face)))
        return contacts, rubs

    def _move(self, vhat: Array, dt: float, count: int) -> None:
        for k, block in enumerate(self.blocks):
            if block.mass_kg:
                here = 6 * (count + k)
                mean, turn = vhat[here : here + 3], vhat[here + 3 : here + 6]
                self.x[k] = tuple((np.array(self.x[k]) + dt * mean).tolist())
                self.v[k] = tuple((2.0 * mean - np.array(self.v[k])).tolist())
                if block.turns:
                    self.quaternions[k] = _turned(self.quaternions[k], 0.5 * dt * turn)
                    self.spins[k] = 2.0 * turn - self.spins[k]

    def _kinetic_J(self) -> float:
        total = 0.0
        for block, inertia, v, spin in zip(self.blocks, self._inertia, self.v, self.spins, strict=True):
            total += 0.5 * block.mass_kg * float(np.dot(v, v)) + 0.5 * float(spin @ (inertia * spin))
        return total

    def stored_J(self, places: Mapping[int, Vector]) -> float:
        total, frames = self._kinetic_J(), [_matrix(q) for q in self.quaternions]
        for block, x in zip(self.blocks, self.x, strict=True):
            moved = np.subtract(x, block.home)
            total += 0.5 * block.spring_N_m * float(moved @ moved) + block.mass_kg * block.gravity * float(moved[-1])
        for key, face in self._faces.items():
            (name, k, corner), j = key, key_of(key[0])  # j: below 0 for a proxy
            place = self.x[j] + frames[j] @ self._corners[j][corner] if j >= 0 else places.get(name)
            if place is None:
                continue
            q = tuple((frames[k].T @ np.subtract(place, self.x[k])).tolist())
            if is_at(face, q, _NO_SIZE, self.blocks[k].half):  # else the next step drops it, and its energy is lost
                limit = inf if j >= 0 else self.blocks[k].limit_N
                total += self._potential_J(depth_behind(face, q, _NO_SIZE, self.blocks[k].half), limit)
                if (stretch := self._stretches.get(key)) is not None:
                    total += 0.5 * self.stiffness * float(stretch @ stretch)
        return total

    def clearance(self, place: Sequence[float]) -> float:
        gaps = []
        for block, x, q in zip(self.blocks, self.x, self.quaternions, strict=True):
            gaps.append(gap_to((_matrix(q).T @ np.subtract(place, x)).tolist(), _NO_SIZE, block.half))
        return min(gaps)


def _spin(body: int) -> slice:
    """The numbers of a body's turning degrees of freedom."""
    return slice(6 * body + 3, 6 * body + 6)


def _inertia(block: Block) -> Array:
    """Of a uniform box about its centre, along its axes [kg m^2]."""
    x, y, z = (half * half for half in block.half)
    return block.mass_kg / 3.0 * np.array([y + z, z + x, x + y])


def _drag(block: Block) -> float:
    """b_r [Nms/rad]: that of its drag at the mean distance of its faces from its centre."""
    x, y, z = block.half
    return block.drag_Ns_m * (x * x + y * y + z * z) / 3.0


def _matrix(q: Sequence[float]) -> Array:
    """R of a unit quaternion."""
    w, x, y, z = q
    return np.array([
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ])  # fmt: skip


def _mean(frame: Array, spin: Array, dt: float) -> Array:
    """(R + R')/2 = R (1 - T/2 [W])^-1."""
    mean: Array = frame @ np.linalg.inv(np.eye(3) - _skew(0.5 * dt * spin))
    return mean


def _skew(vector: Array) -> Array:
    """[a], with which [a] b is a x b."""
    x, y, z = vector.tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def _turned(q: Sequence[float], half: Array) -> Vector:
    """The quaternion of R C, where `half` is T/2 W."""
    w, v = q[0], np.array(q[1:])
    found = np.array([w - v @ half, *(w * half + v + np.cross(v, half))])
    return tuple((found / np.linalg.norm(found)).tolist())
