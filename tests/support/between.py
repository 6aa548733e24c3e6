"""Somebody between both sides who only adds frames: runs in virtual time in which each side may pair with him.

He hears all that both send, within a millisecond, and says what he likes to either, at once. He takes no frame away. To the device he is a
world, to the world a device: in their names, or in names of his own; he has a key of his own, and keeps to the protocol
otherwise. What they then send him he passes on, energy too, but some of it early. Before that a decoy may look for the
world's place of a candidate.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from typing import Any
from unittest.mock import patch

from hapnet.assembly.build import device_session, world_session
from hapnet.params import Params
from hapnet.side.endpoint import NANO
from hapnet.side.packet import Packet
from hapnet.simulation.simulation import Simulation
from hapnet.summary import path
from hapnet.summary.reported import Claim, joined, values_of
from hapnet.summary.run import combine, device_summary, judged, with_wire, world_summary
from hapnet.summary.structure import Summary
from hapnet.wire.encryption import Encrypted
from hapnet.wire.events import EnergyCredited
from hapnet.wire.messages import Hello, Role, Welcome, decode
from hapnet.wire.outgoing import Outgoing
from hapnet.wire.secret import Secret
from hapnet.wire.session import Session, SessionSettings
from tests.support.forger import made_session

MS = 1_000_000
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

    def __init__(self, true: Hello, settings: SessionSettings, incarnation: int, secret: Secret) -> None:
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
        inside = cipher.decrypt(message)
        return to.outward(inside[:4] + to.identity.incarnation.to_bytes(8, "big") + inside[12:])


class Between(Simulation):
    """A run with him. plan : what he does; None: nothing. word : what both sides know, and he does not."""

    def __init__(self, params: Params, seed: int = 0, plan: Plan | None = None, *, word: str = "") -> None:
        self.plan = plan
        self.faces: dict[Role, Puppet] = {}
        """By role that he plays: "world" is what the device hears."""
        self.paired_ns: dict[Role, int] = {}
        self.early_nJ = 0
        """The most that the world had credited before the device sent it."""
        self._paired_both_ns: int | None = None
        self._debt_nJ = 0
        self._decoy: Puppet | None = None
        self._speaking = False
        self._spoke_ns = -1
        self._heard: dict[int, Packet] = {}
        """What he has heard while it is still on its way, by identity."""
        made = partial(made_session, secrets=True, word=word)
        module = "hapnet.simulation.simulation"
        with (
            patch(f"{module}.device_session", partial(made, device_session, private=b"d" * 32)),
            patch(f"{module}.world_session", partial(made, world_session, private=b"w" * 32)),
        ):
            super().__init__(params, seed, kernel=False)

    @property
    def fooled(self) -> bool:
        """Has either side paired with him?"""
        return any(face.paired for face in self.faces.values())

    def _sessions(self) -> dict[Role, Session]:
        return {"device": self.device_endpoint.session, "world": self.world_endpoint.session}

    # -- what he hears ------------------------------------------------------------------------------------------------

    def _to_world(self, packets: Iterable[Packet]) -> None:
        self._deliver("device", list(packets))

    def _to_device(self, packets: Iterable[Packet]) -> None:
        self._deliver("world", list(packets))

    def _deliver(self, sender: Role, packets: list[Packet]) -> None:
        """He acts on each frame before it is where it belongs."""
        for packet in packets:
            if self._heard.pop(id(packet), None) is None:
                self._hear(sender, packet.data)
            self._give(OTHER[sender], [packet])

    def _overhear(self) -> None:
        """He hears the frames that are on their way."""
        for sender, link in (("device", self.up), ("world", self.down)):
            for packet in [entry[2] for entry in link.queue if id(entry[2]) not in self._heard]:
                self._heard[id(packet)] = packet
                self._hear(sender, packet.data)

    def _give(self, role: Role, packets: Iterable[Packet]) -> None:
        (super()._to_world if role == "world" else super()._to_device)(packets)
        for name, session in self._sessions().items():
            if session.peer is not None:
                self.paired_ns.setdefault(name, self.now_ns)
        world, device = self.world_endpoint.session, self.device_endpoint.session
        self.early_nJ = max(self.early_nJ, world.credited_nJ - device.sent_nJ)

    def _hear(self, sender: Role, data: bytes) -> None:
        if self.plan is None or self._speaking:
            return
        message = decode(data)
        if isinstance(message, Hello) and sender not in self.faces:
            self._put_on(sender, message)
        face = self.faces.get(OTHER[sender])
        if face is None:
            return
        other = self.faces.get(sender)
        for event in face.session.receive(self.now_ns, data):
            if isinstance(event, EnergyCredited) and other is not None:
                repaid = min(self._debt_nJ, event.credited_nJ) if sender == "device" else 0
                self._debt_nJ -= repaid
                other.session.shuffle((event.credited_nJ - repaid) * NANO)
        if other is not None and other.paired and (frame := face.passed_on(data, other.session)) is not None:
            self._say(sender, [Outgoing("position", frame)])
        if self._decoy is not None and sender == "world":
            self._decoy.session.receive(self.now_ns, data)
        self._speak()

    def _put_on(self, role: Role, true: Hello) -> None:
        """He has heard a side of this role: from now on he can play it."""
        plan, settings = self.plan, self._sessions()[role].settings
        assert plan is not None
        secret = Secret(b"s" * 32)
        name = true.incarnation ^ 1 if plan.own_names else true.incarnation
        self.faces[role] = Puppet(true, settings, name, secret)
        if plan.decoy and role == "device":
            self._decoy = Puppet(true, settings, true.incarnation ^ 2, Secret(b"y" * 32))

    # -- what he says -------------------------------------------------------------------------------------------------

    def _step(self) -> None:
        self._overhear()
        self._speak()
        super()._step()

    def _tick(self) -> None:
        self._overhear()
        self._speak()
        super()._tick()

    def _speak(self) -> None:
        plan = self.plan
        if plan is None or self._speaking or self.now_ns == self._spoke_ns:
            return
        self._spoke_ns = self.now_ns
        if len(self.faces) == 2 and all(face.paired for face in self.faces.values()):
            if self._paired_both_ns is None:
                self._paired_both_ns, self._debt_nJ = self.now_ns, 0
            elif self.now_ns - self._paired_both_ns > plan.from_s / NANO and self._debt_nJ == 0 and plan.early_nJ:
                self.faces["device"].session.shuffle(plan.early_nJ * NANO)
                self._debt_nJ, self.plan = plan.early_nJ, Plan(**{**vars(plan), "early_nJ": 0})
        if self._decoy is not None:
            said = self._decoy.session.poll(self.now_ns)[0]
            self._say("device", [each for each in said if not isinstance(decode(each.data), Welcome)])
        for role, face in self.faces.items():
            self._say(role, face.session.poll(self.now_ns)[0])

    def _say(self, role: Role, frames: Iterable[Outgoing]) -> None:
        """Say frames in that role, to the other."""
        self._speaking = True
        self._give(OTHER[role], [Packet(frame.kind, frame.data) for frame in frames])
        self._speaking = False

    # -- what both users see ------------------------------------------------------------------------------------------

    def verdicts(self) -> dict[Role, Summary]:
        """Each side's summary as its user sees it: its own half, and what comes to it as the other's account."""
        end_ns, coupling = self.now_ns, self.setup.params.coupling
        parts: dict[Role, Any] = {
            "device": with_wire(device_summary(self.device, coupling), self.device_endpoint.session, end_ns),
            "world": with_wire(world_summary(self.world, coupling), self.world_endpoint.session, end_ns),
        }
        own: dict[Role, Summary] = {}
        for role, part in parts.items():
            figures = path.of_side(role, self._sessions()[role].path.figures())
            halves = (part, None) if role == "device" else (None, part)
            own[role] = combine(
                *halves,
                {"up": None, "down": None},
                seed=self.seed,
                duration_s=self.setup.params.duration_s,
                coupling=coupling,
                path=figures,
            )
        seen: dict[Role, Summary] = {}
        for role, mine in own.items():
            values = values_of(own[OTHER[role]], OTHER[role])
            if self.plan is not None and self.plan.edits and self.fooled:
                values = edited(values, parts[role])
            seen[role] = judged(joined(mine, role, Claim(values, self.setup.params.duration_s, True, True)))
        return seen


def edited(values: dict[str, Any], mine: Any) -> dict[str, Any]:
    """The other's account, so that it fits what the reader of it knows himself."""
    sent, credited = max(values["sent_nJ"], mine["credited_nJ"]), min(values["credited_nJ"], mine["sent_nJ"])
    more = {"sent_nJ": sent, "credited_nJ": credited, "peer.proof": "word"}
    return {name: value for name, value in (values | more).items() if not name.startswith("contradictions.")}
