"""What a session reports to its runtime, one immutable class an event."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from hapnet.wire.messages import Identity


@dataclass(frozen=True, slots=True)
class Paired:
    """`peer` is there and has heard of this side. `number` counts this session's pairs from 1: above 1, a restart."""

    peer: Identity
    number: int


class PositionReceived(NamedTuple):
    """The peer's set-position [m or rad], its number and its sender's clock [ns]."""

    sequence: int
    sent_ns: int
    position: tuple[float, ...]


class EnergyCredited(NamedTuple):
    """Shuffled energy that arrived and was admitted [nJ], reported once."""

    credited_nJ: int


@dataclass(frozen=True, slots=True)
class PeerRefused:
    """A peer will not pair with this incarnation, ever, and why."""

    reason: str


@dataclass(frozen=True, slots=True)
class Mismatch:
    """This side refused a peer, and why."""

    reason: str


@dataclass(frozen=True, slots=True)
class PeerLeft:
    """The peer ended on purpose, and why."""

    reason: str


Event = Paired | PositionReceived | EnergyCredited | PeerRefused | Mismatch | PeerLeft
