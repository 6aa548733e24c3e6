"""Parameters as text and tables: nested values under dotted names, conversion from text, and ranges."""

from __future__ import annotations

import dataclasses
import json
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass
from numbers import Integral, Real
from typing import Any, Self, cast

from hapnet.errors import InvalidParameter

RENAMED: Mapping[str, str] = {"feel": "rendering", "operator_hand": "operator_model"}
"""Former names of parameters and sections: accepted for one more release, and in recordings for ever."""


def present_name(name: str) -> str:
    """The dotted name that a parameter has today, from this one or a former one."""
    first, dot, rest = name.partition(".")
    return RENAMED.get(first, first) + dot + rest


LARGEST_SEED = 2**63 - 1
"""The largest whole number that every reader of JSON and TOML can represent (64 bits)."""


@dataclass(frozen=True)
class Range:
    """The numbers that a parameter may have. For a matrix the range applies only if the value is a single number."""

    above: float | None = None
    at_least: float | None = None
    at_most: float | None = None

    def __contains__(self, value: float) -> bool:
        return (
            (self.above is None or value > self.above)
            and (self.at_least is None or value >= self.at_least)
            and (self.at_most is None or value <= self.at_most)
        )

    def __str__(self) -> str:
        if self.at_least is not None:
            return f"{self.at_least:g} or above" if self.at_most is None else f"{self.at_least:g} to {self.at_most:g}"
        return f"a number above {self.above:g}" + ("" if self.at_most is None else f", at most {self.at_most:g}")


Allowed = tuple[str, ...] | Range
"""The texts or the numbers that a parameter may have."""


NOT_NEGATIVE, POSITIVE = Range(at_least=0.0), Range(above=0.0)


def parameter(default: object, doc: str, allowed: Allowed = Range()) -> Any:
    """A field of a section: its default, its meaning, and its allowed values."""
    return dataclasses.field(default=default, metadata={"doc": doc, "allowed": allowed})


_KINDS: dict[str, tuple[type, type, str]] = {  # the usual type, the accepted type, and its description
    "str": (str, str, "a text"),
    "bool": (bool, bool, "True or False"),
    "int": (int, Integral, "a whole number"),
    "float": (float, Real, "a number"),
}


def check_kind(name: str, value: object, annotation: str) -> None:
    """Raise InvalidParameter if `value` is not of its parameter's plain type; other types are checked in use."""
    usual, kind, words = _KINDS.get(annotation, (None, object, ""))
    if usual is None or type(value) is usual:
        return
    if not isinstance(value, kind) or isinstance(value, bool):
        raise InvalidParameter(name, value, words)


def check_allowed(name: str, value: object, allowed: Allowed) -> None:
    """Raise InvalidParameter unless `value` is one of the texts or numbers; a vector or matrix always passes."""
    if not isinstance(allowed, Range):
        if value not in allowed:
            raise InvalidParameter(name, value, "one of " + ", ".join(allowed), allowed)
    elif isinstance(value, float | int):
        if not math.isfinite(value):
            raise InvalidParameter(name, value, "a finite number")
        if value not in allowed:
            raise InvalidParameter(name, value, str(allowed))


def nested(section: Any) -> dict[str, Any]:
    """All values by name; a section's values are in a nested dictionary. Values are immutable, so none is copied."""
    values = ((spec, getattr(section, spec.name)) for spec in fields(section))
    return {
        spec.name: nested(value) if is_dataclass(value) else value
        for spec, value in values
        if is_dataclass(value) or spec.metadata
    }


class Section:
    """A dataclass of parameters that records which values were passed to its constructor.

    `dataclasses.replace` passes all values, so for such a copy none counts as set by hand.
    """

    made_with: frozenset[str]

    def __new__(cls, *values: object, **named: object) -> Self:
        self = super().__new__(cls)
        own = [spec.name for spec in fields(cast(Any, cls)) if spec.init]
        made_with = frozenset([*own[: len(values)], *named])
        object.__setattr__(self, "made_with", made_with if len(made_with) < len(own) else frozenset())
        return self


def set_by_hand(node: Any, prefix: str = "") -> Iterator[str]:
    """The dotted names of the parameters that were passed to the constructor of a section or of its subsections."""
    for spec in fields(node):
        value = getattr(node, spec.name)
        if isinstance(value, Section):
            yield from set_by_hand(value, f"{prefix}{spec.name}.")
        elif spec.metadata and isinstance(node, Section) and spec.name in node.made_with:
            yield prefix + spec.name


def leaves(node: Any, prefix: str = "") -> Iterator[tuple[str, Any, dataclasses.Field[Any]]]:
    """(dotted name, value, field) of every parameter: a section's own values before its subsections."""
    branches = []
    for spec in fields(node):
        value = getattr(node, spec.name)
        if is_dataclass(value):
            branches.append((f"{prefix}{spec.name}.", value))
        elif spec.metadata:
            yield prefix + spec.name, value, spec
    for name, value in branches:
        yield from leaves(value, name)


def toml_value(value: object) -> str:
    """The value as TOML, made from JSON; TOML allows no escaped surrogates (so none is escaped) and no bare DEL."""
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def flatten(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """(dotted name, value) of every entry in a table and its nested tables."""
    for name, value in table.items():
        if isinstance(value, Mapping):
            yield from flatten(value, f"{prefix}{name}.")
        else:
            yield prefix + name, value


def replaced(node: Any, tree: Mapping[str, Any]) -> Any:
    """A copy of a section with the values in `tree`, which is nested like the section."""
    changes = {name: replaced(getattr(node, name), v) if isinstance(v, dict) else v for name, v in tree.items()}
    return dataclasses.replace(node, **changes)


def converted(name: str, value: object, default: Any, spec: dataclasses.Field[Any]) -> object:
    """`value` in the type of its parameter, given default and field. Raises InvalidParameter: it has another type."""
    matrix = spec.type == "Matrix"
    words = {str: "text", bool: "true or false", int: "a whole number", float: "a number"}[
        float if matrix else type(default)
    ]
    if matrix:
        words = "a number, a list of numbers, or a list of rows"
    if isinstance(value, str) and (matrix or not isinstance(default, str)):
        try:
            value = json.loads(re.sub(r"^([+-]?)\.(?=\d)", r"\g<1>0.", value.strip()).removeprefix("+"))  # .5 is 0.5
        except (ValueError, RecursionError):
            raise InvalidParameter(name, value, words) from None
    if matrix and isinstance(value, list | tuple):
        return tuple(tuple(row) if isinstance(row, list | tuple) else row for row in value)
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if (matrix or isinstance(default, float)) and number:
        converted = float(str(value))
        if not math.isfinite(converted):
            raise InvalidParameter(name, converted, "a finite number")
        return converted
    if type(value) is type(default) and not matrix:
        return value
    raise InvalidParameter(name, value, words)
