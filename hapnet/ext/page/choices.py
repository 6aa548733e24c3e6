"""The couplings and worlds that the page offers.

Couplings: PSPM with each rendering, and every other coupling. Worlds: one of each kind, those of the examples if
the directory exists, and the run's own.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

from hapnet.couplings import pspm, registry
from hapnet.ext.laws import zoh
from hapnet.installing import lacks
from hapnet.laws import COUPLING_NAMES

Choice = tuple[str, str]
"""A coupling and a rendering."""

CHOICES: Mapping[str, Choice] = MappingProxyType(
    {
        "hapnet": (pspm.LAW.name, "hapnet"),
        "paper": (pspm.LAW.name, "paper"),
        "zoh": (zoh.LAW.name, "paper"),
        "zoh, hapnet's rendering": (zoh.LAW.name, "hapnet"),
        **{name: (name, "auto") for name in COUPLING_NAMES if name not in (pspm.LAW.name, zoh.LAW.name)},
    }
)
"""The couplings by the label that users see."""

_WORDS = {
    "hapnet": "PSPM, local contact model",
    "paper": "PSPM as in the paper",
    "zoh": "a plain spring, no PSPM",
    "zoh, hapnet's rendering": "local contact model, no PSPM",
}


def label_of(coupling: str, rendering: str) -> str:
    """The label of this coupling with this rendering; the name itself for a user's own coupling."""
    spec = registry.known(coupling)
    if rendering == "auto" and spec is not None and spec.sends_planes:
        rendering = "hapnet"
    return next((label for label, choice in CHOICES.items() if choice == (coupling, rendering)), coupling)


def words_of(label: str) -> str:
    """A few words that explain a label."""
    spec = registry.known(label)
    return _WORDS.get(label) or ("" if spec is None else spec.title)


_EXAMPLES = Path(__file__).parents[3] / "examples"

MESHES = (".stl", ".obj", ".ply")
"""The files that users may upload: only meshes, as other models can name files of this machine."""

LARGEST_FILE = 32 * 1024 * 1024
"""A larger file is refused [bytes]."""


_EXTRAS = {"mesh": "mesh", "dominoes": "mujoco"}
"""The scenes that need an extra, by label."""


def needs(extra: str) -> str:
    """A note for a label if the extra's libraries are not installed; empty if they are.

    If the user chooses such a scene, the error shows how to install them.
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
"""The worlds by the label that users see: the text for `--scene`."""


def scene_label(text: str) -> str:
    """The label of this text for `--scene`; the text itself if the page does not offer it."""
    return next((label for label, known in SCENES.items() if known == text), text)
