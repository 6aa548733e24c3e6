"""An extension of griffe: docstrings as Markdown.

A section of a docstring is an underlined title and lines "name : words", each describing a name. A section becomes a
list. Doctests and indented equations become blocks without changes.
"""

from __future__ import annotations

import re
from typing import Any

from griffe import Docstring, Extension, Object

_TITLE = re.compile(r"(?m)^([A-Z][A-Za-z ]+)\n-{3,}\n")
_ENTRY = re.compile(r"^(\*{0,2}[\w.]+(?:, \*{0,2}[\w.]+)*) : ")


class Markdown(Extension):
    """Rewrites each docstring after griffe has read it."""

    def on_object(self, *, obj: Object, **_: Any) -> None:
        """Called for every object that griffe finds."""
        if obj.docstring is not None:
            obj.docstring = Docstring(markdown(obj.docstring.value), lineno=obj.docstring.lineno, parent=obj)


def markdown(text: str) -> str:
    """`text` with lists for its sections, and blocks for doctests and indented parts."""
    first, *sections = _TITLE.split(text)
    parts = [_blocks(first)]
    for title, body in zip(sections[::2], sections[1::2], strict=True):
        parts.append(f"**{title}**\n\n{_blocks(body)}")
    return "\n\n".join(parts)


def _blocks(text: str) -> str:
    blocks: list[str] = []
    for part in re.split(r"\n{2,}", text.strip("\n")):
        if part.startswith(">>>"):
            blocks.append(f"```pycon\n{part}\n```")
        elif part.strip() and all(line.startswith("    ") for line in part.splitlines()):
            blocks.append("```text\n" + "\n".join(line[4:] for line in part.splitlines()) + "\n```")
        elif _ENTRY.match(part):
            blocks.append(_entries(part))
        else:
            blocks.append(part.replace("``", "`"))
    return "\n\n".join(blocks)


def _entries(body: str) -> str:
    """A list with one item for each name, also for several names on one line ("a : this. b : that.")."""
    joined: list[str] = []
    for line in body.strip().splitlines():
        if joined and not _ENTRY.match(line):
            joined[-1] += " " + line.strip()
        else:
            joined.append(line.strip())
    entries = [one for line in joined for one in re.split(r"(?<=[.;]) (?=\*{0,2}[a-z_]\w*(?:, \*{0,2}\w+)* : )", line)]
    return "\n".join(
        re.sub(_ENTRY, lambda found: f"* `{found[1]}`: ", one) if _ENTRY.match(one) else f"* {one}"
        for one in (entry.replace("``", "`") for entry in entries)
    )
