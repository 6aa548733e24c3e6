"""The posture in which an arm begins, if the user names none: near the middle between its stops, and not singular.

In a straight arm no joint moves the tip along the arm, so a force along it meets no motion. The measure of that is
`openness`: the smallest singular value of the tip's Jacobian, over the arm's reach. A search among evenly spread
postures looks for the nearest one with at least `OPEN`.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from hapnet.checks import Array, Vector
from hapnet.ext.arms.chain import Chain, difference, gravity
from hapnet.ext.arms.table import ArmTable, chain_of, felt_damping, home_of

OPEN = 0.1
"""A posture with a smaller `openness` is near a singular one."""

HEAVY_NSPM = 100.0
"""Joints that damp more at the tip, in every direction, hardly let a hand move it: a hand of 60 N/m takes seconds."""

_NONE = 1e-6
"""With an openness below this, no joint moves the tip."""

_RADII = (0.25, 0.5, 0.75, 1.0, 1.25, 1.5)
_TRIES = 48
_WITHIN = 0.9
_SAMPLES = 8


def open_home(table: ArmTable) -> Vector:
    """The home of a table: the middle between the stops (`home_of`), or the nearest posture found that is not near a
    singular one and in which the motors carry the weight; if there is none, the posture found that is farthest from
    a singular one. Raises InvalidParameter: as `chain_of`."""
    middle = home_of(table.free)
    chain = chain_of(replace(table, home=middle))
    rank = _rank(chain, table, middle)
    if not rank:
        return middle
    most, best = _openness(chain, table, middle)[rank - 1], middle
    strong = _carried(chain, table, middle)
    for radius in _RADII:
        if most >= OPEN:
            break
        for k in range(_TRIES):
            q = _near(table, middle, radius, k)
            if (found := float(_openness(chain, table, q)[rank - 1])) > most and (
                not strong or _carried(chain, table, q)
            ):
                most, best = found, q
    for i, angle in enumerate(middle):  # turn back each joint that need not turn
        q = (*best[:i], angle, *best[i + 1 :])
        if (
            best != middle
            and _openness(chain, table, q)[rank - 1] >= min(OPEN, most)
            and (not strong or _carried(chain, table, q))
        ):
            best = q
    return best


def openness(table: ArmTable) -> float:
    """The smallest singular value of the tip's Jacobian at home over the arm's reach, of the directions in which the
    arm moves its tip in other postures; 0: it moves its tip in none. Raises InvalidParameter: as `chain_of`."""
    chain = chain_of(table)
    rank = _rank(chain, table, table.home)
    return float(_openness(chain, table, table.home)[rank - 1]) if rank else 0.0


def remarks(table: ArmTable) -> tuple[str, ...]:
    """Lines for the user on why the tip cannot, or hardly, move from home; empty: it can.

    Raises InvalidParameter: as `at_home`.
    """
    chain = chain_of(table)
    values, directions = _directions(chain, table, table.home)
    fixed = [_shown(way) for value, way in zip(values, directions, strict=True) if value < _NONE]
    slow = [
        f"{_shown(way)} ({value:.2g} of the reach a radian, less than {OPEN:g})"
        for value, way in zip(values, directions, strict=True)
        if _NONE <= value < OPEN
    ]
    found = []
    if fixed:
        found.append(f"at the home of {table.name} no joint moves the tip along {' and '.join(fixed)}")
    if slow:
        found.append(f"at the home of {table.name} the joints hardly move the tip along {' and '.join(slow)}")
    if found and openness(replace(table, home=open_home(table))) > 2.0 * openness(table):
        found[-1] += ": choose another posture with &home="
    if HEAVY_NSPM < (damping := felt_damping(table)) < math.inf:
        found.append(
            f"the joints' damping in {table.name} is {damping:.3g} Ns/m or more at the tip: a hand hardly moves it"
        )
    return tuple(found)


def _shown(way: Array) -> str:
    way = way * (1.0 if way[int(np.argmax(np.abs(way)))] > 0.0 else -1.0)
    return "({:.2g}, {:.2g}, {:.2g})".format(*(np.round(way, 3) + 0.0))


def _near(table: ArmTable, middle: Vector, radius: float, k: int) -> Vector:
    """The posture number k of a sequence that fills the stops evenly, no joint farther than `radius` from the middle
    [rad]; the sequence is Roberts's: multiples of powers of the root of ``x^(n+1) = x + 1``, modulo 1."""
    found, reach, root = [], max(table.reaches), 1.5
    for _ in range(40):
        root = (1.0 + root) ** (1.0 / (len(middle) + 1))
    share = float(k + 1)
    for joint, centre in zip(table.free, middle, strict=True):
        down, up = (
            min(radius * (reach if joint.slides else 1.0), _WITHIN * room)
            for room in (centre - joint.lower, joint.upper - centre)
        )
        share /= root
        angle = centre - down + (0.5 + share) % 1.0 * (down + up)
        short = round(angle, 2)
        found.append(short if joint.lower <= short <= joint.upper else angle)
    return tuple(found)


def _rank(chain: Chain, table: ArmTable, home: Vector) -> int:
    """The number of directions in which joints move the tip in most postures."""
    postures = [home, *(_near(table, home, 1.5, k) for k in range(_SAMPLES))]
    return max(int(np.sum(_openness(chain, table, q) > _NONE)) for q in postures)


def _openness(chain: Chain, table: ArmTable, q: Vector) -> Array:
    """The three singular values over the reach, descending."""
    return _directions(chain, table, q)[0]


def _directions(chain: Chain, table: ArmTable, q: Vector) -> tuple[Array, Array]:
    """The singular values of the tip's Jacobian over the reach, descending, and their directions (3, 3)."""
    difference(chain, chain.tip, q, q)
    reach = max(table.reaches)
    J = np.array(chain.tip.columns)[: chain.n].T
    J = J / [1.0 if joint.slides or not reach else reach for joint in table.free]
    directions, values, _ = np.linalg.svd(J)
    return np.append(values, np.zeros(3))[:3], directions.T


def _carried(chain: Chain, table: ArmTable, q: Vector) -> bool:
    """Whether the motors carry the weight, with a half of their torque."""
    load = [0.0] * chain.n
    gravity(chain, q, q, load)
    return all(2.0 * abs(one) < joint.effort for one, joint in zip(load, table.free, strict=True))
