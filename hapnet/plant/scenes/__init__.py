"""hapnet's own worlds by name, each a file.

A world is a function that has its file's name. It returns what `hapnet.plant.worlds.protocol.World` says; its keywords
are what can be set, and the first line of its docstring is the help.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from pkgutil import iter_modules
from types import MappingProxyType

from hapnet.plant.worlds.protocol import World

_FIRST = ("free", "wall", "box", "paper", "moving")
"""The order in which people read them; any other world comes behind these, by its name."""

_found = {one.name: vars(import_module(f"{__name__}.{one.name}"))[one.name] for one in iter_modules(__path__)}

SCENES: Mapping[str, Callable[..., World]] = MappingProxyType(
    {name: _found[name] for name in sorted(_found, key=lambda name: (*_FIRST, *_found).index(name))}
)
