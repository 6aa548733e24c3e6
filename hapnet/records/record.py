"""Records: the state that equations work on, in fields of fixed types.

A record is a class with typed fields: `float`, `int`, an array of a fixed shape, another record, or an array of
records. Plain Python has it as an object whose vectors are lists. Compiled code has it as a numpy structure
(`hapnet.ext.compiled.memory`), so that a whole scenario is one pointer. A class may have attributes besides: only
what its body declares is a field.

That was measured: with lists and loops over indices a case takes plain Python as long as with tuples and `map`, with
numpy's arrays eight times as long. Tuples of arrays made compiling six times as long.

`equation` marks the functions that plain Python runs and numba compiles, both from one source. Such a function takes
numbers, records and their vectors, and writes its results into records; it calls only functions that are marked too.
Nothing is compiled here, and numba is not imported: `hapnet.ext.compiled.twins` makes a compiled twin of each when a
compiled run begins.
"""

from __future__ import annotations

from collections.abc import Callable, MutableSequence, Sequence
from functools import partial
from typing import Annotated, Any, ClassVar, TypeVar, get_args, get_origin, get_type_hints

import numpy as np

F = TypeVar("F", bound=Callable[..., Any])

EQUATIONS: dict[Any, Callable[..., Any] | None] = {}
"""All of them, each with what is compiled in its place; None: itself."""


def equation(function: F) -> F:
    """Mark `function`."""
    EQUATIONS[function] = None
    return function


def compiled_as(twin: Callable[..., Any]) -> Callable[[F], F]:
    """Mark a function in whose place `twin` is compiled, since Python has something faster that gives the same."""

    def mark(function: F) -> F:
        EQUATIONS[function] = twin
        return function

    return mark


class AxisCount(int):
    """A number of axes, as a dimension of fields."""


AXES = AxisCount(3)
"""Compiled memory has room for so many, unless more are asked for (`room_for`). Python's vectors have any length."""

PLANES = 4
"""The most planes that a world sends of one place."""

Floats = MutableSequence[float]
Wholes = MutableSequence[int]
FloatRows = MutableSequence[Floats]

Reals = Sequence[float]
"""A vector that is only read."""

OfAxes = Annotated[Floats, (AXES,)]
MatrixOfAxes = Annotated[FloatRows, (AXES, AXES)]
OfPlanes = Annotated[Floats, (PLANES,)]
VectorsOfPlanes = Annotated[FloatRows, (PLANES, AXES)]

NEVER = 2**63 - 1
"""A time that never comes [ns]."""

_SHORT = 16
"""Longer arrays are numpy's in plain Python too: tables, of which few elements are used at a time."""


R = TypeVar("R", bound="Record")

_FIELDS: dict[type[Record], dict[str, Any]] = {}
_MAKERS: dict[type[Record], tuple[tuple[str, Callable[[], Any]], ...]] = {}


class Record:
    """The base of all records; every field begins as zero."""

    def __init__(self) -> None:
        for name, make in _makers(type(self)):
            setattr(self, name, make())


def room_for(axes: int) -> int:
    """For how many axes memory and machine code are made where so many are asked for: 3, or whole dozens."""
    return int(AXES) if axes <= AXES else -(-axes // 12) * 12


def zero(kind: type[R]) -> R:
    """A record of this kind, all zero, whatever its class does when it is called."""
    record = kind.__new__(kind)
    Record.__init__(record)
    return record


def holding(kind: type[R], **parts: type[Record]) -> type[R]:
    """The class `kind` with these classes of records in its fields: for a layout, where `kind` takes any."""
    name = "Of".join([kind.__name__, *[part.__name__ for part in parts.values()]])
    return type(name, (kind,), {"__annotations__": parts})


def fields(kind: type[Record]) -> dict[str, Any]:
    """The fields of a class of records by name, with their types."""
    if kind not in _FIELDS:
        hints = get_type_hints(kind, include_extras=True)
        _FIELDS[kind] = {name: type_ for name, type_ in hints.items() if get_origin(type_) is not ClassVar}
    return _FIELDS[kind]


def element(type_: Any, axes: int = AXES) -> tuple[type, tuple[int, ...]]:
    """The type of the elements of an array, and its shape; of anything else itself, and no shape.

    axes : stands in shapes in place of `AXES`.
    """
    if isinstance(type_, type):
        return type_, ()
    of, shape = get_args(type_)
    while get_args(of):
        of = get_args(of)[0]
    return of, tuple([axes if isinstance(length, AxisCount) else length for length in shape])


def _makers(kind: type[Record]) -> tuple[tuple[str, Callable[[], Any]], ...]:
    if kind not in _MAKERS:
        _MAKERS[kind] = tuple((name, _maker(*element(type_))) for name, type_ in fields(kind).items())
    return _MAKERS[kind]


def _maker(of: type, shape: tuple[int, ...]) -> Callable[[], Any]:
    """Return the function that makes a field's first value."""
    if not shape:
        return partial(zero, of) if issubclass(of, Record) else of
    if issubclass(of, Record):
        return lambda: [zero(of) for _ in range(shape[0])]
    if max(shape) > _SHORT:
        return lambda: np.zeros(shape, of)
    if len(shape) == 1:
        return lambda: [of()] * shape[0]
    return lambda: [[of()] * shape[1] for _ in range(shape[0])]
