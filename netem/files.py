"""Files that are read once: a study of thousands of runs names the same few."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import lru_cache, update_wrapper
from typing import Concatenate, ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")

_KEPT = 16


def read_once(read: Callable[Concatenate[str, P], T]) -> Callable[Concatenate[str, P], T]:
    """Cache `read`, whose first argument is a file's name: a result is kept as long as the file does not change.

    No caller may change a result. Errors are not kept.
    """

    def of_version(_: tuple[int, ...], path: str, *args: P.args, **kwargs: P.kwargs) -> T:
        return read(path, *args, **kwargs)

    kept: Callable[..., T] = lru_cache(maxsize=_KEPT)(of_version)

    def read_unless_kept(path: str, /, *args: P.args, **kwargs: P.kwargs) -> T:
        try:
            status = os.stat(path)
        except (OSError, ValueError):
            return read(path, *args, **kwargs)  # which raises the right error
        return kept((status.st_dev, status.st_ino, status.st_mtime_ns, status.st_size), path, *args, **kwargs)

    update_wrapper(read_unless_kept, read)
    return read_unless_kept
