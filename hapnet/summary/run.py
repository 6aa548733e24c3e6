"""The summary of a run, for machines: see `hapnet.summary.structure`. Its keys are stable."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, cast

from hapnet.couplings.registry import jointly_passive
from hapnet.couplings.stiffness import Felt, of_springs
from hapnet.installing import versions
from hapnet.recording.samples import Recording, plain
from hapnet.side.device import DeviceSide
from hapnet.side.endpoint import NANO, ControlHalf
from hapnet.side.world import WorldSide
from hapnet.summary import path as paths
from hapnet.summary.former import former_part, restarted, several, vanished, with_former, with_former_margins
from hapnet.summary.from_samples import START_S, credited_early, last_total_margin, min_total_margin, two_port_margin
from hapnet.summary.structure import (
    Contradictions,
    DevicePart,
    DriverPart,
    EnergySummary,
    Environment,
    EnvironmentPart,
    Flow,
    HandSummary,
    LedgerSummary,
    Links,
    MotionFigures,
    PathSummary,
    ServoSummary,
    SidePart as SidePart,
    Stopped,
    Summary as Summary,
    Theorem,
    known,
    unknown,
)
from hapnet.summary.verdict import ROUNDING_J, excess_nJ, has_reservoirs, judge
from hapnet.units import METRES
from hapnet.wire import sums
from hapnet.wire.session import Session


def device_summary(side: DeviceSide, coupling_name: str, servo: Mapping[str, Any] | None = None) -> SidePart:
    """The device's part from its control half. `servo`: the servo's timing in real time."""
    result = _control_summary(side.endpoint, coupling_name)
    result["servo"] = cast(ServoSummary, {**unknown(ServoSummary), "ticks": side.ticks, **(servo or {})})
    result["quantisation_J"] = side.quantisation
    slack = None if jointly_passive(coupling_name) else side.true_slack
    result["true_slack_J"] = None if slack is None else _known(slack)
    result.update(_held(side))
    return result


def _held(side: DeviceSide) -> SidePart:
    result = cast(SidePart, unknown(DevicePart))
    result["hand_work_J"] = side.hand_work if side.simulated else None
    result["stopped"] = _stopped(side)
    result["driver"] = cast(DriverPart | None, side.driver_figures())
    if side.origin_ns is not None:
        result["force"] = "applied" if side.applied else "commanded"
    figures = side.held_forces()
    if "reserve_needed_J" in figures:
        figures["reserve_needed_J"] = _known(figures["reserve_needed_J"])
    return cast(SidePart, {**result, **figures})


def _stopped(side: DeviceSide) -> Stopped | None:
    """The time and reason of the stop of the device's force for good; None: it was not stopped."""
    if side.stopped is None or side.origin_ns is None:
        return None
    at_ns, why, asked = side.stopped
    return {"after_s": round((at_ns - side.origin_ns) * NANO, 3), "why": why, "asked": asked}


def unknown_device() -> SidePart:
    """The device's part if its servo reported nothing: the same keys with value None."""
    part = unknown(SidePart)
    del part["step"], part["environment"], part["failed"]
    return part


def world_summary(side: WorldSide, coupling_name: str) -> SidePart:
    """The world's part from its control half."""
    result = _control_summary(side.endpoint, coupling_name)
    steps = side.stepped
    mean, longest = (steps.all_s / steps.count, steps.longest_s) if steps.count else (None, None)
    result["step"] = {"count": steps.count, "mean_s": mean, "max_s": longest}
    result["environment"] = _own_account(side)
    return cast(SidePart, {**result, **plain(side.held_forces())})


def robot_summary(part: SidePart, side: DeviceSide) -> SidePart:
    """A robot's part in the world's place, from a device's part: a step is a tick, its surroundings are not known."""
    lasted_s = 0.0 if side.origin_ns is None else (side.last_ns - side.origin_ns) * NANO
    mean = lasted_s / side.ticks if side.ticks else None
    part["step"] = {"count": side.ticks, "mean_s": mean, "max_s": side.max_ns * NANO if side.ticks else None}
    part["environment"] = unknown(EnvironmentPart)
    return part


