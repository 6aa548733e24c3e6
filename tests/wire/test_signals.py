"""Signals: what is sent comes over any link, once for each change, and a stop stops the force."""

from itertools import pairwise

import pytest
from hypothesis import given, strategies as st

from hapnet.checks import Vector
from hapnet.errors import BadMessage, HapnetError, InvalidParameter
from hapnet.params import Params
from hapnet.plant.scenes.wall import wall
from hapnet.plant.worlds.scene import Scene
from hapnet.simulation.simulation import Simulation
from hapnet.summary.verdict import judge
from hapnet.wire.events import SignalReceived
from hapnet.wire.fields import Signal
from hapnet.wire.signals import REPEAT_NS, SPACING_NS, STOP, SignalExchange

MS = 1_000_000
VALUES = st.none() | st.booleans() | st.integers(-9, 9) | st.floats(-1.0, 1.0) | st.sampled_from(["a", "b"])


@given(
    st.lists(st.tuples(st.integers(0, 30), st.sampled_from("abc"), VALUES), max_size=40),
    st.lists(st.booleans(), min_size=200, max_size=200),
)
def test_over_a_link_that_loses_frames_the_newest_values_arrive(
    changes: list[tuple[int, str, Signal]], lost: list[bool]
) -> None:
    """Whatever is lost meanwhile: one frame that comes after the last change has everything."""
    here, there = SignalExchange(), SignalExchange()
    now_ns, count = 0, 0
    for wait_ms, name, value in changes:
        now_ns += wait_ms * MS
        here.report(name, value)
        if (frame := here.poll(now_ns)) is not None:
            count += 1
            if not lost[count]:
                for event in there.receive(*frame):
                    assert there.heard[event.name] is event.value
    frame = here.poll(now_ns + REPEAT_NS)
    assert (frame is None) == (not changes)
    if frame is not None:
        there.receive(*frame)
    assert {name: (type(v), v) for name, v in there.heard.items()} == {
        n: (type(v), v) for n, v in here.reported.items()
    }


def test_frames_are_spaced_and_repeated() -> None:
    """A change a millisecond for a second, then none: 10 ms apart, then 200 ms."""
    exchange = SignalExchange()
    assert exchange.next_due_ns is None
    sent = []
    for at_ms in range(2000):
        if at_ms < 1000:
            exchange.report("grip", at_ms)
        if exchange.poll(at_ms * MS) is not None:
            sent.append(at_ms)
    gaps = [b - a for a, b in pairwise(sent)]
    assert set(gaps[:99]) == {SPACING_NS // MS}
    assert set(gaps[101:]) == {REPEAT_NS // MS}


def test_each_change_is_reported_once_and_old_frames_are_dropped() -> None:
    exchange = SignalExchange()
    assert exchange.receive(1, {"a": 1, "b": (1.0, 2.0)}) == (SignalReceived("a", 1), SignalReceived("b", (1.0, 2.0)))
    assert exchange.receive(2, {"a": True, "b": (1.0, 2.0)}) == (SignalReceived("a", True),)
    with pytest.raises(BadMessage, match="after later ones"):
        exchange.receive(2, {"a": 5})
    assert exchange.heard["a"] is True


@pytest.mark.parametrize(
    ("name", "value"),
    [("x", float("nan")), ("x", [1.0]), ("line\n", 1), ("x", "word" * 300), ("x", tuple(range(120))), ("x", b"raw")],
)
def test_what_is_no_small_value_is_refused(name: str, value: Signal) -> None:
    with pytest.raises(InvalidParameter, match=r"^signal "):
        SignalExchange().report(name, value)


# Through both sides, in virtual time


class Lamp(Scene):
    """A wall that hears the device's signals, and reports how many it has heard."""

    def __init__(self, dof: int = 1) -> None:
        plain = wall(dof=dof)
        super().__init__("lamp", dof, plain.walls)
        self.heard: list[tuple[str, Signal]] = []

    def signal(self, name: str, value: Signal) -> None:
        self.heard.append((name, value))

    def signals(self) -> dict[str, Signal]:
        return {"heard": len(self.heard)}


class Faulty(Lamp):
    def signals(self) -> dict[str, Signal]:
        raise RuntimeError("no lamp")


class Stepper:
    """An object that steps by itself, with signals."""

    def __init__(self, dof: int = 1) -> None:
        self.heard: dict[str, Signal] = {}

    def step(self, dt: float, position: Vector, velocity: Vector) -> Vector:
        return (0.0,)

    def signal(self, name: str, value: Signal) -> None:
        self.heard[name] = value

    def signals(self) -> dict[str, Signal]:
        return {"knows": len(self.heard)}


def simulation(**changes: object) -> Simulation:
    params = Params().set({"duration_s": 3.0, "link.up": "delay 40ms 10ms loss 20%", "link.down": "loss 20%"})
    return Simulation(params.set({name.replace("__", "."): value for name, value in changes.items()}), kernel=False)


def test_a_scene_and_a_device_hear_each_other_over_a_lossy_link() -> None:
    run = simulation(scene="tests.wire.test_signals:Lamp")
    run.device_endpoint.report("tool", "pen")
    run.run()
    scene = run.world.scene
    assert scene.heard == [("tool", "pen")]
    assert run.device_endpoint.session.signals.heard == {"heard": 1}


def test_an_object_that_steps_hears_them_too() -> None:
    run = simulation(scene="tests.wire.test_signals:Stepper")
    run.device_endpoint.report("tool", "pen")
    run.run()
    assert run.device_endpoint.session.signals.heard == {"knows": 1}


def test_a_scene_whose_signals_fail_is_named() -> None:
    with pytest.raises(HapnetError, match=r"the scene .*Faulty failed: its signals raised RuntimeError: no lamp"):
        simulation(scene="tests.wire.test_signals:Faulty").run()


def test_a_stop_from_the_world_takes_the_force_away_and_the_run_stays_passive() -> None:
    run = simulation()
    run.world_endpoint.stop_force("the instructor")
    result = run.run()
    stopped = result.summary["device"]["stopped"]
    assert stopped["why"] == "the instructor"
    assert stopped["asked"] is True
    assert 0.0 <= stopped["after_s"] < 1.0
    assert judge(result.summary)["passive"] is True
    assert result.summary["motion"]["peak_force_N"] < 1e-9 or stopped["after_s"] > 0.0
    assert run.device_endpoint.session.signals.heard[STOP] == "the instructor"
