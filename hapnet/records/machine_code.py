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
    """The run needs plain Python, for example because a value leaves the range that messages can carry."""


class WholeRun(Protocol):
    """A run that compiled code continues."""

    def run_until(self, until_ns: int) -> None:
        """Run all events before `until_ns`. Raises NotCompiledError: only plain Python can continue the run."""

    def write_back(self) -> None:
        """Copy the state at the end into the simulation's own objects."""


def directory() -> Path:
    """The folder of the machine code, in the user's cache and never beside the package. It is made if possible."""
    folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "hapnet"
    with suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
    return folder


def no_compiler() -> str | None:
    """The reason why code cannot be compiled here; None: it can."""
    if find_spec("numba") is None:
        return "numba is not installed (extra fast)"
    return "NUMBA_DISABLE_JIT is set" if os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0") else None


@contextmanager
def kept() -> Iterator[None]:
    """Within this context numba caches machine code in `directory()`, or nowhere: by default it writes beside the
    package.

    Numba's own environment variables take precedence.
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
    """`function`, compiled at its first call; unchanged if it cannot be compiled. It calls no other functions."""
    if no_compiler() is not None:
        return function
    numba: Any = import_module("numba")
    try:
        with kept():
            machine_code: Callable[..., Any] = numba.njit(cache=True, error_model="numpy")(function)
    except (OSError, RuntimeError):  # no writable folder: compiled for this process only
        machine_code = numba.njit(error_model="numpy")(function)
    return machine_code
