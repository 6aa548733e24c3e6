"""What must hold after every message, written from hapnet/wire/README.md and from the theory, not from the code."""

import math
from collections.abc import Iterator, Sized
from typing import Any

from hapnet.checks import Vector
from hapnet.control.pspm import Modulation
from hapnet.control.set_position_coupling import Modulator, SetPositionCoupling
from hapnet.errors import BadMessage
from hapnet.records.record import Floats
from hapnet.side.endpoint import BACKLOG, ControlHalf, Endpoint
from hapnet.wire.control_sender import Outgoing
from hapnet.wire.events import EnergyCredited, Event, Paired, PositionReceived, SampleReceived
from hapnet.wire.messages import (
    Account,
    Encrypted,
    Energy,
    Message,
    Motion,
    Port,
    Position,
    Proxy,
    Refuse,
    Signals,
    Wave,
    decode,
)
from tests.fuzzing.decoder import BAD_FRAMES, Broken, allowed, hold
from tests.fuzzing.mutator import BYE, ENERGY, MOTION, PORT, POSITION, PROXY, SIGNALS, WAVE, WELCOME
from tests.fuzzing.numbers import Numbers
from tests.support.own_motion import beyond

KEYS = dict.fromkeys((POSITION, MOTION, PORT, WAVE, PROXY), "position") | {ENERGY: "energy", SIGNALS: "signals"}
"""The key of a kind; of any other: control."""

BAD_MOMENTS = {
    "own",
    "retired",
    "stranger",
    "rival",
    "unpaired",
    "stream",
    "stale",
    "leap",
    "addressee",
    "dimension",
    "acknowledgement",
    "forged",
    "closed",
}

MOST = {
    "_retired": 4096,
    "_replies": 8,
    "timed_nJ": 256,
    "timed_ns": 256,
    "about": 33,
    "tallies": 1216,
    "seen": 1024,
    "dropped": len(BAD_FRAMES | BAD_MOMENTS),
}
"""The longest that containers of a session may be; any other: 32."""

SLACK_J = -1e-9
ROUNDING = 1e-12


# -- the wire half --------------------------------------------------------------------------------------------------


