"""A side's half of a summary as values that it reports to its peer, and both halves as one summary.

A report is a claim of the peer: `peer_report` in the summary has its side and time; the verdict mentions it.
`hapnet/wire/README.md` lists the values under "Accounts".
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol

from hapnet.summary.former import several
from hapnet.summary.path import DIRECTIONS, ROUND_TRIP
from hapnet.summary.run import judged, merge
from hapnet.summary.structure import SIDES, SidePart, Summary, known, read
from hapnet.wire.fields import Signal
from hapnet.wire.messages import Role

_PART = (
    "ledger.margin_J", "ledger.slack_J", "ledger.bound_J", "ledger.work_J", "ledger.margin_end_J",
    "ledger.margin_later_J", "ledger.diverged",
    "deficit_max_J", "quantisation_J", "true_slack_J", "force", "hand_work_J",
    "sent_nJ", "credited_nJ", "acked_nJ", "in_flight_nJ", "abandoned_nJ", "unanswered_s", "incarnations", "peers_J",
    "overrun_leak_J", "overrun_risk_J", "speed_max_mps", "speed_limit_mps",
    "servo.overruns", "servo.longest_ms", "servo.without_force_s", "servo.withheld_s", "servo.ticks", "servo.skipped",
    "stopped.after_s", "stopped.why", "stopped.asked",
    "contradictions.senders", "contradictions.credited", "contradictions.acknowledged",
    "contradictions.keys", "contradictions.seals", "peer.proof", "failed",
    "environment.env_diverged", "environment.env_slack_J", "environment.env_supplied_J", "environment.env_stored_J",
    "environment.env_given_J", "environment.env_paid_J", "environment.env_undone", "environment.env_undone_J",
    "environment.env_overlaps",
)  # fmt: skip
"""Names from the side's own part of the summary."""

_FORMER = (
    "former.count", "former.whole", "former.margin_J", "former.slack_J", "former.sent_nJ", "former.credited_nJ",
)  # fmt: skip
"""The same of a side that had earlier peers."""

_MOTION: dict[Role, tuple[str, ...]] = {
    "device": ("peak_force_N", "peak_torque_Nm"),
    "world": ("peak_penetration_m", "contacts"),
}
_PATH = ("sent", "lost", "loss")
_WALL = ("stiffness_N_m", "springs_N_m")


class Claim(NamedTuple):
    """The last report of a peer: its values, and its arrival in seconds after this side's pairing.

    final : the peer's control had stopped. whole : the report covers all of this side's time.
    """

    values: Mapping[str, Signal]
    as_of_s: float
    final: bool
    whole: bool


class Half(Protocol):
    """A side's half of the account while it runs, with its time and description; a `Status` is such a half."""

    @property
    def role(self) -> Role: ...
    @property
    def time_ns(self) -> int: ...
    @property
    def about(self) -> Mapping[str, Any]: ...
    @property
    def account(self) -> Mapping[str, Signal]: ...


def values_of(own: Summary, role: Role) -> dict[str, Signal]:
    """Return the values that a side reports, from its own summary. Unknown values are left out."""
    part = own[role]
    names = _PART + _FORMER if part is not None and several(part) else _PART
    found: dict[str, Any] = {name: _at(part, name) for name in names}
    found |= {f"motion.{name}": _at(own["motion"], name) for name in _MOTION[role]}
    found |= {f"path.{name}": _at(own["path"][DIRECTIONS[role]], name) for name in _PATH}
    found |= {f"path.{name}": _at(own["path"], name) for name in ROUND_TRIP}
    found |= {f"wall.{name}": _at(own["environment"], name) for name in _WALL}
    return {name: signal for name, value in found.items() if (signal := _reportable(value)) is not None}


