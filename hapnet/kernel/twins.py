"""Compiles equations with numba: each gets a twin, made from the same source.

A twin is the function's own code with other globals: where those name an equation, or a module with equations, they
name its twin. So one source serves both, and importing it costs nothing of numba.
"""

from __future__ import annotations

import gc
import importlib
import sys
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from types import FunctionType, ModuleType
from typing import Any, TypeVar

import numba

from hapnet.kernel.progress import Reported
from hapnet.records.equation import EQUATIONS
from hapnet.records.machine_code import kept

_njit: Any = numba.njit

_LEAN = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True, "_nrt": False, "error_model": "numpy"}

_PARTS: set[str] = set()
"""The names of the functions that only compiled ones call."""

F = TypeVar("F", bound=Callable[..., Any])


def entry(function: F, name: str, choices: Mapping[Callable[..., Any], Callable[..., Any]]) -> F:
    """The compiled twin of the function through which all others are called, whose machine code is kept.

    choices : functions in whose place others are compiled.

    Numba names its files after the function, and looks only at the function's own file to see whether they are still
    valid. So `name` has to change with any of the sources, and with the choices. And no two that differ may share
    files: if two processes add to them at the same time, one finds the other's machine code under its own key.
    """
    assert isinstance(function, FunctionType)
    twin = _with_globals(function, _twins(choices)[function.__module__])
    twin.__qualname__ = name
    try:
        with kept():
            made: F = _njit(cache=True, no_cfunc_wrapper=True, error_model="numpy")(twin)
    except (OSError, RuntimeError):  # nowhere to write: it is compiled for this process alone
        made = _njit(no_cfunc_wrapper=True, error_model="numpy")(twin)
    return made


def _twins(choices: Mapping[Callable[..., Any], Callable[..., Any]]) -> dict[str, dict[str, Any]]:
    """The globals of each module with equations, with their twins in place of them."""
    modules = {function.__module__ for function in (*EQUATIONS, *choices)}
    names = {module: dict(vars(sys.modules[module])) for module in modules}
    stubs = {module: ModuleType(module) for module in modules}
    made: dict[Any, Any] = {}
    for function, other in EQUATIONS.items():
        source = function if other is None else other
        _PARTS.add(source.__qualname__)
        made[function] = _njit(**_LEAN)(_with_globals(source, names[source.__module__]))
    made |= {function: made[chosen] for function, chosen in choices.items()}
    for known in names.values():
        for name, value in known.items():
            if isinstance(value, FunctionType) and value in made:
                known[name] = made[value]
            elif isinstance(value, ModuleType) and value.__name__ in stubs:
                known[name] = stubs[value.__name__]
    for module, stub in stubs.items():
        vars(stub).update(names[module])
    return names


def _with_globals(function: Any, names: dict[str, Any]) -> Any:
    twin = FunctionType(function.__code__, names, function.__name__, function.__defaults__, function.__closure__)
    twin.__qualname__, twin.__module__ = function.__qualname__, function.__module__
    return twin


@contextmanager
def reporting(reported: Reported) -> Iterator[None]:
    """Tell, while numba compiles, which share of the equations it has; nothing if it only loads machine code."""
    event = importlib.import_module("numba.core.event")
    done = 0

    class Compiled(event.Listener):  # type: ignore[name-defined, misc]  # numba has no types
        def on_start(self, event: Any) -> None:
            """Say nothing: only what is compiled counts."""

        def on_end(self, event: Any) -> None:
            nonlocal done
            done += 1
            reported(min(done / (len(_PARTS) + 1), 0.99))

    with event.install_listener("numba:compile", Compiled()):
        yield
    if done:
        reported(1.0)


@contextmanager
def as_one_unit() -> Iterator[None]:
    """What is compiled meanwhile is linked, optimised, and turned into machine code, with the entry alone.

    By itself numba does all of that with each function and what it calls: so every function is copied and optimised
    again for its callers, for theirs, and so on, which takes five times as long. No other thread compiles meanwhile.
    The methods changed here are numba's own, left out for the inner functions; and no more is optimised than pays,
    since all loops are short. What an operator makes of its arguments' types, how a record is written, and whether
    two sets of options are the same is found once, not each time: that takes a third less. A version of numba that has
    not all of this just compiles for longer.
    """
    codegen, config, options, types = (
        importlib.import_module(f"numba.core.{name}") for name in ("codegen", "config", "targetconfig", "types")
    )
    owners = (
        getattr(codegen, "CPUCodeLibrary", None), getattr(codegen, "JITCPUCodegen", None), config,
        types.Function, types.Record, options.TargetConfig,
    )  # fmt: skip
    names = (
        ("_optimize_functions", 0), ("add_linking_library", 0), ("finalize", 0), ("set_env", 1), ("OPT", 2),
        ("LOOP_VECTORIZE", 2), ("SLP_VECTORIZE", 2), ("get_call_type", 3), ("__repr__", 4), ("__eq__", 5),
        ("__hash__", 5),
    )  # fmt: skip
    if not all(hasattr(owners[which], name) for name, which in names):
        yield
        return
    own: list[Any] = [getattr(owners[which], name) for name, which in names]
    optimize, link, finalize, set_env = own[:4]
    resolve, written, same = own[7:10]
    resolved: dict[Any, Any] = {}
    linked: defaultdict[Any, dict[Any, None]] = defaultdict(dict)  # callers first: LLVM links what is called by then

    def optimize_entry(self: Any, module: Any) -> None:
        if self.name not in _PARTS:
            optimize(self, module)

    def link_all(self: Any, library: Any) -> None:
        for one in (library, *linked[library]):
            if one not in linked[self]:
                linked[self][one] = None
                link(self, one)

    def finalize_entry(self: Any) -> None:
        if self.name in _PARTS:
            self._finalized = True
        else:
            finalize(self)

    def set_env_of_emitted(self: Any, name: str, environment: Any) -> None:
        if self._engine.get_global_value_address(name):  # the inner functions raise nothing, so they need none
            set_env(self, name, environment)

    def resolve_once(self: Any, context: Any, arguments: Any, named: Any) -> Any:
        if named:
            return resolve(self, context, arguments, named)
        key = self, tuple(arguments)
        if key not in resolved:
            resolved[key] = resolve(self, context, arguments, named)
        return resolved[key]

    changed: list[Any] = [
        optimize_entry, link_all, finalize_entry, set_env_of_emitted, 1, 0, 0, resolve_once, cache(written),
        lambda self, other: self is other or same(self, other), lambda self: hash(frozenset(self._values)),
    ]  # fmt: skip
    with importlib.import_module("numba.core.compiler_lock").global_compiler_lock:
        collects = gc.isenabled()
        gc.disable()  # all that a compiler makes is in use until the end
        try:
            for (name, which), one in zip(names, changed, strict=True):
                setattr(owners[which], name, one)
            yield
        finally:
            for (name, which), one in zip(names, own, strict=True):
                setattr(owners[which], name, one)
            if collects:
                gc.enable()
