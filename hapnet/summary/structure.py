"""The structure of a run's summary: typed dictionaries whose keys are those of the JSON. None where a value is unknown.

Summaries also come from files: of an older version, torn, or edited by hand. `read` turns whatever it is given into a
summary that has every key, so no other code has to check.
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

from hapnet.summary.from_samples import MotionFigures as MotionFigures
from hapnet.wire.messages import Role

Direction = Literal["up", "down"]
"""From the device, and from the world."""

SIDES: tuple[Role, Role] = ("device", "world")
DIRECTIONS: tuple[Direction, Direction] = ("up", "down")

Number = float | None
Count = int | None
Shape = TypeVar("Shape")


class VerdictSummary(TypedDict):
    """`passive` : None if it is not known. `reason` : why, as a sentence."""

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

    `env_slack_J` : the minimum of what it has dissipated; below 0 it gave out energy of its own. `env_supplied_J` : put
    in by what moves its obstacles. `env_stored_J` : in its springs and bodies at the end. `env_given_J`, `env_paid_J` :
    what it gave out beyond what it had, and what damping took back; None: there was no observer. `env_undone` :
    substeps that MuJoCo made again, `env_undone_J` : what its bodies lost where they were stopped for that.
    `env_overlaps` : pairs of its bodies that began inside one another.
    `env_diverged` : one of these was no finite number.
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
    `springs_N_m` : K and K', or K alone (hapnet/couplings/stiffness.py).
    """

    stiffness_N_m: Number
    felt_stiffness_N_m: Number
    springs_N_m: list[float] | None
    work_J: Number
    slack_J: Number


class LedgerSummary(TypedDict):
    """One side's half of the theorem [J]. `margin_later_J` : the minimum after the first second, at its samples."""

    margin_J: Number
    slack_J: Number
    bound_J: Number
    work_J: Number
    energy_out_J: Number
    margin_end_J: Number
    margin_later_J: Number
    diverged: bool | None


class OutagesSummary(TypedDict):
    """The times in which one side heard nothing from the other."""

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
    """When and why the device's force was stopped for good. `asked` : somebody wanted it, and the account is exact."""

    after_s: Number
    why: str | None
    asked: bool | None


class DriverPart(TypedDict):
    """A real device: how many readings were missed, how often and for how long that was a silence, how long heat
    limited its force, the apparent mass of each axis, as pushes at the start showed it, None: they did not, which
    of its calls blocked the servo, None: none did, how many readings it made in a second, None: as many as it was asked
    for, and how many of its contact forces were missing, None: nobody asked for them."""

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
    """How many messages in the peer's name contradicted what is known of the peer: see `hapnet.wire.sums`."""

    senders: Count
    credited: Count
    acknowledged: Count
    keys: Count
    seals: Count


class PeerPart(TypedDict):
    """Who a side's last peer is. `proof` : what proves it, as in `Session.proof`. `fingerprint` : of the pair's key."""

    proof: str | None
    fingerprint: str | None


class DevicePart(TypedDict, total=False):
    """The entries that only the device knows: its held torques, the simulated hand, a stopped force, a real device."""

    reserve_J: Number
    reserve_needed_J: Number
    overrun_leak_J: Number
    overrun_risk_J: Number
    speed_max_mps: Number
    speed_limit_mps: Number
    guarded_ticks: Count
    force: str | None
    hand_work_J: Number
    stopped: Stopped | None
    driver: DriverPart | None


class SidePart(DevicePart, total=False):
    """One side's entries about itself. Only the device has `servo`, `quantisation_J` and `true_slack_J`, only the world
    `step` and `environment`.

    `failed` : why it ended before its time.

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
    """The measurements of one direction, end to end: of the messages sent, how many arrived, were overtaken, or lost.

    Overtaken are those that arrived late, and those that the transport dropped for it.
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
    """The figures of the path between the sides by their streams, network and emulated links together."""

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
    """Whose part is a peer's report, and when it came, in seconds after pairing [s].

    `final` : that side's control had stopped. `whole` : it covers the time of the side that has it.
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
    """`value` if it is a finite number."""
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
    """A summary with every key, whatever `tree` is. A value that is missing or of another type is None."""
    return cast(Summary, _reader_of(Summary)(tree))


_FORMERLY = {"peer_report": "told", "senders": "tellers"}
"""Keys that recordings before 0.2 have under another name."""


@cache
def _reader_of(shape: Any) -> Callable[[object], dict[str, Any]]:
    """Returns a function that turns anything into this typed dictionary."""
    readers = tuple((name, _reader(hint)) for name, hint in get_type_hints(shape).items())

    def reader(tree: object) -> dict[str, Any]:
        entries: Mapping[Any, Any] = tree if isinstance(tree, dict | Mapping) else {}
        return {name: reader(entries.get(name, entries.get(_FORMERLY.get(name)))) for name, reader in readers}

    return reader


def _reader(hint: Any) -> Callable[[Any], Any]:
    """Returns a function that turns anything into a value of the type `hint`."""
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
