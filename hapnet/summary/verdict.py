"""The verdict on a run: the rules that decide from its summary whether it was passive, and whether a coupling kept its
claim of passivity.

`judge` reads only a summary. A value that an older summary lacks is unknown and counts neither for nor against.

Not passive: more energy than d^2 came out of both ports (of one port, if only that is known), a half of Theorem 1 is
below zero, or energy was credited that was never sent. Not known: everything that could be judged was passive, but part
of the account is missing (a side, the end of a torn recording, the process before a restart, one clock for both ports),
or something happened that the account does not cover (energy that was credited before it was sent, or messages that a
third party sent in a side's name; a deficit, a servo that stalled, a speed above the declared speed, a force that was
stopped because a reading was impossible, encoders too coarse for the margin, an energy stream without
acknowledgements), or the world's own account is not finite.

If a force was held too long because the servo stalled, the servo and not the coupling gave out that energy: it breaks
no claim. The port of a simulated device is known during a stall, so there only the margins count.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from hapnet.couplings import registry
from hapnet.couplings.registry import jointly_passive
from hapnet.couplings.spec import CouplingSpec
from hapnet.params import Params
from hapnet.summary import causes
from hapnet.summary.causes import CONTRADICTED, INCOMPLETE, Finding, found
from hapnet.summary.former import restarted, several, vanished
from hapnet.summary.servos import (
    DEFICIT_J as DEFICIT_J,
    WHOSE as _WHOSE,
    leak as _leak,
    milli as _milli,
    milli_above as _milli_above,
    milli_up as _milli_up,
    parts as _parts,
    rates as _rates,
    stalls as _stalls,
)
from hapnet.summary.structure import SIDES, Direction, Flow, SidePart, Summary, VerdictSummary, read
from hapnet.wire.messages import Role

ROUNDING_J = 1e-9
"""An energy below minus this is negative [J]; rounding may add up to this much in minutes."""

UNANSWERED_S = 5.0
"""An energy stream is dead if nothing was acknowledged for longer, although positions arrived [s]."""

_FLOWS: tuple[tuple[Direction, Role, Role], ...] = (("up", "device", "world"), ("down", "world", "device"))  # from, to
_WHO: Mapping[Role, str] = {
    "device": "device",
    "world": "follower",
}  # a world has a servo where a robot is in its place


class Verdict(NamedTuple):
    """A verdict in parts.

    passive : None: not known. because : for a passive run the energy that it gave out, otherwise each cause found.
    notes : facts that the account rests on. warnings : faults that do not change the verdict.
    """

    passive: bool | None
    because: tuple[str, ...]
    notes: tuple[str, ...]
    warnings: tuple[str, ...]


def judge(tree: object) -> VerdictSummary:
    """The verdict on the run with the summary `tree`, of both sides or of one; see `structure.read`."""
    found = in_parts(tree)
    reasons = dict.fromkeys([*found.because, *found.notes, *found.warnings])
    return {"passive": found.passive, "reason": "; ".join(reasons)}


def in_parts(tree: object) -> Verdict:
    """The verdict as `judge` makes it, in parts."""
    summary = _with_margin(read(tree), tree)
    notes = [*_energy_sources(summary), *_claimed(summary)]
    warnings = [*_stalls(summary), *_rates(summary), *_ended_early(summary)]
    warnings += (one.text for one in _side_findings(summary))
    for passive, findings in ((False, list(_against(summary))), (None, list(_doubts(summary)))):
        if findings:
            return Verdict(passive, tuple(one.text for one in findings), tuple(notes), tuple(warnings))
    notes += (
        f"as commanded: the {_WHO[side]} does not report the applied force"
        for side, part in _parts(summary)
        if part["force"] == "commanded"
    )
    return Verdict(True, (_gave_out(summary),), tuple(notes), tuple(warnings))


def broken(
    tree: object, params: Params | None = None, *, virtual: bool = False, spec: CouplingSpec[Any] | None = None
) -> bool:
    """Whether a coupling that claims to be passive here was not passive. Then the exit code is 4.

    params : of the run. None: unknown; then only a claim that holds on any link counts. virtual : the run was in
    virtual time, so the emulated link is the only one. spec : of the coupling; None: of hapnet's coupling of that name,
    so the claim of a user's own law is unknown.
    """
    if judge(tree)["passive"] is not False:
        return False
    summary = read(tree)
    spec, margin = spec or registry.known(summary["coupling"]), summary["theorem"]["margin_J"]
    tuning = None if spec is None else spec.recorded(summary["tuning"])
    if spec is None or tuning is None or not spec.covers(params or Params(), tuning, virtual):
        return False
    below = margin is not None and margin < -spec.allowance_J(tuning) - ROUNDING_J
    by_law = spec.halves or summary["theorem"]["diverged"] is True or below
    return by_law and any(_against(_without_overruns(summary)))


def overloaded(tree: object) -> str | None:
    """One line if a run was not passive only because forces were held while the servo stalled."""
    summary = read(tree)
    if _leak(summary) and any(_against(summary)) and not any(_against(_without_overruns(summary))):
        return f"not passive, because of the servo and not of the coupling: {'; '.join(_stalls(summary))}"
    return None


def _without_overruns(summary: Summary) -> Summary:
    """Change `summary` as if forces had given out no energy beyond the account while the servo stalled."""
    leak, hand = _leak(summary), summary["hand"]
    ledgers = [(part["ledger"], _leak(summary, side)) for side, part in _parts(summary)]
    for part, more in ((summary["theorem"], leak), (hand, leak), *ledgers):
        if part["margin_J"] is not None:
            part["margin_J"] += more
    if hand["work_J"] is not None:
        hand["work_J"] += leak
    return summary


def excess_nJ(energy: Flow) -> int:
    """The energy credited beyond the energy sent in one direction [nJ]."""
    sent, credited, abandoned = energy["sent_nJ"], energy["credited_nJ"], energy["abandoned_nJ"]
    beyond = 0 if sent is None or credited is None else credited - sent
    return int(max(beyond, 0 if abandoned is None else -abandoned, 0))


def findings(tree: object) -> list[Finding]:
    """All findings against a run, or that leave it in doubt, including those that its reason leaves out."""
    summary = _with_margin(read(tree), tree)
    return [*_against(summary), *_doubts(summary), *_side_findings(summary)]


def incomplete(tree: object) -> list[str]:
    """A line for each missing part of a run's account, and for a stopped force, even if stopped on request."""
    lines = [one.text for one in findings(tree) if one.code == INCOMPLETE]
    return list(dict.fromkeys([*lines, *(one.text for one in _stops(read(tree)))]))


