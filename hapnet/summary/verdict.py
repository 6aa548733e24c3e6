"""Was a run passive? The rules by which its summary is judged, and whether a coupling kept what is claimed of it.

`judge` reads nothing but a summary. What an older one does not have counts as unknown, and says nothing for or against.

Not passive: more energy came out of both ports than d^2 (of one port, where only that is known); a half of Theorem 1
below zero; energy credited that was never sent. Not known: what could be judged was kept, but part of the account is
missing (a side, the end of a torn recording, what a process before a restart did, one clock for both ports), or
something happened that it does not cover (a deficit, a servo that was away, a speed above the declared one, a force
that was stopped as the device could not be right, encoders that blur more than the margin, an energy stream that nobody
answers).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

from hapnet.couplings import registry
from hapnet.couplings.registry import jointly_passive
from hapnet.params import Params

ROUNDING_J = 1e-9
"""An energy is called negative below minus this [J]: what minutes of double precision may add up to."""

DEFICIT_J = 1e-12
"""A deficit up to this is rounding [J]."""

UNANSWERED_S = 5.0
"""An energy stream is dead if for longer nothing of it was acknowledged, though positions came [s]."""

START_S = 1.0
"""The least margin is told from then on too [s]: at the start it is d^2, whatever comes later."""

SIDES = ("device", "world")
_WAYS = (("up", "device", "world"), ("down", "world", "device"))  # of the energy, from and to

Verdict = dict[str, Any]
"""``passive``: True, False or None, not known; ``reason``: why, in words."""


def judge(summary: Mapping[str, Any] | None) -> Verdict:
    """The verdict on the run that `summary` is of, of both sides or of one."""
    if against := list(_against(summary)):
        return {"passive": False, "reason": "; ".join(against)}
    if doubts := list(_doubts(summary)):
        return {"passive": None, "reason": "; ".join(doubts)}
    said = [_kept(summary)]
    if get(summary, "device", "force") == "commanded":
        said.append("as commanded: the device does not tell what it applied")
    return {"passive": True, "reason": "; ".join(said)}


def broken(summary: Mapping[str, Any] | None, params: Params | None = None, *, virtual: bool = False) -> bool:
    """Did a coupling that claims to be passive here not keep it? That is an exit code of its own.

    params : of the run; None: not known, then a claim counts that needs no more than the link to be any. virtual : in
    virtual time, so that the link is the emulated one and nothing else.
    """
    if judge(summary)["passive"] is not False:
        return False
    spec = registry.known(get(summary, "coupling"))
    tuning = None if spec is None else spec.recorded(get(summary, "tuning"))
    if spec is None or tuning is None or not spec.covers(params or Params(), tuning, virtual):
        return False
    margin = known(get(summary, "theorem", "margin_J"))
    diverged = get(summary, "theorem", "diverged") is True
    return spec.halves or diverged or (margin is not None and margin < -spec.allowance_J(tuning) - ROUNDING_J)


def get(tree: Any, *keys: str) -> Any:
    """`tree[key][key]...`, or None where the branch ends early."""
    for key in keys:
        tree = tree.get(key) if isinstance(tree, Mapping) else None
    return tree


def known(value: Any) -> float | None:
    """`value` if it is a finite number."""
    if isinstance(value, bool) or not isinstance(value, int | float) or (isinstance(value, int) and abs(value) > 2**63):
        return None
    return value if math.isfinite(value) else None


def excess_nJ(energy: Any) -> int:
    """What was credited one way beyond what was sent [nJ]; `energy` : that way's entry of the summary."""
    sent, credited, abandoned = (known(get(energy, f"{name}_nJ")) for name in ("sent", "credited", "abandoned"))
    beyond = 0 if sent is None or credited is None else credited - sent
    return int(max(beyond, 0 if abandoned is None else -abandoned, 0))


def stopped(summary: Any) -> str | None:
    """One line, if the device's force was stopped on the way; None if not."""
    after_s, why = (get(summary, "device", "stopped", part) for part in ("after_s", "why"))
    return None if why is None else f"the device's force was stopped after {after_s} s: {why}"


