"""The values of flags that the shell offers after TAB; typer keeps those that begin with the word on the line."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import fields
from itertools import pairwise
from pathlib import Path
from typing import Any

from hapnet.laws import BILATERAL_NAMES, COUPLING_NAMES, GROUP
from hapnet.loading import extension, published
from hapnet.params import Params
from netem.presets import PRESETS

OPERATORS = ("rest", "sine", "press", "hand-1")
MODES = ("peer", "client", "router")
MOTIONS = (".csv", ".mcap")
"""Files that can be an operator's motion."""

_UNQUOTED = frozenset("._-+=@%/,")  # characters that need no quotes in any shell


def glue() -> bool:
    """Join the words of bash's line that contain an ``=``; returns whether the last one does.

    bash splits words at ``=``, and then expects only the part after it: see `behind`. click joins ``--flag=value``
    itself, but not the ``NAME=VALUE`` of ``--set``.
    """
    words = os.environ.get("COMP_WORDS", "").split("\n")[: int(os.environ.get("COMP_CWORD", "0")) + 1]
    line, glued = words[:1], False
    for before, word in pairwise(words):
        glued = word == "=" or (before == "=" and word != "")
        if glued:
            line[-1] += word
        else:
            line.append(word)
    os.environ["COMP_WORDS"], os.environ["COMP_CWORD"] = "\n".join(line), str(len(line) - 1)
    return glued


def behind(offered: str) -> str:
    """The part after the last ``=`` of each offered line, unless it is empty."""
    return "\n".join(filter(None, (line.rpartition("=")[2] for line in offered.splitlines())))


def choices(parameter: str) -> Callable[[], list[str]]:
    """A function that returns the texts that a parameter allows."""
    return lambda: list(_allowed(parameter))


def words(*given: str) -> Callable[[], list[str]]:
    """A function that returns these words."""
    return lambda: list(given)


def profiles() -> list[tuple[str, str]]:
    """Link profiles by name, each with its text in tc-netem's syntax."""
    return [(name, tc) for name, tc in PRESETS.items()]


def couplings() -> list[str]:
    """hapnet's own couplings, and those that packages publish."""
    return [*COUPLING_NAMES, *BILATERAL_NAMES, *published(GROUP)]


def scenes() -> list[tuple[str, str]]:
    """Worlds by name with a description, the solids that need no file, and worlds that packages publish."""
    from hapnet.plant.scenes import SCENES
    from hapnet.plant.worlds.registry import GROUP, about

    others = [*extension("solids").OFFERED, *extension("tools' worlds").OFFERED, *extension("grips").OFFERED]
    others += [("soft", "a soft block"), ("soft:organ", "a soft organ")]
    return [*((name, about(name)) for name in SCENES), *others, *((name, "") for name in published(GROUP))]


def devices() -> list[str]:
    """Devices by name."""
    from hapnet.devices.registry import known

    return ["omni", *known()]


def operators(incomplete: str) -> list[str]:
    """Built-in hands, and files that contain a motion."""
    return [*OPERATORS, *files(incomplete, MOTIONS)]


def assignments(incomplete: str) -> list[tuple[str, str]]:
    """``NAME=`` for every parameter; if only one matches, also ``NAME=VALUE`` with its default and other choices.

    So at least two offers have the same beginning, and the shell adds no space after the ``=``.
    """
    values = Params().flat()
    names = [name for name in values if name.startswith(incomplete.partition("=")[0])]
    found = [(f"{name}=", str(_about(name)["doc"]).replace("[", "\\[")) for name in names]  # no markup: a unit
    if len(names) == 1:
        (name,) = names
        offered = dict.fromkeys((_word(values[name]), *_allowed(name)))
        found += [(f"{name}={value}", found[0][1]) for value in offered if value]
    return found


def specs(incomplete: str) -> list[str]:
    """Files that can be the spec of a sweep or a tuning."""
    return files(incomplete, (".toml",))


def files(incomplete: str, endings: tuple[str, ...]) -> list[str]:
    """Paths with this beginning: files with one of these endings, and directories; of a lone directory its content."""
    found: list[str] = []
    for _ in range(20):
        directory, slash, start = incomplete.rpartition("/")
        found = []
        try:
            for path in sorted(Path(os.path.expanduser(f"{directory}{slash}") or ".").iterdir()):
                hidden = path.name.startswith(".") and not start.startswith(".")
                if hidden or not path.name.startswith(start) or not _plain(path.name):
                    continue
                if path.is_dir():
                    found.append(f"{directory}{slash}{path.name}/")
                elif path.name.endswith(endings):
                    found.append(f"{directory}{slash}{path.name}")
        except OSError:
            break
        if len(found) != 1 or not found[0].endswith("/"):
            break
        incomplete = found[0]
    return found


def _about(parameter: str) -> Mapping[str, Any]:
    """A parameter's description and allowed values."""
    section, _, last = parameter.rpartition(".")
    owner = Params().get(section) if section else Params()
    return next(field.metadata for field in fields(owner) if field.name == last)


def _allowed(parameter: str) -> tuple[str, ...]:
    allowed = _about(parameter)["allowed"]
    return allowed if isinstance(allowed, tuple) else ()


def _plain(name: str) -> bool:
    return all(letter.isalnum() or letter in _UNQUOTED for letter in name)


def _word(value: object) -> str:
    """A value in the form of `--set`; empty if a shell would need quotes."""
    text = str(value).lower() if isinstance(value, bool) else f"{value:g}" if isinstance(value, float) else str(value)
    return text if _plain(text) else ""
