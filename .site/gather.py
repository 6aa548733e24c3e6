"""A hook of mkdocs that collects the site: all pages of the repository, and the files that they show or link.

A page keeps its path in the repository, so links between pages work without changes. Its address is shorter where the
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
    """The paths of all pages, relative to the repository's root."""
    found = [file for folder in FOLDERS for file in (ROOT / folder).rglob("*.md")]
    return [Path("README.md"), Path("CHANGELOG.md"), *sorted(file.relative_to(ROOT) for file in found)]


def on_files(files: Files, config: Any) -> Files:
    """Replace the pages of `docs_dir` by every page of the repository and the files that pages link to."""
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
    made.inclusion = InclusionLevel.INCLUDED  # also in folders with a name that begins with a dot
    for hidden in (".site/pages/", ".github/"):
        made.dest_uri = made.dest_uri.removeprefix(hidden)
    return made


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Remove the comments above code blocks, which are for the tests."""
    return _FOR_TESTS.sub("", markdown)
