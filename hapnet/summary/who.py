"""Who the peer is, as far as a verdict depends on it: proved, said, or contradicted."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import cast

from hapnet.summary.structure import SIDES, SidePart, Summary, read
from hapnet.wire.messages import Role

_CONTRADICTIONS = {
    "acknowledged": "{} of its energy messages acknowledged energy that was never announced",
    "credited": "{} of its energy messages reported less energy than was credited before",
    "tellers": "{} of its energy messages cannot all be of one sender",
    "keys": "more than one key was offered",
    "seals": "{} messages were not sealed with the key of the pair",
}


def contradicted(tree: object) -> bool:
    """Did somebody else speak in a side's name? Then the exit code is 5, unless a claim was broken."""
    summary = read(tree)
    return any(any(part["contradictions"].values()) for side in SIDES if (part := summary[side]) is not None)


def contradictions(side: Role, part: SidePart) -> Iterator[str]:
    """The sum of both halves is a bound only if nobody credits what was not sent by then."""
    other = SIDES[1 - SIDES.index(side)]
    reported = cast(Mapping[str, int | None], part["contradictions"])
    found = [_CONTRADICTIONS[kind].format(count) for kind, count in reported.items() if count]
    if found:
        yield f"somebody else spoke in the {other}'s name: {', '.join(found)}"


def unproved(summary: Summary) -> Iterator[str]:
    """All that was judged is of whoever the peer was, where neither a secret nor a certificate says who that is."""
    if any(part["peer"]["proof"] == "nobody" for side in SIDES if (part := summary[side]) is not None):
        yield "nobody proved who the peer is: there was neither a secret nor a certificate"
