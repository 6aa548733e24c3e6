"""Who the peer is: hello, welcome, refuse, bye. The states and what each input does are in `hapnet.wire.pairing`.

An incarnation, 64 random bits, is one start of a process. The rules:

* A side says hello every period until it is paired. A hello is numbered. The answer is a welcome that repeats its
  number, or a refusal.
* A side is paired by a welcome to one of its own hellos, never by a hello: the network may deliver the hello of a
  process that died long ago, but a welcome proves that its sender was alive after the hello with that number left.
* A stranger (neither the peer nor retired) that says anything is sent a hello. If it answers, it becomes the peer: the
  old one has restarted. Its welcome must repeat a hello that is later than the current pairing. So what dead processes
  left in the network can never displace a living peer.
* Nor can a living stranger: while the peer is heard, strangers (such as a second device under the same name) are
  dropped and not answered; only a hello that does not fit is refused. A stranger keeps saying hello; its turn comes
  when the peer is silent.
* Of several that look for a peer at once the first is the candidate. The others are dropped until it has become the
  peer, or was not heard for `CANDIDATE_NS`. If all were welcomed, each would take itself for the peer and start with a
  full reservoir.
* A peer that was displaced, left or refused is retired for as long as this side runs, and is refused when it speaks.
  Its totals continue where they were, so a new pair with it, counted from zero, would credit them twice. After
  `MAX_PEERS` retired peers a side pairs with nobody else, so the list is bounded and never shortened.

Each message passes three steps: `_classify` says which input it is and changes nothing, the table decides, and
`_act` does what the table says.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from hapnet.errors import BadMessage, InvalidParameter
from hapnet.units import METRES
from hapnet.wire.control_sender import ControlMessage, ControlSender
from hapnet.wire.events import Event, Mismatch, Paired, PeerLeft, PeerRefused
from hapnet.wire.fields import MAX_TEXT
from hapnet.wire.messages import Bye, Hello, Identity, OtherVersion, Refuse, Welcome, decode, encode
from hapnet.wire.pairing import Action, Input, State, transition
from hapnet.wire.secret import Keys, Secret

CANDIDATE_NS = 500_000_000  # several hello periods: one that still looks for a peer is heard meanwhile
REPORT_SPACING_NS = 100_000_000  # minimum time between two reports that somebody does not fit
MAX_PEERS = 4096

COUPLING = "coupling"
"""Entry of `about`: the coupling that a side runs. Both must run the same."""
UNITS = "units"
"""Entry of `about`: the units of a side's axes, as `hapnet.units` has them; absent: metres. Both must have the same."""
SHARED = "shared."
"""An entry of `about` that begins so is a number of the coupling that must be equal on both sides."""

RESERVOIR = "reservoir_J"
"""Entry of `about`: the energy in a side's reservoir when it starts, unless it takes the place of another side [J]."""

SAMPLED, MOST_SAMPLED = "sampled", 1000
"""Entry of `about`: nothing overtakes a message of the stream whose number is a multiple of it; 1 to so many."""

ROBOT = "robot"
"""Entry of a world's `about`: true if the device leads a robot there; else absent."""

EARLIER = "earlier"
"""Entry of a welcome's `about`: how many others its sender was paired with before this one; absent if none."""


class Said(NamedTuple):
    """What the actions need from the message that caused them. What a message does not have keeps its default."""

    sender: int
    addressee: int = 0
    number: int = 0
    identity: Identity | None = None
    reason: str = ""
    """Refusal or bye: the sender's reason. Hello or welcome: why it does not fit."""
    more: dict[str, Any] | None = None


