"""The choices of the page's switch: PSPM with each rendering, and every other coupling."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from hapnet.couplings import pspm, registry
from hapnet.ext.laws import zoh
from hapnet.laws import COUPLING_NAMES

Choice = tuple[str, str]
"""A coupling, and the rendering."""

CHOICES: Mapping[str, Choice] = MappingProxyType(
    {
        "hapnet": (pspm.LAW.name, "hapnet"),
        "paper": (pspm.LAW.name, "paper"),
        "zoh": (zoh.LAW.name, "paper"),
        "zoh, hapnet's rendering": (zoh.LAW.name, "hapnet"),
        **{name: (name, "auto") for name in COUPLING_NAMES if name not in (pspm.LAW.name, zoh.LAW.name)},
    }
)
"""What users read, and what it stands for."""

_WORDS = {
    "hapnet": "PSPM, local contact model",
    "paper": "PSPM as in the paper",
    "zoh": "a plain spring, no PSPM",
    "zoh, hapnet's rendering": "local contact model, no PSPM",
}


def label_of(coupling: str, rendering: str) -> str:
    """The choice that this coupling with this rendering is; a user's own coupling is its own label."""
    spec = registry.known(coupling)
    if rendering == "auto" and spec is not None and spec.world_tells:
        rendering = "hapnet"
    return next((label for label, choice in CHOICES.items() if choice == (coupling, rendering)), coupling)


def words_of(label: str) -> str:
    """The choice as text."""
    spec = registry.known(label)
    return _WORDS.get(label) or ("" if spec is None else spec.title)
