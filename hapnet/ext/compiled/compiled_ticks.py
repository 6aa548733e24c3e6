"""The compiled ticks of a simulated arm or handle, whose record Python reads and writes as well."""

from __future__ import annotations

from typing import Any

from hapnet.checks import Vector


class CompiledTicks:
    """Makes a tick by a compiled call: the `compiled` of a `SimulatedArm` or a `SimulatedHandle`.

    array, end : the end's memory, with `path`, of two rows, and `work`. run : the compiled tick.
    """

    def __init__(self, array: Any, end: Any, run: Any) -> None:
        self._array, self._end, self._run = array, end, run

    def __call__(self, begin: Vector, end: Vector) -> float:
        path, n = self._end.path, len(begin)
        path[0][:n], path[1][:n] = begin, end
        self._run(self._array)
        work: float = self._end.work
        return work
