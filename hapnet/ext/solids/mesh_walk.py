"""Finds the nearest place of a mesh's surface from a triangle nearby: by a walk, and on a smooth patch.

The walk goes from triangle to triangle as long as the distance decreases, and so ends at a local minimum of it. A
proxy in contact stays with the surface that it entered, however thin the solid is: the foot is its *god-object*
(Zilles, Salisbury 1995).

Where no edge is sharp, the triangles form a curved surface with known normals at the corners. With the
weights b_i, a place is ``x = sum b_i (p_i + t n_i)`` (three equations, by Newton's method), and the surface there is

    q = sum b_i (p - 1/2 (n_i . (p - p_i)) n_i),   p = sum b_i p_i

which is exact for any paraboloid, and joins that of the next triangle (after Boubekeur, Alexa 2008).

`principal` returns the curvatures of that patch. Plain Python runs this on lists, numba on arrays, with equal results.
"""

from __future__ import annotations

from math import sqrt
from typing import Any

SMOOTH, EDGE, CORNER = 0, 1, 2
"""A foot is on a smooth patch, or on a sharp edge, or at a corner where sharp edges meet."""

MOST_MOVES = 2000
"""Most moves of one walk. In 50 ms at 0.7 m/s a foot crosses 100 triangles of 0.3 mm."""

_NEARER = 1.0 - 1e-12
_ACROSS, _NEWTON = 8, 5
_BESIDE = -1e-9


