"""The energy account of a running pair, from what both sides publish; the verdict on the pair is based on it."""

from __future__ import annotations

from typing import Any

from hapnet.recording.samples import DeviceSample, WorldSample
from hapnet.summary.structure import SIDES
from hapnet.summary.verdict import START_S
from hapnet.wire.messages import Role

SKEW_NS = 1_000_000_000
"""Credited energy is compared with what the other side had sent this much later [ns]: its samples may come late."""

_ROUNDING_nJ = 2  # a side's own total includes a fraction of a nanojoule


class Account:
    """The account over the samples of both sides, in order of arrival, since both began or one was restarted."""

    def __init__(self) -> None:
        self.margin_J: float | None = None
        """The sum of both sides' present margins [J]."""
        self.min_J: float | None = None
        self.later_J: float | None = None
        """The minimum sum: over all samples, and over those from `START_S` after the first on."""
        self._anew: set[Role] = set()
        self._forget()

    def _forget(self) -> None:
        self._first_ns: int | None = None
        self._newest: dict[Role, DeviceSample | WorldSample] = {}
        self._slack: dict[Role, float] = {}
        self._deficit = 0.0
        self._claims: dict[Role, tuple[float, int]] = {}  # by sender: energy credited to it, and when on its clock
        self._beyond: dict[Role, float] = {}

    @property
    def half_new(self) -> bool:
        """Was one side restarted, and not the other?"""
        return bool(self._anew)

    def begin(self, role: Role) -> None:
        """Forget the samples so far: that side has restarted. If the other has not, the account is not known."""
        if self._anew - {role}:
            self._anew.clear()  # both began: a new pair
        else:
            self._anew.add(role)
        self.margin_J = self.min_J = self.later_J = None
        newest = {side: sample for side, sample in self._newest.items() if side != role}
        self._forget()
        self._newest = newest

    def take(self, role: Role, sample: DeviceSample | WorldSample) -> None:
        """Add a newer sample of that side."""
        other: Role = "world" if role == "device" else "device"
        self._newest[role] = sample
        self._slack[role] = min(self._slack.get(role, sample.slack_J), sample.slack_J)
        if isinstance(sample, DeviceSample):
            self._deficit = max(self._deficit, sample.deficit_J)
        self._compare(role, other, sample)
        if (theirs := self._newest.get(other)) is None:
            return
        self.margin_J = total = sample.margin_J + theirs.margin_J
        self.min_J = total if self.min_J is None else min(self.min_J, total)
        if role == "device":
            self._first_ns = sample.time_ns if self._first_ns is None else self._first_ns
        if role == "device" and self._first_ns is not None and sample.time_ns - self._first_ns >= START_S * 1e9:
            self.later_J = total if self.later_J is None else min(self.later_J, total)
        elif self.later_J is not None:
            self.later_J = min(self.later_J, total)

    def _compare(self, role: Role, other: Role, sample: DeviceSample | WorldSample) -> None:
        """Compare what this side has sent with what was credited to it, and note what it has credited."""
        claim = self._claims.get(role)
        if claim is not None and sample.time_ns - claim[1] >= SKEW_NS:
            self._beyond[role] = max(self._beyond.get(role, 0.0), claim[0] - sample.sent_J)
            del self._claims[role]
        theirs = self._newest.get(other)
        if theirs is not None and other not in self._claims:
            self._claims[other] = sample.credited_J, theirs.time_ns

    def summary(self, coupling: object) -> dict[str, Any] | None:
        """The account in the form of a summary, as far as samples show it; None until both sides have sent one."""
        if self.min_J is None:
            return None
        pairs = 2 if self._anew else 1
        sides: dict[str, dict[str, Any]] = {
            side: {"ledger": {"slack_J": self._slack.get(side)}, "incarnations": pairs} for side in SIDES
        }
        sides["device"]["deficit_max_J"] = self._deficit
        beyond = {role: round(self._beyond.get(role, 0.0) * 1e9) for role in SIDES}
        known = not self._anew or self.min_J < 0.0
        return {
            "theorem": {
                "margin_J": self.min_J if known else None,
                "margin_end_J": self.margin_J,
                "margin_later_J": self.later_J,
            },
            **sides,
            "energy": {
                direction: {"sent_nJ": 0, "credited_nJ": beyond[role] if beyond[role] >= _ROUNDING_nJ else 0}
                for direction, role in zip(("up", "down"), SIDES, strict=True)
            },
            "coupling": coupling,
        }
