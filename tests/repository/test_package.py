"""The package as an index and a stranger's machine see it: its page, its pages, and the types of what README shows."""

import json
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import hapnet
from hapnet.ext.page.commands.options import PageOptions
from tests.conftest import ROOT
from tests.support.notebooks import NOTEBOOKS, code
from tests.support.pages import ALL, PAGES, check_words


def test_on_an_index_no_link_of_the_readme_is_relative() -> None:
    """By the project's own substitutions, as they are given to whoever builds the package."""
    project = tomllib.loads(text("pyproject.toml"))
    hook = project["tool"]["hatch"]["metadata"]["hooks"]["fancy-pypi-readme"]
    page = text("README.md")
    for each in hook["substitutions"]:
        page = re.sub(each["pattern"], each["replacement"], page)
    assert not [target for target in re.findall(r"\]\(([^)\s]+)\)", page) if "://" not in target]
    pictures = re.findall(r"!\[([^\]]+)\]", text("README.md"))
    assert pictures
    assert all(f"*{what}.*" in page for what in pictures)
    assert "```mermaid" not in page  # an index does not draw it
    assert "<!--" not in page  # and shows it


INSTALL = (ROOT / ".site" / "pages" / "install.md").read_text("utf-8")


def test_every_line_that_installs_names_this_package_and_its_extras() -> None:
    extras = tomllib.loads(text("pyproject.toml"))["project"]["optional-dependencies"]
    lines = [line for line in INSTALL.splitlines() if re.match(r"(uv|uvx|pipx|python3 -m venv) ", line)]
    assert len(lines) == 6
    for line in lines:
        (asked,) = re.findall(r"(?:\.|hapnet)\[([\w,]+)\]", line)
        assert set(asked.split(",")) <= set(extras)
    named = re.findall(r"(?m)^\| (`.*`) \| [^|]+ \|$", INSTALL)
    assert {name for names in named for name in re.findall(r"`([\w-]+)`", names)} <= set(extras)


def test_no_page_installs_this_package_from_an_index_that_does_not_have_it_yet() -> None:
    for page in PAGES:
        assert not re.search(r"(pip|pipx|uv|uvx)[^`\n]* '?hapnet-haptics", page.read_text("utf-8")), page


def test_the_container_runs_what_the_pages_say() -> None:
    """On a version of Python that the package names, with files and extras that exist, as a user of its own."""
    file = text(".docker/Dockerfile")
    project = tomllib.loads(text("pyproject.toml"))["project"]
    (version,) = set(re.findall(r"(?m)^FROM python:(3\.\d+)-slim", file))
    assert f"Programming Language :: Python :: {version}" in project["classifiers"]
    copied = [word for line in re.findall(r"(?m)^COPY (.+) \S+$", file) for word in line.split()]
    kept = {line[1:] for line in text(".docker/Dockerfile.dockerignore").splitlines() if line.startswith("!")}
    assert set(copied) == kept
    assert all((ROOT / name).exists() for name in copied)
    (extras,) = re.findall(r"whl\)\[([\w,]+)\]", file)
    assert set(extras.split(",")) <= set(project["optional-dependencies"])
    entry, command = (json.loads(re.findall(rf"(?m)^{word} (.+)$", file)[0]) for word in ("ENTRYPOINT", "CMD"))
    assert [*entry, *command] == ["hapnet", "run"]
    assert entry[0] in project["scripts"]
    assert file.index("\nUSER 1000\n") < file.index("\nENTRYPOINT")
    assert str(PageOptions().port) in re.findall(r"(?m)^EXPOSE (.+)$", file)[0].split()
    for line in re.findall(r"(?m)^docker .+$", INSTALL):
        assert re.search(rf"(?m)^# +{re.escape(line)}(  |$)", file), line
        if words := re.search(r"-p \S+ (hapnet .+)$", line):
            check_words(["hapnet", *words[1].split()[1:]])


def test_pages_that_messages_name_are_beside_the_code() -> None:
    """Those of the installed package, which may be a wheel."""
    from hapnet.ext.doctor import device

    pages = [value for value in vars(device).values() if isinstance(value, Path)]
    assert pages
    assert all(page.is_relative_to(Path(hapnet.__file__).parent) and page.is_file() for page in pages)


@pytest.mark.slow
def test_what_readme_and_examples_show_has_strict_types(tmp_path: Path) -> None:
    """By pyright, as editors do. The programs that draw README's pictures are not among them: matplotlib's own types
    have gaps; nor the packages for LeRobot, which is not installed here."""
    pytest.importorskip("pyright")
    shown = [block for block in ALL if block.page == ROOT / "README.md" and block.language == "python"]
    for number, block in enumerate(shown):
        (tmp_path / f"readme_{number}.py").write_text(block.text, "utf-8")
    shutil.copytree(
        ROOT / "examples", tmp_path / "examples", ignore=shutil.ignore_patterns("pictures", "lerobot", "__pycache__")
    )
    for notebook in NOTEBOOKS:  # whose cells end in what they show
        text = "\n".join(["# pyright: reportUnusedExpression=false", *code(notebook)])
        (tmp_path / f"{notebook.stem}_cells.py").write_text(text, "utf-8")
    settings = {"typeCheckingMode": "strict", "extraPaths": [str(Path(hapnet.__file__).parents[1])]}
    (tmp_path / "pyrightconfig.json").write_text(json.dumps(settings), "utf-8")
    command = [sys.executable, "-m", "pyright", "--pythonpath", sys.executable, "--outputjson", "-p", str(tmp_path)]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    if not done.stdout.startswith("{"):
        pytest.skip(f"pyright is not to be had: {(done.stderr or done.stdout).strip()[-200:]}")
    found = json.loads(done.stdout)
    assert not [each for each in found["generalDiagnostics"] if each["severity"] == "error"]
    assert found["summary"]["filesAnalyzed"] == len(list(tmp_path.rglob("*.py"))) > len(shown) >= 1


def text(name: str) -> str:
    return (ROOT / name).read_text("utf-8")


def test_the_version_is_the_newest_of_the_changelog() -> None:
    version = tomllib.loads(text("pyproject.toml"))["project"]["version"]
    cited = re.search(r"(?m)^version: (.+)$", text("CITATION.cff"))
    assert re.findall(r"(?m)^## (.+)$", text("CHANGELOG.md"))[0] == version
    assert cited[1] == version
