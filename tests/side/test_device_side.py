"""A simulated device in real time: it keeps to the clock however late its servo is, and buys no energy from that."""

import itertools
import math
from typing import Any

import numpy as np
import pytest

from hapnet.assembly.build import device_session, device_side, prepare, world_session, world_side
from hapnet.errors import HapnetError
from hapnet.params import RELAXED_HAND
from hapnet.plant.device import SimulatedDevice
from hapnet.plant.worlds.scene import Scene
from hapnet.recording.samples import Event
from hapnet.side import held_device
from hapnet.side.device import DeviceSide
from hapnet.side.endpoint import DeviceEndpoint, WorldEndpoint
from hapnet.summary.run import device_summary
from tests.support.paper import PAPER

MS = 1_000_000


class LateClock:
    def __init__(self) -> None:
        self.now_ns = 0

    def __call__(self) -> int:
        return self.now_ns


def run_late(words: dict[str, object], late_ns: list[int]) -> tuple[DeviceSide, SimulatedDevice, float, float]:
    """Ticks due every millisecond, each called so late; (side, device, hand's work, kinetic energy at the start)."""
    clock = LateClock()
    setup = prepare(PAPER.set({"operator": "sine", **words}), "sampled")
    side = device_side(setup, DeviceEndpoint(device_session(setup, 7)), clock, lambda sample: None)
    device = side.device
    work = 0.0
    advance = device.advance

    def counted() -> float:
        nonlocal work
        done = advance()
        work += done
        return done

    device.advance = counted  # type: ignore[method-assign]  # the hand's work, counted beside the program
    side.endpoint.paired = True
    side.tick(0)
    kinetic = device.kinetic
    for index, late in enumerate(late_ns, start=1):
        clock.now_ns = index * MS + late
        side.tick(clock.now_ns)
    return side, device, work, kinetic


@pytest.mark.parametrize("servo", ["sampled", "continuous"])
@pytest.mark.long
def test_a_late_servo_does_not_make_time_run_faster(servo: str) -> None:
    rng = np.random.default_rng(1)
    late = np.where(rng.random(4000) < 0.25, 600_000, 0).tolist()
    _, device, _, _ = run_late({"device.servo": servo}, [*late, 0])
    assert device.time == pytest.approx(4.001, abs=0.0011)


def test_a_tick_counts_for_the_time_since_the_last_and_for_no_less_than_the_device_moved() -> None:
    """Late by 0.3 ms it counts for 1.3 ms; the next one, on time, for the millisecond that the device moved on."""
    clock = LateClock()
    setup = prepare(PAPER.set({"operator": "sine", "device.servo": "continuous"}), "continuous")
    side = device_side(setup, DeviceEndpoint(device_session(setup, 7)), clock, lambda sample: None)
    counted: list[float] = []
    tick = side.endpoint.tick_continuous

    def noted(now_ns: int, dt: float, *given: Any, **more: Any) -> bytes | None:
        counted.append(dt)
        return tick(now_ns, dt, *given, **more)

    side.endpoint.tick_continuous = noted  # type: ignore[method-assign]  # to see each tick
    side.endpoint.paired = True
    for now_ns in (0, MS, 2 * MS + 300_000, 3 * MS, 4 * MS):
        clock.now_ns = now_ns
        side.tick(now_ns)
    assert counted[-4:] == pytest.approx([1e-3, 1.3e-3, 1e-3, 1e-3], rel=1e-9)


