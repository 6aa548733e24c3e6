"""Studies of couplings with an arm as the device."""

import json
from pathlib import Path

import pytest

from hapnet.cli import main
from hapnet.errors import InvalidParameter
from hapnet.ext.arms.table import felt_damping, omni
from hapnet.ext.study.case import measure
from hapnet.ext.study.impedance import transmission
from hapnet.ext.study.stable_stiffness import cases
from hapnet.params import Params

ARM = Params().set({"hardware": "omni", "link.up": "4g", "link.down": "4g"})


@pytest.mark.slow
def test_a_comparison_takes_an_arm(tmp_path: Path) -> None:
    """Three axes, a case a coupling; both are passive and render the wall that the springs make."""
    words = ["compare", "--device", "omni", "--coupling", "pspm", "--coupling", "zoh", "--link", "4g", "--operator"]
    assert main([*words, "hand-3", "--duration", "4", "--workers", "1", "--out", str(tmp_path / "c")]) == 0
    found = json.loads((tmp_path / "c" / "compare.json").read_text("utf-8"))
    assert [case["coupling"] for case in found["cases"]] == ["pspm", "zoh", "local wall"]
    for case in found["cases"]:
        assert case["measures"]["margin_J"] >= 0.0
        assert 90.0 < case["measures"]["stiffness_percent"] < 115.0


def test_the_metrics_are_those_of_metres() -> None:
    with pytest.raises(InvalidParameter, match="one with axes in metres, as metrics are in mm and N"):
        measure(ARM.set({"hardware": "omni?axes=joints", "scene": "joints", "duration_s": 0.5}), 0)


def test_an_arm_has_its_own_damping_only() -> None:
    dampings = {case.own_damping for case in cases(ARM)}
    assert dampings == {felt_damping(omni())}
    assert len({case.own_damping for case in cases(Params())}) > 1


@pytest.mark.slow
def test_an_arm_transmits_the_walls_stiffness() -> None:
    """As two springs in a row would at rest; a network of a millisecond hides nothing of that."""
    found = transmission(ARM.set({"link.up": "lan", "link.down": "lan"}), 0, periods=2)
    for line, truth in zip(found.lines[:3], found.truth, strict=False):
        assert line.stiffness == pytest.approx(truth.real, rel=0.05)
