"""Python records with fields in the memory of compiled code: Python and compiled code share them.

So nothing is copied when a servo's tick is compiled and the rest of its side is not. A bound record is read and written
as before, in twice the time: its class gets a property for each field.
"""

from __future__ import annotations

import ctypes
from functools import cache
from operator import attrgetter
from types import SimpleNamespace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from hapnet.ext.compiled.memory import layout
from hapnet.records.record import AXES, Record, element, fields

R = TypeVar("R", bound=Record)

_FIELDS: dict[tuple[Any, int], dict[str, tuple[Any, tuple[int, ...]]]] = {}
_SCALARS: dict[type, Any] = {float: ctypes.c_double, int: ctypes.c_int64}


def memory(kind: Any, axes: int = AXES) -> tuple[NDArray[Any], Any]:
    """Return a zero record of this kind with room for `axes` axes: as an array of length 1 for compiled functions, and
    as its place, a ctypes structure in the same memory, for Python to read and write the fields."""
    array: Any = np.zeros(1, layout(kind, axes))
    place: Any = _structure(kind, axes).from_buffer(array)  # it has the record's names
    return array, place


def copy(place: R, record: R) -> None:
    """Copy a record and its inner records to a place."""
    for name, (of, shape) in _fields(type(record)).items():
        _write(place, name, of, shape, getattr(record, name))


def read(kind: type[R], place: R, axes: int) -> R:
    """Return the record at a place as a plain Python record with `axes` axes; arrays of records are not supported."""
    record = kind.__new__(kind)
    for name, (of, shape) in _fields(kind, axes).items():
        value = getattr(place, name)
        if issubclass(of, Record):
            value = read(of, value, axes)
        elif shape:
            value = value[: shape[0]] if len(shape) == 1 else [row[: shape[1]] for row in value]
        setattr(record, name, value)
    return record


class Move:
    """Moves records that refer to each other to memory: replaces each by a new record with its fields there.

    Records moved later refer to the new versions of records moved before. Do not use the old records afterwards.

    copied : records of these classes are only copied: several sides share them, and none writes to them.
    """

    def __init__(self, copied: tuple[type[Record], ...] = ()) -> None:
        self._copied = copied
        self._moved: dict[int, tuple[Record, Record]] = {}  # keeps the old records alive, so that their ids stay unique

    def to(self, place: Any, record: Record, as_kind: type[Record] | None = None) -> Any:
        """Return the new record, with its inner records replaced too.

        place : a `memory`, or a field of it. as_kind : the new record's class, which adds methods to that of `record`;
        None: the same class.
        """
        kind: Any = as_kind or type(record)
        bound = _bound(kind)
        made = bound.__new__(bound)
        views, known = SimpleNamespace(), _fields(type(record))
        for name, (of, shape) in known.items():
            value = getattr(record, name)
            if isinstance(value, Record) and not isinstance(value, self._copied):
                value = self.to(getattr(place, name), value)
            else:
                _write(place, name, of, shape, value)
            setattr(views, name, _view(place, name, of, shape, value))
        vars(made).update({name: self._new(value) for name, value in vars(record).items() if name not in known})
        vars(made).update(bound_at=place, bound_views=views)
        self._moved[id(record)] = record, made
        return made

    def _new(self, value: Any) -> Any:
        """The new value of an attribute that is not a field: moved records, alone or in a tuple, are replaced."""
        if type(value) is tuple:
            return tuple([self._new(one) for one in value])
        return self._moved.get(id(value), (value, value))[1]


def move_on(place: Any, record: Record) -> None:
    """Move a record that `Move` has made to another place; it must not contain records."""
    views = SimpleNamespace()
    for name, (of, shape) in _fields(type(record)).items():
        value = getattr(record, name)
        _write(place, name, of, shape, value)
        setattr(views, name, _view(place, name, of, shape, value))
    vars(record).update(bound_at=place, bound_views=views)


def _fields(kind: Any, axes: int = AXES) -> dict[str, tuple[Any, tuple[int, ...]]]:
    if (kind, axes) not in _FIELDS:
        _FIELDS[kind, axes] = {name: element(type_, axes) for name, type_ in fields(kind).items()}
    return _FIELDS[kind, axes]


@cache
def _structure(kind: Any, axes: int) -> type[ctypes.Structure]:
    """The ctypes class with the layout of `memory.layout`."""
    described = []
    for name, (of, shape) in _fields(kind, axes).items():
        one: Any = _structure(of, axes) if issubclass(of, Record) else _SCALARS[of]
        for length in reversed(shape):
            one = one * length
        described.append((name, one))
    made = type(kind.__name__, (ctypes.Structure,), {"_fields_": described})
    assert ctypes.sizeof(made) == layout(kind, axes).itemsize, kind
    return made


@cache
def _bound(kind: Any) -> Any:
    """Return the class of bound records of this kind; `kind` itself if it is such a class already."""
    if any("bound_at" in vars(one) for one in kind.__mro__):
        return kind
    return type(kind.__name__, (kind,), {"bound_at": None, **_properties(kind)})


def _properties(kind: type[Record]) -> dict[str, property]:
    return {name: _property(name, *of) for name, of in _fields(kind).items()}


def _property(name: str, of: type, shape: tuple[int, ...]) -> property:
    if not shape and not issubclass(of, Record):
        return property(attrgetter(f"bound_at.{name}"), lambda record, value: setattr(record.bound_at, name, value))

    def write(record: Any, value: Any) -> None:
        assert shape, f"{name} is a record, which stays in its place"
        setattr(record.bound_views, name, _view(record.bound_at, name, of, shape, value))
        _write(record.bound_at, name, of, shape, value)

    return property(attrgetter(f"bound_views.{name}"), write)


def _view(place: Any, name: str, of: type, shape: tuple[int, ...], value: Any) -> Any:
    """Return a view of a vector field with the length of `value`; other values are returned unchanged."""
    if issubclass(of, Record) or not shape:
        return value
    whole = getattr(place, name)
    if len(shape) == 1:
        return (_SCALARS[of] * len(value)).from_buffer(whole)
    return [(_SCALARS[of] * len(row)).from_buffer(one) for one, row in zip(whole, value, strict=False)]


def _write(place: Any, name: str, of: type, shape: tuple[int, ...], value: Any) -> None:
    """Copy a field to its place; a vector may be shorter than the place."""
    if not shape:
        if issubclass(of, Record):
            copy(getattr(place, name), value)
        else:
            setattr(place, name, value)
        return
    whole = getattr(place, name)
    for at, one in enumerate(value):
        if issubclass(of, Record):
            copy(whole[at], one)
        elif len(shape) == 1:
            whole[at] = one
        else:
            whole[at][: len(one)] = one