def _stops(summary: Summary) -> Iterator[Finding]:
    for side, part in _parts(summary):
        if (stop := part["stopped"]) is not None and stop["why"] is not None:
            yield found("stopped", side=_WHO[side], seconds=stop["after_s"], why=stop["why"])


def _was_asked(summary: Summary) -> bool:
    return {stop["asked"] for _, part in _parts(summary) if (stop := part["stopped"]) is not None} == {True}


def has_reservoirs(coupling: object) -> bool:
    """Whether a coupling shuffles energy between reservoirs, so that each side must keep its half of Theorem 1.

    An unknown coupling counts as one, unless it is a user's own.
    """
    spec = registry.known(coupling)
    return ":" not in str(coupling) if spec is None else spec.halves


def _with_margin(summary: Summary, tree: object) -> Summary:
    """Add the margin of both ports as the sum of their halves, if an older version did not write it."""
    theorem = tree.get("theorem") if isinstance(tree, Mapping) else None
    if isinstance(theorem, Mapping) and "margin_J" in theorem:
        return summary
    halves = [_half(summary, side) for side in SIDES]
    if None not in halves and not jointly_passive(summary["coupling"]):
        summary["theorem"]["margin_J"] = sum(half for half in halves if half is not None)
    return summary


def _half(summary: Summary, side: Role) -> float | None:
    """The margin of one side alone [J]."""
    return None if (part := summary[side]) is None else part["ledger"]["margin_J"]


def _torn(summary: Summary) -> list[Role]:
    """The sides of which only samples are known."""
    return [side for side in SIDES if side in summary["torn"]]


def _against(summary: Summary) -> Iterator[Finding]:
    """Yield the reasons why the run was not passive."""
    margin, bound = summary["theorem"]["margin_J"], summary["theorem"]["bound_J"]
    halves, jointly = has_reservoirs(summary["coupling"]), jointly_passive(summary["coupling"])
    if summary["theorem"]["diverged"] is True:
        yield found("diverged")
    if margin is not None and margin < -ROUNDING_J:
        if bound is None:
            yield found("margin", margin=_milli(margin))
        else:
            yield found("bound", out=_milli_above(bound - margin, bound), bound=_milli(bound))
    for side in SIDES:
        own = _half(summary, side)
        alone = margin is None and not jointly
        if own is not None and own < -ROUNDING_J and (alone or halves):
            yield found("half", side=side, margin=_milli(own))
    if halves:
        yield from _halves(summary)
    yield from _true_ports(summary, bound)
    torn = _torn(summary)
    for direction, sender, receiver in _FLOWS:
        flow = summary["energy"][direction]
        beyond, certain = excess_nJ(flow), flow["abandoned_nJ"] is not None and flow["abandoned_nJ"] < 0
        report = summary["peer_report"]
        if report is not None and report["side"] == sender and not report["final"]:
            continue  # it may have sent more since
        if beyond and sender not in torn and (certain or not vanished(summary["device"], summary["world"])):
            yield found("never sent", side=receiver, energy=_milli(beyond * 1e-9), other=sender)


