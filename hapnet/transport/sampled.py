"""Messages of the stream that nothing overtakes, so that the other side can tell what is lost from what is overtaken.

Zenoh numbers the messages of each priority, reliable and best-effort ones apart, and drops one that comes after a later
one of the same kind, silently. With jitter above the time between two messages most of what seems lost was
overtaken, and what comes is the fastest. So every so many-th message is put on a channel of its own, in turn, where
the one before it left `SPACING_S` ago. These are a fair sample of what the network does.
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
"""Least time between two messages of one channel [s]; on hardly any network does a packet overtake one so far ahead."""

_BEST_EFFORT, _RELIABLE = zenoh.Reliability.BEST_EFFORT, zenoh.Reliability.RELIABLE
_P = zenoh.Priority

_UNUSED = [(_P.DATA_HIGH, _BEST_EFFORT), (_P.DATA_LOW, _BEST_EFFORT)]
_UNUSED_ON_DATAGRAMS = [
    (priority, _RELIABLE)
    for priority in (_P.REAL_TIME, _P.INTERACTIVE_HIGH, _P.INTERACTIVE_LOW, _P.DATA_HIGH, _P.DATA_LOW, _P.BACKGROUND)
]
"""Plain udp repeats reliable messages no more than others, so they see the same network; over quic they do not."""

Channel = tuple[zenoh.Priority, zenoh.Reliability]

Putting: TypeAlias = "zenoh.Publisher | SampledPublisher"


class SampledPublisher:
    """Puts the messages of the stream, each on its channel.

    session, key : where. channels : those of the sample. every : a message whose number is a multiple of it is in it.
    """

    def __init__(self, session: zenoh.Session, key: str, channels: Sequence[Channel], every: int) -> None:
        self._every = every
        self._plain = publisher(session, key, POSITION)
        self._apart = [publisher(session, key, POSITION, *channel) for channel in channels]

    def put(self, data: bytes) -> None:
        """Send a frame; raises ZError as a publisher does. One without a number, as a keep-alive, is not sampled."""
        number = sequence_of(data)
        if number is None or number % self._every:
            self._plain.put(data)
        else:
            self._apart[number // self._every % len(self._apart)].put(data)


def channels_of(config: zenoh.Config) -> list[Channel]:
    """The channels that nothing else uses; none where no endpoint lets messages overtake each other."""
    endpoints = endpoints_of(config, "listen") + endpoints_of(config, "connect")
    if not any(map(_overtakes, endpoints)):
        return []
    plain = all(endpoint.startswith("udp/") and "rel=" not in endpoint for endpoint in endpoints)
    return _UNUSED + (_UNUSED_ON_DATAGRAMS if plain else [])


def sample_every(channels: Sequence[Channel], rate_hz: float) -> int:
    """Every so many-th of `rate_hz` messages a second has its channel for `SPACING_S`; 1 without channels: all do."""
    return min(MOST_SAMPLED, math.ceil(SPACING_S * rate_hz / len(channels))) if channels else 1


def _overtakes(endpoint: str) -> bool:
    if endpoint.startswith("udp/"):
        return "rel=1" not in endpoint
    return re.search(r"[?;&](mixed_rel=(1|auto)|rel=0)", endpoint) is not None
