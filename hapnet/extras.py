"""The packages that an extra brings. Who needs one asks before anything runs, so that what is missing is one clear
line.
"""

from __future__ import annotations

from importlib.util import find_spec

from hapnet.errors import MissingLibrary

_RECORD = {"mcap": "mcap", "google.protobuf": "protobuf"}
_REPORT = {**_RECORD, "matplotlib": "matplotlib"}

_LIBRARIES = {  # of an extra: each module, and the library that has it
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
    """Raise MissingLibrary if a library of `extra` is not installed. what : needs it, as text."""
    if missing := lacks(extra):
        raise MissingLibrary(what, " ".join(missing), extra)


def _is_there(module: str) -> bool:
    try:
        return find_spec(module) is not None
    except (ModuleNotFoundError, ValueError):  # not even the package that it is in, or made to be missing
        return False
