"""Records as numpy structures, which compiled code reads and writes in place."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from hapnet.records.record import AXES, Record, element, fields

R = TypeVar("R", bound=Record)

_LAYOUTS: dict[tuple[type[Record], int], np.dtype[Any]] = {}
_PLANS: dict[type[Record], list[tuple[str, type[Record] | None, int]]] = {}
_UNUSED: dict[type[Record], list[Any]] = {}


class _View:
    """A structure with its fields as attributes: numpy's own records are many times slower."""

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
        vars(self)[name] = found  # a view of the same memory, so it stays up to date
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
    unused = _UNUSED.get(kind)
    view: Any = unused.pop() if unused else _View(np.zeros(1, layout(kind))[0])
    record: R = view  # it has the record's names
    return record


def give_back(record: R, kind: type[R]) -> None:
    """Give back an unused record, so that `new` can return it again with its memory and views."""
    view: Any = record
    view.structure.base.view(np.uint8).fill(0)
    _UNUSED.setdefault(kind, []).append(record)


def bare(record: R) -> R:
    """The structure of the record, which compiled code takes."""
    view: Any = record
    taken: R = view.structure
    return taken


def layout(kind: type[Record], axes: int = AXES) -> np.dtype[Any]:
    """The numpy type of a record's structure with room for `axes` axes."""
    if (kind, axes) not in _LAYOUTS:
        described = []
        for name, type_ in fields(kind).items():
            of, shape = element(type_, axes)
            described.append((name, layout(of, axes) if issubclass(of, Record) else np.dtype(of), shape))
        _LAYOUTS[kind, axes] = np.dtype(described, align=True)
    return _LAYOUTS[kind, axes]


def store(structure: R, record: R) -> None:
    """Copy a plain Python record into its structure, field by field; vectors may be shorter than in the structure."""
    for name, of, dimensions in _plan(type(record)):
        value = getattr(record, name)
        if of is not None and not dimensions:
            store(getattr(structure, name), value)
        elif of is not None:
            for one, other in zip(getattr(structure, name), value, strict=False):
                store(one, other)
        elif not dimensions:
            setattr(structure, name, value)
        elif dimensions == 1:
            getattr(structure, name)[: len(value)] = value
        elif len(value):
            rows: Any = getattr(structure, name)
            rows[: len(value), : len(value[0])] = value


def load(record: R, structure: R) -> None:
    """Copy a structure back into its plain Python record, as the reverse of `store`; tuples stay unchanged."""
    for name, of, dimensions in _plan(type(record)):
        if isinstance(getattr(record, name), tuple):
            continue
        found = getattr(structure, name)
        if of is not None and not dimensions:
            load(getattr(record, name), found)
        elif of is not None:
            for one, other in zip(getattr(record, name), found, strict=False):
                load(one, other)
        elif not dimensions:
            setattr(record, name, found)
        else:
            value = getattr(record, name)
            if dimensions == 1:
                numbers = plain(found[: len(value)])
                value[:] = array(value.typecode, numbers) if isinstance(value, array) else numbers
            elif len(value):
                width = len(value[0])
                value[:] = [row[:width] for row in plain(found[: len(value)])]


def _plan(kind: type[Record]) -> list[tuple[str, type[Record] | None, int]]:
    """Each field's name, the kind of record in it (None: numbers), and its number of dimensions."""
    if kind not in _PLANS:
        found = [(name, *element(type_)) for name, type_ in fields(kind).items()]
        _PLANS[kind] = [(name, of if issubclass(of, Record) else None, len(shape)) for name, of, shape in found]
    return _PLANS[kind]


def fill(target: Any, values: Sequence[float]) -> None:
    """Copy a vector to the beginning of a longer one."""
    target[: len(values)] = values


def plain(found: Any) -> list[Any]:
    """A vector as a list of Python's own numbers."""
    numbers: list[Any] = found.tolist()
    return numbers
