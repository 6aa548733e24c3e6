"""A check that the energy messages in the peer's name fit together.

The further entry ``sums`` of an energy message holds its `number`, counted from 1 for each pair; `sent_nJ`, all that
its sender has given to the addressee by then; and `seen`, the highest number of the addressee's energy messages that
its sender has taken. One sender's `sent_nJ` rises with its numbers. And it is never less than what the addressee had
credited in its message `seen`, since that was credited before this message was made: this needs no clock.

An attacker who adds frames in the peer's name cannot remove the peer's own frames. They contradict his, whatever number
he chooses: by another message of the same number, by a sum that falls, or by less than was credited. So energy that was
announced before it was harvested is detected, even if the peer harvests as much later.

Two keys in one name, or a false seal, are evidence too (`Impostors`). If both sides have a word they are not: the
pair's key proves who the peer is, and added frames are dropped. Without a word an attacker may have paired in the
peer's name, with a key of his own, but cannot remove the true peer's messages.
"""

from __future__ import annotations

from collections import Counter, deque

from hapnet.errors import BadMessage
from hapnet.wire.events import Contradiction, Event
from hapnet.wire.fields import SUMS
from hapnet.wire.messages import Energy, Hello, Identity, Message, Welcome
from hapnet.wire.secret import Keys

SENDERS = "senders"
"""Two senders have used the name of one incarnation."""

CREDITED = "credited"
"""More was credited than the peer reports that it had sent by then."""

ACKNOWLEDGED = "acknowledged"
"""Energy was acknowledged that was never announced."""

KEYS = "keys"
"""Two keys were offered in the name of one incarnation."""

SEALS = "seals"
"""A message in the peer's name is not sealed, or not encrypted, with the key of the pair."""

KINDS = (SENDERS, CREDITED, ACKNOWLEDGED, KEYS, SEALS)

_MOST_KEPT = 4096
"""The number of its own messages that a side keeps: at least those of 40 s."""


class Sums:
    """The sums of this side and its peer.

    Attributes
    ----------
    contradictions : the number of contradictions in the peer's name, over all pairs, by kind.
    """

    def __init__(self) -> None:
        self.contradictions: Counter[str] = Counter()
        self.change_pair()

    def change_pair(self) -> None:
        """Begin with another peer, or none: both sides count from 1."""
        self._reported = set[str]()
        self._number = 0
        self._credited_nJ: deque[int] = deque(maxlen=_MOST_KEPT)  # the energy credited in this side's newest messages
        self._newest: tuple[int, int] | None = None  # number and sent_nJ of the peer's message of the highest number
        self._content: tuple[int, ...] = ()  # all fields of that message
        self._without = False  # whether a message without this entry has come

    def next(self, sent_nJ: int, credited_nJ: int) -> tuple[int, int, int]:
        """The entry of the next message, which acknowledges `credited_nJ`."""
        self._number += 1
        self._credited_nJ.append(credited_nJ)
        return self._number, sent_nJ, 0 if self._newest is None else self._newest[0]

    def take(self, message: Energy, announced_nJ: int) -> tuple[Event, ...]:
        """Take the peer's message and return its contradictions; each kind is reported once a pair. Nothing else
        depends on it.
        """
        detail = f"it reports {message.total_nJ} nJ sent, and {message.acked_nJ} nJ credited"
        events = self._count(self._contradiction(message), detail)
        return events + self.acknowledged(message.acked_nJ, announced_nJ)

    def acknowledged(self, acked_nJ: int, announced_nJ: int) -> tuple[Event, ...]:
        """Check an acknowledgement of the peer against the energy that this side has announced."""
        kind = ACKNOWLEDGED if acked_nJ > announced_nJ else ""
        return self._count(kind, f"{acked_nJ} nJ acknowledged of {announced_nJ} nJ announced")

    def doubt(self, kind: str, detail: str) -> tuple[Event, ...]:
        """Enter a contradiction of another origin, of one of `KINDS`."""
        return self._count(kind, detail)

    def _count(self, kind: str, detail: str) -> tuple[Event, ...]:
        if not kind:
            return ()
        self.contradictions[kind] += 1
        if kind in self._reported:
            return ()
        self._reported.add(kind)
        return (Contradiction(kind, detail),)

    def _contradiction(self, message: Energy) -> str:
        sums = (message.more or {}).get(SUMS)
        if sums is None:
            self._without = True
            return SENDERS if self._newest is not None else ""
        number, sent_nJ, seen = sums
        content = message.total_nJ, message.acked_nJ, sent_nJ, seen
        contradicts = self._without or message.total_nJ > sent_nJ or seen > self._number
        if self._newest is not None:
            newest, newest_nJ = self._newest
            contradicts = contradicts or (number - newest) * (sent_nJ - newest_nJ) < 0
            contradicts = contradicts or (number == newest and content != self._content)
        if self._newest is None or number > self._newest[0]:
            self._newest, self._content = (number, sent_nJ), content
        if contradicts:
            return SENDERS
        return CREDITED if sent_nJ < self._credited_by(seen) else ""

    def _credited_by(self, number: int) -> int:
        """The energy that this side had credited when it sent its message of that number [nJ]; 0, if the message is
        no longer kept.
        """
        place = number - self._number - 1
        return self._credited_nJ[place] if 0 <= len(self._credited_nJ) + place < len(self._credited_nJ) else 0


class Impostors:
    """The evidence of keys and seals. keys : this side's. sums : counts and reports the contradictions."""

    def __init__(self, keys: Keys, sums: Sums) -> None:
        self._keys, self._sums = keys, sums

    @property
    def _is_evidence(self) -> bool:
        return self._keys.proof not in (None, "word")

    def on_offer(self, message: Hello | Welcome, peer: Identity | None) -> tuple[Event, ...]:
        """Enter the key, or none, that a message offers. peer : this side's peer, if it has one."""
        other = self._keys.note(message.incarnation, message.more)
        return self.on_peer(peer) if other and peer is not None and peer.incarnation == message.incarnation else ()

    def on_peer(self, peer: Identity | None) -> tuple[Event, ...]:
        """Check whether more than one key was offered in the name of `peer`."""
        if peer is None or not self._is_evidence or not self._keys.is_disputed(peer.incarnation):
            return ()
        return self._sums.doubt(KEYS, "two keys were offered in its name")

    def on_bad(self, message: Message | None, peer: Identity | None, error: BadMessage) -> tuple[Event, ...]:
        """Check whether a dropped message came in the name of `peer`, with a seal that is not the peer's."""
        if error.kind != "forged" or message is None or peer is None or message.incarnation != peer.incarnation:
            return ()
        return self._sums.doubt(SEALS, error.detail) if self._is_evidence else ()
