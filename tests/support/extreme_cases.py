"""Extreme cases for Theorem 1: each parameter over decades, drawn from one seed, and what must hold in each.

`theorem_cases.py` draws what a careful user would set; this draws what the ranges of the parameters allow: no
reservoir at all, a servo of 100 Hz on a stiff spring, a hand of a gram, links that lose nine of ten messages.
"""

import itertools
import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hapnet.assembly.scenes import for_its_scene
from hapnet.checks import Array
from hapnet.errors import InvalidParameter
from hapnet.params import Params
from hapnet.simulation.simulation import Result, Simulation
from tests.conftest import random_spd
from tests.support.independent_account import Account, Witness, account, motion
from tests.support.own_motion import beyond
from tests.support.theorem_cases import HANDWRITING, TOLERANCE_J

AGREEMENT_J = 1e-6
ROUNDING_N = 1e-9
FASTEST_MPS = 15.0
"""What hand and stored energy can make of a device's speed stays below this, by a rough estimate."""

UNCHECKED: Mapping[str, Callable[[], AbstractContextManager[object]]] = {}
"""For each parameter that a case may be refused for: what switches that check off."""


def spread(rng: np.random.Generator, low: float, high: float) -> float:
    """A number with an even logarithm."""
    return float(np.exp(rng.uniform(math.log(low), math.log(high))))


def sometimes(rng: np.random.Generator, share: float, value: float, other: float = 0.0) -> float:
    return value if rng.random() < share else other


def full(rng: np.random.Generator, n: int, low: float, high: float, *, general: bool = True) -> list[list[float]]:
    """An SPD matrix whose eigenvalues lie within two decades of one another, anywhere between low and high."""
    middle = spread(rng, low, high)
    rows = random_spd(rng, n, max(low, 0.1 * middle), min(high, 10.0 * middle))
    return (rows if general else np.diag(np.diagonal(rows))).tolist()  # type: ignore[no-any-return]


def extreme_link(rng: np.random.Generator) -> str:
    """tc words: delay to 0.5 s, loss to 90 %, random or in long bursts, reordering, a rate that queues."""
    delay_ms = spread(rng, 0.01, 500.0)
    words = f"delay {delay_ms:.4f}ms"
    if rng.random() < 0.6:
        words += f" {max(1e-4, rng.uniform(0.0, 1.0) * delay_ms):.4f}ms"  # 0 would be no jitter
        if rng.random() < 0.5:
            words += " distribution " + str(rng.choice(["normal", "pareto", "paretonormal"]))
    kind = rng.integers(4)
    if kind <= 1:
        words += f" loss {rng.uniform(0.0, 90.0):.2f}%"
    elif kind == 2:  # bad with p/(p + r) of the messages, at most 90 %
        recovery = spread(rng, 0.5, 60.0)
        share = rng.uniform(0.01, 0.9)
        words += f" loss gemodel {min(100.0, recovery * share / (1.0 - share)):.3f}% {recovery:.3f}%"
    if rng.random() < 0.3:
        words += f" reorder {rng.uniform(1.0, 90.0):.2f}% {rng.uniform(0.0, 50.0):.2f}%"
    if rng.random() < 0.2:
        words += f" rate {round(spread(rng, 50.0, 5000.0))}kbit limit {rng.integers(2, 400)}"
    return words


def extreme_timeline(rng: np.random.Generator, duration_s: float) -> str:
    """Up to five changes within the run."""
    at = np.sort(rng.uniform(0.0, duration_s, size=int(rng.integers(1, 6)))).tolist()
    return "; ".join(f"at {t:.4f}s: {rng.choice(['down', 'up', extreme_link(rng)])}" for t in at)