def follow(
    vertices: Any, triangles: Any, normals: Any, across: Any, rims: Any, pointed: Any, first: Any, ring: Any,
    flat: Any, start: int, x: float, y: float, z: float,
) -> tuple[int, int, int, float, float, float, float, float, float, float]:  # fmt: skip
    """The foot of the place (x, y, z) [m], from the triangle `start` on.

    Parameters
    ----------
    vertices : (V, 3) [m]. triangles : (F, 3). normals : (F, 3, 3), of each corner. across : (F, 3), the triangle behind
        the edge that lies across from each corner. rims : (F, 3), not 0 if that edge is sharp. pointed : (V,), not 0 at
        the end of a sharp edge. first, ring : the triangles around the vertex v are ``ring[first[v]:first[v + 1]]``.
    flat : (F,), not 0 if all three normals are the triangle's.

    Returns
    -------
    tuple : triangle; `SMOOTH`, `EDGE` or `CORNER`; the number 0 to 2 of the corner, or of the one across from the edge;
        the point [m]; the unit normal; the distance [m], below 0 behind the patch. At edges and corners the normal is 0
        and the distance has no sign.
    """

    def nearest(f: int) -> tuple[float, float, float, float]:
        """The square of the distance from a triangle, and the weights of its corners (Ericson 2005, 5.1.5)."""
        t0, t1, t2 = triangles[f][0], triangles[f][1], triangles[f][2]
        a0, a1, a2 = vertices[t0][0], vertices[t0][1], vertices[t0][2]
        b0, b1, b2 = vertices[t1][0] - a0, vertices[t1][1] - a1, vertices[t1][2] - a2
        c0, c1, c2 = vertices[t2][0] - a0, vertices[t2][1] - a1, vertices[t2][2] - a2
        p0, p1, p2 = x - a0, y - a1, z - a2
        d1, d2 = b0 * p0 + b1 * p1 + b2 * p2, c0 * p0 + c1 * p1 + c2 * p2
        bb, bc, cc = b0 * b0 + b1 * b1 + b2 * b2, b0 * c0 + b1 * c1 + b2 * c2, c0 * c0 + c1 * c1 + c2 * c2
        d3, d4, d5, d6 = d1 - bb, d2 - bc, d1 - bc, d2 - cc
        vc, vb, va = d1 * d4 - d3 * d2, d5 * d2 - d1 * d6, d3 * d6 - d5 * d4
        if d1 <= 0.0 and d2 <= 0.0:
            v, w = 0.0, 0.0
            u = 1.0
        elif d3 >= 0.0 and d4 <= d3:
            v, w = 1.0, 0.0
            u = 0.0
        elif d6 >= 0.0 and d5 <= d6:
            v, w = 0.0, 1.0
            u = 0.0
        elif vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
            v, w = d1 / (d1 - d3), 0.0
            u = 1.0 - v
        elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
            v, w = 0.0, d2 / (d2 - d6)
            u = 1.0 - w
        elif va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
            w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
            u, v = 0.0, 1.0 - w
        else:
            total = va + vb + vc
            v, w = vb / total, vc / total
            u = 1.0 - v - w
        e0, e1, e2 = p0 - v * b0 - w * c0, p1 - v * b1 - w * c1, p2 - v * b2 - w * c2
        return e0 * e0 + e1 * e1 + e2 * e2, u, v, w

    face = start
    square, u, v, w = nearest(face)
    for _ in range(MOST_MOVES):
        zeros = (u == 0.0) + (v == 0.0) + (w == 0.0)
        if zeros == 0:
            break
        least, other, u1, v1, w1 = square * _NEARER, face, u, v, w
        if zeros == 1:
            k = 0 if u == 0.0 else (1 if v == 0.0 else 2)
            beside = across[face][k]
            found, u2, v2, w2 = nearest(beside)
            if found < least:
                least, other, u1, v1, w1 = found, beside, u2, v2, w2
        else:
            k = 0 if u != 0.0 else (1 if v != 0.0 else 2)
            vertex = triangles[face][k]
            for i in range(first[vertex], first[vertex + 1]):
                beside = ring[i]
                found, u2, v2, w2 = nearest(beside)
                if found < least:
                    least, other, u1, v1, w1 = found, beside, u2, v2, w2
        if other == face:
            break
        face, square, u, v, w = other, least, u1, v1, w1

    zeros = (u == 0.0) + (v == 0.0) + (w == 0.0)
    kind, k = SMOOTH, 0
    if zeros == 1:
        k = 0 if u == 0.0 else (1 if v == 0.0 else 2)
        if rims[face][k]:
            kind = EDGE
    elif zeros == 2:
        k = 0 if u != 0.0 else (1 if v != 0.0 else 2)
        if pointed[triangles[face][k]]:
            kind = CORNER
    if kind != SMOOTH:
        t0, t1, t2 = triangles[face][0], triangles[face][1], triangles[face][2]
        q0 = u * vertices[t0][0] + v * vertices[t1][0] + w * vertices[t2][0]
        q1 = u * vertices[t0][1] + v * vertices[t1][1] + w * vertices[t2][1]
        q2 = u * vertices[t0][2] + v * vertices[t1][2] + w * vertices[t2][2]
        return face, kind, k, q0, q1, q2, 0.0, 0.0, 0.0, sqrt(square)

    there, at_u, at_v, at_w = face, u, v, w  # of the walk: taken if no patch is found
    if not flat[face]:
        far = sqrt(square)
        for _ in range(_ACROSS):
            t0, t1, t2 = triangles[face][0], triangles[face][1], triangles[face][2]
            a0, a1, a2 = vertices[t0][0], vertices[t0][1], vertices[t0][2]
            b0, b1, b2 = vertices[t1][0] - a0, vertices[t1][1] - a1, vertices[t1][2] - a2
            c0, c1, c2 = vertices[t2][0] - a0, vertices[t2][1] - a1, vertices[t2][2] - a2
            m0, m1, m2 = normals[face][0][0], normals[face][0][1], normals[face][0][2]
            f0, f1, f2 = normals[face][1][0] - m0, normals[face][1][1] - m1, normals[face][1][2] - m2
            g0, g1, g2 = normals[face][2][0] - m0, normals[face][2][1] - m1, normals[face][2][2] - m2
            p0, p1, p2 = x - a0, y - a1, z - a2
            n0, n1, n2 = m0 + v * f0 + w * g0, m1 + v * f1 + w * g1, m2 + v * f2 + w * g2
            t = n0 * (p0 - v * b0 - w * c0) + n1 * (p1 - v * b1 - w * c1) + n2 * (p2 - v * b2 - w * c2)
            solved = True
            for _ in range(_NEWTON):
                n0, n1, n2 = m0 + v * f0 + w * g0, m1 + v * f1 + w * g1, m2 + v * f2 + w * g2
                r0 = p0 - v * b0 - w * c0 - t * n0
                r1 = p1 - v * b1 - w * c1 - t * n1
                r2 = p2 - v * b2 - w * c2 - t * n2
                i0, i1, i2 = b0 + t * f0, b1 + t * f1, b2 + t * f2
                j0, j1, j2 = c0 + t * g0, c1 + t * g1, c2 + t * g2
                k0, k1, k2 = i1 * j2 - i2 * j1, i2 * j0 - i0 * j2, i0 * j1 - i1 * j0
                size = n0 * k0 + n1 * k1 + n2 * k2
                if not size > 0.0:
                    solved = False
                    break
                l0, l1, l2 = j1 * n2 - j2 * n1, j2 * n0 - j0 * n2, j0 * n1 - j1 * n0
                h0, h1, h2 = n1 * i2 - n2 * i1, n2 * i0 - n0 * i2, n0 * i1 - n1 * i0
                dv = (r0 * l0 + r1 * l1 + r2 * l2) / size
                dw = (r0 * h0 + r1 * h1 + r2 * h2) / size
                t += (r0 * k0 + r1 * k1 + r2 * k2) / size
                v += dv
                w += dw
                if dv * dv + dw * dw < 1e-24:
                    break
            u = 1.0 - v - w
            if not solved or not abs(t) < 2.0 * far + 1e-4 or not v * v + w * w < 100.0:
                break
            if u >= _BESIDE and v >= _BESIDE and w >= _BESIDE:
                there, at_u, at_v, at_w = face, u, v, w
                break
            k = 0 if u <= v and u <= w else (1 if v <= w else 2)
            if rims[face][k]:
                break
            face = across[face][k]
            _, u, v, w = nearest(face)

    face, u, v, w = there, at_u, at_v, at_w
    t0, t1, t2 = triangles[face][0], triangles[face][1], triangles[face][2]
    p0 = u * vertices[t0][0] + v * vertices[t1][0] + w * vertices[t2][0]
    p1 = u * vertices[t0][1] + v * vertices[t1][1] + w * vertices[t2][1]
    p2 = u * vertices[t0][2] + v * vertices[t1][2] + w * vertices[t2][2]
    n0 = n1 = n2 = 0.0
    q0, q1, q2 = p0, p1, p2
    for k in range(3):
        corner = triangles[face][k]
        share = u if k == 0 else (v if k == 1 else w)
        m0, m1, m2 = normals[face][k][0], normals[face][k][1], normals[face][k][2]
        n0 += share * m0
        n1 += share * m1
        n2 += share * m2
        lift = m0 * (p0 - vertices[corner][0]) + m1 * (p1 - vertices[corner][1]) + m2 * (p2 - vertices[corner][2])
        lift *= 0.5 * share
        q0 -= lift * m0
        q1 -= lift * m1
        q2 -= lift * m2
    size = sqrt(n0 * n0 + n1 * n1 + n2 * n2)
    if size > 0.0:
        n0, n1, n2 = n0 / size, n1 / size, n2 / size
    return face, SMOOTH, 0, q0, q1, q2, n0, n1, n2, n0 * (x - q0) + n1 * (y - q1) + n2 * (z - q2)


