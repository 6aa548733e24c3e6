"""Sessions on one pair of keys, without a clock: what tests of the protocol share."""

import random
from collections import Counter
from typing import Any

from hapnet.wire.events import EnergyCredited, Event
from hapnet.wire.messages import Encrypted, Role, decode
from hapnet.wire.session import Session, SessionSettings

MS = 1_000_000
OPEN = SessionSettings(admission_W=1e6, admission_burst_J=1e6)


def session(role: Role, incarnation: int, *, dof: int = 1, settings: SessionSettings = OPEN) -> Session:
    return Session(role=role, dof=dof, name=f"{role}-{incarnation}", incarnation=incarnation, settings=settings)


class Network:
    """Sessions on one pair of keys: what one says, the other role hears late, in any order, repeatedly or never."""

    def __init__(self, *sessions: Session, seed: int = 0, loss: float = 0.0, repeat: float = 0.0, jitter: int = 0):
        self.sessions = list(sessions)
        self.gone: list[Session] = []
        self.one_key = False  # everybody hears everybody
        self.rng = random.Random(seed)
        self.loss, self.repeat, self.jitter = loss, repeat, jitter
        self.now = 0
        self.path: list[tuple[int, Session, bytes]] = []
        self.events: dict[int, list[Event]] = {}
        self.sent: list[bytes] = []

    def kill(self, s: Session) -> None:
        self.sessions.remove(s)
        self.gone.append(s)

    def put(self, sender: Session, data: bytes) -> None:
        self.sent.append(data)
        copies = 0 if self.rng.random() < self.loss else 1 + (self.rng.random() < self.repeat)
        for _ in range(copies):
            self.path.append((self.now + 5 * MS + self.rng.randrange(self.jitter + 1), sender, data))

    def happened(self, s: Session, *kinds: type[Event]) -> list[Event]:
        return [e for e in self.events.get(s.identity.incarnation, []) if isinstance(e, kinds or object)]

    def run(self, duration_ns: int) -> None:
        end = self.now + duration_ns
        while self.now < end:
            for s in self.sessions:
                due = s.next_due_ns
                if due is not None and due <= self.now:
                    outgoing, events = s.poll(self.now)
                    self.events.setdefault(s.identity.incarnation, []).extend(events)
                    for frame in outgoing:
                        message = decode(frame.data)
                        assert isinstance(message, Encrypted) or frame.kind == message.CHANNEL
                        self.put(s, frame.data)
            self.now += MS
            ready = [item for item in self.path if item[0] <= self.now]
            self.path = [item for item in self.path if item[0] > self.now]
            for _, sender, data in ready:
                for s in self.sessions:
                    if s is not sender and (self.one_key or s.identity.role != sender.identity.role):
                        self.events.setdefault(s.identity.incarnation, []).extend(s.receive(self.now, data))
            self.check()

    def check(self) -> None:
        sent, credited = Counter[str](), Counter[str]()
        for s in self.sessions + self.gone:
            assert s.sent_nJ == s.acked_nJ + s.in_flight_nJ + s.abandoned_nJ
            assert s.credited_nJ == sum(e.credited_nJ for e in self.happened(s) if isinstance(e, EnergyCredited))
            sent[s.identity.role] += s.sent_nJ
            credited[s.identity.role] += s.credited_nJ
        assert credited["device"] <= sent["world"]
        assert credited["world"] <= sent["device"]


def paired(**kwargs: Any) -> tuple[Network, Session, Session]:
    device, world = session("device", 1), session("world", 2)
    network = Network(device, world, **kwargs)
    network.run(300 * MS)
    assert device.peer == world.identity
    assert world.peer == device.identity
    return network, device, world