class Watch:
    """The wire half of a side under attack; `receive` and `poll` check all that a session promises.

    endpoint : of the side.
    power_W, burst_J : of its admission.
    accept_stale : does it take positions in any order?
    """

    def __init__(self, endpoint: Endpoint, *, power_W: float, burst_J: float, accept_stale: bool) -> None:
        self.endpoint = endpoint
        self.session = session = endpoint.session
        self.own = session.identity.incarnation
        self.offered = self.accepted = 0
        self.claimed_nJ = 0
        """What the present peer claimed to have sent, in messages that count."""
        self.numbers = Numbers()
        """Of the present peer's stream."""
        self._expects = session.settings.expects
        self._came: set[int] = set()
        """The numbers of the present peer's waves that were taken."""
        self._rate_nW, self._burst_aJ = round(power_W * 1e9), round(burst_J * 1e9) * 10**9
        self._accept_stale = accept_stale
        self._claimed_before_nJ = 0  # by earlier peers
        self._told_nJ = 0
        self._signals = -1
        self._false = 0
        self._account = 1
        self._credited_nJ = 0
        self._start_ns: int | None = None
        self._dropped = 0

    def receive(self, now_ns: int, data: bytes) -> tuple[Event, ...]:
        """Hand a datagram to the endpoint and check everything."""
        session = self.session
        peer, reply_to = session.peer, session._handshake.control.reply_to
        before = None if peer is None else reply_to(peer.incarnation)
        try:
            message = decode(data)
        except BadMessage:
            message = None
        events = self.endpoint.receive(now_ns, data)
        self.offered += 1
        dropped = session.dropped.total() - self._dropped
        self._dropped += dropped
        self.accepted += 1 - dropped
        hold(dropped == 1 or (dropped == 0 and message is not None), dropped, "counts for one message", message)
        hold(self.offered == self.accepted + self._dropped, "messages got lost")
        hold(not (events and dropped) or message is None, "dropped, and yet", events)
        if message is not None:
            self._check_fate(now_ns, message, peer, bool(dropped), events)
        if peer is not None and session.peer is peer:
            reply = reply_to(peer.incarnation)
            hold(
                reply is before or not isinstance(reply, Refuse),
                "it refuses its own peer, that is ends the pair:",
                reply,
            )
        if session.peer is not peer:
            self._claimed_before_nJ += self.claimed_nJ
            self.claimed_nJ = self._told_nJ = 0
            self._signals, self._account = -1, 1
            self.numbers = Numbers()
            self._came.clear()
        self._check(now_ns, events)
        return events

    def poll(self, now_ns: int) -> list[Outgoing]:
        """Poll the endpoint and check everything, that it will not want to be polled at once again among it."""
        outgoing, events = self.endpoint.poll(now_ns)
        hold(len(outgoing) <= 10, len(outgoing), "messages at once")
        for kind, data in outgoing:
            frame = allowed(data)
            if frame is None:
                raise Broken(f"this side sends a frame that is not allowed: {data.hex()}")
            hold(kind == KEYS.get(frame[1], "control"), frame, "on the key", kind)
            if frame[1] == ENERGY:
                self._told_nJ = max(self._told_nJ, frame[4])
        due_ns = self.session.next_due_ns
        hold(due_ns is None or due_ns > now_ns, "polled at", now_ns, "and due again at", due_ns)
        self._check(now_ns, events)
        return outgoing

    def _check_fate(self, now_ns: int, message: Message, peer: Any, dropped: bool, events: tuple[Event, ...]) -> None:
        """What the page says of this message in this state."""
        from_peer = peer is not None and message.incarnation == peer.incarnation
        if isinstance(message, Position | Motion | Port | Wave | Proxy):
            self._check_stream(now_ns, message, from_peer, dropped, events)
        elif isinstance(message, Energy):
            counts = from_peer and message.addressee == self.own
            false = counts and message.acked_nJ > self._told_nJ
            self._false += false
            hold(self.session.sums.contradictions["acknowledged"] >= self._false, "not noticed:", message)
            hold(dropped != counts, "energy", message, "with", self._told_nJ, "nJ told; dropped:", dropped)
            if counts:
                self.claimed_nJ = max(self.claimed_nJ, message.total_nJ)
        elif isinstance(message, Signals):
            counts = from_peer and message.addressee == self.own and message.sequence > self._signals
            hold(dropped != counts, "signals", message, "after", self._signals, "dropped:", dropped)
            if counts:
                self._signals = message.sequence
        elif isinstance(message, Account):  # this side reports none, so none of its own can have been heard
            counts = from_peer and message.addressee == self.own and message.number >= self._account
            counts = counts and message.heard == 0
            hold(dropped != counts, "account", message, "after", self._account, "dropped:", dropped)
            if counts:
                self._account = message.number
        elif isinstance(message, Encrypted):  # this side has no key
            hold(dropped, message, "was not dropped")
        elif getattr(message, "addressee", self.own) not in (self.own, 0) and message.KIND != BYE:
            hold(dropped, message, "was meant for somebody else")
        if message.incarnation == self.own:
            hold(dropped, "it hears itself:", message)
        if any(isinstance(event, Paired) for event in events):
            hold(message.KIND == WELCOME, "paired by", message)

    def _check_stream(
        self, now_ns: int, message: Position | Motion | Port | Wave | Proxy, from_peer: bool, dropped: bool, events: Any
    ) -> None:
        fits = type(message) is self._expects and len(message.vector) == self.session.identity.dof
        before, word = self.numbers.newest, "doubtful"
        if from_peer and fits:
            word = self.numbers.take(now_ns, message.sequence, message.sent_ns)
        first_time = word != "doubtful" and self._is_first(message.sequence)
        late = word == "late" and isinstance(message, Position) and self._accept_stale and first_time
        counts = first_time if isinstance(message, Wave) else word == "new" or late
        hold(dropped != counts, "position", message, "after", before, "is", word, "dropped:", dropped)
        if not counts:
            return
        known: object = SampleReceived(message)
        if isinstance(message, Position):
            known = PositionReceived(
                message.sequence, message.sent_ns, message.position, level=(message.more or {}).get("level")
            )
        first = events[:1]
        hold(all(0 <= one.took_ns <= 9e10 for one in first), message, "took", first)
        found = tuple([one._replace(took_ns=0) for one in first])
        hold(repr(found) == repr((known,)), message, "gave", events)  # NaN, in entries that nobody knows

    def _is_first(self, number: int) -> bool:
        """Each once, none that is far behind the highest; from a run that goes on far behind, all are counted anew."""
        if number == self.numbers.newest and not max(self._came, default=number) - 1024 < number:
            self._came = set(range(number - 1024, number))
        counts = number not in self._came and number > max(self._came, default=-1) - 1024
        if counts:
            self._came.add(number)
        return counts

    def _check(self, now_ns: int, events: tuple[Event, ...]) -> None:
        for event in events:
            if isinstance(event, EnergyCredited):
                hold(event.credited_nJ > 0, event)
                self._credited_nJ += event.credited_nJ
        session = self.session
        in_flight, abandoned, acked = session.in_flight_nJ, session.abandoned_nJ, session.acked_nJ
        hold(in_flight >= 0 and abandoned >= 0 and acked >= 0, "in flight", in_flight, "abandoned", abandoned)
        hold(session.sent_nJ == acked + in_flight + abandoned, "sent", session.sent_nJ, acked, in_flight, abandoned)
        hold(0.0 <= session.residue_J <= 1e-9, "residue", session.residue_J)
        credited = session.credited_nJ
        hold(credited == self._credited_nJ, credited, "nJ credited,", self._credited_nJ, "nJ reported")
        hold(
            credited <= self._claimed_before_nJ + self.claimed_nJ, credited, "nJ credited,", self.claimed_nJ, "claimed"
        )
        if self._start_ns is None:
            self._start_ns = now_ns
        admitted_aJ = self._burst_aJ + self._rate_nW * (now_ns - self._start_ns)
        hold(credited * 10**9 <= admitted_aJ, credited, "nJ credited, admitted", admitted_aJ, "aJ")
        hold(session.dropped.keys() <= BAD_FRAMES | BAD_MOMENTS, session.dropped)

    def check_memory(self) -> None:
        """Whatever a session holds on to, however deep, is bounded."""
        for name, size in _sizes(self.session, 5):
            hold(size <= MOST.get(name, 32), name, "holds", size)


