"""The installed libraries: their versions, the missing libraries of an extra, and the command that installs them."""

from __future__ import annotations

import platform
import shlex
import shutil
import sys
from functools import cache
from importlib.metadata import distributions
from importlib.util import find_spec
from pathlib import Path

from hapnet.errors import MissingLibrary
from netem.versions import DISTRIBUTION, PACKAGES, installed

_INSTALLS_ELSEWHERE = (22, 3)
"""From this version on pip installs into another environment: ``pip --python``."""


def install_command(libraries: str) -> str:
    """The shell command that installs `libraries` (names with blanks between them) into this environment.

    An environment may have no pip of its own (``python3 -m venv --without-pip``), and while it is activated, `python3`
    is its interpreter. So the command contains the path of an interpreter that has pip.
    """
    return f"{_installer()} install {shlex.join(libraries.split())}"


@cache
def _installer() -> str:
    own = shlex.quote(sys.executable)
    if find_spec("pip") is not None:
        return f"{own} -m pip"
    for interpreter in _others():
        if _has_pip(interpreter):
            return f"{shlex.quote(str(interpreter))} -m pip --python {own}"
    if (uv := shutil.which("uv")) is not None:
        return f"{shlex.quote(uv)} pip --python {own}"
    return f"{own} -m ensurepip && {own} -m pip"


def _others() -> list[Path]:
    """Interpreters outside of this environment: first the interpreter that made it, then any others on this machine."""
    made_with = Path(sys.base_prefix) / "bin"
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    found = [made_with / version, made_with / "python3", Path("/usr/local/bin/python3"), Path("/usr/bin/python3")]
    if (on_path := shutil.which("python3")) is not None:
        found.append(Path(on_path))
    own = Path(sys.prefix)
    return [path for path in dict.fromkeys(found) if path.exists() and own not in path.parents]


def _has_pip(interpreter: Path) -> bool:
    """True if the interpreter's libraries include a pip that installs elsewhere. The interpreter is not started."""
    version = interpreter.resolve().name  # python3.11
    prefixes = (interpreter.parent.parent, interpreter.resolve().parent.parent)
    folders = [
        prefix / "lib" / each / name
        for prefix in dict.fromkeys(prefixes)
        for each, name in ((version, "site-packages"), (version, "dist-packages"), ("python3", "dist-packages"))
    ]
    found = distributions(name="pip", path=[str(folder) for folder in folders])
    return any(_numbers(each.version) >= _INSTALLS_ELSEWHERE for each in found)


def _numbers(version: str) -> tuple[int, ...]:
    return tuple(int(part) for part in version.split(".")[:2] if part.isdecimal())


_RECORD = {"mcap": "mcap", "google.protobuf": "protobuf"}
_REPORT = {**_RECORD, "matplotlib": "matplotlib"}

_LIBRARIES = {  # by extra: each module, and the library that contains it
    "record": _RECORD,
    "report": _REPORT,
    "view": {**_REPORT, "viser": "viser"},
    "mesh": {"igl": "libigl", "trimesh": "trimesh", "scipy": "scipy"},
    "mujoco": {"mujoco": "mujoco"},
    "soft": {"numba": "numba", "scipy": "scipy", "meshio": "meshio", "threadpoolctl": "threadpoolctl"},
}


def lacks(extra: str) -> list[str]:
    """The libraries of `extra` that are not installed."""
    return [library for module, library in _LIBRARIES[extra].items() if not _is_there(module)]


def require(extra: str, what: str) -> None:
    """Raise MissingLibrary if a library of `extra` is not installed. what : the feature that needs it, as text."""
    if missing := lacks(extra):
        raise MissingLibrary(what, " ".join(missing), extra)


def _is_there(module: str) -> bool:
    try:
        return find_spec(module) is not None
    except (ModuleNotFoundError, ValueError):  # its parent package is missing, or a test hides the module
        return False


@cache
def _found() -> dict[str, str]:
    return {package: installed(package) for package in (DISTRIBUTION, *PACKAGES)}


def versions() -> dict[str, str]:
    """The versions by distribution name, and Python's version, as in summaries and recordings."""
    return {**_found(), "python": platform.python_version()}
