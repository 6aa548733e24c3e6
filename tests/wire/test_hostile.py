"""A properly paired peer turns hostile: set-positions anywhere, energy out of nothing, as fast as it can.

Both halves of this side are the real ones, in virtual time. What is left of its port's own energy, W + V(0) + E(0) with
nothing credited, may then fall to what admission lets in below zero and no further: so much was bought with a lie.
"""

import math
import random
from collections.abc import Callable
from itertools import product
from typing import NamedTuple

import pytest

from hapnet.assembly.build import prepare
from hapnet.checks import Vector
from hapnet.wire.messages import Energy, Position, decode, encode
from tests.conftest import mostly_slow
from tests.fuzzing.rig import MS, US, Rig
from tests.support.own_motion import beyond
from tests.support.paper import PAPER

SIDES = ("device", "world", "continuous")
DURATION_NS = 2_000 * MS
EVERY_NS = 200 * US  # five times the servo's rate
LEVEL_NJ = 2**63 - 1

STRONG: dict[str, object] = {
    "operator": "rest", "device.force_limit_N": 40.0, "device.step_limit_N": 20.0,
    "device.greatest_speed": 5.0, "device.watchdog_s": 0.0, "world.step_min_s": 0.002, "world.step_max_s": 0.004,
}  # fmt: skip
"""A device that could give its hand more than admission lets in, fast enough for it, and a world that is quick."""

OPEN: dict[str, object] = {"wire.admission_W": 1e6, "wire.admission_burst_J": 1e6}


class Attacked(NamedTuple):
    """What an attack did to a side."""

    rig: Rig
    lowest: float
    """Least W + V(0) + E(0) of its port [J]: below zero, it gave out what it never had."""
    max_step: float
    """Of the spring's force in an update, as the set-position's step makes it [N]."""


Style = Callable[[random.Random, int, list[Vector]], list[float]]


def random_(rng: random.Random, n: int, seen: list[Vector]) -> list[float]:
    return [rng.uniform(-1e6, 1e6) for _ in seen[0]]


def alternating(rng: random.Random, n: int, seen: list[Vector]) -> list[float]:
    return [1e6 * (-1) ** n for _ in seen[0]]


def subnormal(rng: random.Random, n: int, seen: list[Vector]) -> list[float]:
    return [rng.choice((5e-324, -5e-324, 2.2e-308, -0.0)) for _ in seen[0]]


def pumping(rng: random.Random, n: int, seen: list[Vector]) -> list[float]:
    """Always ahead of the motion: a damper with the wrong sign, the most that a listener can do."""
    return [1e6 if now >= before else -1e6 for before, now in zip(*seen, strict=True)]


def swinging(rng: random.Random, n: int, seen: list[Vector]) -> list[float]:
    """Near the resonance of a hand of 0.6 kg on a spring of 235 N/m."""
    return [math.copysign(1e6, math.sin(math.tau * 2.5 * n * EVERY_NS * 1e-9)) for _ in seen[0]]


STYLES = (random_, alternating, subnormal, pumping, swinging)
CROSSED = [(SIDES[k % len(SIDES)], style) for k, style in enumerate(STYLES)]
"""Each side and each style once."""


