"""The versions that matter in a bug report, without importing what they are of."""

from __future__ import annotations

import platform
from functools import cache

from netem.versions import DISTRIBUTION, PACKAGES, installed


@cache
def _found() -> dict[str, str]:
    return {package: installed(package) for package in (DISTRIBUTION, *PACKAGES)}


def versions() -> dict[str, str]:
    """By name of the distribution, and Python's, as summaries and recordings have them."""
    return {**_found(), "python": platform.python_version()}