def principal(bends: Any, face: int, x: float, y: float, z: float) -> tuple[float, ...]:
    """The curvatures of a smooth patch at this unit normal: two times a curvature [1/m] and its direction (3,).

    bends : (F, 3, 3), change of the normal along a direction [1/m]. The directions are its eigenvectors in the surface.
    """
    if abs(x) <= abs(y) and abs(x) <= abs(z):
        p0, p1, p2 = 0.0, -z, y
    elif abs(y) <= abs(z):
        p0, p1, p2 = z, 0.0, -x
    else:
        p0, p1, p2 = -y, x, 0.0
    size = sqrt(p0 * p0 + p1 * p1 + p2 * p2)
    p0, p1, p2 = p0 / size, p1 / size, p2 / size
    q0, q1, q2 = y * p2 - z * p1, z * p0 - x * p2, x * p1 - y * p0
    first, second, third = bends[face][0], bends[face][1], bends[face][2]
    s0 = first[0] * p0 + first[1] * p1 + first[2] * p2
    s1 = second[0] * p0 + second[1] * p1 + second[2] * p2
    s2 = third[0] * p0 + third[1] * p1 + third[2] * p2
    t0 = first[0] * q0 + first[1] * q1 + first[2] * q2
    t1 = second[0] * q0 + second[1] * q1 + second[2] * q2
    t2 = third[0] * q0 + third[1] * q1 + third[2] * q2
    a, b, c = p0 * s0 + p1 * s1 + p2 * s2, q0 * s0 + q1 * s1 + q2 * s2, q0 * t0 + q1 * t1 + q2 * t2
    half = sqrt(0.25 * (a - c) * (a - c) + b * b)
    most = 0.5 * (a + c) + half
    u, v = (most - c, b) if abs(most - c) >= abs(most - a) else (b, most - a)
    size = sqrt(u * u + v * v)
    if size > 0.0:
        u, v = u / size, v / size
    else:
        u, v = 1.0, 0.0
    return (
        most, u * p0 + v * q0, u * p1 + v * q1, u * p2 + v * q2,
        most - 2.0 * half, u * q0 - v * p0, u * q1 - v * p1, u * q2 - v * p2,
    )  # fmt: skip
