"""A user's part, which leaves out what has a default: what it lacks, and how it gets the defaults of its protocol."""

from __future__ import annotations

import inspect
from collections.abc import Iterable
from typing import Any, TypeGuard

from hapnet.plant.worlds.protocol import World


def lacking(part: object, names: Iterable[str]) -> list[str]:
    """Those of the attributes `names` that `part` has not."""
    return sorted(name for name in names if not hasattr(part, name))


def is_world(part: object) -> TypeGuard[World]:
    """Whether `part` has all that a world must have. A class that makes worlds is none."""
    return not isinstance(part, type) and not lacking(part, World.__abstractmethods__)


class Completed:
    """A user's part `own`, with the defaults of a protocol for what it has not."""

    def __init__(self, own: object, protocol: type) -> None:
        self._own, self._protocol = own, protocol

    def __getattr__(self, name: str) -> Any:
        if hasattr(self._own, name):
            return getattr(self._own, name)
        default = inspect.getattr_static(self._protocol, name)
        return default.__get__(self) if hasattr(default, "__get__") else default
