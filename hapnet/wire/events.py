"""The events that a session reports to its runtime: one immutable class for each kind."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from hapnet.wire.fields import Signal
from hapnet.wire.messages import Identity, Motion, Port, Proxy, Wave


@dataclass(frozen=True, slots=True)
class Paired:
    """`peer` has answered this side, and the two are a pair. `number` counts this session's pairs from 1.

    encrypts : whether the pair encrypts.
    proof : the proof of the peer's identity: a word, a certificate, a socket of this machine, or nobody; None: no keys.
    fingerprint : the fingerprint of the pair's key; empty: there is none.
    """

    peer: Identity
    number: int
    encrypts: bool = False
    proof: str | None = None
    fingerprint: str = ""


class PositionReceived(NamedTuple):
    """The peer's set-position [m or rad], its number and its time on the sender's clock [ns].

    took_ns : estimate of its transit time [ns]. level : how full the peer's reservoir is; None: not reported.
    """

    sequence: int
    sent_ns: int
    position: tuple[float, ...]
    took_ns: int = 0
    level: float | None = None


class SampleReceived(NamedTuple):
    """A message that a coupling sends in place of a set-position."""

    message: Motion | Port | Wave | Proxy
    took_ns: int = 0


class EnergyCredited(NamedTuple):
    """Shuffled energy that arrived and was credited [nJ], reported once."""

    credited_nJ: int


@dataclass(frozen=True, slots=True)
class SignalReceived:
    """The peer has changed the value of a signal."""

    name: str
    value: Signal


@dataclass(frozen=True, slots=True)
class PeerRefused:
    """Another side refuses this incarnation for good, with its reason. by_peer : it was the peer, and the pair ends."""

    reason: str
    by_peer: bool = False


@dataclass(frozen=True, slots=True)
class Mismatch:
    """This side refused another side, with the reason."""

    reason: str


@dataclass(frozen=True, slots=True)
class Unproven:
    """A hello, welcome or refusal was ignored because its sender did not prove its identity."""

    reason: str = "it does not prove its key: it has another secret, or it is a stranger"


@dataclass(frozen=True, slots=True)
class PeerLeft:
    """The peer ended on purpose, with its reason."""

    reason: str


@dataclass(frozen=True, slots=True)
class Contradiction:
    """The messages in the peer's name cannot all be the peer's: see `hapnet.wire.sums`.

    kind : the kind of contradiction. Each is reported once for each pair.
    """

    kind: str
    detail: str


@dataclass(frozen=True, slots=True)
class PeerSilent:
    """The peer has been silent for longer than is allowed: its last new message came at `since_ns`."""

    since_ns: int


@dataclass(frozen=True, slots=True)
class PeerHeard:
    """A silence is over.

    silence_ns : how long it lasted.
    recovery_ns : the time from the other side's first message, of any kind, to its first position.
    missing : the positions that did not come meanwhile, by their numbers; 0 if there is another peer now.
    """

    silence_ns: int
    recovery_ns: int
    missing: int


Event = (
    Paired
    | PositionReceived
    | SampleReceived
    | EnergyCredited
    | SignalReceived
    | PeerRefused
    | Mismatch
    | Unproven
    | PeerLeft
    | Contradiction
    | PeerSilent
    | PeerHeard
)
