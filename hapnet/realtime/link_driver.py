"""What a side says, through its emulated link: control's thread sends, the event loop releases and repeats.

The wire half, the link and the timer that wakes the loop for them have one lock, held for microseconds and never while
a message is put.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable

from hapnet.side.device import Clock
from hapnet.side.endpoint import WireHalf
from hapnet.side.packet import FRAME_OVERHEAD, Packet
from hapnet.wire.events import Event
from netem import Link, LinkProfile, Timeline, TimelinePlayer
from netem.aio import DeadlineTimer
from netem.timeline import Entry


class LinkDriver:
    """A side's way out.

    Parameters
    ----------
    wire : the side's wire half. link : shapes all that it says; nobody else uses it.
    put : puts a message of a kind on the wire. clock : [ns]. period_ns : the servo's, if it is a servo that sends.

    Attributes
    ----------
    lock : whoever else uses the wire half holds it.
    """

    def __init__(
        self,
        wire: WireHalf,
        link: Link[Packet],
        put: Callable[[str, bytes], object],
        clock: Clock,
        *,
        period_ns: int | None = None,
    ) -> None:
        self.lock = threading.Lock()
        self._wire, self._link, self._put, self._clock = wire, link, put, clock
        self._period_ns = period_ns
        self._player: TimelinePlayer | None = None
        self._timer: DeadlineTimer | None = None
        self._sent_ns: int | None = None
        self._asked_ns: int | None = None
        self._granted_ns: int | None = None

    def open(self, loop: asyncio.AbstractEventLoop, due: Callable[[], None]) -> None:
        """From `arm` on `due` is called on `loop` when it is time to `pump`."""
        self._loop = loop
        self._timer = DeadlineTimer(loop, due)

    def close(self) -> None:
        """`due` is not called any more."""
        if self._timer is not None:
            self._timer.close()

    def play(self, timeline: Timeline, origin_ns: int) -> None:
        """Change the link as the timeline says, counted from `origin_ns`."""
        with self.lock:
            self._player = TimelinePlayer(self._link, timeline, origin_ns)
            self._arm()

    def change(self, profile: LinkProfile) -> None:
        """From now on the link has this profile; what is in flight stays in flight."""
        with self.lock:
            self._link.change(profile, self._clock())
            self._arm()

    @property
    def pending(self) -> bool:
        """Is anything on the link or still to be said?"""
        with self.lock:
            return (self._link.next_due_ns, self._wire.session.next_due_ns) != (None, None)

    def send(self, data: bytes) -> None:
        """Offer control's message to the link and put on the wire what is not delayed; on control's own thread.

        The message comes first: what else is to be done here waits until it has been put.
        """
        now_ns = self._clock()
        ready = [Packet("position", data)]
        with self.lock:
            straight = self._link.passes()
            if not straight:
                self._link.send(now_ns, ready[0], size=len(data) + FRAME_OVERHEAD)
                ready = [parcel for _, parcel in self._link.poll(now_ns)]
        for parcel in ready:
            self._put(parcel.kind, parcel.data)
        self._sent_ns = now_ns
        if straight and not self._wire.uncollected:
            return  # nothing else is due sooner than before
        with self.lock:
            self._wire.collect()
            self._arm()

    def receive(self, data: bytes) -> tuple[Event, ...]:
        """A message has come in, on any thread; what it means."""
        now_ns = self._clock()
        with self.lock:
            events = self._wire.receive(now_ns, data)
            self._arm()
        return events

    def pump(self) -> tuple[tuple[Event, ...], list[tuple[int, Entry]]]:
        """Send what the protocol has to say and what the link releases, and wait for what is due next; on the loop.

        Returns what the protocol tells, and the link's changes with their times.
        """
        now_ns = self._clock()
        with self.lock:
            changes = [] if self._player is None else self._player.advance(now_ns)
            outgoing, events = self._wire.poll(now_ns)
            for message in outgoing:
                data = message.data
                self._link.send(now_ns, Packet(message.kind, data), size=len(data) + FRAME_OVERHEAD)
            released = self._link.poll(now_ns)
            self._arm()
        for _, parcel in released:
            self._put(parcel.kind, parcel.data)
        return events, changes

    def arm(self) -> None:
        """Wake the loop when something is due next."""
        with self.lock:
            self._arm()

    def _arm(self) -> None:
        if self._timer is None:
            return  # not open yet
        link_ns, wire_ns = self._link.next_due_ns, self._calm_ns(self._wire.next_due_ns)
        due_ns = wire_ns if link_ns is None else link_ns if wire_ns is None else min(link_ns, wire_ns)
        if self._player is not None and (change_ns := self._player.next_due_ns) is not None:
            due_ns = change_ns if due_ns is None else min(due_ns, change_ns)
        if self._timer.kind == "timerfd":  # may be set from any thread
            self._timer.arm(due_ns)
        elif due_ns != self._timer.due_ns:
            self._loop.call_soon_threadsafe(self._timer.arm, due_ns)

    def _calm_ns(self, wire_ns: int | None) -> int | None:
        """When the loop is to look after the protocol that is due at `wire_ns`: that, or a little later.

        A servo's message and the loop would be in each other's way if both came at once, and they would, again and
        again: what is sent with a tick is due again a whole number of periods later. So the loop comes between two.
        """
        if wire_ns == self._asked_ns:
            return self._granted_ns
        self._asked_ns = self._granted_ns = wire_ns
        period_ns = self._period_ns
        if wire_ns is not None and period_ns is not None and self._sent_ns is not None:
            first_ns = self._sent_ns + (2 * period_ns) // 5
            periods = max(0, -((first_ns - wire_ns) // period_ns))  # up to the first such time that is not before
            self._granted_ns = first_ns + periods * period_ns
        return self._granted_ns
