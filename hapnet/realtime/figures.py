"""The figures of one side in real time: its summary, its status, and the description of its recording."""

from __future__ import annotations

from typing import Any

from hapnet.assembly.build import Setup
from hapnet.couplings.registry import jointly_passive
from hapnet.installing import versions
from hapnet.realtime.controllers import Control
from hapnet.realtime.link_driver import LinkDriver
from hapnet.realtime.recorder import described
from hapnet.realtime.telemetry_publisher import LinkMeter
from hapnet.recording.telemetry import Status
from hapnet.side.device import Clock
from hapnet.side.endpoint import NANO
from hapnet.summary import path
from hapnet.summary.from_samples import LiveFigures
from hapnet.summary.reported import Claim, joined, values_of
from hapnet.summary.run import Summary, combine, with_wire
from hapnet.transport.zenoh import ZenohTransport
from hapnet.wire.fields import Signal
from hapnet.wire.messages import Role

_ENERGY = ("sent_nJ", "credited_nJ", "acked_nJ", "in_flight_nJ", "abandoned_nJ")
"""The values of an account that may still change after control has stopped."""


class SideFigures:
    """Computes the figures from a side's parts; on the event loop.

    setup, role, seed : the side's. names : the names of its session and its device, as in the key expressions.
    control, driver, transport, clock : the side's parts.
    utc_less_clock_ns : UTC less the clock's reading, as of the start [ns].

    Attributes
    ----------
    stopped_ns : when control stopped; None while it runs. failed : why it stopped, if it failed.
    live : takes each of this side's samples.
    """

    def __init__(
        self,
        setup: Setup,
        role: Role,
        seed: int,
        names: tuple[str, str],
        control: Control,
        driver: LinkDriver,
        transport: ZenohTransport,
        clock: Clock,
        utc_less_clock_ns: int,
    ) -> None:
        self.stopped_ns: int | None = None
        self.failed: str | None = None
        self.live: LiveFigures = LiveFigures(setup.units)
        self._final: dict[str, Signal] | None = None
        self._setup, self._role, self._seed = setup, role, seed
        self._control, self._driver, self._transport, self._clock = control, driver, transport, clock
        self._started_ns = clock()
        self._utc_less_clock_ns = utc_less_clock_ns
        self._path = path.PathMeter(role, control.wire.session.path)
        self._link = LinkMeter()
        self._about = described(setup, role, seed, driver.port.link.profile) | {
            "session": names[0],
            "name": names[1],
            "dof": setup.dof,
            "versions": versions(),  # reads a hundred files, so not while the servo runs
        }

    @property
    def direction(self) -> str:
        """The direction of this side's link: "up" or "down"."""
        return "up" if self._role == "device" else "down"

    def meta(self) -> dict[str, Any]:
        """The description of a recording that begins now."""
        links = {self.direction: str(self._driver.port.link.profile)}
        origin_ns = self._control.origin_ns
        utc_ns = None if origin_ns is None else origin_ns + self._utc_less_clock_ns
        return self._about | {"links": links, "origin_ns": origin_ns, "utc_origin_ns": utc_ns, "utc_clock": "system"}

    def _hands(self) -> dict[str, Any]:
        """The hands of a world with several; for viewers only, as they come and go."""
        hands = self._setup.scene.hands if self._role == "world" else ()
        return {"hands": [tuple(hand) for hand in hands]} if hands else {}

    def dropped(self) -> dict[str, int]:
        """The number of dropped messages, by kind. The caller holds the driver's lock."""
        flood = self._transport.rate_limiter.refused
        return dict(self._control.wire.session.dropped) | ({"flood": flood} if flood else {})

    def summary(self) -> Summary:
        """The summary so far; the other side's part is the one it reported, or None."""
        own = self._own()
        with self._driver.lock:
            accounts = self._control.wire.session.accounts
            heard, whole = accounts.heard, accounts.whole
        origin_ns = self._control.origin_ns
        if heard is None or origin_ns is None:
            return own
        return joined(
            own, self._role, Claim(heard.values, (heard.came_ns - origin_ns) * NANO, heard.final, whole or heard.final)
        )

    def account(self, *, final: bool) -> dict[str, Signal]:
        """Return the account of this side's half, to be reported to its peer. final : control has stopped, and only
        energy in flight changes.
        """
        values = values_of(self._own(), self._role)
        if not final:  # a servo's process reports its part at its end; its samples come
            live = {
                "ledger.margin_J": self.live.margin_J,
                "ledger.margin_end_J": self.live.margin_end_J,
                "ledger.margin_later_J": self.live.margin_later_J,
            }
            if not jointly_passive(self._setup.params.coupling):
                live["ledger.slack_J"] = self.live.slack_J
            return {name: value for name, value in live.items() if value is not None} | values
        if self._final is None:
            self._final = values
        self._final |= {name: values[name] for name in _ENERGY if name in values}
        return self._final

    def _own(self) -> Summary:
        """This side's summary so far; the other side's part is None."""
        own: dict[str, Any] = {"device": None, "world": None}
        links: dict[str, Any] = {"up": None, "down": None}
        end_ns = self.stopped_ns or self._clock()
        part = self._control.part()
        part["ledger"]["margin_later_J"] = self.live.later_J(part["ledger"]["margin_end_J"])
        with self._driver.lock:  # the servo waits for it: no long work here
            own[self._role] = with_wire(part, self._control.wire.session, end_ns) | {
                "dropped": self.dropped(), "declared_again": self._transport.declared_again, "failed": self.failed,
            }  # fmt: skip
            links[self.direction] = self._driver.port.link.stats.as_dict()
        origin_ns = self._control.origin_ns
        elapsed = None if origin_ns is None else (end_ns - origin_ns) * NANO
        summary = combine(
            own["device"], own["world"], links,
            seed=self._seed, duration_s=elapsed, coupling=self._setup.params.coupling, units=self._setup.units,
            tuning=self._setup.tuned, felt=self._setup.felt,
            path=path.of_side(self._role, self._control.wire.session.path.figures()),
        )  # fmt: skip
        summary["motion"] = self.live.motion()
        summary["wall_clock"] = {"elapsed_s": (self._clock() - self._started_ns) * NANO}
        return summary

    def status(self, *, paused: bool, recording: str) -> Status:
        """The status for viewers. recording : the path of the running recording, or empty."""
        session = self._control.wire.session
        with self._driver.lock:
            stats, paired = self._driver.port.link.stats, session.peer is not None
        return Status(
            role=self._role,
            time_ns=self._clock(),
            incarnation=session.identity.incarnation,
            paired=paired,
            paused=paused,
            recording=recording,
            about=self.meta() | self._hands(),
            link=self._link.read(stats),
            path=dict(self._path.read()),
            account=self.account(final=self.stopped_ns is not None) if self._control.origin_ns is not None else {},
            final=self.stopped_ns is not None,
        )