def restarted(summary: Any) -> bool:
    """Has a side had more than one peer?"""
    return any((known(get(summary, side, "incarnations")) or 0) > 1 for side in SIDES)


def _torn(summary: Any) -> list[str]:
    """The sides of which only samples are known."""
    torn = get(summary, "torn")
    return [side for side in SIDES if isinstance(torn, list | tuple) and side in torn]


def has_reservoirs(coupling: Any) -> bool:
    """Does it shuffle energy between reservoirs, so that each side has a half of Theorem 1 to keep?

    Not the couplings that are known to do without.
    """
    spec = registry.known(coupling)
    return ":" not in str(coupling) if spec is None else spec.halves


def _margin(summary: Any) -> float | None:
    """Of both ports [J]; where nobody summed their halves up, their sum, if that says something."""
    margin = known(get(summary, "theorem", "margin_J"))
    halves = [known(get(summary, side, "ledger", "margin_J")) for side in SIDES]
    told = isinstance(get(summary, "theorem"), Mapping) and "margin_J" in summary["theorem"]
    if margin is not None or told or None in halves or jointly_passive(get(summary, "coupling")):
        return margin
    return sum(half for half in halves if half is not None)


def _against(summary: Any) -> Iterator[str]:
    """Why it was not passive."""
    margin, bound = _margin(summary), known(get(summary, "theorem", "bound_J"))
    halves = has_reservoirs(get(summary, "coupling"))
    if get(summary, "theorem", "diverged") is True:
        yield "it diverged: the energy account is no finite number any more"
    if margin is not None and margin < -ROUNDING_J:
        yield (
            f"margin {_milli(margin)} mJ"
            if bound is None
            else f"{_milli(bound - margin)} mJ came out of both ports, of d² = {_milli(bound)} mJ: "
            f"margin {_milli(margin)} mJ"
        )
    for side in SIDES:
        own = known(get(summary, side, "ledger", "margin_J"))
        alone = margin is None and not jointly_passive(get(summary, "coupling"))
        if own is not None and own < -ROUNDING_J and (alone or halves):
            yield f"the {side}'s half: margin {_milli(own)} mJ"
    if halves:
        yield from _halves(summary)
    yield from _true_ports(summary, bound)
    torn = _torn(summary)
    for way, sender, receiver in _WAYS:
        beyond = excess_nJ(get(summary, "energy", way))
        if beyond and not restarted(summary) and sender not in torn:
            yield f"the {receiver} credited {_milli(beyond * 1e-9)} mJ that the {sender} never sent"


def _halves(summary: Any) -> Iterator[str]:
    """Sides whose half of Theorem 1 was not kept: by their own account or, in a simulation, with the true positions."""
    for side in SIDES:
        slack = known(get(summary, side, "ledger", "slack_J"))
        true = known(get(summary, side, "true_slack_J"))
        blur = known(get(summary, side, "quantisation_J")) or 0.0
        if slack is not None and slack < -ROUNDING_J:
            yield f"the {side}'s half of the theorem fails by {_milli(-slack)} mJ"
        elif true is not None and true < -ROUNDING_J - blur:
            yield f"with the true positions the {side}'s half of the theorem fails by {_milli(-true)} mJ"


def _true_ports(summary: Any, bound: float | None) -> Iterator[str]:
    """Of a simulated device its hand's port is known too, whatever the device says of its actuator."""
    least = known(get(summary, "hand", "margin_J"))
    works = [known(get(summary, port, "work_J")) for port in ("hand", "environment")]
    if least is None and bound is not None and works[0] is not None and works[1] is not None:
        least = None if restarted(summary) else bound + works[0] + works[1]
    if least is not None and least < -ROUNDING_J:
        yield f"at the hand and the walls: margin {_milli(least)} mJ"


