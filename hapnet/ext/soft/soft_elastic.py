"""The equations of a corotated elastic body, each a loop over its tetrahedra; a body compiles them (extra `soft`).

A tetrahedron has a constant gradient ``F = sum x_a g_a'`` of its position, with g_a the gradients of its shape
functions at rest, and the rotation R nearest to F. Its strain in the rotating frame is
``eps = sym(R' F) - I`` (Mueller, Gross 2004), kept as xx, yy, zz, xy, yz, zx. With Lame's constants its energy is
``V (1/2 lam tr(eps)^2 + mu |eps|^2)``. A step rotates the gradients to ``h_a = Q g_a``, with Q the rotation half way:
then the stiffness of the body is that of linear elasticity with h_a in place of g_a, and no matrix is assembled.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from math import cos, sin, sqrt
from typing import Any, NamedTuple

from hapnet.records.machine_code import compiled

TURNS, NEAR = 8, 1e-5
"""The most rounds of the search for a rotation, and the change [rad] below which it ends."""


def turn(x: Any, tets: Any, grads: Any, turns: Any) -> None:
    """Find the rotations R (E, 3, 3) at the positions x (N, 3), from the last ones (Mueller, Bender et al. 2016)."""
    for e in range(len(tets)):
        f = turns[e].copy()
        for i in range(3):
            for j in range(3):
                total = 0.0
                for a in range(4):
                    total += x[tets[e, a], i] * grads[e, a, j]
                f[i, j] = total
        r = turns[e]
        for _ in range(TURNS):
            w0, w1, w2, size = 0.0, 0.0, 0.0, 1e-9
            for j in range(3):
                w0 += r[1, j] * f[2, j] - r[2, j] * f[1, j]
                w1 += r[2, j] * f[0, j] - r[0, j] * f[2, j]
                w2 += r[0, j] * f[1, j] - r[1, j] * f[0, j]
                size += r[0, j] * f[0, j] + r[1, j] * f[1, j] + r[2, j] * f[2, j]
            size = abs(size)
            w0, w1, w2 = w0 / size, w1 / size, w2 / size
            angle = sqrt(w0 * w0 + w1 * w1 + w2 * w2)
            if angle < NEAR:
                break
            k0, k1, k2 = w0 / angle, w1 / angle, w2 / angle
            c, s = cos(angle), sin(angle)
            for j in range(3):
                a0, a1, a2 = r[0, j], r[1, j], r[2, j]
                along = (1.0 - c) * (k0 * a0 + k1 * a1 + k2 * a2)
                r[0, j] = c * a0 + s * (k1 * a2 - k2 * a1) + along * k0
                r[1, j] = c * a1 + s * (k2 * a0 - k0 * a2) + along * k1
                r[2, j] = c * a2 + s * (k0 * a1 - k1 * a0) + along * k2


def strain(x: Any, tets: Any, grads: Any, turns: Any, scale: float, strains: Any) -> None:
    """``strains += scale sym(R' sum x_a g_a')``: for positions the strains without -I, for velocities their rates."""
    for e in range(len(tets)):
        r, f = turns[e], turns[e].copy()
        for i in range(3):
            for j in range(3):
                total = 0.0
                for a in range(4):
                    total += x[tets[e, a], i] * grads[e, a, j]
                f[i, j] = total
        for i in range(3):
            k = (i + 1) % 3
            strains[e, i] += scale * (r[0, i] * f[0, i] + r[1, i] * f[1, i] + r[2, i] * f[2, i])
            strains[e, 3 + i] += (0.5 * scale) * (
                r[0, i] * f[0, k] + r[1, i] * f[1, k] + r[2, i] * f[2, k]
                + r[0, k] * f[0, i] + r[1, k] * f[1, i] + r[2, k] * f[2, i]
            )  # fmt: skip


def energy(lam: Any, mu: Any, strains: Any) -> float:
    """The energy of these strains [J]; lam, mu (E,) : Lame's constants times the volume [J]."""
    total = 0.0
    for e in range(len(strains)):
        a, b, c = strains[e, 0], strains[e, 1], strains[e, 2]
        d, f, g = strains[e, 3], strains[e, 4], strains[e, 5]
        trace = a + b + c
        total += 0.5 * lam[e] * trace * trace + mu[e] * (a * a + b * b + c * c + 2.0 * (d * d + f * f + g * g))
    return total


def stress(tets: Any, grads: Any, turns: Any, lam: Any, mu: Any, strains: Any, h: Any, force: Any) -> None:
    """Add the strains' forces on the nodes to `force` (N, 3), and put the rotated gradients into h (E, 4, 3)."""
    for e in range(len(tets)):
        r, s = turns[e], strains[e]
        pressure = lam[e] * (s[0] + s[1] + s[2])
        m = 2.0 * mu[e]
        for a in range(4):
            g0, g1, g2 = grads[e, a, 0], grads[e, a, 1], grads[e, a, 2]
            t0 = pressure * g0 + m * (s[0] * g0 + s[3] * g1 + s[5] * g2)
            t1 = pressure * g1 + m * (s[3] * g0 + s[1] * g1 + s[4] * g2)
            t2 = pressure * g2 + m * (s[5] * g0 + s[4] * g1 + s[2] * g2)
            node = tets[e, a]
            for i in range(3):
                h[e, a, i] = r[i, 0] * g0 + r[i, 1] * g1 + r[i, 2] * g2
                force[node, i] -= r[i, 0] * t0 + r[i, 1] * t1 + r[i, 2] * t2


def stiff(tets: Any, h: Any, lam: Any, mu: Any, v: Any, out: Any) -> None:
    """``out += K v``, both (N, 3): the stiffness with rotated gradients h, applied without being assembled."""
    for e in range(len(tets)):
        l00, l01, l02, l10, l11, l12, l20, l21, l22 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for a in range(4):
            node = tets[e, a]
            v0, v1, v2 = v[node, 0], v[node, 1], v[node, 2]
            h0, h1, h2 = h[e, a, 0], h[e, a, 1], h[e, a, 2]
            l00, l01, l02 = l00 + v0 * h0, l01 + v0 * h1, l02 + v0 * h2
            l10, l11, l12 = l10 + v1 * h0, l11 + v1 * h1, l12 + v1 * h2
            l20, l21, l22 = l20 + v2 * h0, l21 + v2 * h1, l22 + v2 * h2
        pressure, m = lam[e] * (l00 + l11 + l22), mu[e]
        s00, s11, s22 = pressure + 2.0 * m * l00, pressure + 2.0 * m * l11, pressure + 2.0 * m * l22
        s01, s12, s02 = m * (l01 + l10), m * (l12 + l21), m * (l02 + l20)
        for a in range(4):
            node = tets[e, a]
            h0, h1, h2 = h[e, a, 0], h[e, a, 1], h[e, a, 2]
            out[node, 0] += s00 * h0 + s01 * h1 + s02 * h2
            out[node, 1] += s01 * h0 + s11 * h1 + s12 * h2
            out[node, 2] += s02 * h0 + s12 * h1 + s22 * h2


class Equations(NamedTuple):
    """The loops, compiled."""

    turn: Callable[..., None]
    strain: Callable[..., None]
    energy: Callable[..., float]
    stress: Callable[..., None]
    stiff: Callable[..., None]


@cache
def equations() -> Equations:
    """Return all compiled loops; this loads the compiler."""
    return Equations(*map(compiled, (turn, strain, energy, stress, stiff)))
