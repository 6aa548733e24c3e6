"""Effects of a link beside tc-netem's: each impairment is a file, and its word is the file's name.

`IMPAIRMENTS` finds it. It acts on messages that loss and resends let through, before limit, reordering, delay, rate
and slot.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from pkgutil import iter_modules
from types import MappingProxyType

from netem.impairment import Impairment

_FILES = [one.name for one in iter_modules(__path__)]

for _name in _FILES:
    import_module(f"{__name__}.{_name}")

_KINDS = [kind for kind in Impairment.__subclasses__() if kind.word() in _FILES]

IMPAIRMENTS: Mapping[str, type[Impairment]] = MappingProxyType({kind.word(): kind for kind in _KINDS})
"""Each impairment by its word."""
