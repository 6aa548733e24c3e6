"""The sources of the parameters' values. A value without a source was not set: it is the default.

A scene, a device or a rule may choose another value for it (`hapnet.assembly.resolve`). A value that was set is used
unchanged, or refused.
"""

from __future__ import annotations

from collections.abc import Mapping

from hapnet.errors import InvalidParameter
from hapnet.param_values import present_name

DEFAULT = "default"
"""The source of a value that was not set."""

FILE, FLAG, PROGRAM, PAGE, RECORDING, COMMAND = "file", "flag", "program", "page", "recording", "command"
"""Sources of set values: a parameters' file, the command line, a Python program, the live page, a recording without
sources, and the command itself, such as the relaxed hand of `hapnet play`."""

SCENE, DEVICE, RULE = "scene", "device", "rule"
"""Sources of values that were not set: the scene's own defaults and units, the device's properties, hapnet's rules."""

ASKED = frozenset({FILE, FLAG, PROGRAM, PAGE})
"""The sources of values that the user set: no other value may replace them."""

RESOLVED = frozenset({SCENE, DEVICE, RULE})
"""The sources of values that were not set: `hapnet.assembly.resolve` may choose such a value again."""

SOURCES = frozenset({*ASKED, *RESOLVED, RECORDING, COMMAND})

Sources = tuple[tuple[str, str], ...]
"""Pairs of a parameter's dotted name and its source, for each value that has one."""


def read(table: object) -> dict[str, str]:
    """The sources in a file's or recording's table. Raises InvalidParameter."""
    if not isinstance(table, Mapping):
        raise InvalidParameter("sources", table, "a table of parameters and their sources")
    for name, source in table.items():
        if not isinstance(source, str) or source not in SOURCES:
            raise InvalidParameter(f"sources.{name}", source, "one of " + ", ".join(sorted(SOURCES)), SOURCES)
    return {present_name(name): source for name, source in table.items()}