def _own_account(side: WorldSide) -> EnvironmentPart:
    account = side.environment
    if account is None or not side.steps:
        return unknown(EnvironmentPart)
    observed = account.observed
    return {
        "env_slack_J": _known(account.slack_min),
        "env_supplied_J": _known(account.supplied_J),
        "env_stored_J": _known(account.stored_J),
        "env_given_J": None if observed is None else _known(observed.given_J),
        "env_paid_J": None if observed is None else _known(observed.paid_J),
        "env_undone": None if observed is None else observed.undone,
        "env_undone_J": None if observed is None else _known(observed.undone_J),
        "env_overlaps": None if observed is None else observed.overlaps,
        "env_diverged": not all(map(math.isfinite, (account.slack_min, account.supplied_J, account.stored_J))),
    }


def has_account(part: SidePart | None) -> bool:
    """Whether a side's part has the account of its half."""
    return part is not None and part["ledger"]["margin_J"] is not None


def with_wire(control: SidePart, session: Session, now_ns: int) -> SidePart:
    """The whole part of a side at `now_ns`, from its control half and its wire half."""
    outages = session.outages(now_ns)
    return {
        **control,
        "sent_nJ": session.sent_nJ,
        "credited_nJ": session.credited_nJ,
        "acked_nJ": session.acked_nJ,
        "unanswered_s": session.unanswered_ns * NANO,
        "in_flight_nJ": session.in_flight_nJ,
        "abandoned_nJ": session.abandoned_nJ,
        "incarnations": session.incarnations,
        "peers_J": session.peers_J,
        "former": former_part(session.accounts.former),
        "outages": {
            "count": outages.count,
            "longest_s": outages.max_ns * NANO,
            "total_s": outages.total_ns * NANO,
            "recovery_max_s": outages.recovery_max_ns * NANO,
        },
        "received": outages.received,
        "missing": outages.missing,
        "dropped": dict(session.dropped),
        "contradictions": cast(Contradictions, {kind: session.sums.contradictions[kind] for kind in sums.KINDS}),
        "peer": {
            "proof": session.proof if session.incarnations else None,
            "fingerprint": session.fingerprint or None,
        },
    }


def combine(
    device: SidePart | None,
    world: SidePart | None,
    links: Mapping[str, Mapping[str, Any] | None],
    *,
    seed: int | None,
    duration_s: float | None,
    coupling: str | None,
    units: str = METRES,
    two_port_J: float | None = None,
    two_port_end_J: float | None = None,
    two_port_later_J: float | None = None,
    hand_two_port_J: float | None = None,
    total_margin_J: float | None = None,
    total_end_J: float | None = None,
    total_later_J: float | None = None,
    two_port_recorded_J: float | None = None,
    early_J: tuple[float | None, float | None] = (None, None),
    tuning: Mapping[str, float] | None = None,
    felt: Mapping[str, Any] | None = None,
    torn: Sequence[str] = (),
    path: PathSummary | None = None,
) -> Summary:
    """One summary of both sides. `tuning`: derived from the link by the coupling's rule. `felt`: of walls, see
    stiffness.py. `path`: see path.py.

    `two_port_J` is the minimum over time of the energy put in at both ports, where one clock saw both;
    `two_port_end_J` its value at the end, `two_port_later_J` its minimum from `START_S` on, `hand_two_port_J` its
    minimum with the simulated hand's port in place of the actuator's. Without one clock the theorem's margin is the sum
    of both sides' margins, a lower bound of the true margin. It is None with one side only, after a restart (the energy
    that the ended process put in is not known here), and if energy was credited that was never sent. Its value at the
    end and its minimum from `START_S` on are the sums of both accounts' values. `torn` names the sides of which
    only samples are known.

    `early_J` is the most that was credited up and down before it was sent, as recorded on one clock. Then the sum of
    the halves bounds nothing, and `two_port_recorded_J`, the smallest recorded margin of both ports, counts.

    `units` : of the axes, as `hapnet.units` has them.

    If a coupling is passive only jointly, both sides' minimum margins belong to different times, and their sum bounds
    nothing. Then `total_margin_J` counts: the smallest sum of both margins while both were recorded on one clock, at
    the samples' rate, with the start, where it is d^2; `total_end_J` is that sum at the end, `total_later_J` its
    minimum from `START_S` on. Without them these values are None.

    d^2 sums the initial energies of all processes that took part, and the margin their margins (`FormerPart`).
    """
    sides = [side for side in (device, world) if side is not None]
    margins = [side["ledger"]["margin_J"] for side in sides]
    bound = _bound(device, world)
    energy: EnergySummary = {"up": _flow(device, world, early_J[0]), "down": _flow(world, device, early_J[1])}
    flows = energy["up"], energy["down"]
    again = restarted(device, world) or (several(device, world) and jointly_passive(coupling))
    beyond = any(map(excess_nJ, flows)) and not vanished(device, world)
    margin = end = later = None
    if bound is not None and two_port_J is not None:
        margin = bound + two_port_J
        end, later = (None if at is None else bound + at for at in (two_port_end_J, two_port_later_J))
    elif len(sides) == 2 and None not in margins and not again and not beyond:
        margin, end, later = (_sum(sides, name) for name in ("margin_J", "margin_end_J", "margin_later_J"))
        if several(device, world):
            margin, end, later = with_former_margins(margin, sides), None, None
        if jointly_passive(coupling):
            candidates = [value for value in (total_margin_J, bound) if value is not None]
            margin = None if total_margin_J is None else min(candidates)
            end, later = total_end_J, total_later_J
        if any(early is not None and early > ROUNDING_J for early in early_J):
            margin = None if two_port_recorded_J is None else min(margin or 0.0, two_port_recorded_J)
    theorem = {
        "margin_J": margin,
        "bound_J": bound,
        "energy_out_J": None if margin is None or bound is None else max(0.0, bound - margin),
        "margin_end_J": end,
        "margin_later_J": later,
    }
    diverged = not all(value is None or math.isfinite(value) for value in theorem.values())
    diverged = diverged or any(side["ledger"].get("diverged") for side in sides)
    hand_margin = None if bound is None or hand_two_port_J is None else bound + hand_two_port_J
    hand = {"work_J": None if device is None else device.get("hand_work_J"), "margin_J": hand_margin}
    return judged(cast(Summary, {
        "theorem": cast(Theorem, {**plain(theorem), "diverged": diverged}),
        "hand": cast(HandSummary, plain(hand)),
        "environment": _environment(world, felt),
        "device": device,
        "world": world,
        "energy": energy,
        "path": unknown(PathSummary) if path is None else path.copy(),
        "links": cast(Links, dict(links)),
        "motion": unknown(MotionFigures),
        "seed": seed,
        "duration_s": duration_s,
        "units": units,
        "coupling": coupling,
        "tuning": dict(tuning or {}),
        "torn": list(torn),
        "peer_report": None,
        "versions": versions(),
        "wall_clock": {},
    }))  # fmt: skip


