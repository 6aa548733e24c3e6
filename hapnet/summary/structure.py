"""The structure of a run's summary: typed dictionaries with the keys of the JSON. An unknown value is None.

Summaries also come from files: of an older version, torn, or edited by hand. `read` turns any value into a summary
that has every key, so no other code has to check.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import cache
from types import NoneType
from typing import (
    Any,
    Literal,
    NotRequired,
    Required,
    TypedDict,
    TypeVar,
    cast,
    get_args,
    get_origin,
    get_type_hints,
    is_typeddict,
)

from hapnet.summary.former import FormerPart
from hapnet.summary.from_samples import MotionFigures as MotionFigures
from hapnet.wire.messages import Role

Direction = Literal["up", "down"]
"""The direction from the device (up), or from the world (down)."""

SIDES: tuple[Role, Role] = ("device", "world")
DIRECTIONS: tuple[Direction, Direction] = ("up", "down")

Number = float | None
Count = int | None
Shape = TypeVar("Shape")


class VerdictSummary(TypedDict):
    """`passive` : None if it is not known. `reason` : the causes, as a sentence."""

    passive: bool | None
    reason: str


class Theorem(TypedDict):
    """Both ports together [J], see Theorem 1. `bound_J` is d^2, `energy_out_J` the most energy that ever came out."""

    margin_J: Number
    bound_J: Number
    energy_out_J: Number
    margin_end_J: Number
    margin_later_J: Number
    diverged: bool | None


class HandSummary(TypedDict):
    """The port of the simulated hand [J]."""

    work_J: Number
    margin_J: Number


class EnvironmentPart(TypedDict):
    """The environment's own account [J], as the world's side keeps it (hapnet/plant/worlds/account.py).

    `env_slack_J` : the minimum of its dissipated energy; below 0 it gave out energy of its own. `env_supplied_J` : put
    in by the motors of its obstacles. `env_stored_J` : in its springs and bodies at the end. `env_given_J`,
    `env_paid_J` : energy given out beyond its own, and energy that damping took back; None: there was no observer.
    `env_undone` : substeps that MuJoCo repeated, `env_undone_J` : energy that bodies lost as they were stopped for it.
    `env_overlaps` : pairs of its bodies that began inside one another.
    `env_diverged` : one of these values was not finite.
    """

    env_slack_J: Number
    env_supplied_J: Number
    env_stored_J: Number
    env_given_J: Number
    env_paid_J: Number
    env_undone: int | None
    env_undone_J: Number
    env_overlaps: int | None
    env_diverged: bool | None


class Environment(EnvironmentPart):
    """The port of the environment [J], and its own account.

    `stiffness_N_m` : of the stiffest wall; `felt_stiffness_N_m` : as a hand feels it through the coupling's springs,
    `springs_N_m` : K and K', or K alone; `local_limit_N_m` : the stiffest wall that the device renders without a
    network (hapnet/couplings/stiffness.py).
    """

    stiffness_N_m: Number
    felt_stiffness_N_m: Number
    springs_N_m: list[float] | None
    local_limit_N_m: Number
    work_J: Number
    slack_J: Number


class LedgerSummary(TypedDict):
    """One side's half of the theorem [J]. `margin_later_J` : the minimum after the first second, at its samples.
    `sent_J` : all energy that it counts as sent to the other side."""

    margin_J: Number
    slack_J: Number
    bound_J: Number
    work_J: Number
    energy_out_J: Number
    margin_end_J: Number
    margin_later_J: Number
    sent_J: Number
    diverged: bool | None


class OutagesSummary(TypedDict):
    """The times in which one side received nothing from the other."""

    count: Count
    longest_s: Number
    total_s: Number
    recovery_max_s: Number


class ServoSummary(TypedDict):
    """Timing of the servo; in virtual time only its ticks.

    `late_...` : of every deadline, skipped ones too, until the first tick after it. `overruns` : ticks that came later
    than the watchdog allows. `without_force_s` : the time before each of these, and from a tick without force to the
    next; `withheld_s` : the part of it in which the process that holds its network stood still.
    """

    ticks: Count
    late_p50_us: Number
    late_p99_us: Number
    late_max_us: Number
    late_period: Count
    skipped: Count
    overruns: Count
    longest_ms: Number
    without_force_s: Number
    withheld_s: Number
    unsent: Count
    late_histogram_us: Any


class StepSummary(TypedDict):
    """The world's steps."""

    count: Count
    mean_s: Number
    max_s: Number


