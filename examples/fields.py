"""Two solids as functions of the position: a gyroid in a ball, and a head.

Use ``hapnet simulate --scene 'sdf:examples.fields:gyroid?friction=0.2'``, or hapnet run, or hapnet play. A function
returns a number below 0 inside the solid; the number need not be a distance.
"""

from __future__ import annotations

from math import cos, hypot, pi, sin

from hapnet import Params, simulate

Vector = tuple[float, ...]

CELL_M, HALF_M = 0.03, 0.002
"""Length of a cell of the gyroid, and half the thickness of its sheet."""


def gyroid(position: Vector) -> float:
    """A sheet of 4 mm within a ball of 30 mm, whose centre is 50 mm in front."""
    x, y, z = position
    k = 2.0 * pi / CELL_M
    sheet = sin(k * x) * cos(k * y) + sin(k * y) * cos(k * z) + sin(k * z) * cos(k * x)
    return max(abs(sheet) / (1.5 * k) - HALF_M, hypot(x - 0.05, y, z) - 0.03)


def head(position: Vector) -> float:
    """A head of 100 mm that faces the hand, 20 mm in front of it: skull, jaw, nose and two ears, blended together.

    With ``layers=6mm,3000`` bone lies under the skin.
    """
    x, y, z = position
    parts = (
        _ellipsoid((x - 0.065, y, z - 0.01), (0.045, 0.038, 0.048)),
        _ellipsoid((x - 0.053, y, z + 0.03), (0.028, 0.025, 0.028)),
        _ellipsoid((x - 0.021, y, z + 0.008), (0.01, 0.006, 0.011)),
        _ellipsoid((x - 0.07, abs(y) - 0.039, z), (0.01, 0.005, 0.015)),
    )
    joined = parts[0]
    for part in parts[1:]:
        joined = _joined(joined, part, 0.009)
    return joined


def _ellipsoid(place: Vector, radii: Vector) -> float:
    """The approximate distance from an ellipsoid."""
    inner = hypot(*(x / r for x, r in zip(place, radii, strict=True)))
    steep = hypot(*(x / (r * r) for x, r in zip(place, radii, strict=True)))
    return inner * (inner - 1.0) / steep if steep else -min(radii)


def _joined(first: float, second: float, width: float) -> float:
    """The smaller of two distances, smoothed where they differ by less than `width` [m]."""
    mixed = max(0.0, width - abs(first - second)) / width
    return min(first, second) - 0.25 * mixed * mixed * width


def main() -> None:
    for scene in (f"{__name__}:gyroid?friction=0.2", f"{__name__}:head?stiffness=600&layers=6mm,3000"):
        params = Params().set({"scene": f"sdf:{scene}", "operator": "hand-6", "link.up": "4g", "link.down": "4g"})
        summary = simulate(params, seed=1).summary
        slack = summary["environment"]["env_slack_J"] or 0.0
        print(f"{scene}: {summary['verdict']['reason']}; the world's own account is never below {slack:.0e} J")


if __name__ == "__main__":
    main()
