"""A repeated notice is shown to people a few times, and then only counted; a log for programs has all of them."""

from __future__ import annotations

from dataclasses import dataclass

REPORTED = 3
"""A kind of notice is shown this often within `EVERY_NS`."""

EVERY_NS = 10_000_000_000

REPEATING = frozenset({"silent", "heard", "overrun", "link", "rate"})
"""Kinds of notices that a bad network or a busy machine causes again and again."""


@dataclass
class _Kind:
    begin_ns: int
    reported: int = 0
    untold: int = 0
    text: str = ""


class Repeats:
    """Decides which notices people see; `who` names the side that sends them.

    shown : how often within `EVERY_NS` a kind of notice is shown.
    """

    def __init__(self, shown: int = REPORTED) -> None:
        self._shown = shown
        self._kinds: dict[tuple[str, str], _Kind] = {}

    def line(self, who: str, kind: str, text: str, now_ns: int) -> str | None:
        """The line to show for a notice, with the number of those not shown before it; None: do not show it."""
        if kind not in REPEATING:
            return text
        found = self._kinds.get((who, kind))
        if found is None or now_ns - found.begin_ns >= EVERY_NS:
            untold = found.untold if found is not None else 0
            self._kinds[who, kind] = _Kind(now_ns, reported=1)
            return f"{text} ({untold} more like this before it)" if untold else text
        if found.reported < self._shown:
            found.reported += 1
            return text
        found.untold += 1
        found.text = text
        return None

    def rest(self) -> list[tuple[str, str]]:
        """At the end: for each kind with notices that were not shown, its side and a line about them."""
        untold = [(who, kind) for (who, _), kind in self._kinds.items() if kind.untold]
        self._kinds.clear()
        return [(who, f"{kind.text} (the last of {kind.untold} more like this)") for who, kind in untold]