class Stopped(TypedDict):
    """Time and reason of the stop of the device's force for good. `asked` : on request, and the account is exact."""

    after_s: Number
    why: str | None
    asked: bool | None


class DriverPart(TypedDict):
    """A real device: the number of missed readings; number and length of its silences; the time in which heat limited
    its force; the apparent mass of each axis by the pushes at the start, None: not found; the calls that blocked the
    servo, None: none; the readings that it made in a second, None: as many as the servo's ticks; and the number of
    missing contact forces, None: they were not used."""

    name: str | None
    missed: Count
    silences: Count
    silent_s: Number
    hot_s: Number
    mass_kg: list[float] | None
    blocked: str | None
    reads_hz: Number
    contact_missed: Count | None


class Contradictions(TypedDict):
    """The numbers of messages in the peer's name that contradicted the peer's earlier ones: see `hapnet.wire.sums`."""

    senders: Count
    credited: Count
    acknowledged: Count
    keys: Count
    seals: Count


class PeerPart(TypedDict):
    """The identity of a side's last peer. `proof` : its proof, as in `Session.proof`. `fingerprint` : of the key."""

    proof: str | None
    fingerprint: str | None


class DevicePart(TypedDict, total=False):
    """The entries that only a device has: its held torques, the simulated hand, a stopped force, a real device."""

    reserve_J: Number
    reserve_needed_J: Number
    overrun_leak_J: Number
    overrun_risk_J: Number
    speed_max_mps: Number
    speed_limit_mps: Number
    guarded_ticks: Count
    cut_ticks: Count
    force: str | None
    hand_work_J: Number
    stopped: Stopped | None
    driver: DriverPart | None


class SidePart(DevicePart, total=False):
    """One side's entries about itself. Only the device has `servo`, `quantisation_J` and `true_slack_J`, only the world
    `step` and `environment`.

    `failed` : the reason why it ended early.

    More than twenty attributes: one for each key of the summary's `device` and `world`.
    """

    ledger: Required[LedgerSummary]
    reservoir_min_J: Number
    modulated_share: Number
    deficit_max_J: Number
    discarded_nJ: Count
    sent_nJ: Required[Count]
    credited_nJ: Required[Count]
    acked_nJ: Count
    unanswered_s: Number
    in_flight_nJ: Count
    abandoned_nJ: Count
    incarnations: Count
    peers_J: Number
    former: FormerPart
    outages: OutagesSummary
    received: Count
    missing: Count
    dropped: dict[str, int] | None
    contradictions: Contradictions
    peer: PeerPart
    failed: str | None
    step: StepSummary
    environment: EnvironmentPart
    servo: ServoSummary
    quantisation_J: Number
    true_slack_J: Number


class Flow(TypedDict):
    """Shuffled energy in one direction [nJ]: sent = credited + in flight + abandoned."""

    sent_nJ: Count
    credited_nJ: Count
    in_flight_nJ: Count
    abandoned_nJ: Count
    early_J: Number
    """The most that was credited before it was sent, where both sides were recorded on one clock [J]."""


class EnergySummary(TypedDict):
    """Shuffled energy, in both directions."""

    up: Flow
    down: Flow


class DirectionFigures(TypedDict):
    """The measurements of one direction, end to end: how many of the sent messages arrived, were overtaken, or lost.

    A message is overtaken if it arrived after a newer one, or if the transport dropped it for a newer one.
    """

    sent: Count
    arrived: Count
    overtaken: Count
    lost: Count
    loss: Number
    jitter_p50_ms: Number
    jitter_p99_ms: Number
    age_p50_ms: Number
    age_p99_ms: Number
    stalls: Count
    longest_stall_ms: Number


