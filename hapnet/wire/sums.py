"""A check that the energy messages in the peer's name fit together.

The further entry ``sums`` of an energy message holds its `number`, counted from 1 for each pair; `sent_nJ`, all that
its sender has given to the addressee by then; and `seen`, the highest number of the addressee's energy messages that
its sender has taken. One sender's `sent_nJ` rises with its numbers. And it is never less than what the addressee had
credited in its message `seen`, since that was credited before this message was made: no clock is needed for that.

Who adds frames in the peer's name cannot take the peer's own frames away. They contradict his, whatever number he
chooses: as another message of the same number, as a sum that falls, or as less than was credited. So energy that was
announced before it was harvested is found, even if the peer harvests as much later.

Two keys in one name, or a false seal, show it too (`Impostors`). Where both sides have a word neither shows anything:
the pair's key proves who the peer is, and whoever adds frames only adds what is dropped. Otherwise somebody may have
paired in the peer's name, with a key of his own, and he cannot take away what the true one says.
"""

from __future__ import annotations

from collections import Counter, deque

from hapnet.errors import BadMessage
from hapnet.wire.events import Contradiction, Event
from hapnet.wire.fields import SUMS
from hapnet.wire.messages import Energy, Hello, Identity, Message, Welcome
from hapnet.wire.secret import Keys

SENDERS = "senders"
"""Two have spoken in the name of one incarnation."""

CREDITED = "credited"
"""More was credited than the peer says that it had sent by then."""

ACKNOWLEDGED = "acknowledged"
"""Energy was acknowledged that was never announced."""

KEYS = "keys"
"""Two keys were offered in the name of one incarnation."""

SEALS = "seals"
"""A message in the peer's name is not sealed, or not encrypted, with the key of the pair."""

KINDS = (SENDERS, CREDITED, ACKNOWLEDGED, KEYS, SEALS)

_MOST_KEPT = 4096
"""How many of its own messages a side remembers: 40 s of them at least."""


class Sums:
    """The sums of this side and its peer.

    Attributes
    ----------
    contradictions : how often a message in the peer's name contradicted what is known, over all pairs, by kind.
    """

    def __init__(self) -> None:
        self.contradictions: Counter[str] = Counter()
        self.change_pair()

    def change_pair(self) -> None:
        """There is another peer, or none: it counts from 1, and so does this side."""
        self._reported = set[str]()
        self._number = 0
        self._credited_nJ: deque[int] = deque(maxlen=_MOST_KEPT)  # in the newest of this side's messages
        self._newest: tuple[int, int] | None = None  # number and sent_nJ of the peer's message of the highest number
        self._content: tuple[int, ...] = ()  # all of that message
        self._without = False  # has a message without this entry come?

    def next(self, sent_nJ: int, credited_nJ: int) -> tuple[int, int, int]:
        """The entry of the next message, which acknowledges `credited_nJ`."""
        self._number += 1
        self._credited_nJ.append(credited_nJ)
        return self._number, sent_nJ, 0 if self._newest is None else self._newest[0]

    def take(self, message: Energy, announced_nJ: int) -> tuple[Event, ...]:
        """Take the peer's message and return its contradictions; each kind is reported once a pair. Nothing else
        depends on it.
        """
        reported = f"it reports {message.total_nJ} nJ sent, and {message.acked_nJ} nJ credited"
        found = self._found(self._contradiction(message), reported)
        return found + self.acknowledged(message.acked_nJ, announced_nJ)

    def acknowledged(self, acked_nJ: int, announced_nJ: int) -> tuple[Event, ...]:
        """The peer acknowledges energy. This side has announced so much."""
        kind = ACKNOWLEDGED if acked_nJ > announced_nJ else ""
        return self._found(kind, f"{acked_nJ} nJ acknowledged of {announced_nJ} nJ announced")

    def doubt(self, kind: str, detail: str) -> tuple[Event, ...]:
        """Something else contradicts: one of `KINDS`."""
        return self._found(kind, detail)

    def _found(self, kind: str, detail: str) -> tuple[Event, ...]:
        if not kind:
            return ()
        self.contradictions[kind] += 1
        if kind in self._reported:
            return ()
        self._reported.add(kind)
        return (Contradiction(kind, detail),)

    def _contradiction(self, message: Energy) -> str:
        reported = (message.more or {}).get(SUMS)
        if reported is None:
            self._without = True
            return SENDERS if self._newest is not None else ""
        number, sent_nJ, seen = reported
        content = message.total_nJ, message.acked_nJ, sent_nJ, seen
        found = self._without or message.total_nJ > sent_nJ or seen > self._number
        if self._newest is not None:
            newest, newest_nJ = self._newest
            found = found or (number - newest) * (sent_nJ - newest_nJ) < 0
            found = found or (number == newest and content != self._content)
        if self._newest is None or number > self._newest[0]:
            self._newest, self._content = (number, sent_nJ), content
        if found:
            return SENDERS
        return CREDITED if sent_nJ < self._credited_by(seen) else ""

    def _credited_by(self, number: int) -> int:
        """The energy that this side had credited when it sent its message of that number [nJ]; 0, if that is
        forgotten.
        """
        place = number - self._number - 1
        return self._credited_nJ[place] if 0 <= len(self._credited_nJ) + place < len(self._credited_nJ) else 0


class Impostors:
    """The evidence of keys and seals. keys : of this side. sums : counts and reports the contradictions."""

    def __init__(self, keys: Keys, sums: Sums) -> None:
        self._keys, self._sums = keys, sums

    @property
    def _matters(self) -> bool:
        return self._keys.proof not in (None, "word")

    def on_offer(self, message: Hello | Welcome, peer: Identity | None) -> tuple[Event, ...]:
        """Somebody offers a key, or none; `peer` : this side's, if it has one."""
        other = self._keys.note(message.incarnation, message.more)
        return self.on_peer(peer) if other and peer is not None and peer.incarnation == message.incarnation else ()

    def on_peer(self, peer: Identity | None) -> tuple[Event, ...]:
        """`peer` is the peer from now on, or was heard: check whether more than one key was offered in its name."""
        if peer is None or not self._matters or not self._keys.is_disputed(peer.incarnation):
            return ()
        return self._sums.doubt(KEYS, "two keys were offered in its name")

    def on_bad(self, message: Message | None, peer: Identity | None, error: BadMessage) -> tuple[Event, ...]:
        """A message was dropped: check whether it came in the name of `peer`, with a seal that is not the peer's."""
        if error.kind != "forged" or message is None or peer is None or message.incarnation != peer.incarnation:
            return ()
        return self._sums.doubt(SEALS, error.detail) if self._matters else ()
