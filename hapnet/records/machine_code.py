"""Compiles one function with numba, if that is installed, and keeps the machine code with the user's other caches."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Protocol


class NotCompiledError(Exception):
    """The run does something that only plain Python can do, such as leaving the range that messages can carry."""


class WholeRun(Protocol):
    """A run that compiled code goes on with."""

    def run_until(self, until_ns: int) -> None:
        """Run all events before `until_ns`. Raises NotCompiledError: only plain Python can run it on."""

    def write_back(self) -> None:
        """Give the simulation's own objects the state at the end."""


def directory() -> Path:
    """Where the machine code is kept: with the user's other caches, never beside the package. Made if it can be."""
    found = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "hapnet"
    with suppress(OSError):
        found.mkdir(parents=True, exist_ok=True)
    return found


def no_compiler() -> str | None:
    """Why nothing can be compiled here; None: it can."""
    if find_spec("numba") is None:
        return "numba is not installed (extra fast)"
    return "NUMBA_DISABLE_JIT is set" if os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0") else None


@contextmanager
def kept() -> Iterator[None]:
    """Keep the code that numba compiles meanwhile in `directory()`, or not at all: else it would write beside the
    package.

    What the environment asks of numba goes before that.
    """
    config: Any = import_module("numba.core.config")
    folder, locators = config.CACHE_DIR, getattr(config, "CACHE_LOCATOR_CLASSES", "")
    config.CACHE_DIR = folder or str(directory())
    config.CACHE_LOCATOR_CLASSES = locators or "UserProvidedCacheLocator"
    try:
        yield
    finally:
        config.CACHE_DIR, config.CACHE_LOCATOR_CLASSES = folder, locators


@cache
def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """`function`, compiled when it is first called; itself where nothing can be compiled. It calls no other ones."""
    if no_compiler() is not None:
        return function
    numba: Any = import_module("numba")
    try:
        with kept():
            made: Callable[..., Any] = numba.njit(cache=True, error_model="numpy")(function)
    except (OSError, RuntimeError):  # nowhere to write: it is compiled for this process alone
        made = numba.njit(error_model="numpy")(function)
    return made
