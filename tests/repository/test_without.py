"""The core runs alone: a simulation at a flat wall needs no extension."""

import pytest

from tests.measure.without import EXTENSIONS, loaded_without


def test_a_flat_wall_needs_no_extension() -> None:
    assert len(EXTENSIONS) > 10
    modules, _ = loaded_without("hapnet.ext")
    assert modules < 210  # 201 on 28 November 2026; the aim is 100


def test_what_a_run_needs_is_missed() -> None:
    with pytest.raises(RuntimeError, match=r"^ImportError: hapnet\.side is blocked$"):
        loaded_without("hapnet.side")
