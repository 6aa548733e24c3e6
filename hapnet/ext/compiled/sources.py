"""The sources of the kernel, and whether it was compiled from just these, found without loading the compiler."""

from __future__ import annotations

import hashlib
from contextlib import suppress
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from hapnet.records.machine_code import directory

_PACKAGE = Path(__file__).parents[2]

_COMPILED = (
    "records", "control", "couplings", "mechanics", "plant", "recording", "side", "simulation", "wire",
    "ext/compiled", "ext/laws", "ext/solids", "ext/arms", "ext/tools",
)  # fmt: skip
"""The packages with equations that are compiled, or with constants in them."""


def _mark(kind: str) -> Path:
    """The file that has the digest of what a kind's machine code was made from. Packages of two places have two."""
    return directory() / f"compiled-{kind}-{hashlib.sha256(str(_PACKAGE).encode()).hexdigest()[:16]}"


@cache
def digest() -> str:
    """A digest of all sources that the kernel is compiled from, or takes constants from, and the compiler's version."""
    packages = [_PACKAGE.parent / "netem", *(_PACKAGE / name for name in _COMPILED)]
    found = hashlib.sha256(_compiler().encode())
    for path in sorted(path for package in packages for path in package.rglob("*.py")):
        found.update(path.read_bytes())
    return found.hexdigest()


def name_of(kind: str) -> str:
    """Return the name of a kind's machine code: nothing else has it, neither another kind nor other sources."""
    return f"{kind}-{digest()[:16]}"


def are_compiled(kind: str) -> bool:
    """Whether there is machine code of the present sources for this kind of scenario."""
    try:
        return _mark(kind).read_text("utf-8") == digest()
    except OSError:
        return False


def mark(kind: str) -> None:
    """Note that there is; where nothing can be written there is none for later processes."""
    with suppress(OSError):
        _mark(kind).write_text(digest(), "utf-8")


def _compiler() -> str:
    try:
        return version("numba")
    except PackageNotFoundError:
        return ""
