"""The worlds that the page offers: one of each kind, those of the examples where they are, and the run's own."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

from hapnet.installing import lacks

_EXAMPLES = Path(__file__).parents[3] / "examples"

MESHES = (".stl", ".obj", ".ply")
"""The files that may be given to the page: only meshes, as other models can name files of this machine."""

LARGEST_FILE = 32 * 1024 * 1024
"""No such file is larger [bytes]."""


_EXTRAS = {"mesh": "mesh", "dominoes": "mujoco"}
"""The scenes that need an extra."""


def needs(extra: str) -> str:
    """A note beside a choice's name if the extra's libraries are not installed; empty: they are.

    Choosing it gives the line that says how to install them.
    """
    return f" (needs the extra {extra})" if lacks(extra) else ""


def _offered() -> dict[str, str]:
    found = {"free": "free", "wall": "wall", "box": "box", "sphere": "sphere"}
    for label, file, words in (
        ("mesh", "ring.obj", "mesh:{}?unit=mm"),
        ("dominoes", "dominoes.xml", "mujoco:{}"),
        ("planet", "planet.py", "examples.planet:planet"),
    ):
        if (path := _EXAMPLES / file).is_file():
            extra = _EXTRAS.get(label)
            found[label + (needs(extra) if extra else "")] = words.format(path)
    return found


SCENES: Mapping[str, str] = MappingProxyType(_offered())
"""What users read, and the text for `--scene` that it stands for."""


def scene_label(text: str) -> str:
    """The choice that this text is; another text is its own label."""
    return next((label for label, known in SCENES.items() if known == text), text)
