"""The equations of a corotated elastic body, each a loop over its tetrahedra; a body compiles them (extra `soft`).

A tetrahedron has a constant gradient ``F = sum x_a g_a'`` of its position, with g_a the gradients of its shape
functions at rest, and the rotation R nearest to F. With ``X = sym(R' F) - I`` (Mueller, Gross 2004) its strain in the
rotating frame is ``eps = X - a X^2 + b X^3``, kept as xx, yy, zz, xy, yz, zx: a is `SQUARE`, b is `CUBE`. With 1/2 and
1/3 it would be about the logarithm of the stretch (Hencky), which is steeper for a body that is nearly inverted. With
Lame's constants its energy is ``V (1/2 lam t^2 + mu |eps|^2)``.

Without locking: t is the mean of tr(eps) over a patch of tetrahedra (F-bar-Patch, de Souza Neto et al. 2005), so a
body of linear tetrahedra is not too stiff if it keeps its volume. Tetrahedra are in the order of their patches, patch
p from patches[p] on; shares (E,) are of their patch's volume.

Without a torque: a step uses the rotation Q half way, ``h_a = Q g_a`` and ``A = F Q'``. With L = sum v_a h_a' the rate
of strain in the frame of space is

    D(S),    S = sym(L) - sym([w] A),    w = (tr(A) I - A)^-1 axis(L - L')

with D the derivative of eps by X (`slopes`), and w the angular velocity of R. A rotation of the stretched body has
S = 0 to rounding,
so damping does not slow it, and the stresses, the transpose of that map, have no torque.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from math import cos, sin, sqrt
from typing import Any, NamedTuple

from hapnet.records.machine_code import compiled

SQUARE, CUBE = 0.4, 0.18
"""Coefficients of the strain."""

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


def strain(x: Any, tets: Any, grads: Any, turns: Any, strains: Any) -> None:
    """``strains = sym(R' F) - I`` at the positions x (N, 3)."""
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
            strains[e, i] = r[0, i] * f[0, i] + r[1, i] * f[1, i] + r[2, i] * f[2, i] - 1.0
            strains[e, 3 + i] = 0.5 * (
                r[0, i] * f[0, k] + r[1, i] * f[1, k] + r[2, i] * f[2, k]
                + r[0, k] * f[0, i] + r[1, k] * f[1, i] + r[2, k] * f[2, i]
            )  # fmt: skip


def energy(patches: Any, shares: Any, lam: Any, mu: Any, strains: Any) -> float:
    """The energy of these strains [J]; lam (P,), mu (E,): Lame's constants times the volume [J]."""
    total = 0.0
    for p in range(len(lam)):
        trace = 0.0
        for e in range(patches[p], patches[p + 1]):
            a, b, c = strains[e, 0], strains[e, 1], strains[e, 2]
            d, f, g = strains[e, 3], strains[e, 4], strains[e, 5]
            trace += shares[e] * (a + b + c)
            total += mu[e] * (a * a + b * b + c * c + 2.0 * (d * d + f * f + g * g))
        total += 0.5 * lam[p] * trace * trace
    return total


def turned(x: Any, tets: Any, grads: Any, turns: Any, h: Any, stretch: Any, spin: Any) -> None:
    """Rotated gradients h (E, 4, 3), A = F Q' and M = (tr(A) I - A)^-1 (E, 3, 3) at the positions x (N, 3)."""
    for e in range(len(tets)):
        r, m = turns[e], stretch[e]
        for i in range(3):
            for j in range(3):
                m[i, j] = 0.0
        for a in range(4):
            node = tets[e, a]
            for i in range(3):
                part = r[i, 0] * grads[e, a, 0] + r[i, 1] * grads[e, a, 1] + r[i, 2] * grads[e, a, 2]
                h[e, a, i] = part
                for j in range(3):
                    m[j, i] += x[node, j] * part
        n00, n11, n22 = m[1, 1] + m[2, 2], m[0, 0] + m[2, 2], m[0, 0] + m[1, 1]
        n01, n02, n12, n10, n20, n21 = -m[0, 1], -m[0, 2], -m[1, 2], -m[1, 0], -m[2, 0], -m[2, 1]
        c0, c1, c2 = n11 * n22 - n12 * n21, n12 * n20 - n10 * n22, n10 * n21 - n11 * n20
        det = n00 * c0 + n01 * c1 + n02 * c2
        over = 1.0 / det if det > 1e-3 else 0.0
        s = spin[e]
        s[0, 0], s[1, 0], s[2, 0] = over * c0, over * c1, over * c2
        s[0, 1], s[1, 1], s[2, 1] = (
            over * (n02 * n21 - n01 * n22), over * (n00 * n22 - n02 * n20), over * (n01 * n20 - n00 * n21)
        )  # fmt: skip
        s[0, 2], s[1, 2], s[2, 2] = (
            over * (n01 * n12 - n02 * n11), over * (n02 * n10 - n00 * n12), over * (n00 * n11 - n01 * n10)
        )  # fmt: skip


def rates(v: Any, tets: Any, h: Any, stretch: Any, spin: Any, slope: Any, out: Any) -> None:
    """The strains' rates D(S) (E, 6) into `out`, in the frame of space, of nodes that move with v (N, 3)."""
    for e in range(len(tets)):
        a, m, s = stretch[e], spin[e], out[e]
        l00, l01, l02, l10, l11, l12, l20, l21, l22 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(4):
            node = tets[e, i]
            v0, v1, v2 = v[node, 0], v[node, 1], v[node, 2]
            h0, h1, h2 = h[e, i, 0], h[e, i, 1], h[e, i, 2]
            l00, l01, l02 = l00 + v0 * h0, l01 + v0 * h1, l02 + v0 * h2
            l10, l11, l12 = l10 + v1 * h0, l11 + v1 * h1, l12 + v1 * h2
            l20, l21, l22 = l20 + v2 * h0, l21 + v2 * h1, l22 + v2 * h2
        p, q, r = l21 - l12, l02 - l20, l10 - l01
        w0 = m[0, 0] * p + m[0, 1] * q + m[0, 2] * r
        w1 = m[1, 0] * p + m[1, 1] * q + m[1, 2] * r
        w2 = m[2, 0] * p + m[2, 1] * q + m[2, 2] * r
        s0 = l00 - w1 * a[2, 0] + w2 * a[1, 0]
        s1 = l11 - w2 * a[0, 1] + w0 * a[2, 1]
        s2 = l22 - w0 * a[1, 2] + w1 * a[0, 2]
        s3 = 0.5 * (l01 + l10 - w1 * a[2, 1] + w2 * a[1, 1] - w2 * a[0, 0] + w0 * a[2, 0])
        s4 = 0.5 * (l12 + l21 - w2 * a[0, 2] + w0 * a[2, 2] - w0 * a[1, 1] + w1 * a[0, 1])
        s5 = 0.5 * (l02 + l20 - w1 * a[2, 2] + w2 * a[1, 2] - w0 * a[1, 0] + w1 * a[0, 0])
        o = slope[e]
        for i in range(6):
            s[i] = o[i, 0] * s0 + o[i, 1] * s1 + o[i, 2] * s2 + o[i, 3] * s3 + o[i, 4] * s4 + o[i, 5] * s5


def spread(
    tets: Any, h: Any, stretch: Any, spin: Any, slope: Any, patches: Any, shares: Any, lam: Any, mu: Any, strains: Any,
    sign: float, out: Any,
) -> None:  # fmt: skip
    """Add `sign` times the transpose of `rates`, of the stresses by strains in the frame of space, to out (N, 3)."""
    for patch in range(len(lam)):
        trace = 0.0
        for e in range(patches[patch], patches[patch + 1]):
            trace += shares[e] * (strains[e, 0] + strains[e, 1] + strains[e, 2])
        for e in range(patches[patch], patches[patch + 1]):
            a, m, s = stretch[e], spin[e], strains[e]
            even = lam[patch] * trace * shares[e]
            two = 2.0 * mu[e]
            s0, s1, s2 = even + two * s[0], even + two * s[1], even + two * s[2]
            s3, s4, s5 = two * s[3], two * s[4], two * s[5]
            o = slope[e]
            t00 = o[0, 0] * s0 + o[0, 1] * s1 + o[0, 2] * s2 + o[0, 3] * s3 + o[0, 4] * s4 + o[0, 5] * s5
            t11 = o[1, 0] * s0 + o[1, 1] * s1 + o[1, 2] * s2 + o[1, 3] * s3 + o[1, 4] * s4 + o[1, 5] * s5
            t22 = o[2, 0] * s0 + o[2, 1] * s1 + o[2, 2] * s2 + o[2, 3] * s3 + o[2, 4] * s4 + o[2, 5] * s5
            t01 = o[3, 0] * s0 + o[3, 1] * s1 + o[3, 2] * s2 + o[3, 3] * s3 + o[3, 4] * s4 + o[3, 5] * s5
            t12 = o[4, 0] * s0 + o[4, 1] * s1 + o[4, 2] * s2 + o[4, 3] * s3 + o[4, 4] * s4 + o[4, 5] * s5
            t02 = o[5, 0] * s0 + o[5, 1] * s1 + o[5, 2] * s2 + o[5, 3] * s3 + o[5, 4] * s4 + o[5, 5] * s5
            # the axis of T A', which vanishes if stress and stretch have the same axes
            p = t02 * a[1, 0] + t12 * a[1, 1] + t22 * a[1, 2] - (t01 * a[2, 0] + t11 * a[2, 1] + t12 * a[2, 2])
            q = t00 * a[2, 0] + t01 * a[2, 1] + t02 * a[2, 2] - (t02 * a[0, 0] + t12 * a[0, 1] + t22 * a[0, 2])
            r = t01 * a[0, 0] + t11 * a[0, 1] + t12 * a[0, 2] - (t00 * a[1, 0] + t01 * a[1, 1] + t02 * a[1, 2])
            c0 = m[0, 0] * p + m[1, 0] * q + m[2, 0] * r
            c1 = m[0, 1] * p + m[1, 1] * q + m[2, 1] * r
            c2 = m[0, 2] * p + m[1, 2] * q + m[2, 2] * r
            for i in range(4):
                node = tets[e, i]
                h0, h1, h2 = sign * h[e, i, 0], sign * h[e, i, 1], sign * h[e, i, 2]
                out[node, 0] += t00 * h0 + (t01 + c2) * h1 + (t02 - c1) * h2
                out[node, 1] += (t01 - c2) * h0 + t11 * h1 + (t12 + c0) * h2
                out[node, 2] += (t02 + c1) * h0 + (t12 - c0) * h1 + t22 * h2


def general_strain(strains: Any) -> None:
    """X, as ``U - I`` in strains (E, 6), becomes ``X - SQUARE X^2 + CUBE X^3``."""
    for e in range(len(strains)):
        s = strains[e]
        a, b, c, d, f, g = s[0], s[1], s[2], s[3], s[4], s[5]
        # X^2, and from it X^3 = X^2 X
        aa, bb, cc = a * a + d * d + g * g, d * d + b * b + f * f, g * g + f * f + c * c
        ab, bc, ca = a * d + d * b + g * f, d * g + b * f + f * c, a * g + d * f + g * c
        s[0] += CUBE * (aa * a + ab * d + ca * g) - SQUARE * aa
        s[1] += CUBE * (ab * d + bb * b + bc * f) - SQUARE * bb
        s[2] += CUBE * (ca * g + bc * f + cc * c) - SQUARE * cc
        s[3] += CUBE * (aa * d + ab * b + ca * f) - SQUARE * ab
        s[4] += CUBE * (ab * g + bb * f + bc * c) - SQUARE * bc
        s[5] += CUBE * (aa * g + ab * f + ca * c) - SQUARE * ca


def slopes(stretch: Any, out: Any) -> None:
    """The derivative of `general_strain` at X = A - I, a symmetric map of (xx, yy, zz, xy, yz, zx), into out (E, 6, 6).

    It is ``P dX + dX P + CUBE X dX X``, with ``P = I/2 - SQUARE X + CUBE X^2``.
    """
    for e in range(len(stretch)):
        m, o = stretch[e], out[e]
        a, b, c = m[0, 0] - 1.0, m[1, 1] - 1.0, m[2, 2] - 1.0
        d, f, g = 0.5 * (m[0, 1] + m[1, 0]), 0.5 * (m[1, 2] + m[2, 1]), 0.5 * (m[0, 2] + m[2, 0])
        p0 = 0.5 - SQUARE * a + CUBE * (a * a + d * d + g * g)
        p1 = 0.5 - SQUARE * b + CUBE * (d * d + b * b + f * f)
        p2 = 0.5 - SQUARE * c + CUBE * (g * g + f * f + c * c)
        p3 = CUBE * (a * d + d * b + g * f) - SQUARE * d
        p4 = CUBE * (d * g + b * f + f * c) - SQUARE * f
        p5 = CUBE * (a * g + d * f + g * c) - SQUARE * g
        t = CUBE
        o[0, 0], o[0, 1], o[0, 2] = 2.0 * p0 + t * a * a, t * d * d, t * g * g
        o[0, 3], o[0, 4], o[0, 5] = 2.0 * (p3 + t * a * d), 2.0 * t * d * g, 2.0 * (p5 + t * a * g)
        o[1, 0], o[1, 1], o[1, 2] = t * d * d, 2.0 * p1 + t * b * b, t * f * f
        o[1, 3], o[1, 4], o[1, 5] = 2.0 * (p3 + t * b * d), 2.0 * (p4 + t * b * f), 2.0 * t * d * f
        o[2, 0], o[2, 1], o[2, 2] = t * g * g, t * f * f, 2.0 * p2 + t * c * c
        o[2, 3], o[2, 4], o[2, 5] = 2.0 * t * g * f, 2.0 * (p4 + t * c * f), 2.0 * (p5 + t * c * g)
        o[3, 0], o[3, 1], o[3, 2] = p3 + t * a * d, p3 + t * b * d, t * g * f
        o[3, 3] = p0 + p1 + t * (a * b + d * d)
        o[3, 4], o[3, 5] = p5 + t * (d * f + g * b), p4 + t * (a * f + g * d)
        o[4, 0], o[4, 1], o[4, 2] = t * d * g, p4 + t * b * f, p4 + t * c * f
        o[4, 3] = p5 + t * (d * f + b * g)
        o[4, 4], o[4, 5] = p1 + p2 + t * (b * c + f * f), p3 + t * (d * c + f * g)
        o[5, 0], o[5, 1], o[5, 2] = p5 + t * a * g, t * d * f, p5 + t * c * g
        o[5, 3] = p4 + t * (a * f + d * g)
        o[5, 4], o[5, 5] = p3 + t * (d * c + g * f), p0 + p2 + t * (a * c + g * g)


def rotate(turns: Any, given: Any, scale: float, out: Any) -> None:
    """``out += scale R s R'``, of symmetric s (E, 6)."""
    for e in range(len(given)):
        r, s = turns[e], given[e]
        for i in range(3):
            a0, a1, a2 = r[i, 0], r[i, 1], r[i, 2]
            p0, p1, p2 = a0 * s[0] + a1 * s[3] + a2 * s[5], a0 * s[3] + a1 * s[1] + a2 * s[4], 0.0
            p2 = a0 * s[5] + a1 * s[4] + a2 * s[2]
            k = (i + 1) % 3
            out[e, i] += scale * (p0 * a0 + p1 * a1 + p2 * a2)
            out[e, 3 + i] += scale * (p0 * r[k, 0] + p1 * r[k, 1] + p2 * r[k, 2])


class Equations(NamedTuple):
    """The loops, compiled."""

    turn: Callable[..., None]
    strain: Callable[..., None]
    energy: Callable[..., float]
    turned: Callable[..., None]
    rates: Callable[..., None]
    spread: Callable[..., None]
    general_strain: Callable[..., None]
    slopes: Callable[..., None]
    rotate: Callable[..., None]


@cache
def equations() -> Equations:
    """Return all compiled loops; this loads the compiler."""
    return Equations(*map(compiled, (turn, strain, energy, turned, rates, spread, general_strain, slopes, rotate)))
