"""Compiles equations with numba: each equation gets a compiled twin, made from the same source.

A twin has the function's own code with other globals: each equation, or module with equations, in them is replaced by
its twin. One source serves plain Python and compiled code, and plain Python does not import numba.
"""

from __future__ import annotations

import dis
import hashlib
import sys
from collections import Counter
from collections.abc import Callable, Container, Iterable, Mapping
from functools import cache
from types import FunctionType, ModuleType
from typing import Any, NamedTuple

import numba

from hapnet.ext.compiled import sources
from hapnet.ext.compiled.progress import reporting
from hapnet.records.machine_code import kept
from hapnet.records.record import EQUATIONS

_MOST_INSTRUCTIONS = 150
"""A longer function is not inlined even if it has one call site: numba takes longer for a very long caller."""

Choices = Mapping[Callable[..., Any], Callable[..., Any]]

Names = dict[str, Any]


class Twin(NamedTuple):
    """The compiled twin of a function. functions : the number of functions that numba compiles, itself included."""

    run: Any
    functions: int


def entry(function: Callable[..., Any], name: str, choices: Choices) -> Twin:
    """Return the twin of the entry function, which calls all others. Its machine code is kept.

    choices : maps functions to the functions that are compiled in their place.

    Numba names its files after the function, and checks only the function's own source to see whether they are still
    valid. So `name` must change with any of the sources, and with the choices. Different entries must not share files:
    if two processes write to them at the same time, one finds the other's machine code under its own key.
    """
    assert isinstance(function, FunctionType)
    sites = _call_sites(function, choices)
    inlined = {one for one, count in sites.items() if count == 1 and _length(_source(one)) <= _MOST_INSTRUCTIONS}
    twin = _with_globals(function, _names(function, name, sites, inlined, choices))
    twin.__qualname__ = name
    try:
        with kept():
            made = _compiling(cache=True)(twin)
    except (OSError, RuntimeError):  # no directory to write to: compile for this process only
        made = _compiling()(twin)
    return Twin(made, 1 + len(sites) - len(inlined))


def ready(function: Callable[..., Any], kind: str, choices: Choices, *arguments: Any) -> Any:
    """Return the twin of an entry after a first call with these arguments, which compiles it or loads its machine code.

    kind : the name under which the machine code is kept.
    """
    twin = entry(function, sources.name_of(kind), choices)
    with reporting(twin.functions):
        twin.run(*arguments)
    sources.mark(kind)
    return twin.run


def _compiling(**options: Any) -> Any:
    return numba.njit(error_model="numpy", **options)


def _names(
    function: FunctionType, name: str, equations: Iterable[Any], inlined: Container[Any], choices: Choices
) -> Names:
    """The globals of the entry's twin: those of its module, with each equation replaced by its twin.

    name : the entry's, which marks each twin's name. Numba's symbols are made of names, and a process that loads
        machine code of two entries must not take a function of the one for that of the other. The mark is short: the
        variables of an inlined function are named after all its callers, and LLVM cuts names off at 1024 letters.
    inlined : the equations that are inlined into their caller before numba compiles the caller.
    """
    modules = {one.__module__ for one in (function, *equations, *map(_source, equations), *choices)}
    names: dict[str, Names] = {module: dict(vars(sys.modules[module])) for module in modules}
    stubs = {module: ModuleType(module) for module in modules}
    made: dict[Any, Any] = {}
    mark = hashlib.sha256(name.encode()).hexdigest()[:8]
    for one in equations:
        source = _source(one)
        compiling = _compiling(inline="always" if one in inlined else "never")
        twin = _with_globals(source, names[source.__module__])
        twin.__qualname__ = f"{mark}.{source.__qualname__}"
        made[one] = compiling(twin)
    made |= {one: made[chosen] for one, chosen in choices.items() if chosen in made}
    for known in names.values():
        for key, value in known.items():
            if isinstance(value, FunctionType) and value in made:
                known[key] = made[value]
            elif isinstance(value, ModuleType) and value.__name__ in stubs:
                known[key] = stubs[value.__name__]
    for module, stub in stubs.items():
        vars(stub).update(names[module])
    return names[function.__module__]


def _source(equation: Any) -> Any:
    """The function that is compiled for an equation."""
    return EQUATIONS.get(equation) or equation


def _call_sites(function: FunctionType, choices: Choices) -> Counter[Any]:
    """Count the call sites of all equations that a function calls, directly or through other equations."""
    sites: Counter[Any] = Counter()
    waiting: list[Any] = [function]
    for one in waiting:
        for named in _named(_source(one)):
            called = choices.get(named, named)
            if called in EQUATIONS:
                if called not in sites:
                    waiting.append(called)
                sites[called] += 1
    return sites


@cache
def _named(source: Any) -> tuple[FunctionType, ...]:
    """The functions that a function's code refers to, directly or through a module; once for each reference."""
    known, found = vars(sys.modules[source.__module__]), []
    module: ModuleType | None = None
    for instruction in dis.get_instructions(source):
        value: Any = None
        if instruction.opname == "LOAD_GLOBAL":
            value = known.get(instruction.argval)
        elif module is not None and instruction.opname in ("LOAD_ATTR", "LOAD_METHOD"):
            value = vars(module).get(instruction.argval)
        module = value if isinstance(value, ModuleType) else None
        if isinstance(value, FunctionType):
            found.append(value)
    return tuple(found)


def _length(source: Any) -> int:
    return len(list(dis.get_instructions(source)))


def _with_globals(function: Any, names: dict[str, Any]) -> Any:
    twin = FunctionType(function.__code__, names, function.__name__, function.__defaults__, function.__closure__)
    twin.__qualname__, twin.__module__ = function.__qualname__, function.__module__
    return twin
