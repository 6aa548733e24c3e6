"""Somebody between both sides who only adds frames: runs in virtual time in which each side may pair with him.

He (`stranger.py`) hears all that both send, within a millisecond, and says what he likes to either, at once. He takes
no frame away.
"""

from collections.abc import Iterable
from typing import Any

from hapnet.params import Params
from hapnet.side.link_port import LinkPort, Packet
from hapnet.summary import path
from hapnet.summary.reported import Claim, joined, values_of
from hapnet.summary.run import combine, device_summary, judged, with_wire, world_summary
from hapnet.summary.structure import Summary
from hapnet.wire.control_sender import Outgoing
from hapnet.wire.messages import Role
from hapnet.wire.session import Session
from tests.support.forger import Keyed
from tests.support.stranger import OTHER, Plan, Stranger

MS = 1_000_000


class Between(Keyed):
    """A run with him. plan : what he does; None: nothing. word : what both sides know, and he does not."""

    def __init__(self, params: Params, seed: int = 0, plan: Plan | None = None, *, word: str = "") -> None:
        self.paired_ns: dict[Role, int] = {}
        self.early_nJ = 0
        """The most that the world had credited before the device sent it."""
        self._edits = plan is not None and plan.edits
        self._stranger = (
            None if plan is None else Stranger(plan, self._say, lambda role: self._sessions()[role].settings)
        )
        self._speaking = False
        self._spoke_ns = -1
        self._heard: dict[int, Packet] = {}
        """What he has heard while it is still on its way, by identity."""
        super().__init__(params, seed, secrets=True, word=word)

    @property
    def fooled(self) -> bool:
        """Has either side paired with him?"""
        return self._stranger is not None and bool(self._stranger.believed)

    def _sessions(self) -> dict[Role, Session]:
        return {"device": self.device_endpoint.session, "world": self.world_endpoint.session}

    # -- what he hears ------------------------------------------------------------------------------------------------

    def receive(self, port: LinkPort, packets: Iterable[Packet]) -> None:
        self._deliver("device" if port is self.world_port else "world", list(packets))

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
        self.add(self.port(role), packets)
        for name, session in self._sessions().items():
            if session.peer is not None:
                self.paired_ns.setdefault(name, self.now_ns)
        world, device = self.world_endpoint.session, self.device_endpoint.session
        self.early_nJ = max(self.early_nJ, world.credited_nJ - device.sent_nJ)

    def _hear(self, sender: Role, data: bytes) -> None:
        if self._stranger is not None and not self._speaking:
            self._stranger.hear(sender, data, self.now_ns)
            self._speak()

    # -- what he says -------------------------------------------------------------------------------------------------

    def step(self, now_ns: int) -> Packet | None:
        self._overhear()
        self._speak()
        return super().step(now_ns)

    def tick(self, now_ns: int) -> Packet | None:
        self._overhear()
        self._speak()
        return super().tick(now_ns)

    def _speak(self) -> None:
        if self._stranger is not None and not self._speaking and self.now_ns != self._spoke_ns:
            self._spoke_ns = self.now_ns
            self._stranger.speak(self.now_ns)

    def _say(self, role: Role, frames: list[Outgoing]) -> None:
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
            if self._edits and self.fooled:
                values = edited(values, parts[role])
            seen[role] = judged(joined(mine, role, Claim(values, self.setup.params.duration_s, True, True)))
        return seen


def edited(values: dict[str, Any], mine: Any) -> dict[str, Any]:
    """The other's account, so that it fits what the reader of it knows himself."""
    sent, credited = max(values["sent_nJ"], mine["credited_nJ"]), min(values["credited_nJ"], mine["sent_nJ"])
    more = {"sent_nJ": sent, "credited_nJ": credited, "peer.proof": "word"}
    return {name: value for name, value in (values | more).items() if not name.startswith("contradictions.")}
