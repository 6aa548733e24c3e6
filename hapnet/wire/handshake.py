"""Who the peer is: hello, welcome, refuse, bye.

An incarnation, 64 random bits, is one start of a process. The rules:

* A side says hello every period until it is paired. A hello is numbered and is answered by a welcome that repeats its
  number, or by a refusal.
* A side is paired by a welcome to one of its own hellos, never by a hello: the network may deliver the hello of a
  process that died long ago, but a welcome proves that its sender was alive after the hello with that number left.
* A stranger (neither the peer nor retired) that says anything is sent a hello, and if it answers it is the peer: the
  old one has restarted. Its welcome must repeat a hello later than the current pairing. So what dead processes left in
  the network can never displace a living peer.
* Nor can a living stranger: while the peer is heard, a stranger is a rival (two devices under one name), which is
  dropped and not answered, but for the refusal of a hello that does not fit; what it refuses is dropped as well. It
  goes on saying hello, and its turn comes when the peer is silent.
* Of several that look for a peer at once one is the suitor, the first; the others are rivals until it has become the
  peer, or was not heard for `SUITOR_NS`. Were all welcomed, each would think itself the peer, with a full reservoir.
* A peer that was displaced, left or refused is retired for as long as this side runs, and told so when it speaks: its
  totals go on where they were, so to pair with it anew, from zero, would credit them twice. There are at most
  `MAX_PEERS`; a side that has seen more pairs with nobody else, which is the safe way to have bounded memory.
"""

from __future__ import annotations

from collections.abc import Callable

from hapnet.errors import BadMessage
from hapnet.wire.events import Event, Mismatch, Paired, PeerLeft, PeerRefused
from hapnet.wire.fields import MAX_TEXT
from hapnet.wire.messages import Bye, Hello, Identity, OtherVersion, Refuse, Welcome

HELLO_PERIOD_NS = 100_000_000
PROMPT_NS = 20_000_000  # least time between two hellos, when strangers call for them
REPLY_SPACING_NS = 10_000_000  # however fast strangers speak: at most MAX_REPLIES in this time
MAX_REPLIES = 8
SUITOR_NS = 500_000_000  # more than two hellos of a side that looks for a peer are apart
TOLD_SPACING_NS = 100_000_000  # least time between two events that say that somebody does not fit
MAX_PEERS = 4096
BYE_COPIES = 3
BYE_SPACING_NS = 20_000_000

COUPLING = "coupling"
"""Entry of `about`: the coupling that a side runs. Both must run the same."""
SHARED = "shared."
"""What begins so in `about` is a number of the coupling's that both sides must have the same."""

RESERVOIR = "reservoir_J"
"""Entry of `about`: what the reservoir of a side holds when it starts, unless it takes another one's place [J]."""

EARLIER = "earlier"
"""Entry of a welcome's `about`: how many others its sender was paired with before this one; absent if none."""

ControlMessage = Hello | Welcome | Refuse | Bye


