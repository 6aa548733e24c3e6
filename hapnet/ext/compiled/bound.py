"""Records of plain Python whose fields lie in compiled memory: Python and compiled code work on the same ones.

So nothing is copied when a servo's tick is compiled and the rest of its side is not. A bound record is read and written
as before, at twice the time: its class gets a property for each field.
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
    """A record of this kind, all zero, with room for so many axes: as an array of one, which a compiled function takes,
    and its place, where the fields are read and written."""
    array: Any = np.zeros(1, layout(kind, axes))
    place: Any = _structure(kind, axes).from_buffer(array)  # it has the record's names
    return array, place


def copy(place: R, record: R) -> None:
    """Copy a record, and all that is in it, to its place."""
    for name, (of, shape) in _fields(type(record)).items():
        _write(place, name, of, shape, getattr(record, name))


def read(kind: type[R], place: R, axes: int) -> R:
    """A record of plain Python, like the one at a place but with so many axes; it has no arrays of records in it."""
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
    """Moves records that know each other to memory: each gets a new record, whose fields lie there, in its place.

    Whoever is moved later knows the new ones of those that were moved before. Nobody uses the old ones any more.

    copied : records of these classes are only copied. Nobody writes into them, but several sides share them.
    """

    def __init__(self, copied: tuple[type[Record], ...] = ()) -> None:
        self._copied = copied
        self._moved: dict[int, tuple[Record, Record]] = {}  # with the old ones, so that no other gets their number

    def to(self, place: Any, record: Record, as_kind: type[Record] | None = None) -> Any:
        """The new record, with new ones in it.

        place : a `memory`, or a field of it. as_kind : its class, one that adds methods to that of `record`; None: the
        same.
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
        """The value of another attribute than a field: a record in it, alone or in a tuple, may have been moved."""
        if type(value) is tuple:
            return tuple([self._new(one) for one in value])
        return self._moved.get(id(value), (value, value))[1]


def move_on(place: Any, record: Record) -> None:
    """Move a record that `Move` has made to another place; it has no records in it."""
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
    """The layout of a record, as `memory.layout` has it."""
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
    """The class of bound records of this kind; it may be such a class already."""
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
    """Return a bound record's form of a vector as long as `value`; records in a vector are Python's own."""
    if issubclass(of, Record) or not shape:
        return value
    whole = getattr(place, name)
    if len(shape) == 1:
        return (_SCALARS[of] * len(value)).from_buffer(whole)
    return [(_SCALARS[of] * len(row)).from_buffer(one) for one, row in zip(whole, value, strict=False)]


def _write(place: Any, name: str, of: type, shape: tuple[int, ...], value: Any) -> None:
    """Copy a field to its place; of a vector as many elements as it has."""
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
