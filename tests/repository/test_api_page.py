"""The site's page of names: each exported name, at the place where it is defined."""

import importlib
import re
from pathlib import Path
from types import ModuleType

import pytest

import hapnet
import netem

PAGE = Path(__file__).resolve().parents[2] / ".site" / "pages" / "api.md"
SHOWN = re.findall(r"^::: (\S+)$", PAGE.read_text(), re.MULTILINE)


@pytest.mark.parametrize("path", SHOWN)
def test_a_name_on_the_page_is_defined_where_the_page_says(path: str) -> None:
    module, _, name = path.rpartition(".")
    shown = getattr(importlib.import_module(module), name)
    assert shown.__module__ == module


@pytest.mark.parametrize("package", [hapnet, netem])
def test_the_page_shows_all_that_is_exported(package: ModuleType) -> None:
    shown = {path.rpartition(".")[2] for path in SHOWN}
    data = {"PRESETS"}  # they have no docstring of their own: the pages of netem list them
    assert {name for name in package.__all__ if not name.startswith("__")} - data <= shown
