"""Find and keep the peer: hello, welcome, refuse, bye. `hapnet.wire.pairing` has the states and each input's effect.

An incarnation, 64 random bits, is one start of a process. The rules:

* A side sends a hello every period until it is paired. A hello is numbered. The answer is a welcome that repeats its
  number, or a refusal.
* A side is paired by a welcome to one of its own hellos, never by a hello: the network may deliver the hello of a
  process that died long ago, but a welcome proves that its sender was alive after the hello with that number left.
* A stranger (neither the peer nor retired) that sends any message is sent a hello. If it answers, it becomes the peer:
  the other side has restarted. Its welcome must repeat a hello that is later than the current pairing. So old messages
  of dead processes, still in the network, can never displace a living peer.
* Nor can a living stranger: while the peer is not silent, strangers (such as a second device under the same name) are
  dropped and not answered; only a hello that does not fit is refused. A stranger keeps sending hellos; its turn comes
  when the peer is silent.
* Of several strangers that look for a peer at once the first is the candidate. The others are dropped until it has
  become the peer, was silent for `CANDIDATE_NS`, or has been the candidate for `CANDIDATURE_NS`. After that it waits
  for `CANDIDATE_NS` itself. If all were welcomed, each would act as the peer and start with a full reservoir.
* A side that offers a key first proves that it holds it. Its hello is answered with a hello that is addressed to it and
  sealed with the key of the two. An addressed hello that answers a recent hello of this side proves its sender. Where
  this side has a word (`hapnet.wire.secret`) every sender must prove itself, which needs the word. A sender without
  proof cannot become the candidate, and cannot end a pair.
* A peer that was displaced, left or refused is retired for as long as this side runs, and each of its messages is
  refused. Its totals continue where they were, so a new pair with it, counted from zero, would credit them twice. After
  `MAX_PEERS` retired peers a side accepts no further peer, so the list is bounded and never shortened.

Each message passes three steps: `_classify` finds its input and changes nothing, the table has the actions for the
input, and `_act` carries them out.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from hapnet.errors import BadMessage
from hapnet.wire.control_sender import Addressed, ControlMessage, ControlSender
from hapnet.wire.events import Event, Mismatch, Paired, PeerLeft, PeerRefused, Unproven
from hapnet.wire.fields import ANSWERS, MAX_TEXT
from hapnet.wire.identity import EARLIER, misfit
from hapnet.wire.messages import Bye, Hello, Identity, OtherVersion, Refuse, Welcome
from hapnet.wire.pairing import Action, Input, PairingState, transition
from hapnet.wire.secret import Keys, Secret

CANDIDATE_NS = 500_000_000  # several hello periods: a side that still looks for a peer sends a hello meanwhile
CANDIDATURE_NS = 2_000_000_000  # others wait this long for a candidate that does not become the peer
REPORT_SPACING_NS = 100_000_000  # minimum time between two reports that a side does not fit
MAX_PEERS = 4096


class MessageContent(NamedTuple):
    """The data of the message that caused the actions. Fields that the message does not have keep their defaults."""

    sender: int
    addressee: int = 0
    number: int = 0
    identity: Identity | None = None
    reason: str = ""
    """The sender's reason for a refusal or bye; the reason why a hello or welcome does not fit."""
    more: dict[str, Any] | None = None
    """Its further entries."""
    proven: bool = False
    """Whether a hello or welcome is sealed with the key that it offers."""


class Ignored(BadMessage):
    """The message does not count. events : the events that are reported nevertheless."""

    def __init__(self, kind: str, detail: str, events: tuple[Event, ...]) -> None:
        self.events: tuple[Event, ...] = events
        super().__init__(kind, detail)


