"""Blocks that several hands push: their contacts and their motion are solved together, exactly in energy.

A block is a box that translates on n axes, with a mass m, a drag b, a spring k to its home, and a weight m g. Over a
step of length T its mean velocity vhat obeys the midpoint rule, as the proxies do (`hapnet.plant.integrator`, (12)):

    a vhat = c + f,    a = 2m/T + b + k T/2,    c = 2m/T v - k (x - home) - m g

All faces are perpendicular to the axes, so with a diagonal A the axes are independent, and on each of them a proxy or a
block is a resistance a and a velocity w = c/a that it would have without contact. A contact pushes two of them apart
with a force F(u), which depends on their approach velocity u and never falls with it. So the velocities of a step are
the minimum of a strictly convex function,

    sum a/2 (vhat - w)^2 + sum Phi(u),    dPhi/du = F

found by a semismooth Newton method (`hapnet.ext.many.balance`, with friction too). F is the discrete gradient of the
contact's potential U(p) of the depth p, and a damper for the part of the path that is inside, so F u T is the change of
U and the loss of the damper for any T. U rises as K p^2/2, and beyond the force limit in a straight line: no hand
pushes with more, whatever it does. So the blocks and the springs between all bodies give out no more energy than all
hands together have put in.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import inf
from typing import NamedTuple

import numpy as np

from hapnet.checks import Array, Vector
from hapnet.errors import InvalidParameter
from hapnet.ext.many.balance import Contact, Firmness, Rub, balance
from hapnet.records.vectors import inner

_NO_WAY_M = 1e-12
"""A shorter path is rounding."""


class Block(NamedTuple):
    """A block. home : its centre at the start (n,) [m]. half : half of its size (n,) [m]. mass_kg, drag_Ns_m,
    spring_N_m : m, b, k; a block of mass 0 is fixed. limit_N : the largest force between a proxy and the block.
    friction : Coulomb's mu; between two blocks the larger one. gravity : g, against the last axis [m/s^2]. turns :
    whether it turns, which needs `hapnet.ext.many.turning`."""

    home: Vector
    half: Vector
    mass_kg: float
    drag_Ns_m: float
    spring_N_m: float
    limit_N: float = inf
    friction: float = 0.0
    gravity: float = 0.0
    turns: bool = False


class Free(NamedTuple):
    """A proxy before its contacts act: position (n,) [m], velocity w (n,) [m/s] that it would have without contact, and
    its resistance a on each axis (n,) [Ns/m]."""

    position: Vector
    velocity: Vector
    resistance: Vector


class BlockFace(NamedTuple):
    """The face through which something entered a block: the axis, the side (+1 or -1), and the depth that counts as 0
    [m]. What comes in through an edge is at first too deep, and no spring may push it out with energy that nobody put
    in."""

    axis: int
    side: float
    from_m: float


Pair = tuple[int, ...]
"""The numbers of a proxy or, by `key_of`, a block, and of a block that it may touch; of a corner too (`turning`)."""


class Blocks:
    """The blocks of a world, with the faces that proxies and blocks are in contact with.

    blocks : their homes are apart. stiffness, damping : of each contact, K_w [N/m] and B_w [Ns/m]. Proxies have
    numbers from 0 on.
    Attributes: x, v : position (n,) [m] and velocity (n,) [m/s] of each block.

    Raises InvalidParameter: two blocks overlap.
    """

    def __init__(self, blocks: Sequence[Block], stiffness: float, damping: float) -> None:
        self.blocks = tuple(blocks)
        self.n = len(self.blocks[0].home)
        self.stiffness, self.damping = stiffness, damping
        self.x = [block.home for block in blocks]
        self.v = [(0.0,) * self.n for _ in blocks]
        self._faces: dict[Pair, BlockFace] = {}
        self._stretches: dict[Pair, Array] = {}
        """The stretch of each contact's friction [m]."""
        for k, block in enumerate(self.blocks):
            for j in range(k):
                half = _sum(block.half, self.blocks[j].half)
                if gap_to(block.home, self.blocks[j].home, half) < 0.0:
                    raise InvalidParameter("at", block.home, f"a place outside the block at {self.blocks[j].home} m")

    def solve(self, dt: float, proxies: Mapping[int, Free]) -> dict[int, Vector]:
        """Make a step of `dt` seconds of all blocks, and return the force on each proxy (n,) [N]."""
        n, names = self.n, list(proxies)
        first = n * len(names)  # of the blocks' degrees of freedom
        w, a = np.zeros(first + n * len(self.blocks)), np.full(first + n * len(self.blocks), inf)
        for k, free in enumerate(proxies.values()):
            w[k * n : k * n + n], a[k * n : k * n + n] = free.velocity, free.resistance
        for k, block in enumerate(self.blocks):
            if block.mass_kg:
                here = slice(first + k * n, first + k * n + n)
                a[here] = 2.0 * block.mass_kg / dt + block.drag_Ns_m + 0.5 * block.spring_N_m * dt
                moved = np.subtract(self.x[k], block.home)
                c = 2.0 * block.mass_kg / dt * np.array(self.v[k]) - block.spring_N_m * moved
                c[-1] -= block.mass_kg * block.gravity
                w[here] = c / a[here]
        contacts, faces = self._contacts({name: free.position for name, free in proxies.items()})
        firm = Firmness(self.stiffness, self.damping, dt)
        rubs = self._rubs(contacts, faces)
        force, frictions, _ = balance(w, a, contacts, lambda contact, u: self._push(contact, u, dt), rubs, firm)
        vhat = w + force / a
        self._faces, pairs = faces, list(faces)
        self._stretches = {
            pairs[rub.contact]: firm.stretched(rub.stretch, friction)
            for rub, friction in zip(rubs, frictions, strict=True)
        }
        for k, block in enumerate(self.blocks):
            if block.mass_kg:
                mean = vhat[first + k * n : first + k * n + n].tolist()
                self.x[k] = tuple([x + dt * v for x, v in zip(self.x[k], mean, strict=True)])
                self.v[k] = tuple([2.0 * v - before for v, before in zip(mean, self.v[k], strict=True)])
        return {name: tuple(force[k * n : k * n + n].tolist()) for k, name in enumerate(names)}

    def _contacts(self, places: Mapping[int, Vector]) -> tuple[list[Contact], dict[Pair, BlockFace]]:
        """The contacts that may act in a step that begins with the proxies at these places, and their faces."""
        contacts, faces, first = [], dict[Pair, BlockFace](), len(places)
        zero = (0.0,) * self.n
        bodies = [(name, place, zero) for name, place in places.items()]
        bodies += [(k, self.x[k], block.half) for k, block in enumerate(self.blocks)]
        for number, (name, place, half) in enumerate(bodies):
            own = number - first  # below 0 for a proxy
            for k, block in enumerate(self.blocks):
                if own >= 0 and (own <= k or not (block.mass_kg or self.blocks[own].mass_kg)):
                    continue
                key = (key_of(own) if own >= 0 else name, k)
                both = _sum(half, block.half)
                face = face_of(self._faces.get(key), place, self.x[k], both)
                if face is not None:
                    faces[key] = face
                    depth = depth_behind(face, place, self.x[k], both)
                    one, other = number * self.n + face.axis, (first + k) * self.n + face.axis
                    approach = (one, -face.side), (other, face.side)
                    contacts.append(Contact(approach, depth, inf if own >= 0 else block.limit_N))
        return contacts, faces

    def _rubs(self, contacts: Sequence[Contact], faces: Mapping[Pair, BlockFace]) -> list[Rub]:
        """The friction of these contacts, which are in the order of their faces."""
        found = []
        for number, (contact, (pair, face)) in enumerate(zip(contacts, faces.items(), strict=True)):
            own, k = key_of(pair[0]), pair[1]  # own: below 0 for a proxy
            mu = max(self.blocks[k].friction, self.blocks[own].friction if own >= 0 else 0.0)
            if mu > 0.0 and self.n > 1:
                (one, _), (other, _) = contact.approach
                ways = [axis - face.axis for axis in range(self.n) if axis != face.axis]
                across = [((one + way, 1.0), (other + way, -1.0)) for way in ways]
                found.append(Rub(number, mu, across, self._stretch(pair, face)))
        return found

    def _stretch(self, pair: Pair, face: BlockFace) -> Array:
        """The stretch of a contact's friction so far [m]; 0 where it acts at another face now."""
        before, stretch = self._faces.get(pair), self._stretches.get(pair)
        is_same = before is not None and (before.axis, before.side) == (face.axis, face.side)
        return stretch if is_same and stretch is not None else np.zeros(self.n - 1)

    def stored_J(self, places: Mapping[int, Vector]) -> float:
        """The energy of all motion and all springs, with the proxies at these places (n,) [m]."""
        total = 0.0
        for block, x, v in zip(self.blocks, self.x, self.v, strict=True):
            moved = [a - b for a, b in zip(x, block.home, strict=True)]
            total += 0.5 * block.mass_kg * inner(v, v) + 0.5 * block.spring_N_m * inner(moved, moved)
            total += block.mass_kg * block.gravity * moved[-1]
        for (name, k), face in self._faces.items():
            own = key_of(name)  # below 0 for a proxy
            place = self.x[own] if own >= 0 else places.get(name)
            if place is not None:
                half = _sum(self.blocks[k].half, self.blocks[own].half) if own >= 0 else self.blocks[k].half
                if is_at(face, place, self.x[k], half):  # else the next step drops it, and its energy is lost
                    limit = inf if own >= 0 else self.blocks[k].limit_N
                    total += self._potential_J(depth_behind(face, place, self.x[k], half), limit)
                    if (stretch := self._stretches.get((name, k))) is not None:
                        total += 0.5 * self.stiffness * float(stretch @ stretch)
        return total

    def _potential_J(self, depth: float, limit: float) -> float:
        """U at a depth [m]."""
        if depth <= 0.0:
            return 0.0
        if self.stiffness * depth <= limit:
            return 0.5 * self.stiffness * depth * depth
        return limit * (depth - 0.5 * limit / self.stiffness)

    def _push(self, contact: Contact, u: float, dt: float) -> tuple[float, float]:
        """F [N] at the approach velocity `u` [m/s], and dF/du [Ns/m]. As a difference of U, the mean force over a short
        path would be lost in rounding.
        """
        K, limit, before = self.stiffness, contact.limit, contact.depth
        after = before + dt * u
        inside = (before if before > 0.0 else 0.0), (after if after > 0.0 else 0.0)
        if not any(inside):
            return 0.0, 0.0
        mean, rate = min(K * inside[1], limit), 0.0
        if abs(after - before) > _NO_WAY_M:  # K p, and what is cut off of it below 0 and above the limit
            below, above = inside[0] - before, inside[1] - after
            over = [max(0.0, p - limit / K) for p in inside]
            cut = (below + above) * (below - above) - (over[0] + over[1]) * (over[1] - over[0])
            end, mean = mean, 0.5 * K * (before + after + cut / (after - before))
            rate = dt * (end - mean) / (after - before)
        elif mean < limit:
            rate = 0.5 * K * dt
        push = mean + self.damping * (inside[1] - inside[0]) / dt
        if not 0.0 < push < limit:
            return (limit, 0.0) if push > 0.0 else (0.0, 0.0)
        return push, rate + (self.damping if after > 0.0 else 0.0)

    def let_go(self, proxy: int) -> None:
        """End all contacts of a proxy; the energy of their springs is dissipated."""
        self._faces = {key: face for key, face in self._faces.items() if key[0] != proxy}
        self._stretches = {key: stretch for key, stretch in self._stretches.items() if key[0] != proxy}

    def clearance(self, place: Sequence[float]) -> float:
        """A distance from `place` (n,) [m] within which there is no block; below 0 inside a block."""
        return min(gap_to(place, x, block.half) for x, block in zip(self.x, self.blocks, strict=True))