def test_ticks_that_a_servo_missed_count_as_one_period_each_and_the_last_as_the_rest(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Due at 2 ms, called at 4.3: the device moved on by three periods, of which the last took 1.3 ms."""
    counted: list[float] = []
    count = held_device.count

    def noted(held: held_device.HeldDevice, dt: float) -> None:
        counted.append(dt)
        count(held, dt)

    monkeypatch.setattr(held_device, "count", noted)
    run_late({}, [0, 2_300_000])
    assert counted[-4:] == pytest.approx([1e-3, 1e-3, 1e-3, 1.3e-3], rel=1e-9)


def test_skipped_ticks_are_lived_through() -> None:
    _, device, _, _ = run_late({}, [0, 0, 7 * MS])
    assert device.time == pytest.approx(0.010, abs=1e-9)


def test_trusted_damping_gives_nothing_for_being_late() -> None:
    """At the hand's port, with what was sent counted as gone: the device never gives more than it had (d^2)."""
    late = [450_000 * (index % 2) for index in range(5000)]
    words: dict[str, object] = {"device.own_damping": 0.3, "device.trusted_damping": 0.3, "device.shuffle": "all"}
    words["device.ceiling_J"] = 0.05
    side, device, work, kinetic = run_late(words, late)
    coupling = side.coupling
    stored = device.kinetic - kinetic + coupling.potential(device.position)
    slack = work - stored - (coupling.account - 0.05) - coupling.ledger.sent
    assert slack >= -1e-9


def stopped(stop_ms: int, words: dict[str, object]) -> tuple[dict[str, Any], float]:
    """The device's part of the summary after 22 stops under force, and what the hand was given less what it put in.

    Between two stops the servo runs for 100 ms, pulled 20 mm away from where the hand wants to be.
    """
    setup = prepare(PAPER.set({"operator": "sine", "device.servo": "sampled", **RELAXED_HAND, **words}), "sampled")
    clock = LateClock()
    endpoint = DeviceEndpoint(device_session(setup, 7))
    side = device_side(setup, endpoint, clock, lambda sample: None)
    device = side.device
    given = 0.0

    def tick(after_ms: int) -> None:
        nonlocal given
        clock.now_ns += after_ms * MS
        before, torque = device.position, device.state.torque
        side.tick(clock.now_ns)
        given += sum(t * (b - a) for t, a, b in zip(torque, before, device.position, strict=True))

    side.endpoint.paired = True
    side.tick(0)
    for k in range(22):
        for _ in range(100):
            side.coupling.receive((0.02 * (-1) ** k,), 0.0, 0.0)
            tick(1)
        tick(stop_ms)
    return device_summary(side, "pspm"), given - side.coupling.ledger.credited + side.coupling.ledger.sent


@pytest.mark.long
def test_a_servo_that_is_stopped_for_long_again_and_again_holds_no_more_than_its_account_covers() -> None:
    """300 ms under force, 22 times, with a ceiling of 1 mJ. Forces that come back in full gave out 1.5 mJ."""
    part, given = stopped(300, {"device.ceiling_J": 1e-3})
    assert part["servo"]["ticks"] == 22 * 101
    assert given <= 1e-3
    assert part["ledger"]["margin_J"] >= 0.0
    assert (part["deficit_max_J"], part["overrun_leak_J"], part["overrun_risk_J"]) == (0.0, 0.0, 0.0)


@pytest.mark.long
def test_a_servo_that_is_away_for_as_long_as_its_watchdog_allows_stays_within_its_bound() -> None:
    part, given = stopped(20, {"device.ceiling_J": 0.05})
    assert given <= 0.05
    assert part["ledger"]["margin_J"] >= 0.0
    assert (part["deficit_max_J"], part["overrun_leak_J"]) == (0.0, 0.0)
    assert part["reserve_J"] == pytest.approx(0.02415)  # by hand: F = 2.1 N: 2.2 N 21 mm - 2.1^2/200 J


@pytest.mark.parametrize("servo", ["sampled", "continuous"])
def test_a_servo_that_was_away_renders_nothing_until_it_is_on_time_and_the_account_holds(servo: str) -> None:
    """In contact with a set-position 20 mm off; away for 300 ms, twice 50 ms late after that, then on time again."""
    setup = prepare(PAPER.set({"operator": "sine", "device.servo": servo, "device.watchdog_s": 0.02}), "sampled")
    notes: list[Event] = []
    clock = LateClock()
    side = device_side(
        setup,
        DeviceEndpoint(device_session(setup, 7)),
        clock,
        lambda s: notes.append(s) if isinstance(s, Event) else None,
    )
    side.endpoint.paired = True
    forces = []
    device = side.device

    def tick(now_ns: int) -> float:
        """What the device renders after a tick [N]: what it was asked for, or its spring's."""
        clock.now_ns = now_ns
        side.coupling.receive((-0.02,), 0.0, 0.0)
        side.tick(now_ns)
        set_position = device.state.set_position if device.state.coupled else device.position
        forces.append(abs(device.state.torque[0]) + abs(100.0 * (device.position[0] - set_position[0])))
        return forces[-1]

    side.tick(0)
    now_ns = 0
    for _ in range(100):
        now_ns += MS
        tick(now_ns)
    assert forces[-1] > 1.0
    for late_ms in (300, 50, 50):
        now_ns += late_ms * MS
        assert tick(now_ns) == 0.0
    assert side.overruns == 3
    assert side.punctuality.without_force_ns == 400 * MS
    assert [note.kind for note in notes] == ["overrun"]
    assert "300.0 ms" in notes[0].text
    assert side.max_ns == 300 * MS
    for _ in range(100):
        now_ns += MS
        tick(now_ns)
    steps = [b - a for a, b in itertools.pairwise(forces[102:])]
    if servo == "sampled":  # what is left of 0.1 J, less 5 mJ at the most, covers another 300 ms at 1 m/s
        assert 0.095 / 0.301 < forces[-1] < 0.105 / 0.300
    else:
        assert forces[-1] > 1.0
    assert max(steps) <= setup.params.device.step_limit_N + 0.1  # it begins anew without a jump (0.1 N: the hand moves)
    assert side.coupling.ledger.slack_min >= -1e-12
    assert side.coupling.energy_min >= 0.0


def test_a_watchdog_that_is_off_lets_nothing_go() -> None:
    side, _, _, _ = run_late({"device.watchdog_s": 0.0}, [0, 900 * MS, 0])
    assert (side.overruns, side.max_ns) == (0, 901 * MS)


def test_a_restarted_side_starts_with_nothing() -> None:
    for restarted, energy in ((False, 0.1), (True, 0.0)):
        setup = prepare(PAPER, "sampled")
        side = device_side(setup, DeviceEndpoint(device_session(setup, 7)), lambda: 0, lambda sample: None)
        side.endpoint.paired, side.endpoint.restarted = True, restarted
        side.tick(0)
        assert side.coupling.modulator.energy == energy
        assert side.coupling.ledger.bound == energy


class Timeless(Scene):
    """A scene of the user's own, whose steps take no time that there is."""

    def next_step_s(self, rng: np.random.Generator) -> float:
        return math.nan


def timeless(*, dof: int = 1) -> Scene:
    return Timeless("timeless", dof)


def test_a_scene_that_cannot_say_how_long_a_step_is_is_named() -> None:
    setup = prepare(PAPER.set({"scene": "tests.side.test_device_side:timeless"}), "sampled")
    endpoint = WorldEndpoint(world_session(setup, 7))
    side = world_side(setup, endpoint, np.random.default_rng(0), lambda sample: None)
    with pytest.raises(
        HapnetError, match=r"the scene tests\.side\.test_device_side:timeless failed: next_step_s\(\) .*NaN"
    ):
        side.next_step_ns()
