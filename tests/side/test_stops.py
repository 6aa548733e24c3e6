"""What stops a robot, of each kind: the rows and columns of `hapnet/devices/stops.md`."""

from pathlib import Path

import numpy as np
import pytest

from hapnet import simulate
from hapnet.errors import InvalidParameter
from tests.conftest import mostly_slow
from tests.measure.stops import CAUSES, KINDS, ONE_WAY_MS, Rig, moved_mm

CELLS = [(kind, cause) for kind in KINDS for cause in CAUSES]
FIRST = [*zip(KINDS, CAUSES, strict=False), *[one for one in CELLS if one not in zip(KINDS, CAUSES, strict=False)]]


@pytest.mark.parametrize(("kind", "cause"), mostly_slow(FIRST, 4))
def test_the_robot_stands_still_0_2_s_and_one_way_later(kind: str, cause: str, tmp_path: Path) -> None:
    before, after = moved_mm(kind, cause, tmp_path, 1)
    assert before > 5.0, "it was moving"
    assert after < 2.5


LAW_CELLS = [("four-channel", "silent leader"), *((law, cause) for law in ("pp", "pf") for cause in CAUSES)]


@pytest.mark.parametrize(("law", "cause"), mostly_slow(LAW_CELLS, 1))
def test_so_it_does_with_a_law_between_two_robots(law: str, cause: str, tmp_path: Path) -> None:
    before, after = moved_mm("simulated", cause, tmp_path, 1, coupling=law)
    assert before > 5.0, "it was moving"
    assert after < 2.5


GRIP = {
    "operator": "press", "operator_model.wait_s": 0.1, "operator_model.reach_s": 0.5, "operator_model.hold_s": 60.0,
}  # fmt: skip
JAWS = {
    "simulated": {"scene": "grip:hard", **GRIP},
    "driver": {"scene": "grip:empty", "follower.robot": "tests.measure.stops:JawArm", **GRIP},
}
JAW_CELLS = [
    (k, c) for k in JAWS for c in CAUSES if (k, c) not in (("simulated", "silent leader"), ("driver", "dead-man"))
]


@pytest.mark.parametrize(
    ("kind", "cause"), mostly_slow([("simulated", "silent leader"), ("driver", "dead-man"), *JAW_CELLS], 2)
)
def test_a_closed_jaw_stays_closed(kind: str, cause: str, tmp_path: Path) -> None:
    """Its spring still pulls it into the object: 20 mm of the hand's way are 2 N and more."""
    rig = Rig(kind, tmp_path, 3, **JAWS[kind])
    closed = rig.run(1500)[-1][1]
    assert closed < 0.03, "it touches the object"
    rig.stop(cause)
    after = [x for _, x in rig.run(6500)]
    assert max(after) - min(after) < 1e-4
    assert 5000.0 * (0.03 - after[-1]) == pytest.approx(5000.0 * (0.03 - closed), rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("kind", JAWS)
def test_a_released_jaw_has_no_force_and_drops_what_it_holds(kind: str, tmp_path: Path) -> None:
    rig = Rig(kind, tmp_path, 3, **JAWS[kind], **{"follower.on_stop": "release"})
    assert rig.run(1500)[-1][1] < 0.03
    rig.stop("dead-man")
    assert rig.run(3000)[-1][1] >= 0.03 - 1e-6


@pytest.mark.parametrize(
    ("kind", "held_again_ms"),
    mostly_slow([("driver", 4200), ("driver", 2800), ("simulated", 4200), ("simulated", 2800)], 1),
)
def test_a_jaw_that_was_stopped_is_led_from_where_it_is(kind: str, held_again_ms: int, tmp_path: Path) -> None:
    """A hand that takes the switch again, and is open, does not drop the object; one that is closed opens the jaw."""
    changes = JAWS[kind] | {"operator_model.hold_s": 0.5, "operator_model.wait_s": 1.0}
    rig = Rig(kind, tmp_path, 3, **changes)  # the hand is closed from 1.5 to 2.0 s and from 4.0 to 4.5 s
    closed = rig.run(1900)[-1][1]
    rig.stop("dead-man")
    assert max(x for _, x in rig.run(held_again_ms)) < closed + 1e-4
    rig.resume("dead-man")
    last = rig.run(held_again_ms + 800)[-1][1]
    assert last > 0.045 if held_again_ms == 4200 else last < closed + 1e-3


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "cause"), [("driver", "dead-man"), ("simulated", "remote stop")])
def test_a_robot_that_is_released_has_no_force(kind: str, cause: str, tmp_path: Path) -> None:
    before, after = moved_mm(kind, cause, tmp_path, 2, **{"follower.on_stop": "release"})
    assert before > 5.0
    assert after < 2.5


@pytest.mark.parametrize(
    ("kind", "cause", "on_stop"),
    mostly_slow([
        ("driver", "dead-man", "freeze"), ("simulated", "silent leader", "freeze"),
        ("position arm", "closed page", "freeze"), ("driver", "dead-man", "release"),
        ("simulated", "closed page", "release"),
    ], 2),
)  # fmt: skip
def test_afterwards_it_is_led_from_where_it_is(kind: str, cause: str, on_stop: str, tmp_path: Path) -> None:
    """However far the hand went alone; the force of the robot and of the hand grow by no more than their limits."""
    rig = Rig(kind, tmp_path, 3, **{"follower.on_stop": on_stop})
    rig.run(700)
    rig.stop(cause)
    stands = rig.run(1700)[-1][1]
    alone = rig.device.device.read()[0][0]
    rig.resume(cause)
    again = rig.run(1700 + 2 * ONE_WAY_MS + 30)
    hand = abs(rig.device.device.read()[0][0] - alone)
    assert max(abs(x - stands) for _, x in again) < hand + 5e-3, "it does not go to where the hand went alone"
    later = rig.run(2600)
    assert np.ptp([x for _, x in later]) > 0.02, "it is led"


def test_it_moves_only_while_the_device_is_held() -> None:
    params = {
        "follower.robot": "simulated", "scene": "free", "operator": "sine", "operator_model.amplitude_m": 0.06,
        "device.servo": "sampled", "duration_s": 2.0, "device.enable": "0-0.8, 1.6-9", "link.up": "delay 20ms",
        "link.down": "delay 20ms", "record_hz": 1000.0,
    }  # fmt: skip
    result = simulate(params, 1)
    device, world = result.recording.device, result.recording.world
    assert device is not None
    assert world is not None
    since, later = device["time_s"], world["time_s"]
    alone = (since > 0.81) & (since < 1.55)  # its times count from its own start, a little before the run's
    assert np.ptp(device["position_m"][alone][:, 0]) < 1e-3
    assert np.abs(device["force_N"][alone]).max() == 0.0
    assert np.ptp(world["position_m"][(later > 1.02) & (later < 1.6)][:, 0]) < 1e-4
    assert np.abs(np.diff(device["force_N"], axis=0)[since[1:] > 1.55]).max() <= 0.5 + 1e-9
    assert np.abs(np.diff(world["coupling_force_N"], axis=0)[later[1:] > 1.55]).max() <= 0.5 + 1e-9
    assert result.summary["verdict"]["passive"]


@pytest.mark.parametrize("wrong", ["held", "3-2", "hold"])
def test_who_holds_a_device_must_be_known(wrong: str) -> None:
    with pytest.raises(InvalidParameter, match=r"device\.enable"):
        simulate({"device.enable": wrong, "device.servo": "sampled", "duration_s": 0.1})
