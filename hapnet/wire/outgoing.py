"""A frame on its way to the network."""

from __future__ import annotations

from typing import NamedTuple

from hapnet.wire.control_sender import ControlMessage
from hapnet.wire.messages import Account, Channel, Energy, Signals, encode
from hapnet.wire.secret import sealed


class Outgoing(NamedTuple):
    """A frame to send, and the last part of its key expression."""

    kind: Channel
    data: bytes

    @classmethod
    def of(cls, message: Energy | Signals | Account | ControlMessage, key: bytes | None) -> Outgoing:
        """The frame of `message`; `key` seals it, None: nothing does."""
        return cls(message.CHANNEL, encode(message) if key is None else sealed(message, key))
