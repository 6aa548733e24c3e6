"""The versions that matter in a bug report, found without importing the packages."""

from __future__ import annotations

import platform
from functools import cache

from netem.versions import DISTRIBUTION, PACKAGES, installed


@cache
def _found() -> dict[str, str]:
    return {package: installed(package) for package in (DISTRIBUTION, *PACKAGES)}


def versions() -> dict[str, str]:
    """The versions by the name of the distribution, with Python's, as in summaries and recordings."""
    return {**_found(), "python": platform.python_version()}
