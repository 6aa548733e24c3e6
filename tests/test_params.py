"""Parameters: TOML there and back, `--set`, and one clear line for what is wrong."""

from __future__ import annotations

from pathlib import Path

import pytest

from hapnet.errors import InvalidParameter
from hapnet.params import Params


def test_shown_parameters_read_back_to_the_same(tmp_path: Path) -> None:
    changed = Params().set_words(
        ["world.wall.stiffness=30000", "device.stiffness=[[100, 5], [5, 80]]", "scene=box", "wire.accept_stale=true"]
    )
    file = tmp_path / "p.toml"
    file.write_text(changed.toml(), encoding="utf-8")
    assert Params().load(file) == changed
    assert changed.world.wall.stiffness == 30000.0


def test_defaults_are_section_4s() -> None:
    p = Params()
    assert (p.device.stiffness, p.device.damping, p.world.stiffness, p.world.damping) == (100.0, 0.1, 500.0, 14.0)
    assert (p.world.mass, p.world.wall.stiffness, p.world.wall.damping) == (0.02, 3000.0, 10.0)
    assert (p.device.servo_hz, p.device.pspm_period_s) == (1000.0, 0.005)
    assert (p.world.step_min_s, p.world.step_max_s) == (0.01, 0.05)


@pytest.mark.parametrize(
    ("word", "names"),
    [
        ("world.wal.stiffness=1", "world.wall.stiffness"),
        ("dof=1.5", "whole number"),
        ("device.servo=fast", "continuous"),
        ("duration_s", "NAME=VALUE"),
        ("world.step_min_s=3", "step_max_s"),
        ("world.mass=-1", "above 0"),
        ("device.smoothing_s=-1", "0 or above"),
        ("wire.accept_stale=1", "true or false"),
        ("device.servo_hz=[1]", "a number"),
        ("device.servo_hz=NaN", "finite"),
        ("duration_s=Infinity", "finite"),
        ("device.servo_hz=1e9", "20000"),
    ],
)
def test_what_is_wrong_is_named(word: str, names: str) -> None:
    with pytest.raises(InvalidParameter, match=names.replace(".", r"\.")):
        Params().set_words([word])


def test_a_file_that_is_no_toml(tmp_path: Path) -> None:
    file = tmp_path / "p.toml"
    file.write_text("not = [toml", encoding="utf-8")
    with pytest.raises(InvalidParameter, match="TOML"):
        Params().load(file)