def attack(side: str, style: Style, words: dict[str, object], *, rising: bool = False) -> Attacked:
    """Pair, then attack a side for two seconds; `rising`: energy totals go up by 1 J a message, not at once to the top.

    Every tick and every update is checked on the way: force limit, step limit, slack, balance, everything finite.
    """
    servo = "continuous" if side == "continuous" else "sampled"
    rng = random.Random(1)
    rig = Rig(side, rng, prepare(PAPER.set({"device.servo": servo, **words}), servo))
    for _ in range(10):
        rig.run(MS)
    assert rig.paired
    own, peer = rig.session.identity.incarnation, rig.honest.identity.incarnation
    seen: list[Vector] = [(0.0,) * rig.dof] * 2

    def listen(frame: bytes) -> None:
        message = decode(frame)
        if isinstance(message, Position) and message.incarnation == own:
            seen[:] = [seen[1], message.position]

    rig.overheard = listen
    coupling = rig.plant.coupling
    stiffest = coupling.spring.ellipsoid.largest
    lowest, maximum, ybar, x = math.inf, 0.0, coupling.set_position, rig.plant.x
    for n in range(DURATION_NS // EVERY_NS):
        rig.attack(rig.honest.position(rig.now_ns, style(rng, n, seen)))
        rig.attack(encode(Energy(peer, own, 10**9 * (n + 1) if rising else LEVEL_NJ, 0)))
        rig.run(EVERY_NS)
        ledger = coupling.ledger
        lowest = min(lowest, ledger.work + ledger.bound)
        own = [now - before for now, before in zip(rig.plant.x, x, strict=True)]
        maximum = max(maximum, stiffest * beyond(coupling.set_position, ybar, own))
        ybar, x = coupling.set_position, rig.plant.x
    assert rig.plant.updates > 50
    return Attacked(rig, lowest, maximum)


def admitted(rig: Rig) -> float:
    """What admission lets in until now [J]."""
    wire = rig.setup.params.wire
    return wire.admission_burst_J + wire.admission_W * rig.now_ns * 1e-9


@pytest.mark.parametrize(
    ("side", "style"),
    mostly_slow([*CROSSED, *(case for case in product(SIDES, STYLES) if case not in CROSSED)], 0, len(CROSSED)),
)
@pytest.mark.long
def test_a_hostile_peer_buys_no_more_than_admission_lets_in(side: str, style: Style) -> None:
    done = attack(side, style, STRONG, rising=style is random_)
    rig = done.rig
    assert done.lowest >= -admitted(rig)
    assert rig.session.credited_nJ <= admitted(rig) * 1e9
    assert rig.plant.coupling.ledger.slack_min >= -1e-9
    section = rig.setup.params.world if side == "world" else rig.setup.params.device
    assert done.max_step <= section.step_limit_N * (1.0 + 1e-6)


@pytest.mark.parametrize("side", mostly_slow(SIDES, 0, 1))
@pytest.mark.long
def test_with_the_limits_of_a_small_device_and_positions_in_any_order(side: str) -> None:
    done = attack(side, pumping, {"wire.accept_stale": True, "dof": 3, "scene": "box"})
    assert done.lowest >= -admitted(done.rig)
    assert done.rig.plant.coupling.ledger.slack_min >= -1e-9
    section = done.rig.setup.params.world if side == "world" else done.rig.setup.params.device
    assert done.max_step <= section.step_limit_N * (1.0 + 1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("side", mostly_slow(SIDES, 1, 1))
def test_without_admission_it_would_buy_more(side: str) -> None:
    """The control: the same attack, admission wide open."""
    guarded, opened = attack(side, pumping, STRONG), attack(side, pumping, STRONG | OPEN)
    assert guarded.lowest >= -admitted(guarded.rig) > opened.lowest


@pytest.mark.slow
def test_the_bound_is_nearly_reached() -> None:
    """Admission is what stops a swinging attack, not luck: most of what was let in came out at the hand."""
    done = attack("device", swinging, STRONG)
    assert done.lowest < -0.8 * admitted(done.rig)


@pytest.mark.slow
@pytest.mark.long
def test_sequences_out_of_order_are_taken_if_that_is_wanted() -> None:
    done = attack("device", alternating, {"wire.accept_stale": True})
    rig = done.rig
    who, newest = rig.honest.identity.incarnation, done.rig.watch.session.monitor.numbers.newest
    frames = [encode(Position(who, newest + number, stamp, (1e6,))) for number, stamp in ((9, 2**62), (5, 0), (5, 0))]
    assert [len(rig.attack(frame)) for frame in frames] == [1, 1, 0]  # the last is a copy