def _sum(sides: Sequence[SidePart], name: str) -> float | None:
    """The sum of this value over the sides' ledgers [J]; None if one does not have it."""
    values = [side["ledger"].get(name) for side in sides]
    return None if None in values else sum(cast("list[float]", values))


def judged(summary: Summary) -> Summary:
    """Return `summary` with its verdict. Call it again after a change that the verdict depends on."""
    rest = {name: value for name, value in summary.items() if name != "verdict"}
    return cast(Summary, {"verdict": judge(summary), **rest})


def _environment(world: SidePart | None, felt: Mapping[str, Any] | None) -> Environment:
    """The environment's port: the energy that it put in, the minimum slack of its half of the theorem, its account [J].

    A summary of an older version has neither the account nor the felt stiffness.
    """
    ledger = unknown(LedgerSummary) if world is None else world["ledger"]
    own = unknown(EnvironmentPart) | ({} if world is None else world.get("environment") or {})
    port = {"work_J": ledger.get("work_J"), "slack_J": ledger.get("slack_J")}
    return cast(Environment, {**port, **own, **_felt(felt, felt)})


def _bound(device: SidePart | None, world: SidePart | None) -> float | None:
    """d^2 over all incarnations: each side's own value, or its peer's, which includes the side's earlier processes."""
    initial = []
    for side, peer in ((device, world), (world, device)):
        own = None if side is None else side["ledger"]["bound_J"]
        by_peer = None if peer is None else peer.get("peers_J")
        known = [energy for energy in (own, by_peer) if energy is not None]
        if not known:
            return None
        initial.append(float(max(known)))
    return sum(initial)


