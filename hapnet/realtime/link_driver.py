"""A side's link port in real time: control's thread sends, the event loop releases and retransmits.

One lock guards the port and the timer that wakes the loop. It is held for microseconds, never while a message is put.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable

from hapnet.side.device import Clock
from hapnet.side.link_port import LinkPort, Pumped, earlier
from hapnet.wire.events import Event
from hapnet.wire.stream_frames import stamped
from netem import LinkProfile, Timeline
from netem.aio import DeadlineTimer


class LinkDriver:
    """Drives a link port by the clock.

    port : the side's. put : puts a message of a kind on the wire. clock : returns the time [ns].
    period_ns : the servo's period; None if no servo sends.

    Attributes
    ----------
    lock : must be held by any other code that uses the port or its wire half.
    """

    def __init__(
        self,
        port: LinkPort,
        put: Callable[[str, bytes], object],
        clock: Clock,
        *,
        period_ns: int | None = None,
    ) -> None:
        self.lock: threading.Lock = threading.Lock()
        self.port = port
        self._put, self._clock = put, clock
        self._period_ns = period_ns
        self._timer: DeadlineTimer | None = None
        self._sent_ns: int | None = None
        self._asked_ns: int | None = None
        self._granted_ns: int | None = None

    def open(self, loop: asyncio.AbstractEventLoop, due: Callable[[], None]) -> None:
        """Call `due` on `loop` whenever it is time to `pump`, from the first `arm` on."""
        self._loop = loop
        self._timer = DeadlineTimer(loop, due)

    def close(self) -> None:
        """Stop calling `due`."""
        if self._timer is not None:
            self._timer.close()

    def play(self, timeline: Timeline, origin_ns: int) -> None:
        """See `LinkPort.play`."""
        with self.lock:
            self.port.play(timeline, origin_ns)
            self._arm()

    def change(self, profile: LinkProfile) -> None:
        """See `LinkPort.change`."""
        with self.lock:
            self.port.change(self._clock(), profile)
            self._arm()

    @property
    def pending(self) -> bool:
        """Whether anything is on the link or still to be sent."""
        with self.lock:
            return (self.port.link.next_due_ns, self.port.wire.session.next_due_ns) != (None, None)

    def send(self, data: bytes) -> None:
        """Offer control's message to the link and put it on the wire if it is not delayed; on control's own thread.

        The message is put before all other work. It is stamped now, so that a round trip is that of the network,
        without the computing time of the tick or the step.
        """
        now_ns = self._clock()
        data = stamped(data, now_ns)
        with self.lock:
            released = self.port.send(now_ns, data)
            passed = self.port.link.next_due_ns is None
        for packet in released:
            self._put(packet.kind, packet.data)
        self._sent_ns = now_ns
        if passed and not self.port.wire.uncollected:
            return  # nothing else is due sooner than before
        with self.lock:
            self.port.collect()
            self._arm()

    def receive(self, now_ns: int, data: bytes) -> tuple[Event, ...]:
        """Process a message that came at `now_ns`, on any thread; returns the events that it causes."""
        with self.lock:
            events = self.port.receive(now_ns, data)
            self._arm()
        return events

    def pump(self) -> Pumped:
        """Put everything due on the wire, and set the timer for the next due time; on the loop."""
        now_ns = self._clock()
        with self.lock:
            pumped = self.port.pump(now_ns)
            self._arm()
        for packet in pumped.packets:
            self._put(packet.kind, packet.data)
        return pumped

    def arm(self) -> None:
        """Set the timer that wakes the loop when something is due."""
        with self.lock:
            self._arm()

    def _arm(self) -> None:
        if self._timer is None:
            return  # not open yet
        due_ns = earlier(self.port.release_due_ns, self._calm_ns(self.port.wire.next_due_ns))
        if self._timer.kind == "timerfd":  # may be set from any thread
            self._timer.arm(due_ns)
        elif due_ns != self._timer.due_ns:
            self._loop.call_soon_threadsafe(self._timer.arm, due_ns)

    def _calm_ns(self, wire_ns: int | None) -> int | None:
        """Return when the loop should serve the protocol, which is due at `wire_ns`: then, or a little later.

        The loop and a servo's message delay each other if they coincide. They would coincide again and again, since
        a message sent with a tick is due again a whole number of periods later. So the loop runs between two ticks.
        """
        if wire_ns == self._asked_ns:
            return self._granted_ns
        self._asked_ns = self._granted_ns = wire_ns
        period_ns = self._period_ns
        if wire_ns is not None and period_ns is not None and self._sent_ns is not None:
            first_ns = self._sent_ns + (2 * period_ns) // 5
            periods = max(0, -((first_ns - wire_ns) // period_ns))  # up to the first such time at or after wire_ns
            self._granted_ns = first_ns + periods * period_ns
        return self._granted_ns