def key_of(number: int) -> int:
    """The number of a block beside those of proxies, and back: below 0."""
    return -1 - number


def _sum(one: Vector, other: Vector) -> Vector:
    return tuple([a + b for a, b in zip(one, other, strict=True)])


def gap_to(place: Sequence[float], centre: Vector, half: Vector) -> float:
    """The largest distance on an axis from `place` to a box; below 0 inside."""
    return max([abs(x - c) - h for x, c, h in zip(place, centre, half, strict=True)])


def depth_behind(face: BlockFace, place: Sequence[float], centre: Vector, half: Vector) -> float:
    """The depth behind a face [m]."""
    return half[face.axis] - face.side * (place[face.axis] - centre[face.axis]) - face.from_m


def is_at(face: BlockFace, place: Sequence[float], centre: Vector, half: Vector) -> bool:
    """Whether `place` is in front of the face or behind it: what is beside the block will not be pushed any more."""
    ways = enumerate(zip(place, centre, half, strict=True))
    return all(abs(x - c) - h < 0.0 for axis, (x, c, h) in ways if axis != face.axis)


def face_of(before: BlockFace | None, place: Vector, centre: Vector, half: Vector) -> BlockFace | None:
    """The face between a box and what is at `place`; None: they may not touch in the next step."""
    if before is not None and is_at(before, place, centre, half) and depth_behind(before, place, centre, half) > 0.0:
        return before
    away = [x - c for x, c in zip(place, centre, strict=True)]
    gaps = [abs(d) - h for d, h in zip(away, half, strict=True)]
    nearest = max(range(len(gaps)), key=gaps.__getitem__)
    if any(gap >= 0.0 for axis, gap in enumerate(gaps) if axis != nearest):
        return None
    return BlockFace(nearest, 1.0 if away[nearest] >= 0.0 else -1.0, max(0.0, -gaps[nearest]))
