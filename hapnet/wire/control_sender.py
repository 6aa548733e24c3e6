"""What a side says on its control key, and when: hellos, bounded replies, and byes at the end."""

from __future__ import annotations

from typing import Any

from hapnet.wire.messages import Bye, Hello, Identity, Refuse, Welcome

PROMPT_NS = 20_000_000  # minimum time between two hellos, when strangers call for them
REPLY_SPACING_NS = 10_000_000  # at most MAX_REPLIES replies in this time, however fast strangers send
MAX_REPLIES = 8
BYE_COPIES = 3
BYE_SPACING_NS = 20_000_000

ControlMessage = Hello | Welcome | Refuse | Bye


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
        self._replies: dict[int, Welcome | Refuse] = {}
        self._reply_ns = 0
        self._bye: Bye | None = None
        self._byes_left = 0
        self._bye_ns = 0

    def say_hello(self, now_ns: int) -> None:
        """Say hello as soon as the last one is `PROMPT_NS` old."""
        due_ns = max(now_ns, self._prompt_ns)
        self._hello_ns = due_ns if self._hello_ns is None else min(self._hello_ns, due_ns)

    def stop_hellos(self) -> None:
        """Send no hello until `say_hello` is called."""
        self._hello_ns = None

    def reply(self, message: Welcome | Refuse) -> None:
        """Queue a reply; it replaces one that waits for the same addressee. More than `MAX_REPLIES` are not kept."""
        if message.addressee in self._replies or len(self._replies) < MAX_REPLIES:
            self._replies[message.addressee] = message

    def reply_to(self, incarnation: int) -> Welcome | Refuse | None:
        """The reply that waits for `incarnation`, if there is one."""
        return self._replies.get(incarnation)

    def say_bye(self, bye: Bye, now_ns: int) -> None:
        """Send `bye` a few times, and nothing else from now on."""
        self._bye, self._byes_left, self._bye_ns = bye, BYE_COPIES, now_ns

    def poll(self, now_ns: int, *, searching: bool) -> list[ControlMessage]:
        """The messages to send now. `searching`: hellos repeat at their period; otherwise one is enough."""
        if self._bye is not None:
            if not self._byes_left or now_ns < self._bye_ns:
                return []
            self._byes_left -= 1
            self._bye_ns = now_ns + BYE_SPACING_NS
            return [self._bye]
        out: list[ControlMessage] = []
        if self._replies and now_ns >= self._reply_ns:
            out.extend(self._replies.values())
            self._replies.clear()
            self._reply_ns = now_ns + REPLY_SPACING_NS
        if self._hello_ns is not None and now_ns >= self._hello_ns:
            me = self._identity
            self.hellos += 1
            out.append(Hello(me.incarnation, self.hellos, me.role, me.dof, me.name, me.about, self._offer))
            self._prompt_ns = now_ns + PROMPT_NS
            self._hello_ns = now_ns + self._period_ns if searching else None
        return out

    @property
    def next_due_ns(self) -> int | None:
        """When to poll next. A time in the past means now; None means that nothing is planned."""
        if self._bye is not None:
            return self._bye_ns if self._byes_left else None
        if not self._replies:
            return self._hello_ns
        return self._reply_ns if self._hello_ns is None else min(self._reply_ns, self._hello_ns)
