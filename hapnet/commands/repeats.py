"""What happens again and again is told a few times, and then counted: for people; a log for programs has it all."""

from __future__ import annotations

from dataclasses import dataclass

TOLD = 3
"""So often in `EVERY_NS` a thing of one kind is told."""

EVERY_NS = 10_000_000_000

REPEATING = frozenset({"silent", "heard", "overrun", "link"})
"""Kinds of notices that a bad network or a busy machine brings about without end."""


@dataclass
class _Kind:
    begin_ns: int
    told: int = 0
    untold: int = 0
    text: str = ""


class Repeats:
    """Decides which notices people see; `who` tells apart whose they are."""

    def __init__(self) -> None:
        self._kinds: dict[tuple[str, str], _Kind] = {}

    def line(self, who: str, kind: str, text: str, now_ns: int) -> str | None:
        """The line to show for a notice, with how many were not shown before it; None: it is one too many."""
        if kind not in REPEATING:
            return text
        found = self._kinds.get((who, kind))
        if found is None or now_ns - found.begin_ns >= EVERY_NS:
            untold = found.untold if found is not None else 0
            self._kinds[who, kind] = _Kind(now_ns, told=1)
            return f"{text} ({untold} more like this before it)" if untold else text
        if found.told < TOLD:
            found.told += 1
            return text
        found.untold += 1
        found.text = text
        return None

    def rest(self) -> list[tuple[str, str]]:
        """At the end: who, and a line on what was not shown of each kind."""
        untold = [(who, kind) for (who, _), kind in self._kinds.items() if kind.untold]
        self._kinds.clear()
        return [(who, f"{kind.text} (the last of {kind.untold} more like this)") for who, kind in untold]
