"""netem: a seeded link emulator in the syntax of Linux's tc-netem, for any Python program.

profile = LinkProfile.parse("delay 40ms 10ms distribution normal loss gemodel 1% 20%")
link = Link(profile, seed=1)
link.send(now_ns, item, size=64)
for due_ns, item in link.poll(now_ns): ...
link.next_due_ns

`LinkProfile` describes a link's effects. `Link` applies them without clock or I/O, and `netem.aio.AsyncLink` on an
asyncio loop. `Timeline` changes a link while it runs, and `expect` computes the statistics to expect.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from netem.errors import NetemError as NetemError, ProfileError as ProfileError

if TYPE_CHECKING:
    from netem.expectation import Expectation as Expectation, expect as expect
    from netem.link import Link as Link
    from netem.profile import PRESETS as PRESETS, LinkProfile as LinkProfile, compose as compose
    from netem.stats import LinkStats as LinkStats
    from netem.timeline import Timeline as Timeline, TimelinePlayer as TimelinePlayer
    from netem.trace import CapacityTrace as CapacityTrace, ConditionTrace as ConditionTrace

_NAMES = {
    "expectation": "Expectation expect",
    "link": "Link",
    "profile": "PRESETS LinkProfile compose",
    "stats": "LinkStats",
    "timeline": "Timeline TimelinePlayer",
    "trace": "CapacityTrace ConditionTrace",
}
_HOMES = {name: f"netem.{module}" for module, names in _NAMES.items() for name in names.split()}
__all__ = sorted([*_HOMES, "NetemError", "ProfileError"])


def __getattr__(name: str) -> Any:
    """Import the parts on first use, so that a command's --help does not wait for them."""
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'netem' has no attribute {name!r}")
