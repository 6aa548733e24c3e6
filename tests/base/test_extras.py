"""Without the extras a side runs; what needs one says so in a line, before anything has run."""

import subprocess
import sys
import tomllib
from importlib.metadata import PackageNotFoundError, packages_distributions, requires
from importlib.util import find_spec
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from hapnet import cli, installing
from hapnet.errors import MissingLibrary
from hapnet.recording.mcap import read_recording
from hapnet.simulation.simulation import simulate
from tests.conftest import ROOT, mostly_slow

WITHOUT = """
import sys
from importlib.abc import MetaPathFinder

class Absent(MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("mcap", "google", "matplotlib", "lz4", "zstandard"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Absent())
from hapnet.cli import main
sys.exit(main(sys.argv[1:]))
"""


WHERE_NEEDED = {"manifold3d"}
"""Libraries of extras that few scenes need; the code that needs one says so: see `test_mesh_parts.py`."""


IMPORT_ALL = """
import pkgutil
import sys
from importlib import import_module
from importlib.abc import MetaPathFinder

gone = set(sys.argv[1:])

class Absent(MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in gone:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Absent())
for name in ("hapnet", "netem"):
    for module in pkgutil.walk_packages(import_module(name).__path__, f"{name}.", onerror=lambda name: None):
        if module.name.endswith("__main__"):
            continue
        try:
            import_module(module.name)
        except ModuleNotFoundError as error:
            print(module.name, error.name)
"""

NEED_A_LIBRARY = {
    "hapnet.ext.page": {"viser", "websockets"},
    "hapnet.ext.devices.inverse3_emulator": {"websockets"},
    "hapnet.ext.devices.inverse3_safety": {"websockets"},
    "hapnet.ext.devices.websocket": {"websockets"},
    "hapnet.ext.compiled.twins": {"numba"},
    "hapnet.ext.compiled.whole_runs.run": {"numba"},
    "netem.pytest_plugin": {"pytest"},
}
"""Modules that import a library of an extra when they are imported: they are imported when the extra is asked for."""


def installed_with(extra: str) -> set[str]:
    """The names of the distributions that an installation with this extra brings."""
    found: set[tuple[str, str]] = set()
    open_ones = [("hapnet-haptics", extra)]
    while open_ones:
        one = open_ones.pop()
        if one in found:
            continue
        found.add(one)
        try:
            lines = requires(one[0]) or []
        except PackageNotFoundError:
            continue  # an optional part of a library
        for line in map(Requirement, lines):
            if line.marker is None or line.marker.evaluate({"extra": one[1]}):
                open_ones += [(canonicalize_name(line.name), part) for part in ("", *line.extras)]
    return {name for name, _ in found}


def absent(monkeypatch: pytest.MonkeyPatch, *modules: str) -> None:
    monkeypatch.setattr(installing, "find_spec", lambda name: None if name in modules else find_spec(name))


@pytest.mark.parametrize(
    ("command", "says"),
    [
        (["run"], "recordings and figures needs mcap and protobuf and matplotlib, of the extra `report`"),
        (["run", "--no-files"], "hapnet run needs mcap and protobuf, of the extra `record`"),
        (["simulate"], "extra `report`"),
        (["world"], "extra `report`"),
        (["device", "--record", "device.mcap"], "a recording needs mcap and protobuf, of the extra `record`"),
        (["replay", "run.mcap"], "extra `record`"),
        (["view", "run.mcap"], "extra `record`"),
        (["report", "run.mcap"], "hapnet report needs"),
        (["export", "run.mcap"], "reading a recording needs"),
        (["compare", "--link", "lan"], "hapnet compare needs"),
        (["transparency"], "extra `report`"),
        (["reproduce", "fig5"], "hapnet reproduce needs"),
    ],
)
def test_what_is_missing_is_one_line_at_the_start(
    command: list[str],
    says: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    absent(monkeypatch, "mcap", "google.protobuf", "matplotlib")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "run.mcap").write_bytes(b"\x89MCAP0\r\n")
    assert cli.main(command) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert says in line
    assert line.endswith(("install mcap protobuf", "install mcap protobuf matplotlib"))
    assert [file.name for file in tmp_path.iterdir()] == ["run.mcap"]


def test_only_what_is_missing_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    absent(monkeypatch, "matplotlib")
    with pytest.raises(MissingLibrary, match=r"^a figure needs matplotlib, of the extra `report`"):
        simulate({"duration_s": 0.1}).plot()
    with pytest.raises(MissingLibrary, match=r"install matplotlib$"):
        installing.require("report", "this")
    installing.require("record", "this")


def test_a_recording_is_not_read_without_its_library(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    absent(monkeypatch, "mcap")
    with pytest.raises(MissingLibrary, match="reading a recording needs mcap"):
        read_recording(tmp_path / "run.mcap")


@pytest.mark.parametrize(
    "command", mostly_slow([["simulate", "--no-files", "--duration", "0.2"], ["devices"], ["--version"]], 1)
)
def test_a_command_without_files_needs_no_extra(command: list[str], tmp_path: Path) -> None:
    done = subprocess.run([sys.executable, "-c", WITHOUT, *command], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_an_installation_as_readme_says_imports_every_module() -> None:
    """README installs the extra `report` and nothing more: no other library may be imported on the way to a report."""
    there = installed_with("report")
    assert {"numpy", "matplotlib"} <= there
    gone = {
        module
        for module, distributions in packages_distributions().items()
        if there.isdisjoint(map(canonicalize_name, distributions))
    }
    assert {"scipy", "numba", "pytest"} <= gone
    done = subprocess.run([sys.executable, "-c", IMPORT_ALL, *sorted(gone)], capture_output=True, text=True, check=True)
    failed = [tuple(line.split()) for line in done.stdout.splitlines()]
    wrong = [
        (module, library)
        for module, library in failed
        if not any(
            f"{module}.".startswith(f"{known}.") and library in libraries for known, libraries in NEED_A_LIBRARY.items()
        )
    ]
    assert wrong == []
    assert failed  # an empty list would mean that nothing was hidden


def test_the_extras_are_those_of_the_package() -> None:
    reported = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["optional-dependencies"]

    def libraries(extra: str) -> set[str]:
        names = {line.partition(">=")[0] for line in reported[extra]}
        own = {name for name in names if name.startswith("hapnet-haptics[")}
        return (names - own).union(*(libraries(name.removeprefix("hapnet-haptics[").rstrip("]")) for name in own))

    for extra, modules in installing._LIBRARIES.items():
        assert libraries(extra) - WHERE_NEEDED == set(modules.values())
