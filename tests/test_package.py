"""What the package says of itself is the same everywhere."""

from __future__ import annotations

import re
import tomllib

from tests.conftest import ROOT


def text(name: str) -> str:
    return (ROOT / name).read_text("utf-8")


def test_the_version_is_the_newest_of_the_changelog() -> None:
    version = tomllib.loads(text("pyproject.toml"))["project"]["version"]
    cited = re.search(r"(?m)^version: (.+)$", text("CITATION.cff"))
    assert re.findall(r"(?m)^## (.+)$", text("CHANGELOG.md"))[0] == version
    assert cited is not None
    assert cited[1] == version
