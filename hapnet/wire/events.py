"""What a session reports to its runtime, one immutable class an event."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from hapnet.wire.messages import Identity, Motion, Port, Wave


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


class SampleReceived(NamedTuple):
    """What a coupling sends in place of set-positions."""

    message: Motion | Port | Wave


class EnergyCredited(NamedTuple):
    """Shuffled energy that arrived and was admitted [nJ], reported once."""

    credited_nJ: int


@dataclass(frozen=True, slots=True)
class PeerRefused:
    """Somebody will not pair with this incarnation, ever, and why. by_peer: it was this side's peer, and is no more."""

    reason: str
    by_peer: bool = False


@dataclass(frozen=True, slots=True)
class Mismatch:
    """This side refused a peer, and why."""

    reason: str


@dataclass(frozen=True, slots=True)
class PeerLeft:
    """The peer ended on purpose, and why."""

    reason: str


@dataclass(frozen=True, slots=True)
class PeerSilent:
    """Nothing new has come from the peer for longer than the silence that counts; the last did at `since_ns`."""

    since_ns: int


@dataclass(frozen=True, slots=True)
class PeerHeard:
    """A silence is over: it lasted `silence_ns`, the last `recovery_ns` of it with some word of the other side.

    `missing` : positions that did not come meanwhile, by their numbers; 0 if the peer is another than before.
    """

    silence_ns: int
    recovery_ns: int
    missing: int


Event = (
    Paired
    | PositionReceived
    | SampleReceived
    | EnergyCredited
    | PeerRefused
    | Mismatch
    | PeerLeft
    | PeerSilent
    | PeerHeard
)