def extreme_case(seed: int) -> Params:
    """Case `seed`."""
    rng = np.random.default_rng([seed, 2013])
    scene = str(rng.choice(["free", "wall", "box", "paper"]))
    n = 3 if scene == "paper" else int(rng.integers(1, 4))
    separate = scene != "box"  # a box's walls do not act on each other through M, B' and K'
    duration_s = rng.uniform(0.6, 1.2)
    servo = str(rng.choice(["continuous", "sampled"]))
    servo_hz = spread(rng, 100.0, 5000.0)
    shortest, maximum = sorted(spread(rng, 2e-4, 0.2) for _ in range(2))
    resolution = sometimes(rng, 0.2, spread(rng, 1e-7, 1e-3)) if servo == "sampled" else 0.0
    own_damping = sometimes(rng, 0.7, spread(rng, 1e-4, 10.0))
    stiffness = full(rng, n, 0.1, 1e4)
    changes: dict[str, Any] = {
        "rendering": ("paper", "hapnet")[seed % 2],
        "duration_s": duration_s,
        "record_hz": servo_hz,
        "scene": scene,
        "link.up": extreme_link(rng),
        "link.down": extreme_link(rng),
        "device.servo": servo,
        "device.servo_hz": servo_hz,
        "device.substeps": 1 if rng.random() < 0.7 else int(rng.integers(2, 9)),
        "device.pspm_period_s": spread(rng, 2e-4, 0.1),
        "device.stiffness": stiffness,
        "device.stiffness_range": [0.01, 1e5],
        "device.damping": [spread(rng, 1e-3, 100.0) for _ in range(n)],
        "device.own_damping": own_damping,
        "device.resolution_m": resolution,
        "device.force_limit_N": sometimes(rng, 0.7, spread(rng, 1e-2, 100.0)),
        "device.spring_share": rng.uniform(0.1, 1.0),
        "device.step_limit_N": sometimes(rng, 0.7, spread(rng, 1e-3, 10.0)),
        "world.mass": full(rng, n, 1e-4, 10.0, general=separate),
        "world.damping": full(rng, n, 1e-2, 1e3, general=separate),
        "world.stiffness": full(rng, n, 1.0, 1e5, general=separate),
        "world.step_limit_N": sometimes(rng, 0.7, spread(rng, 1e-2, 1e3)),
        "world.step_min_s": shortest,
        "world.step_max_s": maximum,
        "world.wall.stiffness": spread(rng, 10.0, 1e6),
        "world.wall.damping": sometimes(rng, 0.7, spread(rng, 1e-3, 1e3)),
        "world.wall.position_m": spread(rng, 1e-4, 0.03),
        "world.wall.half_width_m": spread(rng, 1e-4, 0.03),
        "wire.accept_stale": bool(rng.random() < 0.5),
        "wire.admission_W": spread(rng, 1e-3, 1e3),
        "wire.admission_burst_J": spread(rng, 1e-4, 10.0),
        "wire.energy_spacing_s": spread(rng, 1e-3, 0.1),
        "wire.hello_period_s": 0.003,  # nine of ten lost in each direction: a hundred greetings for one answer
        "wire.deadband": sometimes(rng, 0.3, rng.uniform(0.01, 1.0)),
    }
    if scene != "paper":
        changes["dof"] = n
    if servo == "sampled":
        changes["device.trusted_damping"] = sometimes(rng, 0.2, rng.uniform(0.0, 1.0) * own_damping)
    for way in ("up", "down"):
        if rng.random() < 0.4:
            changes[f"link.{way}_timeline"] = extreme_timeline(rng, duration_s)
    for side in ("device", "world"):
        release = changes[f"{side}.step_limit_N"] > 0.0 and rng.random() < 0.5  # letting go is a ramp
        changes[f"{side}.shuffle"] = str(rng.choice(["harvested", "all"]))
        changes[f"{side}.ceiling_J"] = sometimes(rng, 0.75, spread(rng, 1e-7, 1.0))
        changes[f"{side}.smoothing_s"] = sometimes(rng, 0.3, spread(rng, 1e-3, 0.3))
        changes[f"{side}.predict_s"] = sometimes(rng, 0.3, spread(rng, 1e-3, 0.5))
        changes[f"{side}.on_silence"] = "release" if release else "hold"
        changes[f"{side}.silence_after_s"] = spread(rng, 0.005, 0.5)
    changes |= _hand(rng, changes, float(np.linalg.eigvalsh(np.array(stiffness))[-1]))
    return for_its_scene(Params().set(changes))


