"""The couplings' names and their laws' parameters, for modules that must not load the laws: `Params` and the commands.

PSPM is a file of the core. Any other law of hapnet is a file of hapnet/ext/laws/ with a ``LAW = CouplingSpec(...)``.
Its name is the file name, with dashes for underscores. The file is loaded on first use;
`hapnet.couplings.registry` returns its `CouplingSpec`. Laws between two robots, which have no end for a virtual mass,
are files of hapnet/ext/laws/bilateral.
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
"""The order in lists and tables; any other laws follow, sorted by name."""

_FURTHER = "hapnet.ext.laws"
"""The package with a file for each law except PSPM."""


def _of_package(package: str) -> dict[str, str]:
    """The module of each law of a package, by the law's name."""
    try:
        found = find_spec(package)
    except ImportError:  # only the core is installed
        found = None
    folders = (found and found.submodule_search_locations) or ()
    files = [module.name for module in iter_modules(folders) if not module.ispkg]
    return {name.replace("_", "-"): f"{package}.{name}" for name in sorted(files)}


def _modules() -> dict[str, str]:
    """The module of each of hapnet's laws, by the law's name."""
    modules = {"pspm": "hapnet.couplings.pspm"} | _of_package(_FURTHER)
    return {name: modules[name] for name in sorted(modules, key=lambda name: (*_FIRST, *sorted(modules)).index(name))}


_MODULES = _modules()

COUPLING_NAMES = tuple(_MODULES)
"""The names of hapnet's own couplings."""

_BILATERAL = _of_package(f"{_FURTHER}.bilateral")

BILATERAL_NAMES = tuple(_BILATERAL)
"""The names of hapnet's own laws between two robots: they need a follower."""


@cache
def built_in(name: str) -> Any:
    """The `CouplingSpec` of a name in `COUPLING_NAMES` or `BILATERAL_NAMES`."""
    law = import_module((_MODULES | _BILATERAL)[name]).LAW
    assert law.name == name, f"the LAW of the file of {name} is named {law.name}"
    return law


@cache
def sections() -> Mapping[str, type[Any]]:
    """The parameter classes of hapnet's own laws, by the names of their sections in `Params`."""
    return _sections(built_in(name) for name in (*COUPLING_NAMES, *BILATERAL_NAMES))


def sections_of(*names: str) -> Mapping[str, type[Any]]:
    """The parameter classes of these laws, by section; names are hapnet's own, published names, or ``module:NAME``.

    Raises InvalidParameter: there is no such law, or it cannot be loaded.
    """
    return _sections(
        built_in(name)
        if name in (*COUPLING_NAMES, *BILATERAL_NAMES)
        else import_module("hapnet.couplings.registry").coupling(name)
        for name in names
    )


def _sections(laws: Iterable[Any]) -> Mapping[str, type[Any]]:
    return {law.section: law.parameters for law in laws if law.parameters is not None}
