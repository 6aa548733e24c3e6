"""hapnet's own worlds by name, one file each.

A world is a function with the name of its file. It returns a `hapnet.plant.worlds.protocol.World`; its keywords are the
world's parameters, and the first line of its docstring is the help text.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from pkgutil import iter_modules
from types import MappingProxyType

from hapnet.plant.worlds.protocol import World

_FIRST = ("free", "wall", "box", "paper", "moving")
"""Order in help texts; any other world comes after these, by name."""

_found = {one.name: vars(import_module(f"{__name__}.{one.name}"))[one.name] for one in iter_modules(__path__)}

SCENES: Mapping[str, Callable[..., World]] = MappingProxyType(
    {name: _found[name] for name in sorted(_found, key=lambda name: (*_FIRST, *_found).index(name))}
)
