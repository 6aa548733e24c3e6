"""Compiles one function with numba, if that is installed, and keeps the machine code with the user's other caches."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any


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


@cache
def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """`function`, compiled when it is first called; itself where nothing can be compiled. It calls no other ones."""
    if no_compiler() is not None:
        return function
    numba: Any = import_module("numba")
    config: Any = import_module("numba.core.config")
    given = config.CACHE_DIR
    try:
        config.CACHE_DIR = given or str(directory())
        made: Callable[..., Any] = numba.njit(cache=True, error_model="numpy")(function)
    except (OSError, RuntimeError):  # nowhere to write: it is compiled for this process alone
        made = numba.njit(error_model="numpy")(function)
    finally:
        config.CACHE_DIR = given
    return made
