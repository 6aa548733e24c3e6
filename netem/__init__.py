"""netem: a seeded link emulator in the syntax of Linux's tc-netem, for any Python program.

profile = LinkProfile.parse("delay 40ms 10ms distribution normal loss gemodel 1% 20%")
link = Link(profile, seed=1)
link.send(now_ns, item, size=64)
for due_ns, item in link.poll(now_ns): ...
link.next_due_ns

`LinkProfile` describes what a link does. `Link` does it without clock or I/O, and `netem.aio.AsyncLink` on an
asyncio loop. `Timeline` changes a link while it runs, and `expect` computes the statistics to expect.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from netem.errors import NetemError, ProfileError

if TYPE_CHECKING:
    from netem.expectation import Expectation, expect
    from netem.link import Link
    from netem.profile import PRESETS, LinkProfile, compose
    from netem.stats import LinkStats
    from netem.timeline import Timeline, TimelinePlayer
    from netem.trace import CapacityTrace, ConditionTrace

__all__ = [
    "PRESETS",
    "CapacityTrace",
    "ConditionTrace",
    "Expectation",
    "Link",
    "LinkProfile",
    "LinkStats",
    "NetemError",
    "ProfileError",
    "Timeline",
    "TimelinePlayer",
    "compose",
    "expect",
]

_LAZY = {
    "PRESETS": "profile",
    "LinkProfile": "profile",
    "compose": "profile",
    "CapacityTrace": "trace",
    "ConditionTrace": "trace",
    "Link": "link",
    "LinkStats": "stats",
    "Expectation": "expectation",
    "expect": "expectation",
    "Timeline": "timeline",
    "TimelinePlayer": "timeline",
}


def __getattr__(name: str) -> Any:
    """Import the parts on first use, so that a command's --help does not wait for them."""
    if name in _LAZY:
        return getattr(import_module(f"netem.{_LAZY[name]}"), name)
    raise AttributeError(f"module 'netem' has no attribute {name!r}")