class Handshake:
    """One side's part in finding and keeping its peer. `peer` is None while unpaired.

    living : called with the time [ns]; returns whether the peer, if there is one, is living.
    secret : the secret from which keys are derived; None: neither side's messages are sealed.
    """

    def __init__(
        self, identity: Identity, living: Callable[[int], bool], hello_period_ns: int, secret: Secret | None = None
    ) -> None:
        self.identity = identity
        self.keys: Keys = Keys(secret, identity.incarnation)
        """The keys that this side shares with others."""
        self.state: PairingState = PairingState.SEARCHING
        self.peer: Identity | None = None
        self.pairs: int = 0
        self.control: ControlSender = ControlSender(identity, hello_period_ns, self.keys.offer)
        self._living = living
        self._retired: dict[int, str] = {}  # incarnations, with the refusal that answers their messages
        self._stale_hellos = 0  # no welcome to a hello up to this number pairs: the peer was changed since
        self._candidate: int | None = None
        self._candidate_ns = 0  # when its last message came
        self._candidate_since_ns = 0  # when it became the candidate
        self._candidate_proven = False
        self._answered: dict[int, int] = {}  # by proven incarnation: the highest hello of this side that it answered
        self._reported: dict[type[Event], tuple[int, str, int]] = {}

    def receive(self, message: ControlMessage, now_ns: int, data: bytes = b"") -> tuple[Event, ...]:
        """Process a control message, whose frame is `data`; returns the events that it causes.

        Raises BadMessage: the message does not count, through a fault of the network or of its sender.
        LocalProtocolError: this side has said bye.
        """
        self._observe(now_ns)
        return self._act(*self._classify(message, now_ns, data), now_ns)

    def on_data(self, sender: int, now_ns: int, addressee: int | None = None) -> None:
        """Check the sender of energy or a stream's message. Returns if the message counts, else answers and raises.

        addressee : that of an energy message; a stream's message has none.

        Raises BadMessage: `sender` is a stranger, retired, or this side itself; or the energy is for another
        incarnation.
        """
        if not self._is_peer(sender):
            self._observe(now_ns)
            self._act(self._never_a_peer(sender) or Input.DATA, MessageContent(sender), now_ns)
        elif addressee not in (None, self.identity.incarnation):
            self._act(Input.MISADDRESSED, MessageContent(sender, addressee or 0), now_ns)

    def other_version(self, error: OtherVersion, now_ns: int) -> tuple[Event, ...]:
        """Process a frame of another version: a hello is refused with a reason, all else is ignored."""
        sender = error.incarnation
        if error.message_kind != Hello.KIND or sender == self.identity.incarnation:
            return ()
        self._observe(now_ns)
        happened = Input.FORGED_HELLO if self._is_peer(sender) else Input.UNFIT_HELLO
        return self._act(happened, MessageContent(sender, reason=error.detail), now_ns)

    def close(self, now_ns: int, acked_nJ: int, reason: str) -> None:
        """Say bye a few times, and nothing else from now on.

        Raises LocalProtocolError: this side has said bye already.
        """
        self.state = transition(self.state, Input.CLOSE).state
        addressee, key = self.keys.met
        if self.peer is not None:
            addressee, key = self.peer.incarnation, self.keys.shared_with(self.peer.incarnation)
        self.control.say_bye(Bye(self.identity.incarnation, addressee, acked_nJ, reason), key, now_ns)

    def poll(self, now_ns: int) -> list[Addressed]:
        """The messages to send now."""
        return self.control.poll(now_ns, searching=self.state is PairingState.SEARCHING)

    @property
    def next_due_ns(self) -> int | None:
        """The time to poll next. A time in the past means now; None means that nothing is planned."""
        return self.control.next_due_ns

    # -- the input of a message: these functions change no state ---------------------------------------------------

    def _classify(self, message: ControlMessage, now_ns: int, data: bytes = b"") -> tuple[Input, MessageContent]:
        sender = message.incarnation
        match message:
            case Hello():
                identity = _identity(message)
                reason = misfit(self.identity, identity) or self.keys.misfit(message.name, message.more)
                content = MessageContent(
                    sender, number=message.number, identity=identity, reason=reason, more=message.more
                )
                return self._classify_hello(content, now_ns, data)
            case Welcome():
                identity = _identity(message)
                reason = misfit(self.identity, identity) or self.keys.misfit(message.name, message.more)
                reason = reason or self._no_more_peers()
                content = MessageContent(sender, message.addressee, message.number, identity, reason, message.more)
                return self._classify_welcome(content, now_ns, data)
            case Refuse():
                content = MessageContent(sender, message.addressee, reason=message.reason, more=message.more)
                return self._classify_refusal(content, now_ns, data), content
            case Bye():
                return self._classify_bye(sender), MessageContent(sender, reason=message.reason)

    def _classify_hello(self, content: MessageContent, now_ns: int, data: bytes) -> tuple[Input, MessageContent]:
        sender = content.sender
        if (never := self._never_a_peer(sender)) is not None:
            return never, content
        if self._is_peer(sender):
            forged = bool(content.reason) or self.keys.is_other(sender, content.more)
            return Input.FORGED_HELLO if forged else Input.HELLO_OF_PEER, content
        if self.keys.must_prove(content.more):
            answered, number = (content.more or {}).get(ANSWERS, (0, 0))
            if answered == self.identity.incarnation:
                if not self.keys.is_proven(sender, content.more, data):
                    return Input.FALSE_PROOF, content
                oldest = max(self._stale_hellos, self._answered.get(sender, 0))
                content = content._replace(proven=oldest < number <= self.control.hellos)
            if not content.proven:
                return Input.UNPROVEN_UNFIT_HELLO if content.reason else Input.UNPROVEN_HELLO, content
        if content.reason:
            return Input.UNFIT_HELLO, content
        waits = self._is_other_candidate(sender, now_ns, content.proven) or self._must_wait(sender, now_ns)
        return Input.OTHER_CANDIDATE if waits else Input.HELLO, content

    def _classify_welcome(self, content: MessageContent, now_ns: int, data: bytes) -> tuple[Input, MessageContent]:
        sender = content.sender
        if content.addressee != self.identity.incarnation:
            return Input.MISADDRESSED, content
        if self._is_peer(sender):
            return Input.WELCOME_OF_PEER, content
        if (never := self._never_a_peer(sender)) is not None:
            return never, content
        stale = not self._stale_hellos < content.number <= self.control.hellos
        if self.keys.must_prove(content.more) and not stale:
            if not self.keys.is_proven(sender, content.more, data):
                return Input.FALSE_PROOF, content
            content = content._replace(proven=True)
        if self._is_other_candidate(sender, now_ns, content.proven):
            return Input.OTHER_CANDIDATE, content
        if stale:
            return Input.STALE_WELCOME, content
        return Input.UNFIT_WELCOME if content.reason else Input.WELCOME, content

    def _classify_refusal(self, content: MessageContent, now_ns: int, data: bytes) -> Input:
        sender = content.sender
        if sender == self.identity.incarnation:
            return Input.OWN
        if content.addressee != self.identity.incarnation:
            return Input.MISADDRESSED
        if self._is_peer(sender):
            return Input.REFUSAL_OF_PEER
        if not self.keys.may_refuse(sender, content.more, data):
            return Input.FALSE_PROOF
        return Input.OTHER_CANDIDATE if self._is_other_candidate(sender, now_ns, proven=False) else Input.REFUSAL

    def _classify_bye(self, sender: int) -> Input:
        if self._is_peer(sender):
            return Input.BYE_OF_PEER
        return Input.BYE_OF_RETIRED if sender in self._retired else Input.BYE

    def _is_peer(self, sender: int) -> bool:
        return self.peer is not None and self.peer.incarnation == sender

    def _never_a_peer(self, sender: int) -> Input | None:
        """The input, if `sender` can never be the peer, whatever it sends."""
        if sender == self.identity.incarnation:
            return Input.OWN
        return Input.RETIRED if sender in self._retired else None

    def _is_other_candidate(self, sender: int, now_ns: int, proven: bool) -> bool:
        """Whether `sender` must wait for the candidate, which keeps its place for a time, but not against a sender that
        has proved more.
        """
        if self._candidate in (None, sender) or (proven and not self._candidate_proven):
            return False
        held_ns = now_ns - self._candidate_since_ns
        return now_ns - self._candidate_ns <= CANDIDATE_NS and held_ns <= CANDIDATURE_NS

    def _must_wait(self, sender: int, now_ns: int) -> bool:
        """Whether `sender` was the candidate for so long that another must have its turn."""
        over_ns = now_ns - self._candidate_since_ns - CANDIDATURE_NS
        return self._candidate == sender and 0 < over_ns <= CANDIDATE_NS

    def _no_more_peers(self) -> str:
        return f"this side has seen {MAX_PEERS} peers; restart it" if len(self._retired) >= MAX_PEERS else ""

    # -- carry out what the table decides --------------------------------------------------------------------------

    def _observe(self, now_ns: int) -> None:
        """Update the state to the time: the peer may have fallen silent, or sent messages again."""
        if self.peer is not None:
            heard = Input.PEER_HEARD if self._living(now_ns) else Input.PEER_SILENT
            self.state = transition(self.state, heard).state

    def _act(self, happened: Input, content: MessageContent, now_ns: int) -> tuple[Event, ...]:
        row = transition(self.state, happened)
        self.state = row.state
        events: tuple[Event, ...] = ()
        for action in row.actions:
            events += self._do(action, content, now_ns)
        if row.drop is not None:
            kind, detail = row.drop.value
            raise Ignored(kind, detail.format_map(content._asdict()), events)
        return events

    def _do(self, action: Action, content: MessageContent, now_ns: int) -> tuple[Event, ...]:
        match action:
            case Action.MAKE_CANDIDATE:
                self._make_candidate(content, now_ns)
            case Action.SEND_WELCOME:
                self._send_welcome(content)
            case Action.ASK_PROOF:
                return self._ask_proof(content, now_ns)
            case Action.REPORT_UNPROVEN:
                return self._report(Unproven(), content.sender, now_ns)
            case Action.SEND_REFUSAL:
                return self._refuse(content, now_ns)
            case Action.REFUSE_RETIRED:
                self._send_refusal(content.sender, self._retired[content.sender], self.keys.shared_with(content.sender))
            case Action.SEND_HELLO:
                self.control.say_hello(now_ns)
            case Action.PAIR:
                return self._pair(content)
            case Action.END_PAIR:
                self._retire_peer()
                self.control.say_hello(now_ns)
            case Action.REPORT_REFUSAL:
                return self._report(PeerRefused(content.reason), content.sender, now_ns)
            case Action.REPORT_END_BY_REFUSAL:
                return self._report(PeerRefused(content.reason, by_peer=True), content.sender, now_ns)
            case Action.REPORT_BYE:
                return (PeerLeft(content.reason),)
        return ()

    def _pair(self, content: MessageContent) -> tuple[Event, ...]:
        identity = content.identity
        assert identity is not None  # only a welcome pairs
        why = f"replaced by {identity.name}"
        if self.peer is not None:
            self._send_refusal(self.peer.incarnation, why, self.keys.shared_with(self.peer.incarnation))
        self._retire_peer(why)
        self.peer = identity
        self.keys.keep(identity.incarnation, content.more)
        self._candidate = None
        self._answered.clear()
        self.pairs += 1
        self.control.stop_hellos()
        return (self._paired(identity),)

    def _paired(self, peer: Identity) -> Paired:
        encrypts = self.keys.cipher(peer.incarnation) is not None
        return Paired(peer, self.pairs, encrypts, self.keys.proof, self.keys.fingerprint(peer.incarnation))

    def _make_candidate(self, content: MessageContent, now_ns: int) -> None:
        if content.sender != self._candidate or now_ns - self._candidate_since_ns > CANDIDATURE_NS:
            self._candidate_since_ns = now_ns
        self._candidate, self._candidate_ns, self._candidate_proven = content.sender, now_ns, content.proven
        if content.proven and ANSWERS in (content.more or {}):
            if len(self._answered) >= MAX_PEERS:
                self._answered.clear()
            self._answered[content.sender] = (content.more or {})[ANSWERS][1]

    def _ask_proof(self, content: MessageContent, now_ns: int) -> tuple[Event, ...]:
        if not self.keys.has_key(content.more):
            self._send_refusal(content.sender, f"{_name(content)} has no secret, and this side has one")
            return self._report(Unproven(), content.sender, now_ns)
        if not self.control.is_full and (key := self.keys.key_for(content.sender, content.more)) is not None:
            self.control.answer(content.sender, content.number, key)
        return ()

    def _refuse(self, content: MessageContent, now_ns: int) -> tuple[Event, ...]:
        self._send_refusal(content.sender, content.reason, self.keys.key_for(content.sender, content.more))
        if self.keys.must_prove(content.more) and not content.proven:
            return self._report(Unproven(), content.sender, now_ns)
        return self._report(Mismatch(content.reason[:MAX_TEXT]), content.sender, now_ns)

    def _retire_peer(self, why: str = "this incarnation was retired; restart it") -> None:
        if self.peer is not None:
            self._retired[self.peer.incarnation] = why
        self.peer = None
        self._stale_hellos = self.control.hellos

    def _send_welcome(self, content: MessageContent) -> None:
        me = self.identity
        others = len(self._retired) + (self.peer is not None and not self._is_peer(content.sender))
        about = {**me.about, EARLIER: others} if others else me.about
        welcome = Welcome(
            me.incarnation, content.sender, content.number, me.role, me.dof, me.name, about, self.keys.offer
        )
        key = self.keys.key_for(content.sender, content.more)
        if not self._is_peer(content.sender):
            self.keys.meet(content.sender, key)
        self.control.reply(welcome, key)

    def _send_refusal(self, incarnation: int, reason: str, key: bytes | None = None) -> None:
        self.control.reply(Refuse(self.identity.incarnation, incarnation, reason[:MAX_TEXT]), key)

    def _report(self, event: Mismatch | PeerRefused | Unproven, incarnation: int, now_ns: int) -> tuple[Event, ...]:
        """The event, unless one of its type was just reported, or the last event about this sender was the same."""
        if (last := self._reported.get(type(event))) is not None:
            *what, reported_ns = last
            if what == [incarnation, event.reason] or now_ns - reported_ns < REPORT_SPACING_NS:
                return ()
        self._reported[type(event)] = (incarnation, event.reason, now_ns)
        return (event,)


def _name(content: MessageContent) -> str:
    return "a side" if content.identity is None else content.identity.name


def _identity(message: Hello | Welcome) -> Identity:
    return Identity(message.incarnation, message.role, message.dof, message.name, message.about)
