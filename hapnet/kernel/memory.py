"""Records as compiled code has them: structures of numpy, which it reads and writes in place."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from hapnet.kernel.twins import COMPILED
from hapnet.records.record import Record, element, fields, zero

R = TypeVar("R", bound=Record)

_LAYOUTS: dict[type[Record], np.dtype[Any]] = {}
_UNUSED: dict[type[Record], list[Any]] = {}


class _View:
    """A structure with its fields as attributes: numpy's own records take many times as long."""

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
    if not COMPILED:
        return zero(kind)
    unused = _UNUSED.get(kind)
    view: Any = unused.pop() if unused else _View(np.zeros(1, layout(kind))[0])
    made: R = view  # it has the record's names
    return made


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


def layout(kind: type[Record]) -> np.dtype[Any]:
    """How the structure of a record looks."""
    if kind not in _LAYOUTS:
        described = []
        for name, type_ in fields(kind).items():
            of, shape = element(type_)
            described.append((name, layout(of) if issubclass(of, Record) else np.dtype(of), shape))
        _LAYOUTS[kind] = np.dtype(described, align=True)
    return _LAYOUTS[kind]


def store(structure: R, record: R) -> None:
    """Copy a record of plain Python into its structure, field by field; of vectors as many elements as it has."""
    for name, type_ in fields(type(record)).items():
        of, shape = element(type_)
        value = getattr(record, name)
        if not shape and not issubclass(of, Record):
            setattr(structure, name, value)
        elif issubclass(of, Record):
            pairs = zip(getattr(structure, name), value, strict=False) if shape else [(getattr(structure, name), value)]
            for one, other in pairs:
                store(one, other)
        elif len(shape) == 1:
            getattr(structure, name)[: len(value)] = value
        else:
            for row, values in zip(getattr(structure, name), value, strict=False):
                row[: len(values)] = values


def load(record: R, structure: R) -> None:
    """The reverse of `store`."""
    for name, type_ in fields(type(record)).items():
        of, shape = element(type_)
        found, value = getattr(structure, name), getattr(record, name)
        if not shape and not issubclass(of, Record):
            setattr(record, name, found)
        elif issubclass(of, Record):
            for one, other in zip(value, found, strict=False) if shape else [(value, found)]:
                load(one, other)
        elif len(shape) == 1:
            value[:] = plain(found[: len(value)])
        else:
            for values, row in zip(value, found, strict=False):
                values[:] = plain(row[: len(values)])


def plain(found: Any) -> list[Any]:
    """A vector as a list of Python's own numbers."""
    numbers: list[Any] = found.tolist() if isinstance(found, np.ndarray) else list(found)
    return numbers
