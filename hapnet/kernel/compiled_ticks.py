"""A simulated device whose ticks are compiled calls on a record that Python reads and writes as well."""

from __future__ import annotations

from typing import Any

from hapnet.checks import Vector


class CompiledTicks:
    """Comes before a simulated device's class, in place of its `_run`. Its end has `path`, of two rows, and `work`."""

    def runs(self, array: Any, end: Any, run: Any) -> None:
        """array, end : the end's memory. run : the compiled tick."""
        self._array, self._end, self._compiled = array, end, run

    def _run(self, begin: Vector, end: Vector) -> float:
        path, n = self._end.path, len(begin)
        path[0][:n], path[1][:n] = begin, end
        self._compiled(self._array)
        work: float = self._end.work
        return work
