"""The messages on a side's control key, and their times: hellos, bounded replies, and byes at the end.

An `Outgoing` is a frame of any kind on its way to the network.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import msgspec

from hapnet.wire.fields import ANSWERS
from hapnet.wire.messages import Account, Bye, Channel, Energy, Hello, Identity, Refuse, Signals, Welcome, encode
from hapnet.wire.secret import sealed

PROMPT_NS = 20_000_000  # minimum time between two hellos that strangers cause
REPLY_SPACING_NS = 10_000_000  # at most MAX_REPLIES replies in this time, however fast strangers send
MAX_REPLIES = 8
BYE_COPIES = 3
BYE_SPACING_NS = 20_000_000

ControlMessage = Hello | Welcome | Refuse | Bye


class Addressed(NamedTuple):
    """A message to send. `key` seals it; None: it is not sealed, as it is for any side or for a side without a key."""

    message: ControlMessage
    key: bytes | None = None


class ControlSender:
    """The messages of one side's handshake that wait to be sent. `offer`: further entries of its hellos.

    Attributes
    ----------
    hellos : the number of the last hello that was sent; 0 before the first.
    """

    def __init__(self, identity: Identity, hello_period_ns: int, offer: dict[str, Any] | None = None) -> None:
        self.hellos: int = 0
        self._identity, self._offer = identity, offer
        self._period_ns = hello_period_ns
        self._hello_ns: int | None = 0
        self._prompt_ns = 0  # no hello before this time
        self._replies: dict[tuple[int, bytes | None, bool], Hello | Welcome | Refuse] = {}
        self._reply_ns = 0
        self._bye: Addressed | None = None
        self._byes_left = 0
        self._bye_ns = 0

    def say_hello(self, now_ns: int) -> None:
        """Send a hello as soon as the last one is `PROMPT_NS` old."""
        due_ns = max(now_ns, self._prompt_ns)
        self._hello_ns = due_ns if self._hello_ns is None else min(self._hello_ns, due_ns)

    def stop_hellos(self) -> None:
        """Send no hello until `say_hello` is called."""
        self._hello_ns = None

    @property
    def is_full(self) -> bool:
        """Whether so many replies wait that there is no room for another addressee."""
        return len(self._replies) >= MAX_REPLIES

    def reply(self, message: Welcome | Refuse, key: bytes | None = None) -> None:
        """Queue a reply, to be sealed with `key`; it replaces a waiting reply to the same addressee and key.

        At most `MAX_REPLIES` are kept.
        """
        self._queue(message.addressee, message, key)

    def answer(self, incarnation: int, number: int, key: bytes) -> None:
        """Queue a hello that answers hello `number` of `incarnation`, sealed with the key that the two share."""
        me, more = self._identity, {**(self._offer or {}), ANSWERS: (incarnation, number)}
        self._queue(incarnation, Hello(me.incarnation, 0, me.role, me.dof, me.name, me.about, more), key)

    def _queue(self, addressee: int, message: Hello | Welcome | Refuse, key: bytes | None) -> None:
        place = addressee, key, isinstance(message, Hello)
        if place in self._replies or not self.is_full:
            self._replies[place] = message

    def reply_to(self, incarnation: int) -> Hello | Welcome | Refuse | None:
        """The reply that waits for `incarnation`, if there is one."""
        return next((reply for (addressee, *_), reply in self._replies.items() if addressee == incarnation), None)

    def say_bye(self, bye: Bye, key: bytes | None, now_ns: int) -> None:
        """Send `bye` a few times, sealed with `key`, and nothing else from now on."""
        self._bye, self._byes_left, self._bye_ns = Addressed(bye, key), BYE_COPIES, now_ns

    def poll(self, now_ns: int, *, searching: bool) -> list[Addressed]:
        """The messages to send now. `searching`: hellos are repeated at their period; otherwise one is sent."""
        if self._bye is not None:
            if not self._byes_left or now_ns < self._bye_ns:
                return []
            self._byes_left -= 1
            self._bye_ns = now_ns + BYE_SPACING_NS
            return [self._bye]
        out: list[Addressed] = []
        if self._replies and now_ns >= self._reply_ns:
            out.extend(Addressed(self._numbered(reply), key) for (_, key, _), reply in self._replies.items())
            self._replies.clear()
            self._reply_ns = now_ns + REPLY_SPACING_NS
        if self._hello_ns is not None and now_ns >= self._hello_ns:
            me = self._identity
            hello = Hello(me.incarnation, 0, me.role, me.dof, me.name, me.about, self._offer)
            out.append(Addressed(self._numbered(hello)))
            self._prompt_ns = now_ns + PROMPT_NS
            self._hello_ns = now_ns + self._period_ns if searching else None
        return out

    def _numbered(self, message: Hello | Welcome | Refuse) -> Hello | Welcome | Refuse:
        """The message as it is sent: hellos are numbered as they leave."""
        if not isinstance(message, Hello):
            return message
        self.hellos += 1
        return msgspec.structs.replace(message, number=self.hellos)

    @property
    def next_due_ns(self) -> int | None:
        """The time to poll next. A time in the past means now; None means that nothing is planned."""
        if self._bye is not None:
            return self._bye_ns if self._byes_left else None
        if not self._replies:
            return self._hello_ns
        return self._reply_ns if self._hello_ns is None else min(self._reply_ns, self._hello_ns)


class Outgoing(NamedTuple):
    """A frame to send, and the last part of its key expression."""

    kind: Channel
    data: bytes

    @classmethod
    def of(cls, message: Energy | Signals | Account | ControlMessage, key: bytes | None) -> Outgoing:
        """The frame of `message`, sealed with `key`; None: not sealed."""
        return cls(message.CHANNEL, encode(message) if key is None else sealed(message, key))
