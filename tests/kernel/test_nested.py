"""Arrays in records, read and written by compiled code: what numpy makes of the same lines."""

from __future__ import annotations

import operator
from typing import Any

import numba
import numpy as np
import pytest
from numba.core import types
from numba.core.registry import cpu_target

from hapnet.ext.compiled import nested

_NEAR = np.dtype([("at", np.float64, (3,)), ("count", np.int32, (2,))], align=True)
_WHOLE = np.dtype(
    [("first", np.int64), ("matrix", np.float64, (3, 4)), ("cube", np.float64, (2, 3, 2)), ("near", _NEAR, (2,))],
    align=True,
)


def _work(one: Any, small: Any, i: int) -> tuple[float, ...]:
    """Every index as an int and as another type, from both ends, of one and more dimensions, records and views."""
    one.near[-1].at[i] = 7
    one.near[small].at[-1] = one.matrix[-2][i] + one.matrix[i, -1]
    one.near[0].count[-2] = 11.9
    one.matrix[0][small] = one.cube[1][-1][0]
    one.matrix[2] = 2.5
    row, layer = one.matrix[i], one.cube[-1]
    row[0] += layer[-3, 1]
    length = len(one.near) + 10 * len(row) + 100 * layer.shape[0] + 1000 * layer.shape[1] + layer.size + layer.nbytes
    return float(length), row[-1], layer.sum(), row[1:3].sum(), float(one.near[0].count[0])


def _whole() -> Any:
    whole = np.zeros((), _WHOLE)
    whole["matrix"] = 0.1 + np.arange(12.0).reshape(3, 4)
    whole["cube"] = 100.0 + np.arange(12.0).reshape(2, 3, 2)
    return np.rec.array(whole)[()]


@pytest.mark.parametrize("integer", [np.int64, np.int32, np.uint8, np.uint64])
def test_compiled_lines_do_what_numpy_does(integer: Any) -> None:
    expected, found = _whole(), _whole()
    assert numba.njit(_work)(found, integer(1), 1) == _work(expected, integer(1), 1)
    assert found == expected


def test_numba_takes_these_and_its_own_for_all_else() -> None:
    """Were they not taken, everything would work, and only compile for half as long again."""
    context, ours = cpu_target.target_context, nested.__name__
    context.refresh()
    vector, array = numba.typeof(_whole()).typeof("matrix"), types.Array(types.float64, 1, "C")
    find = context._defns[operator.getitem].find
    assert find((vector, types.int64)).__module__ == ours != find((array, types.int64)).__module__
    assert context._defns[operator.setitem].find((vector, types.int64, types.float64)).__module__ == ours
