"""Send sampled messages of the stream that nothing overtakes, so that the receiver distinguishes lost from overtaken.

Zenoh numbers the messages of each priority, reliable and best-effort ones apart, and silently drops a message that
comes after a later one of the same kind. With jitter above the time between two messages most missing messages were
overtaken, and only the fastest arrive. So every n-th message is put on a channel of its own, in turn, whose previous
message was sent `SPACING_S` ago. These are a fair sample of the network's behaviour.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import TypeAlias

import zenoh

from hapnet.transport.config import endpoints_of
from hapnet.transport.entities import POSITION, publisher
from hapnet.wire.identity import MOST_SAMPLED
from hapnet.wire.stream_frames import sequence_of

SPACING_S = 0.15
"""The least time between two messages of one channel [s]; hardly any network delays a packet by so much."""

_BEST_EFFORT, _RELIABLE = zenoh.Reliability.BEST_EFFORT, zenoh.Reliability.RELIABLE
_P = zenoh.Priority

_UNUSED = [(_P.DATA_HIGH, _BEST_EFFORT), (_P.DATA_LOW, _BEST_EFFORT)]
_UNUSED_ON_DATAGRAMS = [
    (priority, _RELIABLE)
    for priority in (_P.REAL_TIME, _P.INTERACTIVE_HIGH, _P.INTERACTIVE_LOW, _P.DATA_HIGH, _P.DATA_LOW, _P.BACKGROUND)
]
"""Plain udp does not repeat reliable messages either, so they measure the same network; over quic they do not."""

Channel = tuple[zenoh.Priority, zenoh.Reliability]

Putting: TypeAlias = "zenoh.Publisher | SampledPublisher"


class SampledPublisher:
    """Puts the messages of the stream, each on its channel.

    session, key : where it publishes. channels : those of the sample. every : a message is sampled if its number is a
    multiple of it.
    """

    def __init__(self, session: zenoh.Session, key: str, channels: Sequence[Channel], every: int) -> None:
        self._every = every
        self._plain = publisher(session, key, POSITION)
        self._apart = [publisher(session, key, POSITION, *channel) for channel in channels]

    def put(self, data: bytes) -> None:
        """Send a frame; raises ZError as a publisher does. A frame without number (a keep-alive) is not sampled."""
        number = sequence_of(data)
        if number is None or number % self._every:
            self._plain.put(data)
        else:
            self._apart[number // self._every % len(self._apart)].put(data)


def channels_of(config: zenoh.Config) -> list[Channel]:
    """The channels that nothing else uses; none if messages cannot overtake each other at any endpoint."""
    endpoints = endpoints_of(config, "listen") + endpoints_of(config, "connect")
    if not any(map(_overtakes, endpoints)):
        return []
    plain = all(endpoint.startswith("udp/") and "rel=" not in endpoint for endpoint in endpoints)
    return _UNUSED + (_UNUSED_ON_DATAGRAMS if plain else [])


def sample_every(channels: Sequence[Channel], rate_hz: float) -> int:
    """Return the n for which every n-th of `rate_hz` messages a second has a channel for `SPACING_S`; 1 without any."""
    return min(MOST_SAMPLED, math.ceil(SPACING_S * rate_hz / len(channels))) if channels else 1


def _overtakes(endpoint: str) -> bool:
    if endpoint.startswith("udp/"):
        return "rel=1" not in endpoint
    return re.search(r"[?;&](mixed_rel=(1|auto)|rel=0)", endpoint) is not None
