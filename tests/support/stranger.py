"""Somebody between both sides who only adds frames, whatever carries them; he uses the session of the sides themselves.

To the device he is a world, to the world a device: in their names, or in names of his own; he has a key of his own, and
keeps to the protocol otherwise. What they then send him he passes on, energy too, but some of it early. Before that a
decoy may look for the world's place of a candidate.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from hapnet.errors import BadMessage
from hapnet.side.endpoint import NANO
from hapnet.wire.control_sender import Outgoing
from hapnet.wire.encryption import Encrypted
from hapnet.wire.events import EnergyCredited
from hapnet.wire.messages import Hello, Role, Welcome, decode
from hapnet.wire.secret import Secret
from hapnet.wire.session import Session, SessionSettings

OTHER: dict[Role, Role] = {"device": "world", "world": "device"}


@dataclass(frozen=True)
class Plan:
    """What he does.

    early_nJ : so much energy he sends to the world before the device does. from_s : when, after he has paired with
    both. decoy : does somebody look for the world's place first, and never take it? own_names : does he speak in names
    of his own? edits : does he change the accounts that they report, so that they fit each other?
    """

    early_nJ: int = 0
    from_s: float = 0.5
    decoy: bool = False
    own_names: bool = False
    edits: bool = False


class Puppet:
    """One of his two faces: a whole session of a side, in the name that he chooses."""

    def __init__(self, true: Hello, settings: SessionSettings | None, incarnation: int, secret: Secret) -> None:
        self.session = Session(
            role=true.role,
            dof=true.dof,
            name=true.name,
            incarnation=incarnation,
            about=dict(true.about),
            settings=settings,
            secret=secret,
        )

    @property
    def paired(self) -> bool:
        return self.session.peer is not None

    def passed_on(self, data: bytes, to: Session) -> bytes | None:
        """A message of a stream that came to this face, as the other face says it; None: it is none."""
        message, cipher = decode(data), self.session._cipher
        if not isinstance(message, Encrypted) or message.number >= 2**63 or cipher is None:
            return None
        try:
            inside = cipher.decrypt(message)
        except BadMessage:  # both sides speak with each other, after all
            return None
        return to.outward(inside[:4] + to.identity.incarnation.to_bytes(8, "big") + inside[12:])


class Stranger:
    """His two faces and his decoy.

    say : carries frames that are said in a role, to the other. settings : of a side's session, as he imitates it; None:
    the usual ones.
    """

    def __init__(
        self,
        plan: Plan,
        say: Callable[[Role, list[Outgoing]], None],
        settings: Callable[[Role], SessionSettings | None] = lambda role: None,
    ) -> None:
        self.plan = plan
        self.faces: dict[Role, Puppet] = {}
        """By role that he plays: "world" is what the device hears."""
        self.believed: set[Role] = set()
        """The roles in which somebody has paired with him."""
        self._say, self._settings = say, settings
        self._decoy: Puppet | None = None
        self._paired_both_ns: int | None = None
        self._debt_nJ = 0
        self._left_nJ = plan.early_nJ

    def hear(self, sender: Role, data: bytes, now_ns: int) -> None:
        """Take a frame that the side of this role has sent."""
        message = decode(data)
        if isinstance(message, Hello) and sender not in self.faces:
            self._put_on(sender, message)
        face = self.faces.get(OTHER[sender])
        if face is None:
            return
        other = self.faces.get(sender)
        for event in face.session.receive(now_ns, data):
            if isinstance(event, EnergyCredited) and other is not None:
                repaid = min(self._debt_nJ, event.credited_nJ) if sender == "device" else 0
                self._debt_nJ -= repaid
                other.session.shuffle((event.credited_nJ - repaid) * NANO)
        if other is not None and other.paired and (frame := face.passed_on(data, other.session)) is not None:
            self._say(sender, [Outgoing("position", frame)])
        if self._decoy is not None and sender == "world":
            self._decoy.session.receive(now_ns, data)

    def _put_on(self, role: Role, true: Hello) -> None:
        """He has heard a side of this role: from now on he can play it."""
        name = true.incarnation ^ 1 if self.plan.own_names else true.incarnation
        self.faces[role] = Puppet(true, self._settings(role), name, Secret(b"s" * 32))
        if self.plan.decoy and role == "device":
            self._decoy = Puppet(true, self._settings(role), true.incarnation ^ 2, Secret(b"y" * 32))

    def speak(self, now_ns: int) -> None:
        """Say what is due."""
        self.believed |= {role for role, face in self.faces.items() if face.paired}
        if len(self.faces) == 2 and all(face.paired for face in self.faces.values()):
            if self._paired_both_ns is None:
                self._paired_both_ns, self._debt_nJ = now_ns, 0
            elif now_ns - self._paired_both_ns > self.plan.from_s / NANO and self._debt_nJ == 0 and self._left_nJ:
                self.faces["device"].session.shuffle(self._left_nJ * NANO)
                self._debt_nJ, self._left_nJ = self._left_nJ, 0
        if self._decoy is not None:
            said: Iterable[Outgoing] = self._decoy.session.poll(now_ns)[0]
            self._say("device", [each for each in said if not isinstance(decode(each.data), Welcome)])
        for role, face in self.faces.items():
            self._say(role, face.session.poll(now_ns)[0])
