"""A device of your own: anything with `dof`, limits, `read` and `apply`. Here a mass on a bench, without a hand.

hapnet run --device examples.own_device:Bench
"""

from __future__ import annotations

import time


class Bench:
    """A 100 g carriage on a rail, integrated in its own time; replace `read` and `apply` with your driver's calls."""

    force_limit = 3.0  # N
    resolution = 2e-5  # m

    def __init__(self, dof: int) -> None:
        self.dof = dof
        self._x = self._v = self._force = [0.0] * dof
        self._seen = time.monotonic()

    def read(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        now = time.monotonic()
        dt, self._seen = min(now - self._seen, 0.01), now
        self._v = [v + dt * (f - 0.5 * v) / 0.1 for v, f in zip(self._v, self._force, strict=True)]
        self._x = [x + dt * v for x, v in zip(self._x, self._v, strict=True)]
        counts = tuple(self.resolution * round(x / self.resolution) for x in self._x)
        return counts, tuple(self._v)

    def apply(self, force: tuple[float, ...]) -> None:
        self._force = list(force)


if __name__ == "__main__":
    from hapnet.cli import main

    raise SystemExit(main(["run", "--device", "examples.own_device:Bench", "--duration", "3", "--out", "runs/bench"]))