class PathSummary(TypedDict):
    """The figures of the path between the sides, measured by their streams; network and emulated links together."""

    round_trip_min_ms: Number
    round_trip_p50_ms: Number
    round_trip_p99_ms: Number
    up: DirectionFigures | None
    down: DirectionFigures | None


class LinkPart(TypedDict):
    """The figures of an emulated link: the entries of `netem.LinkStats`."""

    profile: str | None
    offered: Count
    delivered: Count
    lost: Count
    resent: Count
    recovered: Count
    lost_down: Count
    dropped_limit: Count
    reordered: Count
    delay_p50_ms: Number
    delay_p99_ms: Number
    late_max_ms: Number
    delay_histogram_ms: Any


class Links(TypedDict):
    """The emulated links; None if a side did not report it."""

    up: LinkPart | None
    down: LinkPart | None


class Reported(TypedDict):
    """The side whose part is a peer's report, and the arrival of that report after pairing [s].

    `final` : that side's control had stopped. `whole` : the report covers the receiving side's whole time.
    """

    side: str | None
    as_of_s: Number
    final: bool | None
    whole: bool | None


class Summary(TypedDict):
    """The summary of a run, in the order of its JSON.

    More than twenty attributes: one for each of its keys.
    """

    verdict: VerdictSummary
    theorem: Theorem
    hand: HandSummary
    environment: Environment
    device: SidePart | None
    world: SidePart | None
    energy: EnergySummary
    path: PathSummary
    links: Links
    motion: MotionFigures
    seed: Count
    duration_s: Number
    units: str | None
    coupling: str | None
    tuning: dict[str, Any]
    torn: list[Any]
    versions: dict[str, Any]
    wall_clock: dict[str, Any]
    replay: NotRequired[dict[str, Any]]
    reconstructed: NotRequired[bool | None]
    peer_report: Reported | None


def known(value: object) -> float | None:
    """Return `value` if it is a finite number, else None."""
    if type(value) is float:
        return value if math.isfinite(value) else None
    if isinstance(value, bool) or not isinstance(value, int | float) or (isinstance(value, int) and abs(value) > 2**63):
        return None
    return value if math.isfinite(value) else None


def unknown(shape: type[Shape]) -> Shape:
    """All keys of a typed dictionary with value None, nested ones too."""
    reader: Callable[[object], Any] = _reader_of(cast(Any, shape))
    return cast(Shape, reader({}))


def read(tree: object) -> Summary:
    """Return a summary with every key from any value. A value that is missing or of another type is None."""
    return cast(Summary, _reader_of(Summary)(tree))


_FORMERLY = {"peer_report": "told", "senders": "tellers"}
"""Keys that recordings before 0.2 have under another name."""


@cache
def _reader_of(shape: Any) -> Callable[[object], dict[str, Any]]:
    """Return a function that turns any value into this typed dictionary."""
    readers = tuple((name, _reader(hint)) for name, hint in get_type_hints(shape).items())

    def reader(tree: object) -> dict[str, Any]:
        entries: Mapping[Any, Any] = tree if isinstance(tree, dict | Mapping) else {}
        return {name: reader(entries.get(name, entries.get(_FORMERLY.get(name)))) for name, reader in readers}

    return reader


def _reader(hint: Any) -> Callable[[Any], Any]:
    """Return a function that turns any value into a value of the type `hint`, or None."""
    optional = NoneType in get_args(hint)
    kind = next(kind for kind in get_args(hint) if kind is not NoneType) if optional else hint
    if is_typeddict(kind):
        whole = _reader_of(kind)
        return (lambda value: whole(value) if isinstance(value, dict | Mapping) else None) if optional else whole
    if kind in (int, float):
        return known
    if kind is Any:
        return lambda value: value
    kind = get_origin(kind) or kind
    if optional:
        return lambda value: value if isinstance(value, kind) else None
    return lambda value: value if isinstance(value, kind) else kind()
