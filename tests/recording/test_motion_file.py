"""CSV files of other people: the line of a fault, units, and columns by name or by parameter."""

import math
from pathlib import Path

import numpy as np
import pytest

from hapnet.cli import main
from hapnet.errors import InvalidParameter
from hapnet.recording.motion_file import read_columns

ROWS = [(0.01 * i, 0.03 * math.sin(0.03 * i)) for i in range(500)]
"""Five seconds at 100 Hz."""


def write(path: Path, heading: str = "time_s,x_m", *, rows: list[tuple[object, ...]] | None = None) -> str:
    given: list[tuple[object, ...]] = list(ROWS) if rows is None else rows
    path.write_text("\n".join([heading, *(",".join(map(str, row)) for row in given)]) + "\n")
    return str(path)


def refusal(file: str, columns: str = "") -> str:
    with pytest.raises(InvalidParameter) as info:
        read_columns(file, columns)
    assert "\n" not in str(info.value)
    return str(info.value)


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ((0.03, ""), "line 5: x_m is missing"),
        ((0.03,), "line 5: x_m is missing"),
        ((0.03, "nan"), "line 5: x_m is 'nan', not a finite number below 1e+12"),
        ((0.03, "1.2.3"), "line 5: x_m is '1.2.3', not a finite number below 1e+12"),
        ((0.01, 0.0), "line 5: its time, 0.01 s, is not after the one before, 0.02 s"),
        ((0.02, 0.0), "line 5: its time, 0.02 s, is not after the one before, 0.02 s"),
    ],
)
def test_a_fault_names_its_line(tmp_path: Path, wrong: tuple[object, ...], says: str) -> None:
    """Line 5 of an editor: the heading, three rows, and this one."""
    file = write(tmp_path / "hand.csv", rows=[*ROWS[:3], wrong, *ROWS[4:]])
    assert refusal(file) == f"operator {file}: {says}"


def test_blank_lines_are_left_out_and_counted(tmp_path: Path) -> None:
    path = tmp_path / "hand.csv"
    path.write_text("time_s,x_m\n0,0\n\n0.1,0\n\n0.1,0\n")
    assert "line 6: its time" in refusal(str(path))


def test_a_file_without_a_heading_says_so(tmp_path: Path) -> None:
    assert "line 1 has no names; write a heading with time_s and x_m" in refusal(write(tmp_path / "a.csv", "0.0,0.0"))


def test_units_are_read_from_the_names(tmp_path: Path) -> None:
    plain = read_columns(write(tmp_path / "a.csv"))
    scaled = [(1e3 * t, 1e3 * x) for t, x in ROWS]
    for heading, of_time, of_place in (("time_ms,x_mm", 1.0, 1.0), ("time_us,x_um", 1e3, 1e3)):
        rows: list[tuple[object, ...]] = [(of_time * t, of_place * x) for t, x in scaled]
        found = read_columns(write(tmp_path / "b.csv", heading, rows=rows))
        assert list(found) == ["time_s", "x_m"]
        np.testing.assert_allclose(found["time_s"], plain["time_s"], rtol=1e-12)
        np.testing.assert_allclose(found["x_m"], plain["x_m"], rtol=1e-12, atol=1e-15)


def test_other_names_are_chosen_by_the_parameter_and_the_refusal_says_how(tmp_path: Path) -> None:
    file = write(tmp_path / "a.csv", "timestamp,px", rows=[(t, 1e3 * x) for t, x in ROWS])
    line = refusal(file)
    assert "line 1 has the columns timestamp, px, and no time_s and x_m" in line
    assert '--set operator_model.columns="time_s=timestamp x_m=px"' in line
    found = read_columns(file, "time_s=timestamp x_mm=px")
    np.testing.assert_allclose(found["x_m"], [x for _, x in ROWS], atol=1e-15)
    assert "columns of" in refusal(file, "time_s=timestamp x_mm=py")
    assert "pairs NAME=COLUMN" in refusal(file, "seconds=timestamp")


def test_a_chosen_column_takes_precedence_over_a_name(tmp_path: Path) -> None:
    file = write(tmp_path / "a.csv", "time_s,x_m,filtered", rows=[(t, 9.0, x) for t, x in ROWS])
    np.testing.assert_allclose(read_columns(file, "x_m=filtered")["x_m"], [x for _, x in ROWS])


def test_semicolons_with_decimal_commas_are_read(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("time_s;x_m\n" + "\n".join(f"{t};{x}".replace(".", ",") for t, x in ROWS))
    np.testing.assert_allclose(read_columns(str(path))["x_m"], [x for _, x in ROWS])


def test_milliseconds_taken_for_seconds_are_noticed(tmp_path: Path) -> None:
    """500 rows 10 s apart, and the same of a recording at 1 kHz, which a limit of 3600 s would not refuse."""
    for step_s in (10.0, 1.0):
        rows: list[tuple[object, ...]] = [(step_s * i, x) for i, (_, x) in enumerate(ROWS)]
        line = refusal(write(tmp_path / "a.csv", rows=rows))
        assert f"its rows are {step_s:g} s apart, and it moves at " in line
        assert "are the times milliseconds? Then name the column time_ms" in line


def test_a_hand_that_lasts_milliseconds_is_noticed(tmp_path: Path) -> None:
    rows: list[tuple[object, ...]] = [(1e-3 * t, x) for t, x in ROWS]
    line = refusal(write(tmp_path / "a.csv", rows=rows))
    assert "it lasts 4.99 ms in 500 rows (are the times in another unit than s?)" in line


def test_slow_or_sparse_hands_are_read(tmp_path: Path) -> None:
    """A key pose every few seconds, and a slow hand at 100 Hz."""
    keys: list[tuple[object, ...]] = [(5.0 * i, 0.01 * i) for i in range(6)]
    assert len(read_columns(write(tmp_path / "a.csv", rows=keys))["x_m"]) == 6
    slow: list[tuple[object, ...]] = [(t, 1e-3 * x) for t, x in ROWS]
    assert len(read_columns(write(tmp_path / "b.csv", rows=slow))["x_m"]) == 500


def test_the_command_takes_the_parameter(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = write(tmp_path / "a.csv", "stamp,px", rows=[(1e3 * t, 1e3 * x) for t, x in ROWS])
    words = ["simulate", "--operator", file, "--duration", "0.3", "--no-files"]
    assert main(words) == 2
    assert main([*words, "--set", "operator_model.columns=time_ms=stamp x_mm=px"]) == 0
    assert "PASSIVE" in capsys.readouterr().out
