"""The causes of a verdict against a run, or of doubt: each with its sentence and its exit code.

A cause has one row here, one in the table of README.md, and a case in `tests/summary/test_causes.py`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import NamedTuple, cast

from hapnet.summary.former import restarted, vanished
from hapnet.summary.structure import SIDES, SidePart, Summary
from hapnet.wire.messages import Role

FAILED = 2
"""Exit code: a process failed or got wrong input, and reported that in one line."""

INCOMPLETE = 3
"""Exit code: the run went well, but its output or its account is not complete."""

NOT_PASSIVE = 4
"""Exit code: a coupling that claims to be passive here was not. It takes precedence over all codes but an error's."""

CONTRADICTED = 5
"""Exit code: a third party sent messages in the name of a side, so it is not known whether the run was passive."""


class Cause(NamedTuple):
    """passive : the verdict for this cause: False; None: not known; True: the cause does not change the verdict.

    code : the exit code, unless another cause's takes precedence. `NOT_PASSIVE` : 0 where the coupling claims nothing,
    and `INCOMPLETE` where only the servo is to blame. sentence : with the names of values in braces.
    """

    passive: bool | None
    code: int
    sentence: str


class Finding(NamedTuple):
    """A cause that a summary shows, and its sentence with the values."""

    cause: str
    text: str

    @property
    def code(self) -> int:
        return CAUSES[self.cause].code


CAUSES: Mapping[str, Cause] = MappingProxyType({
    "diverged": Cause(False, NOT_PASSIVE, "the run diverged: its energy account is no longer finite"),
    "bound": Cause(
        False, NOT_PASSIVE, "gave out {out} mJ, more than the {bound} mJ allowed"
    ),
    "margin": Cause(False, NOT_PASSIVE, "the margin fell to {margin} mJ"),
    "half": Cause(False, NOT_PASSIVE, "the margin of the {side}'s half fell to {margin} mJ"),
    "slack": Cause(False, NOT_PASSIVE, "the {side}'s half of the theorem fails by {energy} mJ"),
    "true positions": Cause(
        False, NOT_PASSIVE, "with the true positions the {side}'s half of the theorem fails by {energy} mJ"
    ),
    "hand": Cause(False, NOT_PASSIVE, "the margin at the hand and the walls fell to {margin} mJ"),
    "never sent": Cause(False, NOT_PASSIVE, "the {side} credited {energy} mJ that the {other} never sent"),
    "torn": Cause(None, 0, "the {side}'s recording is incomplete: the rest of its account is missing"),
    "peer lost": Cause(None, INCOMPLETE, "the rest of the {side}'s account is missing since its last report{when}"),
    "no reading": Cause(None, INCOMPLETE, "the {side}'s account is missing: {name} gave no reading"),
    "account": Cause(None, INCOMPLETE, "the {side}'s account is missing{rest}"),
    "accounts": Cause(None, INCOMPLETE, "there is no energy account"),
    "joint account": Cause(
        None,
        INCOMPLETE,
        "this coupling is passive only at both ports together, and the {side}'s account is missing",
    ),
    "not at once": Cause(
        None, 0, "this coupling is passive only at both ports together, and no clock covers both"
    ),
    "no fit": Cause(None, 0, "the accounts of the two sides do not match"),
    "restart": Cause(None, 0, "the account of an earlier {side} is not known"),
    "former": Cause(None, 0, "the rest of the account of an earlier {side} is missing since its last report"),
    "early": Cause(None, CONTRADICTED, "the {side} credited {energy} mJ before the {other} sent it"),
    "contradiction": Cause(
        None, CONTRADICTED, "another sender used the {side}'s name: {messages}"
    ),
    "deficit": Cause(None, 0, "the {side} gave out {energy} mJ that its reservoir did not have"),
    "dead stream": Cause(
        None, 0, "the {side}'s energy stream is dead: no acknowledgement for {seconds} s"
    ),
    "stopped": Cause(None, INCOMPLETE, "the {side}'s force was stopped after {seconds} s: {why}"),
    "leak": Cause(None, 0, "{stalls}"),
    "risk": Cause(
        None, 0, "while the {whose}servo stalled, {energy} mJ may have come out unseen, more than the margin"
    ),
    "speed": Cause(None, 0, "the {side} moved at {speed} m/s, and declares at most {limit} m/s"),
    "repeats": Cause(
        None, 0, "the {side}'s speed is not known: its readings are new every {every} ms only, and jump at {speed} "
        "m/s, more than the {limit} m/s that it declares; let it declare rate_hz = {reads}",
    ),
    "blur": Cause(
        None, 0, "the {whose}encoders are coarse: the account may be off by {energy} mJ, over the margin of {margin} mJ"
    ),
    "world failed": Cause(None, FAILED, "the world failed, and its own account is not known: {why}"),
    "world's account": Cause(
        None, 0, "the world's own account is not finite (stored_J or supplied_J): its energy is not known"
    ),
    "blocked": Cause(True, INCOMPLETE, "the {side}'s driver blocks: {what}"),
    "unproved": Cause(
        True, 0, "the peer's identity is not proven: there was neither a secret nor a certificate"
    ),
})  # fmt: skip
"""The causes, in the order in which a verdict lists them."""


def found(cause: str, **values: object) -> Finding:
    """The cause with these values in its sentence."""
    return Finding(cause, CAUSES[cause].sentence.format(**values))


_CONTRADICTIONS = {
    "acknowledged": "{} of its energy messages acknowledged energy that was never announced",
    "credited": "{} of its energy messages reported less energy than was credited before",
    "senders": "{} of its energy messages cannot all be of one sender",
    "keys": "more than one key was offered",
    "seals": "{} messages were not sealed with the key of the pair",
}


def former(side: Role, part: SidePart) -> Iterator[Finding]:
    """Yield that an earlier peer of this side vanished, and has told only a part of its account."""
    if vanished(part) and not restarted(part):
        yield found("former", side=SIDES[1 - SIDES.index(side)])


def contradictions(side: Role, part: SidePart) -> Iterator[Finding]:
    """Yield contradictions in a side's energy messages: then the sum of both halves is not a bound."""
    other = SIDES[1 - SIDES.index(side)]
    reported = cast(Mapping[str, int | None], part["contradictions"])
    kinds = [_CONTRADICTIONS[kind].format(count) for kind, count in reported.items() if count]
    if kinds:
        yield found("contradiction", side=other, messages=", ".join(kinds))


def unproved(summary: Summary) -> Iterator[Finding]:
    """Yield that the peer's identity was not proved, if there was neither a secret nor a certificate."""
    if any(part["peer"]["proof"] == "nobody" for side in SIDES if (part := summary[side]) is not None):
        yield found("unproved")
