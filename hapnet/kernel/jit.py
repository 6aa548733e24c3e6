"""Compiles the kernel's functions with numba; where it is missing, the same functions run as plain Python.

Numba's own switch, the environment's `NUMBA_DISABLE_JIT=1`, makes them plain Python too.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FunctionType
from typing import Any, TypeVar

from hapnet.kernel import sources

try:
    import numba
except ImportError:
    COMPILED = False
    _njit: Any = None
else:
    from numba.core import config

    COMPILED = not getattr(config, "DISABLE_JIT", 0)
    _njit = numba.njit

_LEAN = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True, "_nrt": False, "error_model": "numpy"}

_PARTS: set[str] = set()
"""The names of the functions that only compiled ones call."""

F = TypeVar("F", bound=Callable[..., Any])


def compiled(function: F) -> F:
    """`function`, compiled when it is first called by a compiled one."""
    if not COMPILED:
        return function
    _PARTS.add(function.__qualname__)
    made: F = _njit(**_LEAN)(function)
    return made


def shared(function: Callable[..., Any], **callees: Callable[..., Any]) -> Callable[..., Any]:
    """A function of the reference, compiled as it stands.

    callees : the functions that it calls by these global names, themselves `shared`.
    """
    if not COMPILED:
        return function
    assert isinstance(function, FunctionType)
    clone = FunctionType(
        function.__code__, {**function.__globals__, **callees}, function.__name__, function.__defaults__
    )
    _PARTS.add(function.__name__)
    made: Callable[..., Any] = _njit(**_LEAN)(clone)
    return made


def entry(function: F) -> F:
    """The function through which everything else is called: its machine code is cached for other processes.

    Numba looks only at the entry's own file to see whether its cache is still valid. So the entry must be a closure
    that uses `SOURCES`, which changes with any source file that it may be compiled from.
    """
    return _njit(cache=True, no_cfunc_wrapper=True, error_model="numpy")(function) if COMPILED else function


@contextmanager
def as_one_unit() -> Iterator[None]:
    """What is compiled meanwhile is optimised, and turned into machine code, with the entry alone.

    By itself numba does both with each function and all that it calls: so every function is optimised again for its
    callers, for theirs, and so on, which takes four times as long. No other thread compiles meanwhile. The methods
    changed here are numba's own, left out for the inner functions; and no more is optimised than pays, since all loops
    are short. A version of numba that has not all of this just compiles for longer.
    """
    codegen, config = (importlib.import_module(f"numba.core.{name}") for name in ("codegen", "config"))
    owners = (getattr(codegen, "CPUCodeLibrary", None), getattr(codegen, "JITCPUCodegen", None), config)
    names = (
        ("_optimize_functions", 0), ("_optimize_final_module", 0), ("_finalize_final_module", 0), ("set_env", 1),
        ("OPT", 2), ("LOOP_VECTORIZE", 2), ("SLP_VECTORIZE", 2),
    )  # fmt: skip
    if not all(hasattr(owners[which], name) for name, which in names):
        yield
        return
    own: list[Any] = [getattr(owners[which], name) for name, which in names]
    prepare, optimize, emit, set_env = own[:4]

    def prepare_entry(self: Any, module: Any) -> None:
        if self.name not in _PARTS:
            prepare(self, module)

    def optimize_entry(self: Any) -> None:
        if self.name not in _PARTS:
            optimize(self)

    def emit_entry(self: Any) -> None:
        if self.name not in _PARTS:
            emit(self)
        self._finalized = True

    def set_env_of_emitted(self: Any, name: str, environment: Any) -> None:
        if self._engine.get_global_value_address(name):  # the inner functions raise nothing, so they need none
            set_env(self, name, environment)

    changed: list[Any] = [prepare_entry, optimize_entry, emit_entry, set_env_of_emitted, 1, 0, 0]
    with importlib.import_module("numba.core.compiler_lock").global_compiler_lock:
        try:
            for (name, which), one in zip(names, changed, strict=True):
                setattr(owners[which], name, one)
            yield
        finally:
            for (name, which), one in zip(names, own, strict=True):
                setattr(owners[which], name, one)


SOURCES = sources.digest() if COMPILED else ""
