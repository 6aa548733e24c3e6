"""netem: a seeded link emulator with the words of Linux's tc-netem, for any Python program; it never duplicates.

profile = LinkProfile.parse("delay 40ms 10ms distribution normal loss gemodel 1% 20%")
link = Link(profile, seed=1)
link.send(now_ns, item, size=64)
for due_ns, item in link.poll(now_ns): ...
link.next_due_ns
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from netem.errors import NetemError, ProfileError
from netem.profile import PRESETS, LinkProfile, compose

if TYPE_CHECKING:
    from netem.link import Link
    from netem.stats import LinkStats

__all__ = ["PRESETS", "Link", "LinkProfile", "LinkStats", "NetemError", "ProfileError", "compose"]


def __getattr__(name: str) -> Any:
    """`Link` and `LinkStats` on first use: they need numpy, and a command's --help does not."""
    if name == "Link":
        from netem.link import Link

        return Link
    if name == "LinkStats":
        from netem.stats import LinkStats

        return LinkStats
    raise AttributeError(f"module 'netem' has no attribute {name!r}")
