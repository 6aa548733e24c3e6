"""What an extra brings. Who needs one asks before anything runs, so that what is missing is one clear line."""

from __future__ import annotations

from importlib.util import find_spec

from hapnet.errors import MissingLibrary

_LIBRARIES = {  # of an extra: each module, and the library that has it
    "record": {"mcap": "mcap", "google.protobuf": "protobuf"},
    "report": {"mcap": "mcap", "google.protobuf": "protobuf", "matplotlib": "matplotlib"},
    "soft": {"numba": "numba", "scipy": "scipy", "meshio": "meshio", "threadpoolctl": "threadpoolctl"},
}


def require(extra: str, what: str) -> None:
    """Raise MissingLibrary if a library of `extra` is not installed. what : needs it, as text."""
    missing = [library for module, library in _LIBRARIES[extra].items() if not _is_there(module)]
    if missing:
        raise MissingLibrary(what, " ".join(missing), extra)


def _is_there(module: str) -> bool:
    try:
        return find_spec(module) is not None
    except ModuleNotFoundError:  # not even the package that it is in
        return False
