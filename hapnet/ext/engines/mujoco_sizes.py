"""A check of the sizes that a MuJoCo model requires, before MuJoCo builds it: a short file may require all memory and
hours.

The text is searched, not parsed: MuJoCo also reads invalid XML, such as comments that contain two hyphens.
"""

from __future__ import annotations

import html
import math
import re
from collections.abc import Iterator, Mapping
from pathlib import Path

from hapnet.file_content import read_text

LARGEST_FILE = 64 << 20
"""The largest file of a model's text [bytes]."""

MOST_FILES = 200
"""The greatest number of files that a model includes."""

MOST: Mapping[str, tuple[float, tuple[str, ...]]] = {
    "replicate": (1e4, ("count",)),
    "flexcomp": (2e4, ("count",)),
    "composite": (2e4, ("count",)),
    "hfield": (4e6, ("nrow", "ncol")),
    "texture": (8e6, ("width", "height")),
}
"""By element: the greatest product of these attributes; a missing attribute counts as the first one. Nested replicates
count as one product."""

MOST_SIZE = 1e6
"""The greatest number in the element ``size``, except its memory."""

MOST_MEMORY = 256e6
"""The greatest memory in the element ``size`` [bytes]."""

_UNITS = {"K": 2**10, "M": 2**20, "G": 2**30, "T": 2**40, "P": 2**50, "E": 2**60}
_LEFT_OUT = re.compile(r"<!--.*?-->|<!\[CDATA\[.*?\]\]>", re.DOTALL)
_ELEMENT = re.compile(r"""<(/?)([A-Za-z_][\w.-]*)((?:[^<>"']|"[^"]*"|'[^']*')*)>""")
_ATTRIBUTE = re.compile(r"""([A-Za-z_][\w.-]*)\s*=\s*(?:"([^"]*)"|'([^']*)')""")


def check_sizes(file: Path) -> None:
    """Raise ValueError for a model, or a file that it includes, that requires more than `MOST` allows; OSError."""
    seen, to_read = set[Path](), [file]
    while to_read:
        current = to_read.pop().resolve()
        if current in seen:
            continue
        seen.add(current)
        if len(seen) > MOST_FILES:
            raise ValueError(f"it includes more than {MOST_FILES} files")
        for included in _checked(read_text(current, LARGEST_FILE)):
            to_read += [path for path in {file.parent / included, current.parent / included} if path.is_file()]


def _checked(text: str) -> Iterator[str]:
    """Check a text; returns the files that it includes."""
    copies = [1.0]
    for closes, name, attributes_text in _ELEMENT.findall(_LEFT_OUT.sub("", text)):
        if closes:
            if name == "replicate" and len(copies) > 1:
                copies.pop()
            continue
        attributes = {key: html.unescape(one or other) for key, one, other in _ATTRIBUTE.findall(attributes_text)}
        if name in ("include", "model") and "file" in attributes:
            yield attributes["file"]
        if name == "size":
            _check_size(attributes)
        if name not in MOST:
            continue
        most, keys = MOST[name]
        claimed = math.prod(
            max(1.0, abs(one)) for key in keys for one in _numbers(attributes.get(key, attributes.get(keys[0], "1")))
        )
        if name == "replicate":
            claimed *= copies[-1]
            if not attributes_text.endswith("/"):
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
    """The numbers in a text, without other words, which MuJoCo refuses."""
    for part in text.split():
        try:
            yield float(part)
        except ValueError:
            return
