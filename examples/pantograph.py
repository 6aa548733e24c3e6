"""A pantograph of your own: two motors turn two arms, and two forearms hold one handle (a five-bar linkage).

Lengths and encoders are as in Haply's hAPI for its 2DIY, third generation. Handle and hand are simulated: replace them
with your motors. See hapnet/devices/pantograph.md.

hapnet run --device examples.pantograph:Pantograph --dof 2
"""

import sys
import time
from collections.abc import Callable
from math import acos, atan2, cos, hypot, pi, sin, sqrt

Vector = tuple[float, ...]
ARM, FOREARM, BASE, COUNT = 0.07, 0.09, 0.038, 2 * pi / 4880  # m; the motors lie at (0, 0) and (BASE, 0); rad
CENTRE = (BASE / 2, 0.11)  # hapnet's origin relative to the left motor [m]


class Linkage:
    """Position of the handle and Jacobian, for arms at the angles `left` and `right` [rad] from the x axis."""

    def __init__(self, left: float, right: float) -> None:
        self.turned = left, right
        ax, ay = ARM * cos(left), ARM * sin(left)
        bx, by = BASE + ARM * cos(right), ARM * sin(right)
        wide = hypot(bx - ax, by - ay)
        high = sqrt(FOREARM**2 - wide**2 / 4) / wide
        self.handle = x, y = (ax + bx) / 2 - high * (by - ay), (ay + by) / 2 + high * (bx - ax)
        (ux, uy), (vx, vy) = self.forearms = (x - ax, y - ay), (x - bx, y - by)
        a, b = self.levers = uy * ax - ux * ay, vy * (bx - BASE) - vx * by  # lever of each arm's torque on its forearm
        flat = ux * vy - uy * vx  # 0 if the forearms are collinear
        self.jacobian = (a * vy / flat, -b * uy / flat), (-a * vx / flat, b * ux / flat)  # dx/d(left), dx/d(right); dy

    def torques(self, force: Vector) -> Vector:
        """The motors' torques for this force at the handle, J transposed times the force [Nm]."""
        return tuple(sum(row[k] * f for row, f in zip(self.jacobian, force, strict=True)) for k in (0, 1))

    def force(self, torques: Vector) -> Vector:
        """The force at the handle from these torques [N]: each torque pulls along its forearm."""
        pulls = [torque / lever for torque, lever in zip(torques, self.levers, strict=True)]
        return tuple(sum(bar[k] * pull for bar, pull in zip(self.forearms, pulls, strict=True)) for k in (0, 1))


def angles(x: float, y: float) -> Vector:
    """The arms' angles [rad] for a handle at (x, y) [m], with the elbows outwards."""
    bent = [acos((ARM**2 + r * r - FOREARM**2) / (2 * ARM * r)) for r in (hypot(x, y), hypot(x - BASE, y))]
    return atan2(y, x) + bent[0], atan2(y, x - BASE) - bent[1]


class Pantograph:
    """Encoders and motors at the joints; position and force at the handle."""

    force_limit, resolution, workspace = 3.0, 0.09 * COUNT, (0.06, 0.05)  # a count moves the handle by 90 mm * COUNT
    knows_force = False  # the motors' actual force is not measured

    def __init__(self, dof: int, clock: Callable[[], float] = time.monotonic) -> None:
        self.dof, self.clock, self.at, self.v = dof, clock, clock(), (0.0, 0.0)
        self.motors = Motors(self.at)
        self.now = self.between = Linkage(*angles(*CENTRE))

    def read(self) -> tuple[Vector, Vector]:
        """Position [m], and velocity filtered over 15 ms [m/s]."""
        before, then, self.at = self.now, self.at, self.clock()
        self.now = Linkage(*self.motors.read(self.at))
        self.between = Linkage(*[(a + b) / 2 for a, b in zip(before.turned, self.now.turned, strict=True)])
        share = (self.at - then) / (self.at - then + 0.015)
        way = [b - a for a, b in zip(before.handle, self.now.handle, strict=True)]
        self.v = tuple(
            (1.0 - share) * v + share * w / max(self.at - then, 1e-6) for v, w in zip(self.v, way, strict=True)
        )
        return tuple(x - c for x, c in zip(self.now.handle, CENTRE, strict=True)), self.v

    def apply(self, force: Vector) -> None:
        """Hold the torques that make this force [N] at the current position."""
        self.motors.torques = self.now.torques(force)

    def acted(self) -> Vector:
        """The mean force since the last tick: the torques are held while the arms turn, so it is taken halfway."""
        return self.between.force(self.motors.torques)


class Motors:
    """Simulated motors and a handle of 0.1 kg, in a hand that rests for a second, then moves 30 mm to the right."""

    def __init__(self, now: float) -> None:
        self.now, self.born, self.work = now, now, 0.0
        self.x, self.v = list(CENTRE), [0.0, 0.0]
        self.torques: Vector = (0.0, 0.0)

    def read(self, now: float) -> Vector:
        """The arms' angles [rad], in whole counts of the encoders."""
        self.now = max(self.now, now - 0.02)
        while self.now + 1e-4 <= now:
            force = Linkage(*angles(*self.x)).force(self.torques)
            goal = CENTRE[0] + 0.03 * min(1.0, max(0.0, self.now - self.born - 1.0)), CENTRE[1]
            for k in (0, 1):
                self.v[k] += 1e-3 * (force[k] + 40.0 * (goal[k] - self.x[k]) - 4.0 * self.v[k])
                self.x[k] += 1e-4 * self.v[k]
                self.work += 1e-4 * self.v[k] * force[k]
            self.now += 1e-4
        return tuple(COUNT * round(angle / COUNT) for angle in angles(*self.x))


if __name__ == "__main__":
    from hapnet.cli import main

    raise SystemExit(main(["run", "--device", "examples.pantograph:Pantograph", "--dof", "2", *sys.argv[1:]]))
