"""Records: the state that equations work on, in fields of fixed types.

A record is a class with typed fields: `float`, `int`, an array of a fixed shape, another record, or an array of
records. In plain Python it is an object with lists as vectors. In compiled code it is a numpy structure
(`hapnet.ext.compiled.memory`), so that a whole scenario is one pointer. A class may have further attributes: only
those declared in its body are fields.

Measured: in plain Python, lists with loops over indices are as fast as tuples with `map`, and eight times as fast as
numpy arrays. With tuples of arrays compiling took six times as long.

`equation` marks the functions that plain Python runs and numba compiles, both from one source. Such a function takes
numbers, records and their vectors, and writes its results into records; it calls only other marked functions.
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
"""All equations, each with the function that is compiled in its place; None: the equation itself."""


def equation(function: F) -> F:
    """Mark `function` as an equation."""
    EQUATIONS[function] = None
    return function


def compiled_as(twin: Callable[..., Any]) -> Callable[[F], F]:
    """Mark an equation for which `twin` is compiled: in Python a faster function gives the same result."""

    def mark(function: F) -> F:
        EQUATIONS[function] = twin
        return function

    return mark


class AxisCount(int):
    """A number of axes, as a dimension of fields."""


AXES = AxisCount(3)
"""The default number of axes in compiled memory (see `room_for`). Python's vectors have any length."""

PLANES = 8
"""The most planes that a world sends, for a tool."""

POINT_PLANES = 4
"""The most planes that a world sends for a point."""

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
"""A time after every event [ns]."""

_SHORT = 16
"""Longer arrays are numpy arrays in plain Python too: they are tables, with few elements in use at a time."""


R = TypeVar("R", bound="Record")

_FIELDS: dict[type[Record], dict[str, Any]] = {}
_MAKERS: dict[type[Record], tuple[tuple[str, Callable[[], Any]], ...]] = {}


class Record:
    """The base of all records; every field begins as zero."""

    def __init__(self) -> None:
        for name, make in _makers(type(self)):
            setattr(self, name, make())


def room_for(axes: int) -> int:
    """The number of axes for which memory and machine code are made, at least `axes`: 3, or whole dozens."""
    return int(AXES) if axes <= AXES else -(-axes // 12) * 12


def zero(kind: type[R]) -> R:
    """A record of this kind with all fields zero; its constructor is not called."""
    record = kind.__new__(kind)
    Record.__init__(record)
    return record


def holding(kind: type[R], **parts: type[Record]) -> type[R]:
    """A subclass of `kind` with these classes of records as fields: for a memory layout, if `kind` accepts any."""
    name = "Of".join([kind.__name__, *[part.__name__ for part in parts.values()]])
    return type(name, (kind,), {"__annotations__": parts})


def fields(kind: type[Record]) -> dict[str, Any]:
    """The fields of a class of records by name, with their types."""
    if kind not in _FIELDS:
        hints = get_type_hints(kind, include_extras=True)
        _FIELDS[kind] = {name: type_ for name, type_ in hints.items() if get_origin(type_) is not ClassVar}
    return _FIELDS[kind]


def element(type_: Any, axes: int = AXES) -> tuple[type, tuple[int, ...]]:
    """The element type and the shape of an array's type; any other type itself, with an empty shape.

    axes : replaces `AXES` in shapes.
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
    """Return the function that makes a field's initial value."""
    if not shape:
        return partial(zero, of) if issubclass(of, Record) else of
    if issubclass(of, Record):
        return lambda: [zero(of) for _ in range(shape[0])]
    if max(shape) > _SHORT:
        return lambda: np.zeros(shape, of)
    if len(shape) == 1:
        return lambda: [of()] * shape[0]
    return lambda: [[of()] * shape[1] for _ in range(shape[0])]
