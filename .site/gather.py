"""A hook of mkdocs: the pages of the site are those that lie beside the code, with the files that they show or link.

A page keeps its path in the repository, so links between pages hold as they stand. Its address is shorter where the
path begins with `.site/pages/` or `.github/`.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files, InclusionLevel

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = ("hapnet", "netem", "examples", "tests", ".github", ".site/pages")
SITE = Path(".site/pages")

_LINK = re.compile(r"\]\(([^)\s#]+)")
_FENCED = re.compile(r"(?ms)^```.*?^```$")
_FOR_TESTS = re.compile(r"(?m)^<!-- .+ -->\n(?=```)")


def pages() -> list[Path]:
    """All pages, from the repository's root."""
    found = [file for folder in FOLDERS for file in (ROOT / folder).rglob("*.md")]
    return [Path("README.md"), Path("CHANGELOG.md"), *sorted(file.relative_to(ROOT) for file in found)]


def on_files(files: Files, config: Any) -> Files:
    """In place of the folder's own pages: every page, by its path, and what pages link to."""
    for own in files.documentation_pages():
        files.remove(own)
    linked: set[Path] = set()
    for page in pages():
        text = _FENCED.sub("", (ROOT / page).read_text("utf-8"))
        near = ((ROOT / page.parent / link).resolve() for link in _LINK.findall(text) if "://" not in link)
        linked |= {file.relative_to(ROOT) for file in near if file.is_file() and file.suffix != ".md"}
        files.append(_file(page, config))
    for file in sorted(linked):
        files.append(_file(file, config))
    return files


def _file(path: Path, config: Any) -> File:
    made = File.generated(config, str(path), abs_src_path=str(ROOT / path))
    made.inclusion = InclusionLevel.INCLUDED  # also below a folder whose name begins with a dot
    for hidden in (".site/pages/", ".github/"):
        made.dest_uri = made.dest_uri.removeprefix(hidden)
    return made


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Without the comments above blocks, which are for the tests."""
    return _FOR_TESTS.sub("", markdown)
