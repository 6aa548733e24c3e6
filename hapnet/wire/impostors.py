"""A detector of others who speak in the peer's name. Two keys in one name, or a false seal, show it.

Where both sides have a word neither shows anything: the pair's key proves who the peer is, and whoever adds frames only
adds what is dropped. Otherwise somebody may have paired in the peer's name, with a key of his own, and he cannot take
away what the true one says.
"""

from __future__ import annotations

from hapnet.errors import BadMessage
from hapnet.wire.events import Event
from hapnet.wire.messages import Hello, Identity, Message, Welcome
from hapnet.wire.secret import Keys
from hapnet.wire.sums import KEYS, SEALS, Sums


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
