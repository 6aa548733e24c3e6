"""One side of the protocol: handshake, position stream and energy channel behind one interface.

Bytes and the time go in, events and bytes come out; there is no clock and no I/O here. A runtime

* passes every datagram that arrives, on any key, to `receive`, and acts on the events;
* calls `poll` after that, after `shuffle` and `close`, and at `next_due_ns`, and sends the frames that it returns;
* calls `position` whenever there is a set-position to send. Only this method may run in another thread: it shares
  no mutable state with the others.

Network input never raises: a bad message is counted in `dropped` by its kind and changes nothing.

The account over all pairs is exact at every instant: `sent_nJ == acked_nJ + in_flight_nJ + abandoned_nJ` here, and for
each pair `acked_nJ (here) <= credited_nJ (peer) <= sent_nJ (here)`. Abandoned energy may have been credited if only its
acknowledgement was lost; a peer that leaves with a bye reports exactly how much it credited.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence

from hapnet.errors import BadMessage, InvalidParameter
from hapnet.wire.account import AccountExchange
from hapnet.wire.control_sender import Outgoing
from hapnet.wire.encryption import Cipher
from hapnet.wire.energy_channel import EnergyChannel, Totals
from hapnet.wire.events import EnergyCredited, Event, PositionReceived, SampleReceived
from hapnet.wire.fields import SUMS, Signal, printable
from hapnet.wire.handshake import Handshake, Ignored
from hapnet.wire.identity import MOST_SAMPLED, RESERVOIR, SAMPLED, check_identity
from hapnet.wire.messages import (
    Account,
    Bye,
    Encrypted,
    Energy,
    Hello,
    Identity,
    Message,
    Motion,
    OtherVersion,
    Port,
    Position,
    Proxy,
    Refuse,
    Role,
    Scalar,
    Signals,
    Stream,
    Wave,
    Welcome,
    decode,
    encode,
)
from hapnet.wire.numbering import DOUBTFUL, LATE
from hapnet.wire.path import Path, arrive, is_used
from hapnet.wire.peer_monitor import Outages, PeerMonitor
from hapnet.wire.replay_window import ReplayWindow, stale_detail
from hapnet.wire.secret import Secret, decrypted
from hapnet.wire.session_settings import SessionSettings as SessionSettings
from hapnet.wire.signals import SignalExchange
from hapnet.wire.stream import PositionStream as PositionStream
from hapnet.wire.stream_frames import sequence_of
from hapnet.wire.sums import Impostors, Sums
from hapnet.wire.token_bucket import TokenBucket


class Session:
    """One side, from the start of its process to its end.

    More than twenty attributes: some outlive a pair of sides, the others are the parts of the present pair.

    role, dof, name, about : this side's identity, sent to the peer. `about` is a small description of what it runs.
    incarnation : 64 random bits, not 0, drawn when the process starts.
    settings : see `SessionSettings`.
    secret : the secret from which this side's keys are derived. None: it offers no key, so that nothing is sealed.

    Raises InvalidParameter: an identity that no peer would accept; a setting out of range.
    """

    def __init__(
        self,
        *,
        role: Role,
        dof: int,
        name: str,
        incarnation: int,
        about: dict[str, Scalar] | None = None,
        settings: SessionSettings | None = None,
        secret: Secret | None = None,
    ) -> None:
        self.identity: Identity = Identity(incarnation, role, dof, name, dict(about or {}))
        check_identity(self.identity)
        self.settings: SessionSettings = settings or SessionSettings()
        self.dropped: Counter[str] = Counter()
        self.dropped_for: dict[str, str] = {}
        """The detail of the last message that was dropped, for each kind in `dropped`."""
        self.closed: bool = False
        self._expects = self.settings.expects
        self.replay_window = ReplayWindow()
        self.path: Path = Path()
        """The measurements of the path between the sides."""
        self._monitor = PeerMonitor(self.settings.silence_ns)
        self._handshake = Handshake(self.identity, self._monitor.living, self.settings.hello_period_ns, secret)
        self._admission = TokenBucket(self.settings.admission_W, self.settings.admission_burst_J)
        self._past = Totals()
        self._channel = self._open_channel(0.0)
        self._cipher: Cipher | None = None
        self.fingerprint: str = ""
        """The fingerprint of the key of the present or last pair, for people to compare; empty: there is none."""
        self.sums: Sums = Sums()
        """The check that the energy messages in the peer's name fit together."""
        self._impostors = Impostors(self._handshake.keys, self.sums)
        self.positions: PositionStream = PositionStream(incarnation)
        self.position: Callable[[int, Sequence[float]], bytes] = self.positions.position
        """(now_ns, position) -> the next frame for the position key; see `PositionStream`."""
        self.signals: SignalExchange = SignalExchange()
        """Named values beside the stream, in both directions."""
        self.accounts: AccountExchange = AccountExchange()
        """Each side's reports of its half of the account."""
        self.peers_J: float = 0.0
        """The energy in the first peer's reservoir at its start, as reported [J]; later peers start with none."""

    @property
    def peer(self) -> Identity | None:
        """The peer, while paired."""
        return self._handshake.peer

    @property
    def channel(self) -> EnergyChannel:
        """The stream of energy of the present pair."""
        return self._channel

    @property
    def monitor(self) -> PeerMonitor:
        """The monitor of the peer's messages and silences."""
        return self._monitor

    @property
    def handshake_over(self) -> bool:
        """Whether the handshake has nothing more to send."""
        return self._handshake.next_due_ns is None

    def sample(self, every: int) -> None:
        """Announce to later peers that nothing overtakes a stream's message whose number is a multiple of `every`."""
        if every > 1:
            self.identity.about[SAMPLED] = min(every, MOST_SAMPLED)

    def shuffle(self, energy_J: float) -> None:
        """Send `energy_J` [J] to the peer. While there is none it is abandoned, which is safe, and counted.

        Raises InvalidParameter: negative or not finite.
        """
        self._channel.send(energy_J)
        if self.peer is None or self.closed:
            self._channel.abandon()

    def report(self, name: str, value: Signal) -> None:
        """Send the peer this value beside the stream. A value that is not small is dropped, and counted."""
        try:
            self.signals.report(name, value)
        except InvalidParameter as error:
            self._drop(BadMessage("own signal", str(error)))

    def receive(self, now_ns: int, data: bytes) -> tuple[Event, ...]:
        """Process the datagram `data`; returns the events that it causes. Never raises, whatever the content."""
        if self.closed:
            self.dropped["closed"] += 1
            return ()
        before = self._handshake.peer
        message: Message | None = None
        doubts: tuple[Event, ...] = ()
        try:
            message = decode(data)
            if type(message) is Encrypted:
                self._handshake.on_data(message.incarnation, now_ns)
                message = decrypted(message, self._cipher)
            elif type(message) is not self._expects or self._cipher is not None:
                self._handshake.keys.require_seal(message, data)
            if type(message) is self._expects:  # nearly every message
                return self._on_stream(message, now_ns)
            if isinstance(message, Hello | Welcome):
                doubts = self._impostors.on_offer(message, before)
            events = self._dispatch(message, now_ns, data)
        except OtherVersion as error:
            self._drop(error)
            events = self._handshake.other_version(error, now_ns)
        except BadMessage as error:
            self._drop(error)
            ignored = error.events if isinstance(error, Ignored) else ()
            events = self._impostors.on_bad(message, before, error) + ignored
        if self._handshake.peer is not before:
            self._change_pair(now_ns)
            events += self._impostors.on_peer(self.peer)
        return events + doubts

    @property
    def proof(self) -> str | None:
        """The proof of the peer's identity: "word", "certificate", "socket" or "nobody"; None: there are no keys."""
        return self._handshake.keys.proof

    def outward(self, frame: bytes) -> bytes | None:
        """A frame of this side's stream as it is sent, encrypted if the pair encrypts; None: it must not be sent."""
        if self._cipher is not None:
            return self._cipher.encrypt(frame, sequence_of(frame))
        keys = self._handshake.keys  # the next peer, if it has keys, would take an open frame for another sender's
        return None if keys.must_encrypt or (self.peer is None and keys.offer) else frame

    @property
    def encrypts(self) -> bool:
        """Whether this side must encrypt all that it sends. A pair in which both sides merely can encrypt does so
        too.
        """
        keys = self._handshake.keys
        return keys.must_encrypt if self.peer is None else keys.is_secret(self.peer.incarnation)

    def _drop(self, error: BadMessage) -> None:
        self.dropped[error.kind] += 1
        self.dropped_for[error.kind] = error.detail

    def watch(self, now_ns: int) -> tuple[Event, ...]:
        """Report that the peer has fallen silent, once for each silence. Call it regularly."""
        if self.closed or self.peer is None or (silent := self._monitor.watch(now_ns)) is None:
            return ()
        return (silent,)

    def outages(self, now_ns: int) -> Outages:
        """The peer's silences and losses so far."""
        return self._monitor.outages(now_ns)

    def poll(self, now_ns: int) -> tuple[list[Outgoing], tuple[Event, ...]]:
        """Return the messages to send now, and the events of energy that is credited now after waiting for the token
        bucket.
        """
        events = self._credited(self._channel.admit(now_ns))
        outgoing: list[Outgoing] = []
        peer = self._handshake.peer
        if peer is not None and (due := self._channel.poll(now_ns)) is not None:
            sums = {SUMS: self.sums.next(self._channel.sent_nJ, due[1])} if self.settings.sends_sums else None
            outgoing.append(self._outgoing(Energy(self.identity.incarnation, peer.incarnation, *due, sums)))
        if peer is not None and not self.closed and (values := self.signals.poll(now_ns)) is not None:
            outgoing.append(self._outgoing(Signals(self.identity.incarnation, peer.incarnation, *values)))
        if peer is not None and not self.closed and (account := self.accounts.poll(now_ns)) is not None:
            outgoing.append(self._outgoing(Account(self.identity.incarnation, peer.incarnation, *account)))
        outgoing.extend(Outgoing.of(message, key) for message, key in self._handshake.poll(now_ns))
        return outgoing, events

    @property
    def next_due_ns(self) -> int | None:
        """The latest time to call `poll` next. A time in the past means now; None means that nothing is planned."""
        handshake, channel = self._handshake.next_due_ns, self._channel.next_due_ns
        if self.peer is not None and not self.closed:
            for due in (self.signals.next_due_ns, self.accounts.next_due_ns):
                if due is not None:
                    channel = due if channel is None else min(due, channel)
        if handshake is None or channel is None:
            return channel if handshake is None else handshake
        return min(handshake, channel)

    def close(self, now_ns: int, reason: str) -> None:
        """End the pair and this side: `poll` still returns some byes; after them nothing is due.

        Energy in flight is abandoned: wait for `settled` first, as long as there is time.
        """
        if not self.closed:
            self.closed = True
            self._channel.abandon()
            self._handshake.close(now_ns, self._channel.credited_nJ, printable(reason))

    @property
    def settled(self) -> bool:
        """Whether all energy sent is acknowledged or abandoned."""
        return self.in_flight_nJ == 0

    @property
    def incarnations(self) -> int:
        """The number of the peer's incarnations that this side was paired with."""
        return self._handshake.pairs

    @property
    def sent_nJ(self) -> int:
        """All energy sent, in whole nJ: over all pairs, and while there was none."""
        return self._past.sent + self._channel.sent_nJ

    @property
    def acked_nJ(self) -> int:
        """The energy that the peers have acknowledged."""
        return self._past.acked + self._channel.acked_nJ

    @property
    def credited_nJ(self) -> int:
        """The energy that this side has credited to its peers: the sum of all `EnergyCredited`."""
        return self._past.credited + self._channel.credited_nJ

    @property
    def abandoned_nJ(self) -> int:
        """The energy that was sent without a peer, or was not acknowledged when its pair ended."""
        return self._past.abandoned + self._channel.abandoned_nJ

    @property
    def in_flight_nJ(self) -> int:
        """The energy that was sent and is neither acknowledged nor abandoned."""
        return self._channel.in_flight_nJ

    @property
    def unanswered_ns(self) -> int:
        """The time in which positions came, but no acknowledgement of the energy in flight [ns]; 0: none in flight."""
        return self._channel.unanswered_ns(self._monitor.heard_ns)

    @property
    def residue_J(self) -> float:
        """The fraction of a nanojoule that waits to be sent [J]: all shuffled energy is `sent_nJ` plus this."""
        return self._channel.residue_J

    def _dispatch(self, message: Message, now_ns: int, data: bytes) -> tuple[Event, ...]:
        self._monitor.on_any_message(now_ns)
        match message:
            case Position() | Motion() | Port() | Wave() | Proxy():
                return self._on_stream(message, now_ns)
            case Energy():
                self._handshake.on_data(message.incarnation, now_ns, message.addressee)
                return self._on_energy(message, now_ns)
            case Signals():
                self._handshake.on_data(message.incarnation, now_ns, message.addressee)
                return self.signals.receive(message.sequence, message.values)
            case Account():
                self._handshake.on_data(message.incarnation, now_ns, message.addressee)
                self.accounts.receive(message, now_ns)
                return ()
            case Bye():
                return self._on_bye(message, now_ns, data)
            case Encrypted():  # it was replaced by its content
                return ()
            case Hello() | Welcome() | Refuse():
                return self._handshake.receive(message, now_ns, data)

    def _on_energy(self, message: Energy, now_ns: int) -> tuple[Event, ...]:
        announced_nJ = self._channel.announced_nJ
        events = self.sums.take(message, announced_nJ)
        # a total may be true although the acknowledgement in the same message is false
        credited_nJ = self._channel.receive(message.total_nJ, min(message.acked_nJ, announced_nJ), now_ns)
        return events + self._credited(credited_nJ)

    def _on_stream(self, message: Stream, now_ns: int) -> tuple[Event, ...]:
        peer = self._handshake.peer
        if peer is None or peer.incarnation != message.incarnation:
            self._handshake.on_data(message.incarnation, now_ns)
        if type(message) is not self._expects:
            raise BadMessage("stream", f"a {_word(message)}; allowed with this coupling: a {_word(self._expects)}")
        if len(message.vector) != self.identity.dof:
            raise BadMessage("dimension", f"{len(message.vector)} coordinates; allowed: {self.identity.dof}")
        monitor, path, sequence, sent_ns = self._monitor, self.path, message.sequence, message.sent_ns
        once = type(message) is Wave
        place = arrive(
            path, monitor, self.replay_window, once, now_ns, sequence, sent_ns, message.echo_ns, message.came_ns
        )
        if place == DOUBTFUL:
            newest = monitor.numbers.newest
            detail = f"{_word(message)} {sequence} cannot follow {newest}: its number or its time stamp is not possible"
            raise BadMessage("leap", detail)
        received = (
            PositionReceived(sequence, sent_ns, message.position, path.under_way_ns, message.level)
            if isinstance(message, Position)
            else SampleReceived(message, path.under_way_ns)
        )
        if not is_used(place, once, self.settings.accept_stale and type(message) is Position):
            raise BadMessage("stale", stale_detail(_word(message), sequence, place))
        heard = None if place == LATE else monitor.ended
        return (received,) if heard is None else (received, heard)

    def _on_bye(self, message: Bye, now_ns: int, data: bytes) -> tuple[Event, ...]:
        peer = self.peer
        mine = message.addressee == self.identity.incarnation
        events: tuple[Event, ...] = ()
        if mine and peer is not None and peer.incarnation == message.incarnation:
            announced_nJ = self._channel.announced_nJ
            events = self.sums.acknowledged(message.acked_nJ, announced_nJ)
            self._channel.acknowledge(min(message.acked_nJ, announced_nJ), now_ns)
        return events + self._handshake.receive(message, now_ns, data)

    def _credited(self, credited_nJ: int) -> tuple[Event, ...]:
        return (EnergyCredited(credited_nJ),) if credited_nJ else ()

    def _change_pair(self, now_ns: int) -> None:
        if (peer := self.peer) is not None:
            self.fingerprint = self._handshake.keys.fingerprint(peer.incarnation)
            self._monitor.begin(now_ns)
            every = peer.about.get(SAMPLED)
            self.path.begin(now_ns, every if type(every) is int and 1 <= every <= MOST_SAMPLED else 1)
            self.replay_window = ReplayWindow()
            reservoir_J = peer.about.get(RESERVOIR)
            if self.incarnations == 1 and isinstance(reservoir_J, float) and reservoir_J > 0.0:
                self.peers_J = reservoir_J  # later peers start with none
        self.signals.change_pair()
        self.accounts.change_pair(paired=self.peer is not None)
        self._cipher = None if self.peer is None else self._handshake.keys.cipher(self.peer.incarnation)
        self._channel.abandon()
        self._past.add(self._channel)
        self._channel = self._open_channel(self._channel.residue_J)
        self.sums.change_pair()

    def _outgoing(self, message: Energy | Signals | Account) -> Outgoing:
        if self._cipher is not None:
            return Outgoing(message.CHANNEL, self._cipher.encrypt(encode(message)))
        return Outgoing.of(message, self._handshake.keys.shared_with(message.addressee))

    def _open_channel(self, residue_J: float) -> EnergyChannel:
        return EnergyChannel(self._admission, spacing_ns=self.settings.spacing_ns, residue_J=residue_J)


def _word(stream: Stream | type[Stream]) -> str:
    return (stream if isinstance(stream, type) else type(stream)).__name__.lower()
