"""The page as it is without plotly, wherever the tests run; `tests/plots/test_zoomed.py` has the one with it."""

import pytest


@pytest.fixture(autouse=True)
def plain(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hapnet.ext.pictures.zoomed.can_zoom", lambda: False)
