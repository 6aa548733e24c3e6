"""The coupling tdpa between real processes."""

from typing import Any

import pytest

from tests.support.processes import started


@pytest.mark.slow
@pytest.mark.parametrize(
    "more", [(), pytest.param(("--realtime",), marks=pytest.mark.soak)], ids=["thread", "realtime"]
)
def test_over_zenoh(more: tuple[str, ...], tmp_path: Any) -> None:
    words = ("run", "--coupling", "tdpa", "--duration", 3, "--seed", 1, "--json", "-", "--out", tmp_path / "run")
    with started(*words, *more) as program:
        summary = program.summary()
    assert summary["coupling"] == "tdpa"
    assert summary["motion"]["contacts"] >= 1
    assert summary["motion"]["peak_force_N"] > 0.1
    assert summary["theorem"]["margin_J"] > 0.0
    assert all(set(summary[side]["dropped"]) <= {"stale", "closed", "unpaired"} for side in ("device", "world"))
