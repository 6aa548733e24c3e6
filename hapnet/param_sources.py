"""Where the values of parameters come from. A value without a source was not set: it is the default, and may be chosen.

What nobody set may be chosen by a scene, a device or a rule (`hapnet.assembly.resolve`). What was set is used as it
was set, or refused.
"""

from __future__ import annotations

from collections.abc import Mapping

from hapnet.errors import InvalidParameter

DEFAULT = "default"
"""The source of what nobody set."""

FILE, FLAG, PROGRAM, PAGE, RECORDING, COMMAND = "file", "flag", "program", "page", "recording", "command"
"""Set by: a parameters' file, the command line, a Python program, the live page, a recording that does not say more,
and the command itself, such as the relaxed hand of `hapnet play`."""

SCENE, DEVICE, RULE = "scene", "device", "rule"
"""Chosen for what was not set: the scene's own defaults and units, what the device is, and hapnet's rules."""

ASKED = frozenset({FILE, FLAG, PROGRAM, PAGE})
"""The user set it, so nothing else may be used in its place."""

RESOLVED = frozenset({SCENE, DEVICE, RULE})
"""Chosen for what was not set; the same parts choose it again."""

SOURCES = frozenset({*ASKED, *RESOLVED, RECORDING, COMMAND})

Sources = tuple[tuple[str, str], ...]
"""The source of each value that has one, by its parameter's dotted name, in their order."""


def read(table: object) -> dict[str, str]:
    """The sources in a file's or recording's table. Raises InvalidParameter."""
    if not isinstance(table, Mapping):
        raise InvalidParameter("sources", table, "a table of parameters and their sources")
    for name, source in table.items():
        if not isinstance(source, str) or source not in SOURCES:
            raise InvalidParameter(f"sources.{name}", source, "one of " + ", ".join(sorted(SOURCES)), SOURCES)
    return dict(table)
