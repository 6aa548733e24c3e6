"""A side that has had several peers in turn: the accounts of those before the last one.

Each process keeps its own half of Theorem 1, and each receiver credits at most what was sent to it. So the sum of the
margins of all processes at both ports is a bound as with two. d^2 does not grow: whoever comes later starts empty.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal, TypedDict

from hapnet.wire.account import Heard

if TYPE_CHECKING:
    from hapnet.summary.structure import SidePart


class FormerPart(TypedDict):
    """The accounts of a side's earlier peers, as these reported them: how many, how many of them are final (the peer
    had ended, and did not vanish), and sums of their margins, their smallest slack [J], and sums of the energy that
    they sent and credited [nJ]."""

    count: int | None
    whole: int | None
    margin_J: float | None
    slack_J: float | None
    sent_nJ: int | None
    credited_nJ: int | None


def former_part(accounts: Sequence[Heard]) -> FormerPart:
    """The part of a summary with these accounts."""

    def values(name: str) -> list[float]:
        found = [one.values.get(name) for one in accounts]
        numbers = [value for value in found if isinstance(value, int | float) and not isinstance(value, bool)]
        return [number for number in numbers if math.isfinite(number)]

    def total(name: str) -> float | None:
        found = values(name)
        return math.fsum(found) if len(found) == len(accounts) else None

    sent, credited = total("sent_nJ"), total("credited_nJ")
    return {
        "count": len(accounts),
        "whole": sum(one.final for one in accounts),
        "margin_J": total("ledger.margin_J"),
        "slack_J": min(values("ledger.slack_J"), default=None),
        "sent_nJ": None if sent is None else int(sent),
        "credited_nJ": None if credited is None else int(credited),
    }


def several(*sides: SidePart | None) -> bool:
    """Whether one of these sides has had more than one peer."""
    return any(_others(side) > 0 for side in sides if side is not None)


def restarted(*sides: SidePart | None) -> bool:
    """Whether an earlier peer of one of these sides has told nothing of its account."""
    return any(_others(side) > _told(side, "count") for side in sides if side is not None)


def vanished(*sides: SidePart | None) -> bool:
    """Whether an earlier peer of one of these sides has not told its whole account."""
    return any(_others(side) > _told(side, "whole") for side in sides if side is not None)


def _others(side: SidePart) -> int:
    """The number of a side's earlier peers."""
    return max(0, (side.get("incarnations") or 0) - 1)


def _told(side: SidePart, name: Literal["count", "whole"]) -> int:
    former = side.get("former")
    return 0 if former is None else former[name] or 0


def with_former(own: int | None, other: SidePart | None, name: Literal["sent_nJ", "credited_nJ"]) -> int | None:
    """This side's value and those of its earlier processes, or of others in its place, as the other side knows them."""
    if other is None or not several(other) or restarted(other):
        return own
    former = other["former"][name]
    return None if own is None or former is None else own + former


def with_former_margins(margin_J: float | None, sides: Sequence[SidePart]) -> float | None:
    """A pair's margin with those of all earlier processes; None: one is not known [J]."""
    margins = [margin_J, *(side["former"]["margin_J"] for side in sides if several(side))]
    known = [one for one in margins if one is not None]
    return math.fsum(known) if len(known) == len(margins) else None
