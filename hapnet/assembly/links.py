"""The emulated links of a run: profiles and timelines that may stand between the two sides."""

from __future__ import annotations

from hapnet.errors import InvalidParameter
from hapnet.params import Params
from netem import LinkProfile, Timeline


def link_profile(name: str, words: str) -> LinkProfile:
    """The emulated link that the parameter `name` describes: tc-netem's syntax, or a profile's name.

    Raises NetemError, InvalidParameter: there is no such link, or it cannot stand between the two sides.
    """
    return _between_sides(name, LinkProfile.named(words))


def _between_sides(name: str, profile: LinkProfile) -> LinkProfile:
    if profile.corrupt:
        allowed = "a link without corrupt: checksums below Zenoh drop corrupted messages, so use loss"
        raise InvalidParameter(name, str(profile), allowed)
    if any(one.copies for one in profile.others):
        allowed = "a link without duplicate: Theorem 1 holds only where no energy arrives twice (netem's relays can)"
        raise InvalidParameter(name, str(profile), allowed)
    return profile


def link_timeline(direction: str, params: Params) -> Timeline | None:
    """Return the changes of the link in a direction while it runs, if there are any; raises as `link_profile` does."""
    name = f"link.{direction}_timeline"
    timeline = Timeline.parse(text) if (text := str(params.get(name))) else None
    for entry in () if timeline is None else timeline.entries:
        if isinstance(entry.action, LinkProfile):
            _between_sides(name, entry.action)
    return timeline
