"""The text of `--version` for bug reports: installed versions, and the system. It imports none of the packages."""

from __future__ import annotations

import os
import platform
from collections.abc import Sequence

ABSENT = "not installed"
DISTRIBUTION = "hapnet-haptics"
"""The distribution that contains both packages, `hapnet` and `netem`."""
PACKAGES = (
    "numpy",
    "eclipse-zenoh",
    "msgpack",
    "msgspec",
    "typer",
    "rich",
    "cryptography",
    "mcap",
    "matplotlib",
    "viser",
)


def installed(package: str) -> str:
    """A distribution's version, or `ABSENT`."""
    from importlib import metadata  # here, since it takes longer than the rest of this package's imports

    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return ABSENT


def described(program: str, packages: Sequence[str] = PACKAGES) -> str:
    """One line each for the program, Python, the system, the processors and the packages."""
    system = " ".join(filter(None, (platform.system(), platform.release(), platform.machine())))
    rows = {
        "python": f"{platform.python_version()} ({platform.python_implementation()})",
        "platform": system,
        "cpus": _processors(),
        **{package: installed(package) for package in packages},
    }
    width = max(map(len, rows))
    return "\n".join([f"{program} {installed(DISTRIBUTION)}", *(f"{name:<{width}}  {rows[name]}" for name in rows)])


def _processors() -> str:
    there = os.cpu_count() or 1
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else there
    return f"{there}" if usable == there else f"{there}, of which {usable} may be used"
