"""The command that installs a missing library: it can be typed as it stands, in an activated environment too."""

import shlex
import subprocess
import sys
import venv
from pathlib import Path

import pytest

from hapnet import installing
from hapnet.errors import MissingLibrary
from hapnet.installing import install_command
from tests.conftest import ROOT


def test_an_environment_without_pip_is_mended_by_an_interpreter_that_has_it(tmp_path: Path) -> None:
    """As README makes one. `--dry-run` stands for what would be loaded from the network."""
    own = tmp_path / "my env"
    venv.create(own, with_pip=False, symlinks=True)
    code = "from hapnet.installing import install_command; print(install_command('a-library another'))"
    path = {"PATH": f"{own / 'bin'}:/usr/local/bin:/usr/bin:/bin", "VIRTUAL_ENV": str(own), "PYTHONPATH": str(ROOT)}
    said = subprocess.run(
        ["sh", "-c", f"python3 -c {shlex.quote(code)}"], env=path, capture_output=True, text=True, check=True
    ).stdout.strip()
    words = shlex.split(said)
    assert words[-3:] == ["install", "a-library", "another"]
    if "ensurepip" in words:
        pytest.skip("no interpreter here has pip")
    assert str(own / "bin" / "python3") in words or str(own / "bin" / "python") in words
    listed = said.replace("install a-library another", "list")
    done = subprocess.run(["sh", "-c", listed], env=path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_an_environment_that_has_pip_uses_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(installing, "find_spec", lambda name: object())
    installing._installer.cache_clear()
    try:
        assert install_command("viser") == f"{shlex.quote(sys.executable)} -m pip install viser"
    finally:
        installing._installer.cache_clear()


def test_the_line_names_what_is_missing_and_the_command() -> None:
    line = str(MissingLibrary("a scene with a mesh", "libigl scipy", "mesh"))
    assert line.startswith("a scene with a mesh needs libigl and scipy, of the extra `mesh`, which is not installed: ")
    assert line.endswith(install_command("libigl scipy"))
