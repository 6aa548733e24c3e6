"""Names: a class that a reader meets is one and the same wherever its name stands."""

import re
from pathlib import Path

import pytest

from tests.conftest import ROOT


@pytest.mark.long
def test_a_class_name_stands_in_one_module() -> None:
    modules: dict[str, set[Path]] = {}
    for module in sorted((ROOT / "hapnet").rglob("*.py")):
        for name in re.findall(r"(?m)^ *class (\w+)[(:\[]", module.read_text("utf-8")):
            modules.setdefault(name, set()).add(module)
    several = {name: sorted(map(str, found)) for name, found in modules.items() if len(found) > 1}
    assert len(modules) > 500
    assert several.keys() <= {"Tuning"}, several  # each law's parameters are its tuning
