"""Simulated hands: where they start and end, how smooth they are, and the recorded hand."""

import csv
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hapnet.errors import InvalidParameter
from hapnet.plant.generated_hand import GeneratedHand
from hapnet.plant.operator import HeldAtEnd, Impedance, Operator, Press, Recorded, Rest, Sine, hand_path, minimum_jerk
from hapnet.recording.motion import read_motion

HAND = Impedance()


def sampled(operator: Recorded | Press | Sine, seconds: float) -> np.ndarray:
    return np.array([operator.reference(i * 1e-3) for i in range(int(seconds * 1000))])


def test_minimum_jerk_has_its_boundary_conditions_and_peak_speed() -> None:
    """Flash and Hogan: rest to rest, peak speed 15/8 of the mean at the middle."""
    h = 1e-5
    assert [minimum_jerk(s) for s in (-1.0, 0.0, 0.5, 1.0, 2.0)] == [0.0, 0.0, 0.5, 1.0, 1.0]
    assert (minimum_jerk(0.5 + h) - minimum_jerk(0.5 - h)) / (2 * h) == pytest.approx(15.0 / 8.0)
    assert minimum_jerk(h) / h < 1e-8
    assert (1.0 - minimum_jerk(1.0 - h)) / h < 1e-8


def test_press_waits_presses_holds_and_withdraws() -> None:
    press = Press((0.0,), (0.04,), HAND, reach=1.0, hold=1.5, wait=0.5)
    for t, x in ((0.0, 0.0), (0.5, 0.0), (1.0, 0.02), (1.5, 0.04), (2.9, 0.04), (3.5, 0.02), (4.0, 0.0), (5.0, 0.02)):
        assert press.reference(t)[0] == pytest.approx(x, abs=1e-12)


def test_sine_and_rest() -> None:
    sine = Sine(2, HAND, amplitude=0.03, frequency=0.5)
    for t in (0.0, 0.3, 1.7):
        assert math.hypot(*sine.reference(t)) == pytest.approx(0.03)
    assert Rest(3, HAND).reference(12.0) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("rests_at", [None, (0.01,)])
def test_a_hand_that_ends_blends_from_its_motion_to_rest(rests_at: tuple[float, ...] | None) -> None:
    """By 10 s^3 - 15 s^4 + 6 s^5, which is 0.104 at a quarter of the time, and 1/2 at half."""
    sine = Sine(1, HAND, amplitude=0.03, frequency=0.5)
    held = HeldAtEnd(sine, 2.3, 0.4, rests_at)
    (rest,) = rests_at or sine.reference(2.3)
    for t, share in ((0.7, 0.0), (2.3, 0.0), (2.4, 0.103515625), (2.5, 0.5), (2.7, 1.0), (9.0, 1.0)):
        (moving,) = sine.reference(t)
        assert held.reference(t)[0] == pytest.approx((1.0 - share) * moving + share * rest, rel=1e-12)


def test_recorded_hand_follows_its_samples_and_bridges_its_gaps(handwriting: Path) -> None:
    with handwriting.open() as lines:
        rows = list(csv.DictReader(lines))
    t = np.array([float(row["time_s"]) for row in rows])
    xy = np.array([[float(row["x_m"]), float(row["y_m"])] for row in rows])
    pressure = np.array([float(row["pressure"]) for row in rows])
    down = np.array([row["pen_down"] == "1" for row in rows])
    hand = read_motion(str(handwriting), 3, HAND, press_depth=0.008, hover=0.006)
    lead = 0.08
    points = sampled(hand, hand.duration)

    writing = [i for i in range(2, len(t) - 2) if down[i - 2 : i + 3].all() and t[i + 2] - t[i - 2] < 0.05]
    assert len(writing) > 600
    for i in writing:
        assert hand.reference(t[i] + lead)[:2] == pytest.approx(xy[i], abs=2e-4)
    deep = np.array([hand.reference(t[i] + lead)[2] for i in writing])
    assert np.corrcoef(deep, -pressure[writing])[0, 1] > 0.9
    assert deep.min() >= -0.008
    assert points[:, 2].max() == pytest.approx(0.006)

    for at in np.flatnonzero(np.diff(t) > 0.2):  # long gaps: the pen is up in the middle
        assert hand.reference((t[at] + t[at + 1]) / 2 + lead)[2] == pytest.approx(0.006, abs=1e-4)
    speed = np.linalg.norm(np.diff(points, axis=0), axis=1) / 1e-3
    assert speed.max() < 0.6  # the recording jumps at 3.7 m/s where the pen was lost


def test_recorded_hand_starts_and_ends_lifted_and_repeats(handwriting: Path) -> None:
    hand = read_motion(str(handwriting), 3, HAND)
    assert hand.reference(0.0)[2] == pytest.approx(0.006, abs=1e-4)
    assert hand.reference(hand.duration + 2.0) == pytest.approx(hand.reference(2.0), abs=1e-9)


def test_a_plain_recording(tmp_path: Path) -> None:
    file = tmp_path / "m.csv"
    file.write_text("time_s,x_m\n" + "\n".join(f"{i / 100},{0.01 * math.sin(i / 20)}" for i in range(200)))
    hand = read_motion(str(file), 1, HAND)
    for t in np.linspace(0.1, 1.8, 50):
        assert hand.reference(float(t))[0] == pytest.approx(0.01 * math.sin(t * 5), abs=2e-6)


@pytest.mark.parametrize(
    ("text", "dof"),
    [
        ("a,b\n1,2\n", 1),
        ("time_s,x_m\n0,1\n0,2\n", 1),
        ("time_s,x_m\n0,one\n1,2\n", 1),
        ("time_s,x_m\n0,nan\n1,2\n", 1),
        ("time_s,x_m\n0,0\n1,2\n", 2),
        ("", 1),
    ],
)
def test_what_is_no_recording_is_refused(tmp_path: Path, text: str, dof: int) -> None:
    file = tmp_path / "m.csv"
    file.write_text(text)
    with pytest.raises(InvalidParameter, match="operator"):
        read_motion(str(file), dof, HAND)


def test_a_missing_recording_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidParameter, match="nowhere"):
        read_motion(str(tmp_path / "nowhere.csv"), 1, HAND)


@pytest.mark.parametrize(
    "make",
    [
        lambda: Rest(2, HAND, (0.01, -0.02)),
        lambda: Sine(2, HAND, 0.03, 0.7, (0.001, 0.0), start_s=0.9),
        lambda: Press((0.0, -0.0), (0.04, -0.03), HAND, reach=0.7, hold=0.4, wait=0.3),
        lambda: GeneratedHand(np.random.default_rng(5), (0.6, 0.8), HAND, HAND),
        lambda: HeldAtEnd(Sine(2, HAND), 30.0, 1.0),
    ],
)
def test_the_path_of_many_ticks_has_the_bits_of_each(make: Callable[[], Operator]) -> None:
    times = np.arange(1, 70_000, 7) * 1e-3
    each = make()
    assert hand_path(make(), times).tobytes() == np.array([each.reference(t) for t in times.tolist()]).tobytes()