class Handshake:
    """One side's part in finding and keeping its peer. `peer` is None while unpaired.

    living : called with the time [ns]; returns whether the peer, if there is one, was heard lately.
    secret : what keys are made of; None: neither side's messages are sealed.
    """

    def __init__(
        self, identity: Identity, living: Callable[[int], bool], hello_period_ns: int, secret: Secret | None = None
    ) -> None:
        self.identity = identity
        self.keys: Keys = Keys(secret, identity.incarnation)
        """The keys that this side shares with others."""
        self.state: State = State.SEARCHING
        self.peer: Identity | None = None
        self.pairs: int = 0
        self.control: ControlSender = ControlSender(identity, hello_period_ns, self.keys.offer)
        self._living = living
        self._retired: dict[int, str] = {}  # incarnations, with the refusal that they get when they speak
        self._stale_hellos = 0  # welcomes to these are older than the present peer, or the end of the last
        self._candidate: int | None = None
        self._candidate_ns = 0  # when it was heard last
        self._reported: dict[type[Event], tuple[int, str, int]] = {}

    def receive(self, message: ControlMessage, now_ns: int, data: bytes = b"") -> tuple[Event, ...]:
        """Process a control message, whose frame is `data`; returns the events that it causes.

        Raises BadMessage: the message does not count, through a fault of the network or of its sender.
        LocalProtocolError: this side has said bye.
        """
        self._observe(now_ns)
        return self._act(*self._classify(message, now_ns, data), now_ns)

    def on_data(self, sender: int, now_ns: int, addressee: int | None = None) -> None:
        """Check who sent energy or a stream's message. Returns if the message counts; otherwise answers and raises.

        addressee : of energy. A stream's message has none.

        Raises BadMessage: `sender` is a stranger, retired, or this side itself; or the energy is for another
        incarnation.
        """
        if not self._is_peer(sender):
            self._observe(now_ns)
            self._act(self._never_a_peer(sender) or Input.DATA, Said(sender), now_ns)
        elif addressee not in (None, self.identity.incarnation):
            self._act(Input.MISADDRESSED, Said(sender, addressee or 0), now_ns)

    def other_version(self, error: OtherVersion, now_ns: int) -> tuple[Event, ...]:
        """Process a frame of another version: a hello is refused with a reason, all else is ignored."""
        sender = error.incarnation
        if error.message_kind != Hello.KIND or sender == self.identity.incarnation:
            return ()
        self._observe(now_ns)
        happened = Input.FORGED_HELLO if self._is_peer(sender) else Input.UNFIT_HELLO
        return self._act(happened, Said(sender, reason=error.detail), now_ns)

    def close(self, now_ns: int, acked_nJ: int, reason: str) -> None:
        """Say bye a few times, and nothing else from now on.

        Raises LocalProtocolError: this side has said bye already.
        """
        self.state = transition(self.state, Input.CLOSE).state
        addressee = self.peer.incarnation if self.peer is not None else self.keys.met
        self.control.say_bye(Bye(self.identity.incarnation, addressee, acked_nJ, reason), now_ns)

    def poll(self, now_ns: int) -> list[ControlMessage]:
        """The messages to send now."""
        return self.control.poll(now_ns, searching=self.state is State.SEARCHING)

    @property
    def next_due_ns(self) -> int | None:
        """When to poll next. A time in the past means now; None means that nothing is planned."""
        return self.control.next_due_ns

    # -- which input a message is: nothing here changes anything ---------------------------------------------------

    def _classify(self, message: ControlMessage, now_ns: int, data: bytes = b"") -> tuple[Input, Said]:
        sender = message.incarnation
        match message:
            case Hello():
                identity = _identity(message)
                reason = self._misfit(identity) or self.keys.misfit(message.name, message.more)
                said = Said(sender, number=message.number, identity=identity, reason=reason, more=message.more)
                happened = self._classify_hello(said, now_ns)
                if happened is Input.HELLO_OF_PEER and self.keys.is_other(sender, message.more):
                    return Input.FORGED_HELLO, said
                return happened, said
            case Welcome():
                identity = _identity(message)
                reason = self._misfit(identity) or self._no_more_peers() or self.keys.misfit(message.name, message.more)
                said = Said(sender, message.addressee, message.number, identity, reason)
                happened = self._classify_welcome(said, now_ns)
                if happened is Input.WELCOME and (why := self.keys.prove(message.name, sender, message.more, data)):
                    return Input.UNFIT_WELCOME, said._replace(reason=why)
                return happened, said
            case Refuse():
                said = Said(sender, message.addressee, reason=message.reason)
                return self._classify_refusal(said, now_ns), said
            case Bye():
                return self._classify_bye(sender), Said(sender, reason=message.reason)

    def _classify_hello(self, said: Said, now_ns: int) -> Input:
        if (never := self._never_a_peer(said.sender)) is not None:
            return never
        if self._is_peer(said.sender):
            return Input.FORGED_HELLO if said.reason else Input.HELLO_OF_PEER
        if said.reason:
            return Input.UNFIT_HELLO
        return Input.OTHER_CANDIDATE if self._is_other_candidate(said.sender, now_ns) else Input.HELLO

    def _classify_welcome(self, said: Said, now_ns: int) -> Input:
        if said.addressee != self.identity.incarnation:
            return Input.MISADDRESSED
        if self._is_peer(said.sender):
            return Input.WELCOME_OF_PEER
        if (never := self._never_a_peer(said.sender)) is not None:
            return never
        if self._is_other_candidate(said.sender, now_ns):
            return Input.OTHER_CANDIDATE
        if not self._stale_hellos < said.number <= self.control.hellos:
            return Input.STALE_WELCOME
        return Input.UNFIT_WELCOME if said.reason else Input.WELCOME

    def _classify_refusal(self, said: Said, now_ns: int) -> Input:
        if said.sender == self.identity.incarnation:
            return Input.OWN
        if said.addressee != self.identity.incarnation:
            return Input.MISADDRESSED
        if self._is_peer(said.sender):
            return Input.REFUSAL_OF_PEER
        return Input.OTHER_CANDIDATE if self._is_other_candidate(said.sender, now_ns) else Input.REFUSAL

    def _classify_bye(self, sender: int) -> Input:
        if self._is_peer(sender):
            return Input.BYE_OF_PEER
        return Input.BYE_OF_RETIRED if sender in self._retired else Input.BYE

    def _is_peer(self, sender: int) -> bool:
        return self.peer is not None and self.peer.incarnation == sender

    def _never_a_peer(self, sender: int) -> Input | None:
        """The input, if `sender` can never be the peer, whatever it says."""
        if sender == self.identity.incarnation:
            return Input.OWN
        return Input.RETIRED if sender in self._retired else None

    def _is_other_candidate(self, sender: int, now_ns: int) -> bool:
        return self._candidate not in (None, sender) and now_ns - self._candidate_ns <= CANDIDATE_NS

    def _misfit(self, peer: Identity) -> str:
        """Why `peer` and this side cannot be a pair; empty if they can."""
        me = self.identity
        if peer.role == me.role:
            return f"both sides are a {me.role}: {peer.name} and {me.name}"
        if peer.dof != me.dof:
            return f"{peer.name} has {peer.dof} degrees of freedom, {me.name} has {me.dof}"
        mine, theirs = me.about.get(COUPLING), peer.about.get(COUPLING)
        if mine is not None and theirs is not None and mine != theirs:
            return f"{peer.name} runs the coupling {theirs}, {me.name} runs {mine}"
        units = peer.about.get(UNITS, METRES), me.about.get(UNITS, METRES)
        if units[0] != units[1]:
            return f"{peer.name} has axes in {units[0]}, {me.name} in {units[1]}: both must have the same"
        for key, value in me.about.items():
            if key.startswith(SHARED) and key in peer.about and value != peer.about[key]:
                name = key.removeprefix(SHARED)
                return f"{peer.name} has {name} {peer.about[key]}, {me.name} has {value}: both must have the same"
        return ""

    def _no_more_peers(self) -> str:
        return f"this side has seen {MAX_PEERS} peers; restart it" if len(self._retired) >= MAX_PEERS else ""

    # -- carry out what the table decides --------------------------------------------------------------------------

    def _observe(self, now_ns: int) -> None:
        """Update the state to the time: the peer may have fallen silent, or be heard again."""
        if self.peer is not None:
            heard = Input.PEER_HEARD if self._living(now_ns) else Input.PEER_SILENT
            self.state = transition(self.state, heard).state

    def _act(self, happened: Input, said: Said, now_ns: int) -> tuple[Event, ...]:
        row = transition(self.state, happened)
        self.state = row.state
        events: tuple[Event, ...] = ()
        for action in row.actions:
            events += self._do(action, said, now_ns)
        if row.drop is not None:
            kind, detail = row.drop.value
            raise BadMessage(kind, detail.format_map(said._asdict()))
        return events

    def _do(self, action: Action, said: Said, now_ns: int) -> tuple[Event, ...]:
        match action:
            case Action.MAKE_CANDIDATE:
                self._candidate, self._candidate_ns = said.sender, now_ns
            case Action.SEND_WELCOME:
                self.keys.meet(said.sender, said.more)
                self._send_welcome(said)
            case Action.SEND_REFUSAL:
                self._send_refusal(said.sender, said.reason)
                return self._report(Mismatch(said.reason[:MAX_TEXT]), said.sender, now_ns)
            case Action.REFUSE_RETIRED:
                self._send_refusal(said.sender, self._retired[said.sender])
            case Action.SEND_HELLO:
                self.control.say_hello(now_ns)
            case Action.PAIR:
                return self._pair(said)
            case Action.END_PAIR:
                self._retire_peer()
                self.control.say_hello(now_ns)
            case Action.REPORT_REFUSAL:
                return self._report(PeerRefused(said.reason), said.sender, now_ns)
            case Action.REPORT_END_BY_REFUSAL:
                return self._report(PeerRefused(said.reason, by_peer=True), said.sender, now_ns)
            case Action.REPORT_BYE:
                return (PeerLeft(said.reason),)
        return ()

    def _pair(self, said: Said) -> tuple[Event, ...]:
        identity = said.identity
        assert identity is not None  # only a welcome pairs
        why = f"replaced by {identity.name}"
        if self.peer is not None:
            self._send_refusal(self.peer.incarnation, why)
        self._retire_peer(why)
        self.peer = identity
        self.keys.keep(identity.incarnation)
        self._candidate = None
        self.pairs += 1
        self.control.stop_hellos()
        return (Paired(identity, self.pairs, self.keys.cipher(identity.incarnation) is not None),)

    def _retire_peer(self, why: str = "this incarnation was retired; restart it") -> None:
        if self.peer is not None:
            self._retired[self.peer.incarnation] = why
        self.peer = None
        self._stale_hellos = self.control.hellos

    def _send_welcome(self, said: Said) -> None:
        me = self.identity
        others = len(self._retired) + (self.peer is not None and not self._is_peer(said.sender))
        about = {**me.about, EARLIER: others} if others else me.about
        welcome = Welcome(me.incarnation, said.sender, said.number, me.role, me.dof, me.name, about, self.keys.offer)
        self.control.reply(welcome)

    def _send_refusal(self, incarnation: int, reason: str) -> None:
        self.control.reply(Refuse(self.identity.incarnation, incarnation, reason[:MAX_TEXT]))

    def _report(self, event: Mismatch | PeerRefused, incarnation: int, now_ns: int) -> tuple[Event, ...]:
        """The event, unless one of its type was just reported, or the last one said the same about the same sender."""
        if (last := self._reported.get(type(event))) is not None:
            *what, reported_ns = last
            if what == [incarnation, event.reason] or now_ns - reported_ns < REPORT_SPACING_NS:
                return ()
        self._reported[type(event)] = (incarnation, event.reason, now_ns)
        return (event,)


def _identity(message: Hello | Welcome) -> Identity:
    return Identity(message.incarnation, message.role, message.dof, message.name, message.about)


def check_identity(identity: Identity) -> None:
    """Check that a side can read its own hello and welcome, whatever their numbers: the largest are tried.

    Raises InvalidParameter: it could not.
    """
    try:
        me = identity
        about = {**me.about, EARLIER: 2**63}
        data = encode(Welcome(me.incarnation, 2**64 - 1, 2**64 - 1, me.role, me.dof, me.name, about))
        if not me.name:
            raise BadMessage("range", "name is empty")
        decode(data)
    except (BadMessage, TypeError, ValueError, OverflowError) as error:
        allowed = f"incarnation of 64 bits, not 0; role device or world; 1 to 64 dof; short texts and numbers ({error})"
        raise InvalidParameter("identity", identity, allowed) from None
