"""Makes examples/ring.obj: a ring of 4,096 triangles, in millimetres, 62 mm in front of the origin.

python -m examples.pictures.ring
"""

from __future__ import annotations

from math import cos, pi, sin
from pathlib import Path

FILE = Path(__file__).resolve().parents[1] / "ring.obj"
AROUND, ACROSS = 64, 32
MIDDLE_MM, THICKNESS_MM, X_MM = 30.0, 12.0, 62.0


def ring() -> str:
    """The file's text: vertices, then triangles that name three of them, counted from 1."""
    lines = ["# made by examples/pictures/ring.py"]
    for i in range(AROUND):
        u = 2.0 * pi * i / AROUND
        for j in range(ACROSS):
            v = 2.0 * pi * j / ACROSS
            from_axis = MIDDLE_MM + THICKNESS_MM * cos(v)
            lines.append(f"v {X_MM + from_axis * cos(u):.3f} {from_axis * sin(u):.3f} {THICKNESS_MM * sin(v):.3f}")
    for i in range(AROUND):
        for j in range(ACROSS):
            a, b, c, d = (
                1 + (i + di) % AROUND * ACROSS + (j + dj) % ACROSS for di, dj in ((0, 0), (1, 0), (1, 1), (0, 1))
            )
            lines += [f"f {a} {b} {c}", f"f {a} {c} {d}"]
    return "\n".join([*lines, ""])


if __name__ == "__main__":
    FILE.write_text(ring(), "utf-8")