class Handshake:
    """One side's part in finding and keeping its peer. `peer` is None while unpaired.

    living : says of a time [ns] whether the peer, if there is one, was heard lately.
    """

    def __init__(self, identity: Identity, living: Callable[[int], bool], hello_period_ns: int) -> None:
        self.identity = identity
        self._living = living
        self.peer: Identity | None = None
        self.pairs = 0
        self._period_ns = hello_period_ns
        self._retired: set[int] = set()
        self._hellos = 0
        self._stale_hellos = 0  # welcomes to these are older than the current state
        self._hello_ns: int | None = 0
        self._prompt_ns = 0  # no hello before that
        self._replies: dict[int, Welcome | Refuse] = {}
        self._reply_ns = 0
        self._suitor: int | None = None  # who alone may become the peer
        self._suitor_ns = 0
        self._bye: Bye | None = None
        self._byes_left = 0
        self._bye_ns = 0
        self._told: dict[type[Event], tuple[int, str, int]] = {}

    def check_peer(self, sender: int, now_ns: int) -> None:
        """Return if `sender` is the peer; else raise BadMessage (stranger, retired, own), and see to the sender."""
        if self.peer is not None and self.peer.incarnation == sender:
            return
        self._check_sender(sender)
        self._check_peer_is_silent(sender, now_ns)
        self._call(now_ns)
        if self.peer is None:
            raise BadMessage("unpaired", f"incarnation {sender:#x} is not the peer yet")
        raise BadMessage("stranger", f"incarnation {sender:#x} is not the peer's")

    def hello(self, message: Hello, now_ns: int) -> tuple[Event, ...]:
        self._check_sender(message.incarnation)
        if reason := self._misfit(_identity(message)):
            return self._refuse(message.incarnation, reason, now_ns)
        self._check_no_rival(message.incarnation, now_ns)
        me = self.identity
        number = message.number
        earlier = self._earlier_peers(message.incarnation)
        about = {**me.about, EARLIER: earlier} if earlier else me.about
        self._reply(Welcome(me.incarnation, message.incarnation, number, me.role, me.dof, me.name, about))
        if self.peer is None or self.peer.incarnation != message.incarnation:
            self._call(now_ns)
        return ()

    def welcome(self, message: Welcome, now_ns: int) -> tuple[Event, ...]:
        self.check_addressee(message.addressee)
        if self.peer is not None and self.peer.incarnation == message.incarnation:
            return ()
        self._check_sender(message.incarnation)
        self._check_no_rival(message.incarnation, now_ns)
        if not self._stale_hellos < message.number <= self._hellos:
            self._call(now_ns)
            raise BadMessage("stale", f"welcome to hello {message.number}; the last pairing was after it, or never")
        identity = _identity(message)
        if reason := self._misfit(identity):
            return self._refuse(message.incarnation, reason, now_ns)
        if len(self._retired) >= MAX_PEERS:
            return self._refuse(message.incarnation, f"this side has seen {MAX_PEERS} peers; restart it", now_ns)
        if self.peer is not None:
            self._reply(self._refusal(self.peer.incarnation, f"replaced by {identity.name}"))
            self._retire(self.peer, now_ns)
        self.peer = identity
        self._suitor = None
        self.pairs += 1
        self._stale_hellos = self._hellos
        self._hello_ns = None
        return (Paired(identity, self.pairs),)

    def refuse(self, message: Refuse, now_ns: int) -> tuple[Event, ...]:
        self._check_not_own(message.incarnation)
        self.check_addressee(message.addressee)
        by_peer = self.peer is not None and self.peer.incarnation == message.incarnation
        if self.peer is not None and by_peer:
            self._retire(self.peer, now_ns)
        else:
            self._check_peer_is_silent(message.incarnation, now_ns)
            self._check_no_other_suitor(message.incarnation, now_ns)
        return self._tell(PeerRefused(message.reason, by_peer), message.incarnation, now_ns)

    def bye(self, message: Bye, now_ns: int) -> tuple[Event, ...]:
        if self.peer is None or self.peer.incarnation != message.incarnation:
            kind = "retired" if message.incarnation in self._retired else "stranger"
            raise BadMessage(kind, f"bye of {message.incarnation:#x}, which is not the peer")
        self._retire(self.peer, now_ns)
        return (PeerLeft(message.reason),)

    def other_version(self, error: OtherVersion, now_ns: int) -> tuple[Event, ...]:
        """A frame of another version: a hello is refused in words, the rest ignored."""
        if error.message_kind != Hello.KIND or error.incarnation == self.identity.incarnation:
            return ()
        return self._refuse(error.incarnation, error.detail, now_ns)

    def check_addressee(self, addressee: int) -> None:
        """Raise BadMessage (addressee) unless that is this incarnation."""
        if addressee != self.identity.incarnation:
            raise BadMessage("addressee", f"meant for incarnation {addressee:#x}")

    def close(self, now_ns: int, acked_nJ: int, reason: str) -> None:
        """Say bye a few times and nothing else any more."""
        addressee = self.peer.incarnation if self.peer is not None else 0
        self._bye = Bye(self.identity.incarnation, addressee, acked_nJ, reason)
        self._byes_left, self._bye_ns = BYE_COPIES, now_ns

    def poll(self, now_ns: int) -> list[ControlMessage]:
        """The messages to send now."""
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
            me = self.identity
            self._hellos += 1
            out.append(Hello(me.incarnation, self._hellos, me.role, me.dof, me.name, me.about))
            self._prompt_ns = now_ns + PROMPT_NS
            self._hello_ns = now_ns + self._period_ns if self.peer is None else None
        return out

    @property
    def next_due_ns(self) -> int | None:
        """When to poll next; a time that has passed means now."""
        if self._bye is not None:
            return self._bye_ns if self._byes_left else None
        if not self._replies:
            return self._hello_ns
        return self._reply_ns if self._hello_ns is None else min(self._reply_ns, self._hello_ns)

    def _check_not_own(self, sender: int) -> None:
        if sender == self.identity.incarnation:
            raise BadMessage("own", "this side's own incarnation came back")

    def _check_sender(self, sender: int) -> None:
        """Raise BadMessage (own, retired) for one that can be no peer, ever."""
        self._check_not_own(sender)
        if sender in self._retired:
            self._reply(self._refusal(sender, "this incarnation was retired; restart it"))
            raise BadMessage("retired", f"incarnation {sender:#x} was the peer once")

    def _check_peer_is_silent(self, sender: int, now_ns: int) -> None:
        if self.peer is not None and self.peer.incarnation != sender and self._living(now_ns):
            raise BadMessage("rival", f"incarnation {sender:#x} wants the place of a peer that is alive")

    def _check_no_rival(self, sender: int, now_ns: int) -> None:
        """Return if `sender` is the peer, or the one that may become it: the suitor, which it is from then on."""
        if self.peer is not None and self.peer.incarnation == sender:
            return
        self._check_peer_is_silent(sender, now_ns)
        self._check_no_other_suitor(sender, now_ns)
        self._suitor, self._suitor_ns = sender, now_ns

    def _check_no_other_suitor(self, sender: int, now_ns: int) -> None:
        if self._suitor not in (None, sender) and now_ns - self._suitor_ns <= SUITOR_NS:
            raise BadMessage("rival", f"incarnation {sender:#x} speaks while another one is about to be the peer")

    def _earlier_peers(self, incarnation: int) -> int:
        """How many others this side was paired with before `incarnation`."""
        current = self.peer is not None and self.peer.incarnation != incarnation
        return len(self._retired) - (incarnation in self._retired) + current

    def _misfit(self, peer: Identity) -> str | None:
        me = self.identity
        if peer.role == me.role:
            return f"both sides are a {me.role}: {peer.name} and {me.name}"
        if peer.dof != me.dof:
            return f"{peer.name} has {peer.dof} degrees of freedom, {me.name} has {me.dof}"
        mine, theirs = me.about.get(COUPLING), peer.about.get(COUPLING)
        if mine is not None and theirs is not None and mine != theirs:
            return f"{peer.name} runs the coupling {theirs}, {me.name} runs {mine}"
        for key in me.about:
            if key.startswith(SHARED) and key in peer.about and me.about[key] != peer.about[key]:
                name = key.removeprefix(SHARED)
                return (
                    f"{peer.name} has {name} {peer.about[key]}, {me.name} has {me.about[key]}: both must have the same"
                )
        return None

    def _call(self, now_ns: int) -> None:
        due_ns = max(now_ns, self._prompt_ns)
        self._hello_ns = due_ns if self._hello_ns is None else min(self._hello_ns, due_ns)

    def _retire(self, peer: Identity, now_ns: int) -> None:
        self._retired.add(peer.incarnation)
        self.peer = None
        self._stale_hellos = self._hellos
        self._call(now_ns)

    def _reply(self, message: Welcome | Refuse) -> None:
        if message.addressee in self._replies or len(self._replies) < MAX_REPLIES:
            self._replies[message.addressee] = message

    def _refusal(self, incarnation: int, reason: str) -> Refuse:
        return Refuse(self.identity.incarnation, incarnation, reason[:MAX_TEXT])

    def _refuse(self, incarnation: int, reason: str, now_ns: int) -> tuple[Event, ...]:
        if self.peer is not None and self.peer.incarnation == incarnation:
            return ()  # the peer did fit: this is a forgery, and a refusal would end the pair
        self._reply(self._refusal(incarnation, reason))
        return self._tell(Mismatch(reason[:MAX_TEXT]), incarnation, now_ns)

    def _tell(self, event: Mismatch | PeerRefused, incarnation: int, now_ns: int) -> tuple[Event, ...]:
        """The event, unless the last of its type said the same of the same peer, or was just now."""
        if (last := self._told.get(type(event))) is not None:
            *what, told_ns = last
            if what == [incarnation, event.reason] or now_ns - told_ns < TOLD_SPACING_NS:
                return ()
        self._told[type(event)] = (incarnation, event.reason, now_ns)
        return (event,)


def _identity(message: Hello | Welcome) -> Identity:
    return Identity(message.incarnation, message.role, message.dof, message.name, message.about)
