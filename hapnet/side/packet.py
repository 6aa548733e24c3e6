"""The packets that a link carries between the two sides."""

from __future__ import annotations

from typing import NamedTuple

FRAME_OVERHEAD = 62
"""Bytes of the Ethernet, IP, UDP and Zenoh headers around a message; they count on links with a rate."""


class Packet(NamedTuple):
    """A message on a link: the last part of its key, and its bytes."""

    kind: str
    data: bytes
