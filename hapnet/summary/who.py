"""Who the peer is, as far as a verdict depends on it: proved, said, or contradicted."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import cast

from hapnet.summary.causes import Finding, found
from hapnet.summary.structure import SIDES, SidePart, Summary
from hapnet.wire.messages import Role

_CONTRADICTIONS = {
    "acknowledged": "{} of its energy messages acknowledged energy that was never announced",
    "credited": "{} of its energy messages reported less energy than was credited before",
    "tellers": "{} of its energy messages cannot all be of one sender",
    "keys": "more than one key was offered",
    "seals": "{} messages were not sealed with the key of the pair",
}


def contradictions(side: Role, part: SidePart) -> Iterator[Finding]:
    """The sum of both halves is a bound only if nobody credits what was not sent by then."""
    other = SIDES[1 - SIDES.index(side)]
    reported = cast(Mapping[str, int | None], part["contradictions"])
    kinds = [_CONTRADICTIONS[kind].format(count) for kind, count in reported.items() if count]
    if kinds:
        yield found("contradiction", side=other, messages=", ".join(kinds))


def unproved(summary: Summary) -> Iterator[Finding]:
    """All that was judged is of whoever the peer was, where neither a secret nor a certificate says who that is."""
    if any(part["peer"]["proof"] == "nobody" for side in SIDES if (part := summary[side]) is not None):
        yield found("unproved")
