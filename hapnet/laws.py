"""The couplings' names, and their laws' parameters, for what must not load the laws: `Params` and the commands.

A law of hapnet is a file of hapnet/couplings/ with a line ``LAW = CouplingSpec(``. Its name is the file's, with dashes
for underlines. The file is loaded when the law is asked for; `hapnet.couplings.registry` says what it is.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

GROUP = "hapnet.couplings"
"""The entry points by which other packages publish their laws."""

_FIRST = ("pspm", "zoh", "popc", "tdpa", "eba", "wave", "digital-wave", "pd")
"""The order in which people read them; any other law comes behind these, by its name."""

_COUPLINGS = Path(__file__).parent / "couplings"


def _names() -> tuple[str, ...]:
    texts = {file.stem.replace("_", "-"): file.read_text("utf-8") for file in _COUPLINGS.glob("*.py")}
    found = [name for name, text in texts.items() if re.search(r"^LAW\b.* = CouplingSpec\(", text, re.MULTILINE)]
    return tuple(sorted(found, key=lambda name: (*_FIRST, *sorted(found)).index(name)))


COUPLING_NAMES = _names()
"""hapnet's own."""


@cache
def built_in(name: str) -> Any:
    """The `CouplingSpec` of that name, which is one of `COUPLING_NAMES`."""
    law = import_module(f"hapnet.couplings.{name.replace('-', '_')}").LAW
    assert law.name == name, f"the LAW of the file of {name} is named {law.name}"
    return law


@cache
def sections() -> Mapping[str, type[Any]]:
    """The classes of hapnet's own laws' parameters, by the names of their sections in `Params`."""
    return _sections(built_in(name) for name in COUPLING_NAMES)


def sections_of(*names: str) -> Mapping[str, type[Any]]:
    """The same of these laws, where they are not hapnet's own: a published one's name, or ``module:NAME``.

    Raises InvalidParameter: there is no such law, or it cannot be loaded.
    """
    own = [name for name in names if name not in COUPLING_NAMES]
    return _sections(import_module("hapnet.couplings.registry").coupling(name) for name in own)


def _sections(laws: Iterable[Any]) -> Mapping[str, type[Any]]:
    return {law.section: law.parameters for law in laws if law.parameters is not None}
