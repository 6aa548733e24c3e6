"""Copies state between the reference's objects and the kernel's records, attribute by attribute.

A record has the names of its reference without underscores, so most of its fields are copied by name, private ones too:
as with pickling, what is copied is the object's state, not its interface.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from hapnet.kernel.memory import plain
from hapnet.records.record import Record


def value(source: object, name: str) -> Any:
    """An attribute of the reference by its name, preferring the one with an underscore before it."""
    return getattr(source, _found(source, name))


def replace(target: object, name: str, new: Any) -> None:
    """Set such an attribute."""
    setattr(target, _found(target, name), new)


def _found(source: object, name: str) -> str:
    return f"_{name}" if hasattr(source, f"_{name}") else name


def put(record: Record, field: str, values: Any) -> None:
    """Set a field: a number, or as many elements of an array as there are values."""
    if not isinstance(values, list | tuple):
        setattr(record, field, values)
    elif values:
        array = getattr(record, field)
        if isinstance(values[0], list | tuple):
            for row, numbers in zip(array, values, strict=False):
                row[: len(numbers)] = numbers
        else:
            array[: len(values)] = values


def read(record: Record, source: object, names: str, **renamed: str) -> None:
    """Copy attributes of `source` into the record.

    names : of attributes, separated by spaces. renamed : the record's field, and the attribute's name.
    """
    for name in names.split():
        put(record, name, value(source, name))
    for field, name in renamed.items():
        put(record, field, value(source, name))


def write(record: Record, target: object, names: str, **renamed: str) -> None:
    """Copy numbers from the record to attributes of `target`: the reverse of `read`."""
    for name in names.split():
        replace(target, name, number(getattr(record, name)))
    for field, name in renamed.items():
        replace(target, name, number(getattr(record, field)))


def number(found: Any) -> Any:
    """A plain number: without a compiler, elements of arrays come into fields as numpy's numbers."""
    return found.item() if isinstance(found, np.generic) else found


def vector(record: Record, field: str, n: int) -> tuple[float, ...]:
    """A vector of the record."""
    return tuple(plain(getattr(record, field)[:n]))


def optional(record: Record, field: str, flag: str, found: Any) -> None:
    """Set a field whose value may be None; `flag` says whether it is known."""
    put(record, flag, int(found is not None))
    if found is not None:
        put(record, field, found)