def _hand(rng: np.random.Generator, changes: Mapping[str, Any], K: float) -> dict[str, Any]:
    """Device and hand, light and heavy, and a motion that keeps their speed within what can be declared.

    The estimate: the motion's own speed, raised by resonance, what a spring stretched by the whole motion gives, and
    what all stored energy gives.
    """
    seconds = changes["duration_s"]
    arm = sometimes(rng, 0.8, spread(rng, 1e-4, 10.0))
    energy = changes["device.ceiling_J"] + changes["world.ceiling_J"]
    mass = max(spread(rng, 1e-3, 100.0 if rng.random() < 0.2 else 1.0), 2.0 * energy / (0.2 * FASTEST_MPS) ** 2)
    damping, stiffness = sometimes(rng, 0.7, spread(rng, 1e-3, 100.0)), spread(rng, 0.1, 1e4)
    operators = ["rest", "sine", "sine", "press"] + ([str(HANDWRITING)] if HANDWRITING.exists() else [])
    kind = str(rng.choice(operators))
    frequency, reach = spread(rng, 0.1, 50.0), spread(rng, 0.02, 1.0)
    drag = damping + changes["device.own_damping"]
    quality = math.sqrt((K + stiffness) * (mass + arm)) / drag if drag else math.inf
    rate = {"sine": 2.0 * math.pi * frequency, "press": 2.0 / reach}.get(kind, 0.0)
    resonance = 2.0 + min(quality, 0.5 * rate * seconds)
    fastest = rate * resonance + math.sqrt((K + stiffness) / (mass + arm))  # by metre of the motion
    amplitude = min(spread(rng, 1e-4, 0.1), 0.8 * FASTEST_MPS / fastest)
    reached = amplitude * fastest + math.sqrt(2.0 * energy / (mass + arm))
    declared = max(0.01, reached * spread(rng, 1.0, 10.0))
    return {
        "operator": kind,
        "operator_model.amplitude_m": amplitude,
        "operator_model.frequency_hz": frequency,
        "operator_model.start_m": 0.0,
        "operator_model.goal_m": amplitude,
        "operator_model.reach_s": reach,
        "operator_model.hold_s": rng.uniform(0.0, 0.3),
        "operator_model.wait_s": rng.uniform(0.0, 0.1),
        "operator_model.mass": arm,
        "operator_model.damping": damping,
        "operator_model.stiffness": stiffness,
        "device.mass": mass,
        "device.greatest_speed": declared,
        "device.watchdog_s": sometimes(rng, 0.8, spread(rng, 1.0, 50.0) / changes["device.servo_hz"]),
    }


@dataclass(frozen=True)
class Examined:
    """What a case came to. `refused`: why it was not run; `wrong`: what did not hold, a word and a figure each."""

    case: int
    params: Params
    refused: InvalidParameter | None = None
    wrong: tuple[str, ...] = ()
    too_fast: bool = False
    """The device went faster than was declared: nothing is claimed then."""
    account: Account | None = field(default=None, repr=False)

    @property
    def kinds(self) -> set[str]:
        return {text.partition(":")[0] for text in self.wrong}


def examine(case: int, params: Params | None = None) -> Examined:
    """Run a case and check all that must hold."""
    params = params or extreme_case(case)
    try:
        simulation = Simulation(params, case, kernel=False)  # the witness sees every call
    except InvalidParameter as error:
        return Examined(case, params, refused=error)
    witness = Witness(simulation)
    try:
        with np.errstate(all="ignore"):
            result = simulation.run()
    except Exception as error:
        return Examined(case, params, wrong=(f"error: {type(error).__name__}: {error}",))
    with np.errstate(all="ignore"):  # what diverges is to be reported as such
        counted = account(witness)
        too_fast = simulation.setup.servo == "sampled" and _speed(witness) > params.device.greatest_speed
        wrong = [*_not_finite(result), *_too_much(witness, counted, result), *_shuffled(witness, result.summary)]
        wrong += _disagreement(witness, counted, result)
        broken = list(_energy(result.summary))
        wrong += _verdict(result.summary, too_fast, bool(broken))
        if not too_fast:
            wrong += broken
    return Examined(case, params, wrong=tuple(wrong), too_fast=too_fast, account=counted)


def _speed(witness: Witness) -> float:
    """The greatest mean speed over a tick [m/s] that its readings show: a count may be rounding."""
    readings = np.array(witness.readings)
    count = witness.params.device.resolution_m * math.sqrt(readings.shape[1])
    way = np.linalg.norm(np.diff(readings, axis=0), axis=1) - count
    return float(np.max(way, initial=0.0)) * witness.params.device.servo_hz


def _not_finite(result: Result) -> Iterator[str]:
    for name, columns in (("device", result.recording.device), ("world", result.recording.world)):
        assert columns is not None, f"nothing of the {name} was recorded"
        for key, values in columns.items():
            known = np.isfinite(values)
            if key in ("age_s", "transit_s"):  # there are none before the first message
                known = known[int(np.argmax(known)) :] if known.any() else known[:0]
            if not known.all():
                yield f"nan: {name} {key}"
    for name in ("device", "world"):
        if not all(math.isfinite(value or 0.0) for value in result.summary[name]["ledger"].values()):
            yield f"nan: ledger of the {name}"


