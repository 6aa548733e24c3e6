"""Every code block of README and of the pages runs, every command in them exists, and every link leads somewhere."""

import re
import sys
import tomllib
from pathlib import Path
from urllib.parse import unquote

import pytest

from examples.pictures.__main__ import FILM, RECIPES
from tests.conftest import ROOT
from tests.support.pages import (
    ALL,
    DATA_ONLY,
    MAINS,
    PAGES,
    Block,
    argv_of,
    check_words,
    prepare,
    run_python,
    run_shell,
)

HERE = [
    block for block in ALL if not block.why_not and not block.is_in_real_time and block.language in ("sh", "python")
]
EXTRAS = {
    "pandas": "pandas", "rosbag2": "rosbags", "mesh:": "igl", "mujoco": "mujoco", "sweep": "pyarrow", "tune": "optuna",
}  # fmt: skip


def marked(block: Block) -> object:
    marks = [pytest.mark.soak] if "soak" in block.words else [pytest.mark.slow] * ("slow" in block.words)
    return pytest.param(block, id=block.name, marks=marks)


@pytest.mark.parametrize("block", [marked(block) for block in HERE])
def test_a_block_runs(block: Block, certificates: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for word, module in EXTRAS.items():
        if word in block.text:
            pytest.importorskip(module, reason=f"{module} is not installed")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "mine", raising=False)
    monkeypatch.setenv("COLUMNS", "200")
    prepare(tmp_path, block.page, certificates)
    if block.language == "python":
        run_python(block.text)
    else:
        printed = run_shell(block)
        assert block.printed in (None, printed)


def test_every_block_is_run_or_says_why_not() -> None:
    for block in ALL:
        assert block.language in ("sh", "python", "toml", *DATA_ONLY), block.name
        assert block.words <= {"slow", "soak", "in two terminals"}, block.name
        if block.is_in_real_time:
            assert block.why_not or "slow" in block.words, f"{block.name} starts processes: it is slow"
        if block.language == "toml":
            tomllib.loads(block.text)
        if block.language == "text":
            assert block.why_not or any(other.printed == block.text for other in ALL), f"{block.name} follows no block"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_no_code_hides_from_the_tests(page: Path) -> None:
    """Indented code is not fenced, so that nothing would run it."""
    outside = re.sub(r"(?ms)^```.*?^```$", "", page.read_text("utf-8"))
    assert not re.search(r"(?m)^\n {4}\S", outside)


@pytest.mark.parametrize("block", [pytest.param(b, id=b.name) for b in ALL if b.language == "sh"])
def test_every_command_and_flag_exists(block: Block) -> None:
    for line in block.commands:
        argv = argv_of(line)
        if argv[0] in MAINS and "$" not in line and ">" not in argv:
            check_words(argv)


def test_every_picture_and_page_that_is_named_is_there() -> None:
    for page in PAGES:
        for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text("utf-8")):
            if "://" in target:
                continue
            file, _, anchor = unquote(target).partition("#")
            there = (page.parent / file).resolve() if file else page
            assert there.exists(), f"{page.relative_to(ROOT)} links to {target}"
            if anchor:
                assert anchor in anchors(there), f"{page.relative_to(ROOT)} links to {target}"


def test_every_page_stands_once_in_the_menu_of_the_site() -> None:
    """The site is built with `--strict`, which refuses a page that no menu leads to."""
    menu = re.findall(r"(?m)^ +- (?:.+: )?(\S+\.md)$", (ROOT / ".site" / "mkdocs.yml").read_text("utf-8"))
    there = [str(page.relative_to(ROOT)) for page in [*PAGES, ROOT / "CHANGELOG.md"]]
    assert sorted(menu) == sorted(there)


def anchors(page: Path) -> set[str]:
    """Of each heading, as GitHub makes them: small letters, blanks as dashes, no punctuation."""
    outside = re.sub(r"(?ms)^```.*?^```$", "", page.read_text("utf-8"))
    headings = re.findall(r"(?m)^#+ (.+)$", outside)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-") for heading in headings}


def test_the_readme_is_short_and_its_film_small() -> None:
    assert len((ROOT / "README.md").read_text("utf-8").split()) <= 650
    assert (ROOT / "examples" / "play.gif").stat().st_size <= 2_000_000


def test_every_picture_is_made_by_the_script_and_on_a_page() -> None:
    reported = " ".join(page.read_text("utf-8") for page in PAGES)
    pictures = {file.name for end in ("png", "gif") for file in (ROOT / "examples").glob(f"*.{end}")}
    made = {name for recipe in RECIPES for name in recipe.pictures if not name.endswith(".csv")}
    assert pictures == {FILM, *made}
    assert {name for name in pictures if f"examples/{name})" not in reported} == set()
