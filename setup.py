"""The page of the package on an index: README with absolute links, as nothing else of the repository is beside it.

All else is in pyproject.toml. `[project.urls]` there says where pictures and pages are, under "Repository".
"""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parent
_LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\]]*\])*)\]\((?!\w+://|#)([^)\s]+)\)")


def index_page(readme: str, repository: str | None, version: str) -> str:
    """README as an index shows it.

    repository : the address where pages and pictures of `version` are; None: there is none, so the page says in words
    what a picture shows, and links to nothing.
    """

    def absolute(found: re.Match[str]) -> str:
        picture, text, target = found.groups()
        if repository is None:
            return f"*{text}.*" if picture else text
        return f"{picture}[{text}]({repository}/{'raw' if picture else 'blob'}/v{version}/{target})"

    return _LINK.sub(absolute, readme)


if __name__ == "__main__":
    from setuptools import setup

    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    page = index_page(
        (ROOT / "README.md").read_text("utf-8"), project.get("urls", {}).get("Repository"), project["version"]
    )
    setup(long_description=page, long_description_content_type="text/markdown")