def _energy(summary: dict[str, Any]) -> Iterator[str]:
    """Slack and margins, each side's and both ports'. No leak is allowed for, however small the ceiling."""
    device = summary["device"]
    for name, value, minimum in (
        ("device slack", device["ledger"]["slack_J"], -TOLERANCE_J),
        ("device margin", device["ledger"]["margin_J"], -TOLERANCE_J),
        ("world slack", summary["world"]["ledger"]["slack_J"], -TOLERANCE_J),
        ("world margin", summary["world"]["ledger"]["margin_J"], -TOLERANCE_J),
        ("two-port margin", summary["theorem"]["margin_J"], -TOLERANCE_J),
        ("device reservoir", device["reservoir_min_J"], 0.0),
        ("world reservoir", summary["world"]["reservoir_min_J"], 0.0),
    ):
        if value is None or not value >= minimum:
            yield f"{name}: {value} J"


def _verdict(summary: dict[str, Any], too_fast: bool, broken: bool) -> Iterator[str]:
    """The summary's own word: not "passive" where that is not so or not known, nor "not passive" where it is."""
    verdict = summary["verdict"]
    if verdict["passive"] is True and (too_fast or broken):
        yield f"verdict: passive, {verdict['reason']}"
    if verdict["passive"] is False and not broken:
        yield f"verdict: not passive, {verdict['reason']}"


def _disagreement(witness: Witness, counted: Account, result: Result) -> Iterator[str]:
    """Where summary and recording are not what the independent account says, at the end, over time or at the least."""
    summary, recording = result.summary, result.recording
    bound = summary["theorem"]["bound_J"]
    for name, own, reported in (
        ("device", counted.device_min, summary["device"]["ledger"]["margin_J"]),
        ("world", counted.world_least, summary["world"]["ledger"]["margin_J"]),
        ("two ports", counted.both_least, summary["theorem"]["margin_J"]),
        ("hand and world", counted.hand_and_world_least, bound + result.hand.lowest),
    ):
        if own is not None and not abs(own - reported) <= AGREEMENT_J + 1e-12 * abs(own):
            yield f"account of the {name}: {own:.9g} J, the summary says {reported:.9g} J"
    for name, series, columns in (
        ("device", counted.device, recording.device),
        ("world", counted.world, recording.world),
    ):
        reported = columns["margin_J"]
        if series is not None and len(series) != len(reported):
            yield f"samples of the {name}: {len(reported)} of {len(series)}"
        elif series is not None and len(series):
            off, largest = float(np.max(np.abs(series - reported))), float(np.max(np.abs(series)))
            if not off <= AGREEMENT_J + 1e-12 * largest:
                yield f"account of the {name} over time: off by {off:.3g} J"
    if not counted.unseen <= (summary["device"]["quantisation_J"] or 0.0) + TOLERANCE_J:
        yield f"quantisation: {counted.unseen:.3g} J, the summary says {summary['device']['quantisation_J']} J"
    for name, value in motion(witness).items():
        reported = summary["motion"][name]
        if value is not None and (reported is None or not abs(value - reported) <= 1e-9 + 1e-9 * abs(value)):
            yield f"motion {name}: {value}, the summary says {reported}"


def _shuffled(witness: Witness, summary: dict[str, Any]) -> Iterator[str]:
    """Energy over the wire: what was given and taken, to the nanojoule; no flow may be negative."""
    for way, sender, receiver in (("up", witness.device, witness.world), ("down", witness.world, witness.device)):
        flow = summary["energy"][way]
        sent, credited = flow["sent_nJ"], flow["credited_nJ"]
        if credited != receiver.credited_nJ or abs(sent - sender.given_J * 1e9) > 1.0 + 1e-12 * sent:
            yield f"energy {way}: {sender.given_J:.9g} J given, {receiver.credited_nJ} nJ taken; the summary: {flow}"
        if (
            min(value for value in flow.values() if value is not None) < 0
            or sent != credited + flow["in_flight_nJ"] + flow["abandoned_nJ"]
        ):
            yield f"energy {way}: {flow}"