def _halves(summary: Summary) -> Iterator[Finding]:
    """Yield the sides that broke their half of Theorem 1, by their account or, in simulations, the true positions."""
    for side, part in _parts(summary):
        slack, true, blur = part["ledger"]["slack_J"], part["true_slack_J"], part["quantisation_J"] or 0.0
        if slack is not None and slack < -ROUNDING_J:
            yield found("slack", side=side, energy=_milli(-slack))
        elif true is not None and true < -ROUNDING_J - blur:
            yield found("true positions", side=side, energy=_milli(-true))
        if (before := part["former"]["slack_J"]) is not None and before < -ROUNDING_J:
            yield found("slack", side=SIDES[1 - SIDES.index(side)], energy=_milli(-before))


def _true_ports(summary: Summary, bound: float | None) -> Iterator[Finding]:
    """Yield a violation at the port of a simulated hand, which is known independently of the actuator's port."""
    hand, by_world = summary["hand"], summary["environment"]["work_J"]
    minimum, by_hand = hand["margin_J"], hand["work_J"]
    if minimum is None and bound is not None and by_hand is not None and by_world is not None:
        minimum = None if several(summary["device"], summary["world"]) else bound + by_hand + by_world
    if minimum is not None and minimum < -ROUNDING_J:
        yield found("hand", margin=_milli(minimum))


def _energy_sources(summary: Summary) -> Iterator[str]:
    """Yield the sources of energy: the coupling beyond d^2, the world beyond its own, the world's motors, the hand.

    An active world or hand does not count against the coupling: passivity is a property of the two ports between them.
    There is no line if the world's own account is not known.
    """
    margin, world = summary["theorem"]["margin_J"], summary["environment"]
    slack, supplied, given = world["env_slack_J"], world["env_supplied_J"], world["env_given_J"]
    if slack is None:
        return
    beyond = None if margin is None else max(0.0, -margin)
    by_servo = min(beyond or 0.0, _leak(summary))
    sources = {
        "the servo": by_servo,
        "the coupling": None if beyond is None else beyond - by_servo,
        "the world itself": -slack,
        "the motors of the world": supplied,
        "the hand": summary["hand"]["work_J"],
    }
    named = [f"{name} ({_milli(of)} mJ)" for name, of in sources.items() if of is not None and of > ROUNDING_J]
    if named:
        yield f"energy came from {', '.join(named)}"
    if given is not None and given > ROUNDING_J:
        paid = _milli(world["env_paid_J"])
        yield f"the world would have given {_milli(given)} mJ of its own, of which damping took back {paid}"


def _claimed(summary: Summary) -> Iterator[str]:
    """Yield which side's account is only the claim of a process on another host."""
    if (report := summary["peer_report"]) is not None:
        for side in SIDES:
            if side == report["side"] and _half(summary, side) is not None:
                yield f"the {side}'s account as it reported it"


def _missing_since(summary: Summary) -> Iterator[Finding]:
    """Yield the time from which on the account of a process on another host is missing."""
    if (report := summary["peer_report"]) is not None and not report["whole"]:
        when = "" if report["as_of_s"] is None else f", {report['as_of_s']:.1f} s after pairing"
        yield found("peer lost", side=report["side"], when=when)


def _ended_early(summary: Summary) -> Iterator[str]:
    """Yield the sides that ended early, with the reasons."""
    whys = {side: why for side, part in _parts(summary) if (why := part["failed"])}
    if len(whys) == 2 and len({*whys.values()}) == 1:
        yield f"both sides ended before their time: {whys['device']}"
    else:
        yield from (f"the {side} ended before its time: {why}" for side, why in whys.items())


def _doubts(summary: Summary) -> Iterator[Finding]:
    """Yield the reasons why it is not known whether the run was passive."""
    margin = summary["theorem"]["margin_J"]
    yield from (found("torn", side=side) for side in _torn(summary))
    yield from _missing_since(summary)
    if margin is None:
        yield from _missing(summary, [side for side in SIDES if _half(summary, side) is not None])
    for direction, sender, receiver in _FLOWS:
        early = summary["energy"][direction]["early_J"]
        if early is not None and early > ROUNDING_J and not several(summary["device"], summary["world"]):
            yield found("early", side=receiver, energy=_milli(early), other=sender)
    for side, part in _parts(summary):
        deficit, silent_s = part["deficit_max_J"], part["unanswered_s"]
        yield from causes.former(side, part)
        yield from causes.contradictions(side, part)
        if deficit is not None and deficit > DEFICIT_J + (_leak(summary, side) if _known_port(part) else 0.0):
            yield found("deficit", side=side, energy=_milli(deficit))
        if silent_s is not None and silent_s > UNANSWERED_S:
            yield found("dead stream", side=side, seconds=f"{silent_s:.1f}")
    if not _was_asked(summary):
        yield from _stops(summary)
    if any(_leak(summary, side) and not _known_port(part) for side, part in _parts(summary)):
        yield from (found("leak", stalls=line) for line in _stalls(summary))
    for side, part in _parts(summary):
        yield from _doubts_of_servo(side, part, summary)
    world, slack = summary["world"], summary["environment"]["env_slack_J"]
    if world is not None and world["failed"] is not None and slack is None and "world" not in summary["torn"]:
        yield found("world failed", why=world["failed"])
    if summary["environment"]["env_diverged"] is True:
        yield found("world's account")