def joined(own: Summary, role: Role, claim: Claim) -> Summary:
    """The summary of both sides from one side's data: its `own` summary, and its peer's claim."""
    other = SIDES[1 - SIDES.index(role)]
    far = _read(claim.values, other)
    part, mine = far[other], own[role]
    assert part is not None
    if mine is not None and not claim.final:
        _bring_up(part, mine)
    both = merge(*((own, far) if role == "device" else (far, own)), seed=own["seed"])
    both["motion"] = far["motion"]
    for name in _MOTION[role]:
        both["motion"][name] = own["motion"][name]  # type: ignore[literal-required]
    both["duration_s"], both["tuning"], both["wall_clock"] = own["duration_s"], own["tuning"], own["wall_clock"]
    both["peer_report"] = {"side": other, "as_of_s": claim.as_of_s, "final": claim.final, "whole": claim.whole}
    return judged(both)


def present(device: Half, world: Half, margins: Mapping[str, float | None]) -> Summary:
    """The summary of a pair while it runs, from both sides' reports of their halves.

    The order of two reports is not known, so a receiver may have credited energy that its sender has not reported yet:
    energy that was never sent is found only at the end. margins : of both ports, as `merge` takes them.
    """
    halves = [_read(half.account, half.role) for half in (device, world)]
    parts = halves[0]["device"], halves[1]["world"]
    for half, source in zip(halves, (device, world), strict=True):
        coupling = source.about.get("coupling")
        half["coupling"] = coupling if isinstance(coupling, str) else None
    for own, other in (parts, parts[::-1]):
        assert own is not None and other is not None  # noqa: PT018  # `_read` makes them
        _bring_up(own, other)
    return merge(*halves, margins=margins)


def _bring_up(part: SidePart, mine: SidePart) -> None:
    """Update the counts of a running peer with the newer ones of the other side since its report."""
    sent, credited, acked = part["sent_nJ"], part["credited_nJ"], mine["acked_nJ"]
    former = mine["former"] if several(mine) and "former" in mine else None
    sent_before, credited_before = (0, 0) if former is None else (former["sent_nJ"] or 0, former["credited_nJ"] or 0)
    if sent is not None and mine["credited_nJ"] is not None and sent_before + sent < mine["credited_nJ"]:
        part["sent_nJ"] = None
    if credited is not None and acked is not None:
        part["credited_nJ"] = max(credited, acked - credited_before)


def _read(values: Mapping[str, Signal], role: Role) -> Summary:
    """The summary with these values of a side; other values, and values of a wrong type, are None."""
    part: dict[str, Any] = {"stopped": {}}
    for name in _PART + _FORMER:
        *nested, last = name.split(".")
        inside = part.setdefault(nested[0], {}) if nested else part
        inside[last] = values.get(name)
    if part["stopped"].get("why") is None:
        part["stopped"] = None
    springs = values.get("wall.springs_N_m")
    path: dict[str, Any] = {name: values.get(f"path.{name}") for name in ROUND_TRIP}
    direction = {name: values.get(f"path.{name}") for name in _PATH}
    return read({
        role: part,
        "motion": {name: values.get(f"motion.{name}") for name in _MOTION[role]},
        "path": path | ({} if direction["sent"] is None else {DIRECTIONS[role]: direction}),
        "environment": {
            "stiffness_N_m": values.get("wall.stiffness_N_m"),
            "springs_N_m": list(springs) if isinstance(springs, tuple) else None,
        },
    })  # fmt: skip


def _at(tree: object, name: str) -> object:
    for key in name.split("."):
        tree = tree.get(key) if isinstance(tree, Mapping) else None
    return tree


def _reportable(value: object) -> Signal:
    """The value in a form that a message can carry; None: it is not known."""
    if isinstance(value, list | tuple):
        numbers = [number for one in value if (number := known(one)) is not None]
        return tuple(numbers) if numbers else None
    if isinstance(value, str):
        return "".join(c if c.isprintable() else " " for c in value)[:200]
    return value if isinstance(value, bool) else known(value)