def _too_much(witness: Witness, counted: Account, result: Result) -> Iterator[str]:
    """Force, steps of force and credited energy beyond their limits."""
    if witness.least_gap_nJ < 0:
        yield f"credited: {-witness.least_gap_nJ} nJ more than was sent"
    params = witness.params
    device, world = params.device, params.world
    limit, step = device.force_limit_N or math.inf, device.step_limit_N or math.inf
    forces = np.zeros((0, 1))
    if witness.servo == "sampled":
        forces = np.vstack([np.zeros((1, len(witness.start))), np.array(witness.applied)])
        yield from _above("force asked for", np.array(witness.commanded), limit)
        stopped = {event.time_ns for event in result.recording.events}  # a stop that is reported may drop the force
        period_ns = round(1e9 / device.servo_hz)
        reported = np.array([witness.origin_ns + k * period_ns in stopped for k in range(1, len(forces))], dtype=bool)
        y = result.recording.device["set_position_m"]
        if len(y) == len(forces) - 1:  # each tick is recorded
            x = np.array(witness.readings[: len(forces)])
            own = _spring(params, x[1:] - y) - _spring(params, x[:-1] - y)
            pairs = zip(forces[1:], forces[:-1], own, strict=True)
            steps = np.array([[beyond(*one)] for one in pairs]).reshape(-1, 1)
            yield from _above("step", steps[~reported], step)
    else:
        if counted.coupling_force is not None:
            forces = counted.coupling_force
        if witness.jumps:
            x, before, after = np.array(witness.jumps).swapaxes(0, 1)
            own = np.diff(x, axis=0, prepend=before[:1])
            K = _matrix(device.stiffness, len(witness.start))
            steps = np.array([[_spring_step(*one, K)] for one in zip(after, before, own, strict=True)])
            yield from _above("step", steps, step)
    yield from _above("force", forces, limit, 1e-5 * limit)
    yield from _above("world's step", _steps_of_world(witness, params), world.step_limit_N or math.inf)


def _spring_step(after: Array, before: Array, own: Array, K: Array) -> float:
    """The step of a spring's force [N] beyond the part that the own motion causes.

    A modulated set-position of several axes is the nearest that is paid for, and may be beside the line of `own`. Then
    only its distance from `before` is known: |proj(y) - before| <= |y - p| + |p - before| for the point p of the line
    that is nearest to y, as `before` is paid for and a projection is non-expansive.
    """
    stiffest = float(np.linalg.eigvalsh(K)[-1])
    if len(own) == 1:
        return stiffest * beyond(after, before, own)
    return stiffest * max(float(np.linalg.norm(after - before) - np.linalg.norm(own)), 0.0)


def _steps_of_world(witness: Witness, params: Params) -> np.ndarray[Any, Any]:
    """The force's steps at the world [N], beyond the mass's own motion; a carried mass takes the set-position along."""
    steps = witness.steps
    K = _matrix(params.world.stiffness, len(witness.start))
    found = [np.zeros(1)]
    for before, one in itertools.pairwise(steps):
        carried = np.array(one.begun) - before.position
        own = np.array(before.position) - before.begun
        found.append(np.array([_spring_step(one.set_position, before.set_position + carried, own, K)]))
    return np.array(found)


def _above(name: str, vectors: np.ndarray[Any, Any], limit: float, tolerance: float = 0.0) -> Iterator[str]:
    if not len(vectors) or limit == math.inf:
        return
    maximum = float(np.max(np.linalg.norm(vectors, axis=1)))
    if not maximum <= limit * (1.0 + 1e-9) + ROUNDING_N + tolerance:
        yield f"{name}: {maximum:.6g} N, allowed {limit:.6g} N"


def _spring(params: Params, e: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Force [N] at offsets e (N, n) of the spring that saturates through its potential: ``-K e`` up to its knee."""
    K = _matrix(params.device.stiffness, e.shape[1])
    pull = e @ K
    stretch = np.sqrt(np.sum(pull * e, axis=1, keepdims=True))
    limit = params.device.force_limit_N * params.device.spring_share
    knee = limit / math.sqrt(np.linalg.eigvalsh(K)[-1]) if limit else math.inf
    return np.asarray(-pull * np.where(stretch <= knee, 1.0, knee / np.maximum(stretch, 1e-300)))


def _matrix(value: object, n: int) -> np.ndarray[Any, Any]:
    given = np.asarray(value, dtype=float)
    return given if given.ndim == 2 else np.diag(np.broadcast_to(given, (n,)))
