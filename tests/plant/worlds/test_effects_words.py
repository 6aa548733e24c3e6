"""Effects of a solid's surface from its words, and grains from files."""

from pathlib import Path

import pytest

from hapnet.errors import InvalidParameter
from hapnet.ext.solids.effects_words import read_grain
from hapnet.ext.solids.rigid import rigid
from hapnet.mechanics.effects import Effects, Grain


def test_words_of_a_scene() -> None:
    text = "plane?grain=0.2mm,2mm&grain_along=0,0,1&stick=0.5&viscosity=2&snap=1,5mm"
    (solid,) = rigid(text).contacts.solids
    assert solid.effects == Effects(2.0, 0.5, 1.0, 0.005, Grain.sine(2e-4, 2e-3, (0.0, 0.0, 1.0)))
    (plain,) = rigid("plane?viscosity=0").contacts.solids
    assert plain.effects is None


def written(path: Path, text: str) -> str:
    path.write_text(text)
    return str(path)


def test_a_recorded_grain_is_read(tmp_path: Path) -> None:
    rows = "distance_m,height_m\n0,0\n0.001,0.0002\n0.002,-0.0001\n0.003,0\n"
    grain = read_grain(written(tmp_path / "g.csv", rows), (0.0, 0.0, 3.0))
    assert grain == Grain.of([0.0, 2e-4, -1e-4, 0.0], 0.004, (0.0, 0.0, 1.0))
    (solid,) = rigid(f"plane?grain={tmp_path}/g.csv").contacts.solids
    assert solid.effects.grain == grain._replace(wave=(0.0, grain.wave[2], 0.0))


def test_the_mark_with_which_some_editors_begin_a_file_is_no_part_of_it(tmp_path: Path) -> None:
    rows = "\ufeffdistance_m,height_m\n0,0\n0.001,0.0002\n"
    assert read_grain(written(tmp_path / "g.csv", rows), (0.0, 1.0, 0.0)).height_m == 2e-4


@pytest.mark.parametrize("height", [1e-310, 5e-324, 1e-3])
def test_the_highest_sample_is_whole_however_low_a_grain_is(height: float) -> None:
    assert Grain.of([0.0, height, -height], 1e-3, (1.0,)).shape == bytes([0, 127, 129])


@pytest.mark.parametrize("height", [float("nan"), float("inf")])
def test_a_grain_that_is_not_finite_is_refused_with_a_count(height: float) -> None:
    with pytest.raises(InvalidParameter, match="64 heights, 64 of them not finite"):
        Grain.sine(height, 1e-3, (1.0,))
    with pytest.raises(InvalidParameter, match="3 heights, 1 of them"):
        Grain.of([0.0, height, 0.0], 1e-3, (1.0,))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "not empty"),
        ("0,0\n1,1\n", "first line is distance_m,height_m"),
        ("distance_m,height_m\n0,0\n", "2 to 256 rows"),
        ("distance_m,height_m\n" + "".join(f"{i},0\n" for i in range(257)), "2 to 256 rows"),
        ("distance_m,height_m\n0,0\n1,x\n", "two finite numbers"),
        ("distance_m,height_m\n0,0\n1,2,3\n", "two finite numbers"),
        ("distance_m,height_m\n0,0\n1,nan\n", "two finite numbers"),
        ("distance_m,height_m\n0,0\n1,0\n3,0\n", "evenly spaced"),
        ("distance_m,height_m\n1,0\n2,0\n", "evenly spaced"),
        ("distance_m,height_m\n0,0\n0,0\n", "evenly spaced"),
        ("distance_m,height_m\n0,0\n1,0.5\n", "0 to 0.1"),
        ("distance_m,height_m\n0,0\n0.000001,0.0005\n", r"within \+-100000"),
    ],
)
def test_a_grain_that_is_wrong_is_refused_in_one_line(text: str, says: str, tmp_path: Path) -> None:
    with pytest.raises(InvalidParameter, match=says) as refused:
        rigid(f"plane?grain={written(tmp_path / 'g.csv', text)}")
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    "words", ["grain=1,2mm", "grain=0.1mm", "grain=0.1mm,0mm", "grain_along=1,0,0", "snap=1", "snap=1,5", "stick=-1",
              "viscosity=x", "snap=1000,1mm", "grain=gone.csv"],
)  # fmt: skip
def test_words_that_are_wrong_are_refused(words: str) -> None:
    with pytest.raises(InvalidParameter):
        rigid(f"plane?{words}")
