"""One side's port to its emulated link, without clock or I/O; both runtimes use it.

A runtime passes in the messages of control (`send`) and of the network (`receive`), and puts the resulting packets on
the wire, in their order. Real time calls `pump` at `next_due_ns`. The simulation calls the two parts of `pump`,
`release` and `send_due`, each when it is due: within one nanosecond, the packets that one side's link releases reach
the other side before either side's protocol runs (see `hapnet.simulation.events`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from hapnet.side.endpoint import WireHalf
from hapnet.wire.events import Event
from netem import Link, LinkProfile, Timeline, TimelinePlayer
from netem.timeline import Entry


class Pumped(NamedTuple):
    """The events that became due.

    packets : for the wire. events : from the protocol. changes : of the link, with their times [ns].
    """

    packets: list[Packet]
    events: tuple[Event, ...]
    changes: list[tuple[int, Entry]]


class LinkPort:
    """A side's wire half, the link that carries all that it sends, and the timeline that changes the link.

    Actions that are due in one port at the same time run in this order in both runtimes: changes of the link, packets
    that the link releases, messages of the protocol. Not thread-safe: two users need a lock.

    wire : the side's wire half. link : other code may only read its figures.
    """

    def __init__(self, wire: WireHalf, link: Link[Packet]) -> None:
        self.wire: WireHalf = wire
        self.link: Link[Packet] = link
        self._player: TimelinePlayer | None = None

    def play(self, timeline: Timeline, origin_ns: int) -> None:
        """Change the link by the timeline, counted from `origin_ns`."""
        self._player = TimelinePlayer(self.link, timeline, origin_ns)

    def change(self, now_ns: int, profile: LinkProfile) -> None:
        """Give the link another profile; packets in flight keep their release times."""
        self.link.change(profile, now_ns)

    def send(self, now_ns: int, data: bytes) -> Sequence[Packet]:
        """Offer control's message to the link; returns what the link releases by now, at once if nothing delays it.

        Call `collect` afterwards for the energy that came with the message: the message goes first.
        """
        packet = self.outward(data)
        if packet is None:
            return ()
        if self.offer(now_ns, packet):
            return (packet,)
        return [released for _, released in self.link.poll(now_ns)]

    def outward(self, data: bytes) -> Packet | None:
        """The packet for the link with control's message; None: the message must not be sent."""
        frame = self.wire.session.outward(data)
        return None if frame is None else Packet("position", frame)

    def offer(self, now_ns: int, packet: Packet) -> bool:
        """Offer a packet to the link. True: the link has no effect and did not take the packet; deliver it now."""
        if self.link.passes():
            return True
        self.link.send(now_ns, packet, len(packet.data) + FRAME_OVERHEAD)
        return False

    def collect(self) -> None:
        """Pass control's surplus energy to the session, which sends it when it is due."""
        self.wire.collect()

    def receive(self, now_ns: int, data: bytes) -> tuple[Event, ...]:
        """Process a message from the network; returns the events that it causes."""
        return self.wire.receive(now_ns, data)

    def pump(self, now_ns: int) -> Pumped:
        """Do everything that is due by now: `release`, then `send_due`."""
        packets, changes = self.release(now_ns)
        events: tuple[Event, ...] = ()
        if (due_ns := self.wire.next_due_ns) is not None and due_ns <= now_ns:
            events = self.send_due(now_ns)
            packets += [packet for _, packet in self.link.poll(now_ns)]
        return Pumped(packets, events, changes)

    def release(self, now_ns: int) -> tuple[list[Packet], list[tuple[int, Entry]]]:
        """Change the link by its timeline; returns the packets that the link releases by now, and the changes."""
        changes = [] if self._player is None else self._player.advance(now_ns)
        return [packet for _, packet in self.link.poll(now_ns)], changes

    def send_due(self, now_ns: int) -> tuple[Event, ...]:
        """Offer the protocol's messages that are due to the link; returns the events that time causes."""
        outgoing, events = self.wire.poll(now_ns)
        for message in outgoing:
            self.link.send(now_ns, Packet(message.kind, message.data), len(message.data) + FRAME_OVERHEAD)
        return events

    @property
    def next_due_ns(self) -> int | None:
        """The time of the next `pump` if nothing else happens. A past time means now; None: nothing is planned."""
        return earlier(self.release_due_ns, self.wire.next_due_ns)

    @property
    def release_due_ns(self) -> int | None:
        """The time of the next `release`, due to the link or its timeline."""
        due_ns = self.link.next_due_ns
        return due_ns if self._player is None else earlier(due_ns, self._player.next_due_ns)


def earlier(one_ns: int | None, other_ns: int | None) -> int | None:
    """The earlier of two times; None means never."""
    if one_ns is None or other_ns is None:
        return other_ns if one_ns is None else one_ns
    return min(one_ns, other_ns)


FRAME_OVERHEAD = 62
"""Bytes of the Ethernet, IP, UDP and Zenoh headers around a message; they count on links with a rate."""


class Packet(NamedTuple):
    """A message on a link: the last part of its key, and its bytes."""

    kind: str
    data: bytes
