"""The sizes that a MuJoCo model claims to need, checked before MuJoCo makes it: a short file may claim all memory and
hours.

The text is searched, not parsed: MuJoCo reads more than is XML, such as comments with two hyphens in them.
"""

from __future__ import annotations

import html
import math
import re
from collections.abc import Iterator, Mapping
from pathlib import Path

from hapnet.file_content import read_text

LARGEST_FILE = 64 << 20
"""No file of a model's text is larger [bytes]."""

MOST_FILES = 200
"""A model includes at most so many others."""

MOST: Mapping[str, tuple[float, tuple[str, ...]]] = {
    "replicate": (1e4, ("count",)),
    "flexcomp": (2e4, ("count",)),
    "composite": (2e4, ("count",)),
    "hfield": (4e6, ("nrow", "ncol")),
    "texture": (8e6, ("width", "height")),
}
"""By element: the most that the product of these attributes may be, of which all are as the first one if not given.
Replicates in one another count as one product."""

MOST_SIZE = 1e6
"""The most of any number in the element ``size``, but its memory."""

MOST_MEMORY = 256e6
"""The most of that [bytes]."""

_UNITS = {"K": 2**10, "M": 2**20, "G": 2**30, "T": 2**40, "P": 2**50, "E": 2**60}
_LEFT_OUT = re.compile(r"<!--.*?-->|<!\[CDATA\[.*?\]\]>", re.DOTALL)
_ELEMENT = re.compile(r"""<(/?)([A-Za-z_][\w.-]*)((?:[^<>"']|"[^"]*"|'[^']*')*)>""")
_ATTRIBUTE = re.compile(r"""([A-Za-z_][\w.-]*)\s*=\s*(?:"([^"]*)"|'([^']*)')""")


def check_sizes(file: Path) -> None:
    """Raise ValueError for a model, or a file that it includes, that claims more than `MOST` allows; OSError."""
    seen, left = set[Path](), [file]
    while left:
        one = left.pop().resolve()
        if one in seen:
            continue
        seen.add(one)
        if len(seen) > MOST_FILES:
            raise ValueError(f"it includes more than {MOST_FILES} files")
        for included in _checked(read_text(one, LARGEST_FILE)):
            left += [path for path in {file.parent / included, one.parent / included} if path.is_file()]


def _checked(text: str) -> Iterator[str]:
    """The files that a text includes."""
    copies = [1.0]
    for closes, name, words in _ELEMENT.findall(_LEFT_OUT.sub("", text)):
        if closes:
            if name == "replicate" and len(copies) > 1:
                copies.pop()
            continue
        given = {key: html.unescape(one or other) for key, one, other in _ATTRIBUTE.findall(words)}
        if name in ("include", "model") and "file" in given:
            yield given["file"]
        if name == "size":
            _check_size(given)
        if name not in MOST:
            continue
        most, keys = MOST[name]
        claimed = math.prod(
            max(1.0, abs(one)) for key in keys for one in _numbers(given.get(key, given.get(keys[0], "1")))
        )
        if name == "replicate":
            claimed *= copies[-1]
            if not words.endswith("/"):
                copies.append(claimed)
        if not claimed <= most:
            raise ValueError(f"its {name} claims {claimed:.3g} ({' times '.join(keys)}), {most:.3g} are allowed")


def _check_size(given: Mapping[str, str]) -> None:
    for key, value in given.items():
        most = MOST_SIZE
        scale = 1.0
        if key == "memory":
            most, scale = MOST_MEMORY, float(_UNITS.get(value.strip()[-1:].upper(), 1))
            value = value.strip().rstrip("KMGTPEkmgtpe")
        for one in _numbers(value):
            if not one * scale <= most:
                raise ValueError(f"its size claims {key} {one * scale:.3g}, {most:.3g} are allowed")


def _numbers(text: str) -> Iterator[float]:
    """The numbers in a text; what is none MuJoCo refuses."""
    for part in text.split():
        try:
            yield float(part)
        except ValueError:
            return