def _sizes(thing: object, depth: int) -> Iterator[tuple[str, int]]:
    """(name, size) of every container among the attributes of `thing` and of what they hold."""
    names = getattr(thing, "__dict__", None) or {
        name: getattr(thing, name) for cls in type(thing).__mro__ for name in getattr(cls, "__slots__", ())
    }
    for name, value in names.items():
        if isinstance(value, str | bytes):
            yield f"{name} (text)", len(value) // 64
        elif isinstance(value, Sized):
            yield name, len(value)
        elif depth and type(value).__module__.startswith("hapnet"):
            yield from _sizes(value, depth - 1)


# -- the control half -----------------------------------------------------------------------------------------------


class Audited:
    """A modulator, each of its updates checked against (8), (9), the ceiling and the step limit.

    Stands in the modulator's place in a `SetPositionCoupling`.
    """

    def __init__(self, modulator: Modulator, max_step: float, ceiling: float) -> None:
        self.inner = modulator
        self.spring = modulator.spring
        self.max_step = max_step
        self.ceiling = ceiling
        self.updates = 0
        self._stored = 0.0
        self._x: Vector | None = None  # at the last update; and ybar after it
        self._ybar: Vector = ()
        self._K: list[list[float]] = modulator.spring.K.tolist()
        limit = modulator.spring.force_limit
        largest = modulator.spring.ellipsoid.largest
        self._knee = math.inf if limit is None else limit / math.sqrt(largest)

    @property
    def set_position(self) -> Vector:
        return self.inner.set_position

    @property
    def energy(self) -> float:
        return self.inner.energy

    @property
    def deficit(self) -> float:
        return self.inner.deficit

    @property
    def account(self) -> float:
        return self.inner.account

    @property
    def level(self) -> float | None:
        return self.inner.level

    @property
    def modulated(self) -> int:
        return self.inner.modulated

    @property
    def ybar(self) -> Floats:
        return self.inner.ybar

    @property
    def discarded(self) -> float:
        return self.inner.discarded

    @property
    def jump(self) -> float:
        return self.inner.jump

    def modulate(self, y: Vector, x: Vector, dissipated: float, received: float, keep: float = 0.0) -> Modulation:
        start, account = self.inner.set_position, self.inner.account
        before = self._potential(x, start)
        result = self.inner.modulate(y, x, dissipated, received, keep)
        ybar = result.set_position
        after = self._potential(x, ybar)
        numbers = (*ybar, *y, *x, *result[1:], dissipated, received, after)
        hold(all(map(math.isfinite, numbers)), "not finite:", result, "from", y, x, dissipated, received)
        hold(result.energy >= 0.0 and result.deficit >= 0.0, "energy", result.energy, "deficit", result.deficit)
        ceiling = max(self.ceiling, (keep - after) * (1.0 + ROUNDING))
        hold(result.energy <= ceiling and result.sent >= 0.0 and result.discarded >= 0.0, result)
        hold(result.energy == 0.0 or result.deficit == 0.0, "energy and a deficit:", result)
        left = account + received + dissipated + before - after
        kept = result.energy - result.deficit + result.sent + result.discarded
        scale = abs(account) + received + abs(dissipated) + before + after
        hold(abs(left - kept) <= ROUNDING * scale, "energy from nothing:", left, "became", kept, result)
        if y != x:  # letting the spring go knows no limit
            reserve: float = getattr(self.inner, "reserve", 0.0)
            self._check_step(start, ybar, x, account + received + dissipated + before - reserve)
        self._x, self._ybar = x, ybar
        self._stored = after
        self.updates += 1
        return result

    def split_reservoir(self, most: float = math.inf) -> float:
        before = self.inner.energy
        given = self.inner.split_reservoir(most)
        hold(0.0 <= given <= before and self.inner.energy + given == before, "shared", given, "of", before)
        return given

    def give(self, dt: float, peer_level: float, keep: float) -> float:
        """Only the fuller side gives, and what the spring's jumps and a force under zero-order hold need stays here."""
        before, level = self.inner.energy, self.level
        given = self.inner.give(dt, peer_level, keep)
        hold(self.inner.energy == before - given, "given", given, "of", before, "left", self.inner.energy)
        if given != 0.0:
            reserve: float = getattr(self.inner, "reserve", 0.0)
            spare = before - max(reserve, keep - self._stored)
            hold(0.0 < given <= spare, "given", given, "of", spare)
            hold(level is not None and level > peer_level + 0.1, "a level of", level, "gave to", peer_level)
        return given

    def _check_step(self, start: Vector, ybar: Vector, x: Vector, at_hand: float) -> None:
        """The step limit, beyond the own motion; where the energy does not suffice, ybar must yield too. A proxy that
        was carried took ybar along since the last update: that part of its motion changed no force."""
        if self._x is None:
            return
        own = tuple([a - b - (c - d) for a, b, c, d in zip(x, self._x, start, self._ybar, strict=True)])
        yielding = 0.0
        for end in (start, tuple([a + b for a, b in zip(start, own, strict=True)])):
            if at_hand < (stored := self._potential(x, end)) and stored > 0.0:
                s, minimum = self._length(stored), self._length(max(0.0, at_hand))
                yielding = max(yielding, math.dist(x, end) * (1.0 - minimum / s))
        step = beyond(ybar, start, own)
        rounding = ROUNDING * (math.hypot(*start) + math.hypot(*ybar) + math.hypot(*x)) + 1e-8 * yielding
        limit = self.max_step + yielding + rounding
        hold(step <= limit, "step", step, "limit", self.max_step, "yielding", yielding)

    def _potential(self, x: Vector, ybar: Vector) -> float:
        e = [a - b for a, b in zip(x, ybar, strict=True)]
        square = sum(sum(k * b for k, b in zip(row, e, strict=True)) * a for row, a in zip(self._K, e, strict=True))
        s = math.sqrt(max(0.0, square))
        return 0.5 * square if s <= self._knee else self._knee * s - 0.5 * self._knee**2

    def _length(self, potential: float) -> float:
        """|e|_K where the spring holds this energy [J]."""
        linear = math.sqrt(2.0 * potential)
        return linear if linear <= self._knee else potential / self._knee + 0.5 * self._knee


def check_coupling(coupling: SetPositionCoupling, x: Vector, force_limit: float | None) -> None:
    """Control after a tick or a step: finite, its half of the theorem kept, the spring within its limit."""
    ledger, modulator = coupling.ledger, coupling.modulator
    hold(ledger.slack_min >= SLACK_J, "slack", ledger.slack_min)
    hold(modulator.energy >= 0.0 and modulator.deficit >= 0.0, "energy", modulator.energy, modulator.deficit)
    state = (*x, *modulator.set_position, *coupling.target, ledger.margin, ledger.slack, ledger.credited, ledger.sent)
    hold(all(map(math.isfinite, state)), "not finite:", state)
    if force_limit is not None:
        force = math.hypot(*coupling.spring.force(modulator.set_position, x))
        hold(force <= force_limit * (1.0 + ROUNDING), "the spring pulls with", force, "N of", force_limit)


def check_control(control: ControlHalf, received: int) -> None:
    """What waits between the halves is bounded: some positions, and a credit for each message received since a tick."""
    hold(len(control.waiting) <= min(BACKLOG, received), len(control.waiting), "positions wait")
    hold(len(control.credits) <= received, len(control.credits), "credits wait of", received, "messages")
