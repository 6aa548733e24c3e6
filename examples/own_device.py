"""A device of your own: a class with `dof`, its limits, `read` and `apply`.

This carriage on a tilted rail slides into a virtual wall and comes to rest where the wall carries its weight.

python examples/own_device.py                               # flags of `hapnet run` may follow: --link 4g
hapnet run --device examples.own_device:Rail                # the same; `hapnet device`: with the world on another host
"""

from __future__ import annotations

import sys
import time

Vector = tuple[float, ...]


class Rail:
    """A carriage simulated in real time. For real hardware put your driver's calls into `read` and `apply`."""

    force_limit = 3.0  # of the actuators [N]; None: no limit
    resolution = 2e-5  # of the encoders [m]; 0.0: exact

    MASS, FRICTION, WEIGHT = 0.1, 2.0, 1.0  # kg, Ns/m, and N along the rail

    def __init__(self, dof: int) -> None:
        self.dof = dof
        self._x = self._v = self._force = (0.0,) * dof
        self._read_s = time.monotonic()
        self._caught = True  # held by a catch until control begins

    def begin(self) -> None:
        """Open the catch; called when the sides have connected."""
        self._caught = False

    def read(self) -> tuple[Vector, Vector]:
        """Position [m] and velocity [m/s] now; called once per servo period."""
        now = time.monotonic()
        dt, self._read_s = min(now - self._read_s, 0.01), now
        if self._caught:
            return self._x, self._v
        push = [f + self.WEIGHT - self.FRICTION * v for f, v in zip(self._force, self._v, strict=True)]
        self._v = tuple(v + dt * f / self.MASS for v, f in zip(self._v, push, strict=True))
        self._x = tuple(x + dt * v for x, v in zip(self._x, self._v, strict=True))
        return tuple(self.resolution * round(x / self.resolution) for x in self._x), self._v

    def apply(self, force: Vector) -> None:
        """Hold this force [N] until the next call."""
        self._force = force


if __name__ == "__main__":
    from hapnet.cli import main

    # otherwise the carriage would fall during hapnet's test pushes and while the force ramps up
    at_once = ("--set", "device.self_test_N=0", "--set", "device.force_ramp_s=0")
    raise SystemExit(main(["run", "--device", "examples.own_device:Rail", "--duration", "3", *at_once, *sys.argv[1:]]))