def _doubts(summary: Any) -> Iterator[str]:
    """What keeps it from being known whether it was passive."""
    accounts = {side: known(get(summary, side, "ledger", "margin_J")) for side in SIDES}
    margin = _margin(summary)
    yield from (f"the {side}'s recording is torn: the rest of its account is missing" for side in _torn(summary))
    if margin is None:
        yield from _missing(summary, [side for side, value in accounts.items() if value is not None])
    device = get(summary, "device")
    for side in SIDES:
        deficit = known(get(summary, side, "deficit_max_J"))
        if deficit is not None and deficit > DEFICIT_J:
            yield f"the {side} gave out {_milli(deficit)} mJ that its reservoir did not have"
        silent_s = known(get(summary, side, "unanswered_s"))
        if silent_s is not None and silent_s > UNANSWERED_S:
            yield f"the {side}'s energy stream is dead: nothing of it was acknowledged for {silent_s:.1f} s"
    if (line := stopped(summary)) is not None:
        yield line
    leak = known(get(device, "overrun_leak_J"))
    if leak is not None and leak > 0.0:
        yield f"while the servo was away for longer than watchdog_s, {_milli(leak)} mJ came out beyond the reserve"
    risk = known(get(device, "overrun_risk_J"))
    if margin is not None and risk is not None and risk > max(margin, ROUNDING_J):
        yield f"while the servo was away, {_milli(risk)} mJ may have come out unseen, more than the margin"
    speed, limit = known(get(device, "speed_max_mps")), known(get(device, "speed_limit_mps"))
    if speed is not None and limit is not None and speed > limit:
        yield f"the device moved at {speed:.3g} m/s, and declares at most {limit:.3g} m/s"
    true, blur = known(get(device, "true_slack_J")), known(get(device, "quantisation_J"))
    if blur is not None and true is not None:
        blur = max(0.0, -true)  # a simulation knows what the encoders really hid
    if margin is not None and blur is not None and blur > max(margin, ROUNDING_J):
        yield f"the encoders blur the account by up to {_milli(blur)} mJ, more than the margin of {_milli(margin)} mJ"


def _missing(summary: Any, accounts: list[str]) -> Iterator[str]:
    """Why both ports together have no margin, though `accounts` are there."""
    if not accounts:
        yield "there is no energy account"
    elif restarted(summary):
        yield "a side was started anew: what went in and out at the one before is not known"
    elif len(accounts) == 1:
        other = SIDES[1 - SIDES.index(accounts[0])]
        if jointly_passive(get(summary, "coupling")):
            yield f"of both ports together only, and the {other}'s account is not here"
        else:
            yield f"the {other}'s account is not here; the {accounts[0]}'s half held{_of_half(summary, accounts[0])}"
    elif jointly_passive(get(summary, "coupling")):
        yield "of both ports together only, and both were not seen at the same time"
    elif not _torn(summary):
        yield "the accounts of both sides do not fit each other"


def _of_half(summary: Any, side: str) -> str:
    margin, bound = (known(get(summary, side, "ledger", name)) for name in ("margin_J", "bound_J"))
    if margin is None or bound is None:
        return ""
    return f", at most {_milli(max(0.0, bound - margin))} of its {_milli(bound)} mJ ever came out"


def _kept(summary: Any) -> str:
    """How far it was from not being passive."""
    names = ("bound_J", "energy_out_J", "margin_end_J", "margin_later_J")
    bound, out, end, later = (known(get(summary, "theorem", name)) for name in names)
    margin = _margin(summary)
    if out is None and margin is not None and bound is not None:
        out = max(0.0, bound - margin)
    of = "" if bound is None else f" of d² = {_milli(bound)}"
    said = f"margin at least {_milli(margin)} mJ" if out is None else f"at most {_milli(out)}{of} mJ ever came out"
    if end is None:
        return said
    after = "" if later is None else f", at least {_milli(later)} after {START_S:g} s"
    return f"{said}; margin {_milli(end)} mJ at the end{after}"


def _milli(energy_J: float | None) -> str:
    """In mJ, four digits; what is pure rounding is 0."""
    if energy_J is None or abs(energy_J) < DEFICIT_J:
        return "0"
    value = energy_J * 1e3
    return f"{value:.0f}" if 1e4 <= abs(value) < 1e12 else f"{value:.4g}"
