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
from contextlib import contextmanager, suppress
from functools import cache
from types import FunctionType, ModuleType
from typing import Any, TypeVar

import numba
from numba.core.compiler import CompilerBase, DefaultPassBuilder

from hapnet.ext.compiled.progress import Reported
from hapnet.records.machine_code import kept
from hapnet.records.record import EQUATIONS

with suppress(ImportError):  # numba's inner functions, of another version
    import hapnet.ext.compiled.nested  # noqa: F401  (arrays in records, in less code)

_njit: Any = numba.njit

_IDLE = {
    "with_lifting", "inline_closure_likes", "rewrite_semantic_constants", "dead_branch_prune", "Rewrite dynamic raises",
    "make_function_op_code_to_jit_function", "inline_inlinables", "find_literally", "literal_unroll",
    "LiteralPropagation", "inline_overloads", "nopython_rewrites", "nopython_supported_feature_validation",
    "ir_legalization", "annotate_types", "dump_parfor_diagnostics",
}  # fmt: skip
"""Numba's passes that find nothing to do in an equation, which has neither closures nor array expressions, or that only
end the lives of variables ("ir_legalization"), which matters to what is counted by references."""


class _Passes(CompilerBase):
    """Numba's passes but for the idle ones, which take a quarter of the time of all."""

    def define_pipelines(self) -> list[Any]:
        passes: Any = DefaultPassBuilder.define_nopython_pipeline(self.state)  # type: ignore[no-untyped-call]
        passes.passes = [one for one in passes.passes if one[0].name() not in _IDLE]
        passes.finalize()
        return [passes]


_LEAN = {
    "no_cpython_wrapper": True, "no_cfunc_wrapper": True, "_nrt": False, "error_model": "numpy",
    "pipeline_class": _Passes,
}  # fmt: skip

_PARTS: set[str] = set()
"""The names of the functions that only compiled ones call."""

_MADE: dict[Any, Any] = {}
"""Each twin by its function and by what is compiled in others' place in what it calls: scenarios share it."""

_LINKED: defaultdict[Any, dict[Any, None]] = defaultdict(dict)
"""What each of numba's libraries calls, callers first: LLVM links what is called by then."""

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
        key = source, _chosen_within(function, choices)
        if key not in _MADE:
            _MADE[key] = _njit(**_LEAN)(_with_globals(source, names[source.__module__]))
        made[function] = _MADE[key]
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


def _chosen_within(function: Any, choices: Mapping[Any, Any]) -> frozenset[Any]:
    """The choices in what an equation calls, and what that calls, each with what it chooses."""
    reached, chosen = [function], set()
    for one in reached:
        for called in _called(EQUATIONS[one] or one):
            target = choices.get(called, called)
            if called in choices:
                chosen.add((called, target))
            if target in EQUATIONS and target not in reached:
                reached.append(target)
    return frozenset(chosen)


@cache
def _called(source: Any) -> frozenset[Any]:
    """The functions that a function's code names, by themselves or in a module."""
    words, known = source.__code__.co_names, vars(sys.modules[source.__module__])
    values = [known.get(word) for word in words]
    values += [vars(one).get(word) for one in values if isinstance(one, ModuleType) for word in words]
    return frozenset(one for one in values if isinstance(one, FunctionType))


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
    """Link, optimise, and turn into machine code all that is compiled meanwhile, with the entry alone.

    By itself numba does all of that with each function and what it calls: so every function is copied and optimised
    again for its callers, for theirs, and so on, which takes five times as long. No other thread compiles meanwhile.
    The methods changed here are numba's own, left out for the inner functions; and no more is optimised than pays:
    loops are short and are as fast if they are not unrolled, and nothing is counted by references. What an operator
    makes of its arguments' types, how a record is written, and how large a type is is found once, not each time, and
    where variables end their lives only if somebody asks: that takes a third less. A version of numba that has not all
    of this just compiles for longer.
    """
    names = ("codegen", "types", "cpu", "postproc", "transforms")
    codegen, types, cpu, postproc, transforms = (importlib.import_module(f"numba.core.{name}") for name in names)
    library, context = getattr(codegen, "CPUCodeLibrary", None), getattr(cpu, "CPUContext", None)
    own: dict[str, Any] = {}  # by the names below
    resolved: dict[Any, Any] = {}

    def optimize_entry(self: Any, module: Any) -> None:
        if self.name not in _PARTS:
            own["_optimize_functions"](self, module)

    def optimize_once(self: Any) -> None:
        llvm = importlib.import_module("llvmlite.binding")
        wanted = llvm.create_pipeline_tuning_options(speed_level=1)
        wanted.loop_unrolling = wanted.loop_vectorization = wanted.slp_vectorization = False
        builder = llvm.create_pass_builder(self._codegen._tm, wanted)  # noqa: SLF001
        builder.getModulePassManager().run(self._final_module, builder)

    def link_all(self: Any, library: Any) -> None:
        for one in (library, *_LINKED[library]):
            if one not in _LINKED[self]:
                _LINKED[self][one] = None
                own["add_linking_library"](self, one)

    def finalize_entry(self: Any) -> None:
        if self.name in _PARTS:
            self._finalized = True
        else:
            own["finalize"](self)

    def set_env_of_emitted(self: Any, name: str, environment: Any) -> None:
        if self._engine.get_global_value_address(name):  # the inner functions raise nothing, so they need none
            own["set_env"](self, name, environment)

    def resolve_once(self: Any, context: Any, arguments: Any, named: Any) -> Any:
        if named:
            return own["get_call_type"](self, context, arguments, named)
        key = self, tuple(arguments)
        if key not in resolved:
            resolved[key] = own["get_call_type"](self, context, arguments, named)
        return resolved[key]

    def find_lifetimes_if_asked(self: Any, emit_dels: bool = False, **named: Any) -> None:
        if emit_dels:
            own["run"](self, emit_dels, **named)
        self.func_ir.blocks = transforms.canonicalize_cfg(self.func_ir.blocks)
        self.func_ir.variable_lifetime = postproc.VariableLifetime(self.func_ir.blocks)

    changes: tuple[tuple[Any, str, Any], ...] = (
        (library, "_optimize_functions", optimize_entry),
        (library, "_optimize_final_module", optimize_once),
        (library, "add_linking_library", link_all),
        (library, "finalize", finalize_entry),
        (getattr(codegen, "JITCPUCodegen", None), "set_env", set_env_of_emitted),
        (postproc.PostProcessor, "run", find_lifetimes_if_asked),
        (types.Function, "get_call_type", resolve_once),
        (types.Record, "__repr__", cache(lambda self: own["__repr__"](self))),
        (context, "get_abi_sizeof", cache(lambda self, kind: own["get_abi_sizeof"](self, kind))),
    )
    if not all(hasattr(owner, name) for owner, name, _ in changes):
        yield
        return
    own |= {name: getattr(owner, name) for owner, name, _ in changes}
    with importlib.import_module("numba.core.compiler_lock").global_compiler_lock:
        collects = gc.isenabled()
        gc.disable()  # all that a compiler makes is in use until the end
        try:
            for owner, name, change in changes:
                setattr(owner, name, change)
            yield
        finally:
            for owner, name, _ in changes:
                setattr(owner, name, own[name])
            if collects:
                gc.enable()
