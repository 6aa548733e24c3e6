"""Marks the functions that plain Python runs and numba compiles, both from one source.

Such a function takes numbers, records (`hapnet.records.record`) and their vectors, and writes its results into records;
it calls only functions that are marked too. Nothing is compiled here, and numba is not imported:
`hapnet.ext.compiled.twins` makes a compiled twin of each when a compiled run begins.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

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