def _side_findings(summary: Summary) -> Iterator[Finding]:
    """Yield the findings that appear with any verdict and do not change it."""
    for side, part in _parts(summary):
        driver = part["driver"]
        if driver is not None and driver["blocked"] is not None:
            yield found("blocked", side=_WHO[side], what=driver["blocked"])
    yield from causes.unproved(summary)


def contradicted(tree: object) -> bool:
    """Whether a third party sent messages in a side's name. Then the exit code is 5, unless a claim was broken."""
    return any(one.code == CONTRADICTED for one in findings(tree))


def _doubts_of_servo(side: Role, device: SidePart, summary: Summary) -> Iterator[Finding]:
    """Yield doubts about a servo and its encoders."""
    margin, risk, whose = summary["theorem"]["margin_J"], device["overrun_risk_J"], _WHOSE[side]
    if margin is not None and risk is not None and risk > max(margin, ROUNDING_J):
        yield found("risk", whose=whose, energy=_milli(risk))
    speed, limit = device["speed_max_mps"], device["speed_limit_mps"]
    if speed is not None and limit is not None and speed > limit:
        values = {"side": _WHO[side], "speed": f"{speed:.3g}", "limit": f"{limit:.3g}"}
        reads_hz = None if device["driver"] is None else device["driver"]["reads_hz"]
        if reads_hz:
            yield found("repeats", reads=f"{reads_hz:.0f}", every=f"{1e3 / reads_hz:.2g}", **values)
        else:
            yield found("speed", **values)
    true, blur = device["true_slack_J"], device["quantisation_J"]
    if blur is not None and true is not None and has_reservoirs(summary["coupling"]):
        blur = min(blur, max(0.0, -true))  # in a simulation the true effect of the encoders is known
    if margin is not None and blur is not None and blur > max(margin, ROUNDING_J):
        yield found("blur", whose=whose, energy=_milli(blur), margin=_milli(margin))


def _known_port(side: SidePart) -> bool:
    """Whether the work of the device's force is known at all times, as it is for a simulated device."""
    return side.get("hand_work_J") is not None


def _missing(summary: Summary, accounts: list[Role]) -> Iterator[Finding]:
    """Yield the reasons why both ports together have no margin, although `accounts` exist."""
    jointly = jointly_passive(summary["coupling"])
    device = summary["device"]
    driver = None if device is None or "device" in accounts else device["driver"]
    if driver is not None and driver["missed"]:
        yield found("no reading", side="device", name=driver["name"])
    elif not accounts:
        yield found("accounts")
    elif restarted(summary["device"], summary["world"]):
        yield from (
            found("restart", side=SIDES[1 - SIDES.index(side)]) for side, part in _parts(summary) if restarted(part)
        )
    elif len(accounts) == 1:
        other = SIDES[1 - SIDES.index(accounts[0])]
        if jointly:
            yield found("joint account", side=other)
        else:
            half = f"; the {accounts[0]}'s half held{_of_half(summary[accounts[0]])}"
            yield found("account", side=other, rest=half)
    elif jointly:
        yield found("not at once")
    elif not _torn(summary):
        yield found("no fit")


def _of_half(side: SidePart | None) -> str:
    if side is None or (margin := side["ledger"]["margin_J"]) is None or (bound := side["ledger"]["bound_J"]) is None:
        return ""
    return f" and gave out at most {_milli_up(max(0.0, bound - margin), bound)} mJ of its {_milli(bound)} mJ"


def _gave_out(summary: Summary) -> str:
    """The most energy that a passive run gave out."""
    margin, bound = summary["theorem"]["margin_J"], summary["theorem"]["bound_J"]
    out = summary["theorem"]["energy_out_J"]
    if out is None and margin is not None and bound is not None:
        out = max(0.0, bound - margin)
    if out is None:
        return f"margin at least {_milli(margin)} mJ"
    if bound is None:
        return f"gave out at most {_milli_up(out, out)} mJ"
    if bound < out <= bound + ROUNDING_J:
        out = bound
    return f"gave out at most {_milli_up(out, bound)} mJ of the {_milli(bound)} mJ allowed"
