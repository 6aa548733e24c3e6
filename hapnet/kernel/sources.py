"""What the kernel is compiled from, and whether it was compiled from just that, without loading the compiler."""

from __future__ import annotations

import hashlib
from contextlib import suppress
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

_HERE = Path(__file__).parent
_MARK = _HERE / "__pycache__" / "compiled"
"""Beside the machine code; it has the digest of what that was made from."""


@cache
def digest() -> str:
    """A digest of all sources that the kernel is compiled from, or takes constants from, and the compiler's version."""
    packages = [_HERE.parents[1] / "netem"]
    packages += [_HERE.parent / name for name in ("kernel", "records", "control", "mechanics", "plant", "wire")]
    found = hashlib.sha256(_compiler().encode())
    for path in sorted(path for package in packages for path in package.rglob("*.py")):
        found.update(path.read_bytes())
    return found.hexdigest()


def are_compiled() -> bool:
    """Is there machine code of the present sources?"""
    try:
        return _MARK.read_text("utf-8") == digest()
    except OSError:
        return False


def mark() -> None:
    """Note that there is; where nothing can be written the compiler keeps its code elsewhere, and nobody knows."""
    with suppress(OSError):
        _MARK.write_text(digest(), "utf-8")


def _compiler() -> str:
    try:
        return version("numba")
    except PackageNotFoundError:
        return ""
