"""The couplings' names, and their laws' parameters, for what must not load the laws: `Params` and the commands.

PSPM is a file of the core. Any other law of hapnet is a file of hapnet/ext/laws/ with a ``LAW = CouplingSpec(...)``.
Its name is the file's, with dashes for underlines. The file is loaded when the law is asked for;
`hapnet.couplings.registry` says what it is.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pkgutil import iter_modules
from typing import Any

GROUP = "hapnet.couplings"
"""The entry points by which other packages publish their laws."""

_FIRST = ("pspm", "zoh", "popc", "tdpa", "eba", "wave", "digital-wave", "pd")
"""The order in which people read them; any other law comes behind these, by its name."""

_FURTHER = "hapnet.ext.laws"
"""The package with a file for each law but PSPM."""


def _modules() -> dict[str, str]:
    """The module of each law of hapnet's, by the law's name."""
    found = {"pspm": "hapnet.couplings.pspm"}
    try:
        package = find_spec(_FURTHER)
    except ImportError:  # the core alone
        package = None
    folders = (package and package.submodule_search_locations) or ()
    found |= {one.name.replace("_", "-"): f"{_FURTHER}.{one.name}" for one in iter_modules(folders) if not one.ispkg}
    return {name: found[name] for name in sorted(found, key=lambda name: (*_FIRST, *sorted(found)).index(name))}


_MODULES = _modules()

COUPLING_NAMES = tuple(_MODULES)
"""hapnet's own."""


@cache
def built_in(name: str) -> Any:
    """The `CouplingSpec` of that name, which is one of `COUPLING_NAMES`."""
    law = import_module(_MODULES[name]).LAW
    assert law.name == name, f"the LAW of the file of {name} is named {law.name}"
    return law


@cache
def sections() -> Mapping[str, type[Any]]:
    """The classes of hapnet's own laws' parameters, by the names of their sections in `Params`."""
    return _sections(built_in(name) for name in COUPLING_NAMES)


def sections_of(*names: str) -> Mapping[str, type[Any]]:
    """The same of these laws: hapnet's own, a published one's name, or ``module:NAME``.

    Raises InvalidParameter: there is no such law, or it cannot be loaded.
    """
    return _sections(
        built_in(name) if name in COUPLING_NAMES else import_module("hapnet.couplings.registry").coupling(name)
        for name in names
    )


def _sections(laws: Iterable[Any]) -> Mapping[str, type[Any]]:
    return {law.section: law.parameters for law in laws if law.parameters is not None}
