"""Records: the kernel's state, in structures that compiled code reads and writes in place.

A record is declared as a class with typed fields: `float`, `int`, an array of a fixed shape, another record, or an
array of records. Compiled code gets a numpy structure, so that a whole scenario is one pointer. (A tuple of arrays made
compiling six times as long.) Plain Python gets instances of the classes, which are a good deal faster there.
"""

from __future__ import annotations

from typing import Annotated, Any, TypeVar, get_args, get_type_hints

import numpy as np
from numpy.typing import NDArray

from hapnet.kernel.jit import COMPILED

AXES = 3
"""The most axes that a scenario may have."""

PLANES = 4
"""The most planes that a world tells of one place."""

Floats = NDArray[np.float64]
Wholes = NDArray[np.int64]

Vector = Annotated[Floats, (AXES,)]
Matrix = Annotated[Floats, (AXES, AXES)]
OfPlanes = Annotated[Floats, (PLANES,)]
VectorsOfPlanes = Annotated[Floats, (PLANES, AXES)]


class Record:
    """The base of all records; every field begins as zero."""


R = TypeVar("R", bound=Record)

_LAYOUTS: dict[type[Record], np.dtype[Any]] = {}
_UNUSED: dict[type[Record], list[Any]] = {}


class _View:
    """A record as compiled code has it, with its fields as attributes: numpy's own records take many times as long."""

    def __init__(self, structure: np.void) -> None:
        vars(self)["structure"] = structure

    def __getattr__(self, name: str) -> Any:
        found = self.structure[name]
        if isinstance(found, np.void):
            found = _View(found)
        elif isinstance(found, np.generic):
            return found.item()
        elif found.dtype.names is not None:
            found = _Views(found)
        vars(self)[name] = found  # it is a view of the same place, whatever is written there
        return found

    def __setattr__(self, name: str, value: Any) -> None:
        self.structure[name] = value


class _Views:
    """An array of records."""

    __slots__ = ("structures",)

    def __init__(self, structures: NDArray[Any]) -> None:
        self.structures = structures

    def __len__(self) -> int:
        return len(self.structures)

    def __getitem__(self, index: int) -> _View:
        return _View(self.structures[index])


def new(kind: type[R]) -> R:
    """A record of this kind, all zero."""
    if COMPILED:
        unused = _UNUSED.get(kind)
        view: Any = unused.pop() if unused else _View(np.zeros(1, layout(kind))[0])
        made: R = view  # it has the record's names
        return made
    record = kind()
    for name, type_ in fields(kind).items():
        setattr(record, name, _zero(type_))
    return record


def give_back(record: R, kind: type[R]) -> None:
    """Nobody uses the record any more: `new` may return it. Its memory, and the views of it, are worth keeping."""
    if COMPILED:
        view: Any = record
        memory = view.structure.base
        memory.view(np.uint8).fill(0)
        _UNUSED.setdefault(kind, []).append(record)


def bare(record: R) -> R:
    """The record as compiled code takes it."""
    view: Any = record
    taken: R = view.structure if COMPILED else record
    return taken


def _zero(type_: Any) -> Any:
    if type_ in (int, float):
        return type_()
    if isinstance(type_, type):
        return new(type_)
    element, shape = _element(type_)
    return [new(element) for _ in range(*shape)] if issubclass(element, Record) else np.zeros(shape, element)


def fields(kind: type[Record]) -> dict[str, Any]:
    """The fields of a record by name, with their types."""
    return get_type_hints(kind, include_extras=True)


def layout(kind: type[Record]) -> np.dtype[Any]:
    """How an element of the structured array looks."""
    if kind in _LAYOUTS:
        return _LAYOUTS[kind]
    described = []
    for name, type_ in fields(kind).items():
        element, shape = (type_, ()) if isinstance(type_, type) else _element(type_)
        described.append((name, layout(element) if issubclass(element, Record) else np.dtype(element), shape))
    _LAYOUTS[kind] = np.dtype(described, align=True)
    return _LAYOUTS[kind]


def _element(type_: Any) -> tuple[type, tuple[int, ...]]:
    """The type of an array's elements, and its shape."""
    array, shape = get_args(type_)
    arguments = get_args(array)
    return (arguments[0] if len(arguments) == 1 else get_args(arguments[1])[0]), shape
