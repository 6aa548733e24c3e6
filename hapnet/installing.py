"""The command that installs a missing library into this environment, so that it works when it is typed."""

from __future__ import annotations

import shlex
import shutil
import subprocess
import sys
from functools import cache
from importlib.util import find_spec
from pathlib import Path

_LIMIT_S = 20.0
"""An interpreter that takes longer to start is no help [s]."""


def install_command(libraries: str) -> str:
    """One line for a shell; `libraries` : their names, with blanks between them.

    An environment may have no pip of its own (``python3 -m venv --without-pip``), and where it is activated, `python3`
    is its interpreter. So the line names an interpreter that has pip by its path.
    """
    return f"{_installer()} install {shlex.join(libraries.split())}"


@cache
def _installer() -> str:
    own = shlex.quote(sys.executable)
    if find_spec("pip") is not None:
        return f"{own} -m pip"
    for interpreter in _others():
        if _has_pip(interpreter):
            return f"{shlex.quote(interpreter)} -m pip --python {own}"
    if (uv := shutil.which("uv")) is not None:
        return f"{shlex.quote(uv)} pip --python {own}"
    return f"{own} -m ensurepip && {own} -m pip"


def _others() -> list[str]:
    """Interpreters outside of this environment: the one that it was made with, then those that are found."""
    made_with = Path(sys.base_prefix) / "bin"
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    found = [made_with / version, made_with / "python3", Path("/usr/local/bin/python3"), Path("/usr/bin/python3")]
    if (on_path := shutil.which("python3")) is not None:
        found.append(Path(on_path))
    own = Path(sys.prefix)
    return list(dict.fromkeys(str(one) for one in found if one.exists() and own not in one.parents))


def _has_pip(interpreter: str) -> bool:
    """Can it install into another environment? That is `pip --python`, of pip 22.3."""
    code = "import sys, pip; sys.exit(tuple(map(int, pip.__version__.split('.')[:2])) < (22, 3))"
    try:
        done = subprocess.run([interpreter, "-I", "-c", code], capture_output=True, timeout=_LIMIT_S, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return False
    return done.returncode == 0
