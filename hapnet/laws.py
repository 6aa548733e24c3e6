"""The couplings' names, and their laws' parameters, for what must not load the laws: `Params` and the commands.

A law of hapnet is a file of hapnet/couplings/ with a line ``LAW = CouplingSpec(``. Its name is the file's, with dashes
for underlines. The file is loaded when the law is asked for; `hapnet.couplings.registry` says what it is.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

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
    return import_module(f"hapnet.couplings.{name.replace('-', '_')}").LAW


@cache
def sections() -> Mapping[str, type[Any]]:
    """The classes of the laws' parameters, by the names of their sections in `Params`."""
    laws = [built_in(name) for name in COUPLING_NAMES]
    return {law.section: law.parameters for law in laws if law.parameters is not None}