def merge(
    device: Summary,
    world: Summary,
    *,
    seed: int | None = None,
    recording: Recording | None = None,
    margins: Mapping[str, Any] | None = None,
) -> Summary:
    """Combine the device's and the world's summaries. `recording`: of both sides, if there is one.

    margins : of both ports together, as `combine` takes them; None: those of the recording.
    """
    whole = combine(
        device["device"],
        world["world"],
        {"up": device["links"]["up"], "down": world["links"]["down"]},
        seed=device["seed"] if seed is None else seed,
        duration_s=device["duration_s"],
        coupling=device["coupling"] or world["coupling"],
        units=device.get("units") or world.get("units") or METRES,
        tuning=device.get("tuning"),
        felt=_felt(device.get("environment"), world.get("environment")),
        torn=[side for part in (device, world) for side in part.get("torn") or ()],
        **(recorded_margins(recording) if margins is None else margins),
        path=paths.of_both(device.get("path"), world.get("path")),
    )
    whole["wall_clock"] = {"device": device["wall_clock"], "world": world["wall_clock"]}
    moved = [part["motion"] for part in (device, world) if isinstance(part.get("motion"), Mapping)]
    for name in whole["motion"]:  # each side's own figures; tracking errors need both sides' samples
        known_of = [value for one in moved if (value := one.get(name)) is not None]
        whole["motion"][name] = next(iter(known_of), None)  # type: ignore[literal-required]
    return whole


def _felt(device: object, world: object) -> Felt:
    """The felt stiffness from the certain parts of both sides' reports: the device's K, the world's K' and walls."""
    own, far = _springs(device), _springs(world)
    wall = _positive(world.get("stiffness_N_m")) if isinstance(world, Mapping) else None
    limits = [_positive(one.get("local_limit_N_m")) for one in (device, world) if isinstance(one, Mapping)]
    return of_springs(
        [*own[:1], *far[1:]] if own and far else own or far or None, wall, next(filter(None, limits), None)
    )


def _springs(felt: object) -> list[float]:
    springs = felt.get("springs_N_m") if isinstance(felt, Mapping) else None
    return [one for one in map(_positive, springs) if one] if isinstance(springs, list | tuple) else []


def _positive(value: object) -> float | None:
    return number if (number := known(value)) is not None and number > 0.0 else None


def recorded_margins(recording: Recording | None) -> dict[str, Any]:
    """Return the recorded margins of both ports together, as `combine` takes them."""
    if recording is None:
        return {}
    return {
        "total_margin_J": min_total_margin(recording),
        "total_end_J": last_total_margin(recording),
        "total_later_J": min_total_margin(recording, since_s=START_S),
        "two_port_recorded_J": two_port_margin(recording),
        "early_J": credited_early(recording),
    }


def _control_summary(control: ControlHalf, coupling_name: str) -> SidePart:
    ledger = unknown(LedgerSummary)
    minimum = deficit = modulated = None
    discarded = 0.0
    if control.started:
        coupling = control.coupling
        account = coupling.ledger
        slack = None if jointly_passive(coupling_name) else _known(account.slack_min)
        energies = account.margin_min, account.bound, account.margin
        ledger = {
            "margin_J": _known(account.margin_min),
            "slack_J": slack,
            "bound_J": account.bound,
            "work_J": _known(account.work),
            "energy_out_J": _known(max(0.0, account.bound - account.margin_min)),
            "margin_end_J": _known(account.margin),
            "margin_later_J": None,
            "sent_J": _known(account.sent),
            "diverged": not all(map(math.isfinite, energies)),
        }
        discarded = coupling.discarded
        if has_reservoirs(coupling_name):
            minimum, deficit, modulated = coupling.energy_min, coupling.deficit_max, coupling.modulated_share
    return cast(SidePart, {
        "ledger": ledger,
        "reservoir_min_J": minimum,
        "modulated_share": modulated,
        "deficit_max_J": deficit,
        "discarded_nJ": round(discarded * 1e9),
    })  # fmt: skip


def _flow(sender: SidePart | None, receiver: SidePart | None, early_J: float | None) -> Flow:
    """Shuffled energy in one direction [nJ]: sent = credited + in flight + abandoned.

    A sender that ends abandons the energy that is not acknowledged. The receiver counts how much of it was credited.
    """
    credited = None if receiver is None else with_former(receiver["credited_nJ"], sender, "credited_nJ")
    if sender is None:
        return {**unknown(Flow), "credited_nJ": credited, "early_J": early_J}
    sent, abandoned = with_former(sender["sent_nJ"], receiver, "sent_nJ"), sender["abandoned_nJ"]
    in_flight = sender["in_flight_nJ"]
    if sent is not None and credited is not None and abandoned is not None and not several(sender, receiver):
        abandoned = min(abandoned, sent - credited)
        in_flight = sent - credited - abandoned
    return {
        "sent_nJ": sent,
        "credited_nJ": credited,
        "in_flight_nJ": in_flight,
        "abandoned_nJ": abandoned,
        "early_J": early_J,
    }


def _known(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
