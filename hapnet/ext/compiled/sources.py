"""Finds whether the kernel was compiled from the present sources, without loading the compiler."""

from __future__ import annotations

import hashlib
from contextlib import suppress
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from hapnet.errors import HapnetError
from hapnet.records.machine_code import directory

_PACKAGE = Path(__file__).parents[2]

_COMPILED = (
    "records", "control", "couplings", "mechanics", "plant", "recording", "side", "simulation", "wire",
    "ext/compiled", "ext/laws", "ext/solids", "ext/arms", "ext/tools",
)  # fmt: skip
"""The packages with compiled equations, or with constants in such equations."""


def _mark(kind: str) -> Path:
    """The file with the digest of the sources of a kind's machine code; each copy of the package has its own file."""
    return directory() / f"compiled-{kind}-{hashlib.sha256(str(_PACKAGE).encode()).hexdigest()[:16]}"


@cache
def digest() -> str:
    """The digest of the compiler's version and all sources from which the kernel is compiled or takes constants."""
    packages = [_PACKAGE.parent / "netem", *(_PACKAGE / name for name in _COMPILED)]
    found = hashlib.sha256(_compiler().encode())
    for path in sorted(path for package in packages for path in package.rglob("*.py")):
        found.update(path.read_bytes())
    return found.hexdigest()


def name_of(kind: str) -> str:
    """Return the name of a kind's machine code; it is different for other kinds and other sources."""
    return f"{kind}-{digest()[:16]}"


def are_compiled(kind: str) -> bool:
    """Whether there is machine code of the present sources for this kind of scenario."""
    try:
        return _mark(kind).read_text("utf-8") == digest()
    except OSError:
        return False


def mark(kind: str) -> None:
    """Note that this kind is compiled. Without a writable directory, later processes compile it again.

    Other processes read the file meanwhile, so it is replaced as a whole.
    """
    if are_compiled(kind):
        return
    from hapnet.recording.whole_file import complete_or_absent  # here, as a plain run imports this module

    with suppress(HapnetError), complete_or_absent(_mark(kind)) as file:
        file.write_text(digest(), "utf-8")


def _compiler() -> str:
    try:
        return version("numba")
    except PackageNotFoundError:
        return ""
