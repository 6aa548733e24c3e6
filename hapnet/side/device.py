"""The complete device's side of a run: endpoint, device and recording; either runtime drives it.

This module has the part that all servos share. The sampled servo is in sampled_device.py, the continuous servo in
continuous_device.py.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

from hapnet.checks import Vector
from hapnet.control.coupling import CouplingState, ForceParts
from hapnet.control.ledger import Ledger
from hapnet.plant.device import Device, SimulatedDevice
from hapnet.plant.live_hand import LiveHand
from hapnet.recording.samples import DeviceSample, Event, MetricSample, PostureSample, Sample
from hapnet.records.record import equation
from hapnet.side.endpoint import DeviceControl
from hapnet.side.punctuality import Punctuality, periods_until
from hapnet.wire.fields import Signal
from hapnet.wire.signals import STOP

S = TypeVar("S", DeviceSample, MetricSample)

Write = Callable[[Sample], None]
Clock = Callable[[], int]

Observe = Callable[[float, float], None]
"""Takes the energies put in so far [J]: at the port of the side's account, and by the simulated hand."""

_UNKNOWN = (None, None, None, None)


@dataclass(frozen=True)
class Drive:
    """Timing and recording of a device's side, for any servo.

    period_ns : of the servo. record_every : ticks between two samples given to `write`.
    watchdog_ns : a tick that is late by more than this renders no force and releases the spring (ybar = x). So do the
        ticks after it, until a tick is in time. Then the coupling starts again, as fast as the limit of the force's
        step allows, and as far as the account covers another stall (control/reserve.py). None: no watchdog.
    clock : read once more after the device was read, so that no interval is taken too short (10).
    write_motion : receives the device's samples in place of `write`, with the motion alone.
    """

    period_ns: int
    clock: Clock
    write: Write
    record_every: int = 1
    watchdog_ns: int | None = None
    write_motion: Callable[[MetricSample], None] | None = None


class Stop(NamedTuple):
    """The time at which the force was stopped for good [ns], and the reason.

    asked : the stop was requested; False: a fault caused it.
    """

    at_ns: int
    why: str
    asked: bool


class DeviceSide(ABC):
    """A device, its servo and its endpoint; one subclass for each kind of servo.

    endpoint : this side's endpoint, or its control half. device : simulated or real. drive : its timing and recording.
    """

    def __init__(self, endpoint: DeviceControl, device: Device, drive: Drive) -> None:
        self.endpoint = endpoint
        self.device = device
        self.drive = drive
        self.origin_ns: int | None = None
        """The start of control, on this side's clock; None before."""
        self.ledger: Ledger | None = None
        """This side's energy account; None before control starts."""
        self.ticks: int = 0
        self.punctuality: Punctuality = Punctuality(drive.period_ns, drive.watchdog_ns)
        """Counts the late ticks, in each of which the watchdog releases the spring, and the time without force."""
        self.stopped: Stop | None = None
        """The stop of the force for good; None: the force was not stopped."""
        self.withheld: str = ""
        """The reason why no force is rendered for now; empty: force is rendered."""
        self.withheld_ns: int = 0
        """The total time for which the force was withheld [ns]."""
        self.paused = False
        """True: a simulated device and its hand stand still and nothing is recorded; all else continues."""
        self.applied = True
        """Whether the device has always reported the force that it really applied."""
        self.let_go = ""
        """The program's reason why the device leads nothing for now; empty: there is none."""
        self.live_hand: LiveHand | None = None
        """The simulated hand, if a user moves it during the run."""
        self._late = self._releases_spring = False
        self._excused = False  # the next tick is late because the device was silent
        self._waiting: Callable[[], None] | None = None
        self.last_ns = 0
        self._expected_ns = 0  # the time up to which a simulated device was advanced

    @property
    def coupling(self) -> CouplingState:
        return self.endpoint.coupling

    @property
    def overruns(self) -> int:
        """The number of ticks so late that the watchdog released the spring."""
        return self.punctuality.late

    @property
    def max_ns(self) -> int:
        """The longest time between two ticks [ns]."""
        return self.punctuality.max_ns

    @property
    def true_slack(self) -> float | None:
        """Smallest slack with the true positions [J], in a simulation; None elsewhere.

        The slack is that of the actuator's port. With the range harvest it is that of the hand's port, since this
        harvest relies on the device's own damping.
        """
        return None

    @property
    def hand_work(self) -> float:
        """Work done by the simulated hand on the device since the start [J]; 0 if a person holds it."""
        return 0.0 if self.ledger is None else self.ledger.work

    @property
    def quantisation(self) -> float | None:
        """The largest error by which encoder quantisation may make the slack look too large [J]."""
        return None

    @property
    def simulated(self) -> bool:
        """Whether the device and its hand are simulated."""
        return isinstance(self.device, SimulatedDevice)

    def held_forces(self) -> dict[str, Any]:
        """The summary's entries about forces held from tick to tick; empty where no force is held."""
        return {}

    def driver_figures(self) -> dict[str, Any] | None:
        """The summary's entries about a real device; None: it is simulated."""
        return None

    @property
    def _renders_none(self) -> bool:
        """Whether the force was stopped for good."""
        return self.stopped is not None

    def stop_force(self, now_ns: int, why: str, *, asked: bool = False) -> None:
        """Stop the force for good; the rest continues. `asked` : the stop was requested, and nothing is wrong."""
        if self.stopped is None:
            self.stopped = Stop(now_ns, why, asked)
            self._write(
                Event(now_ns, "stopped", f"the device renders no force any more: {why}", "info" if asked else "error")
            )

    def withhold(self, now_ns: int, why: str) -> None:
        """Render no force while `why` is not empty; begin and end are recorded as events. Then the force grows anew."""
        if self.endpoint.paired and bool(why) != bool(self.withheld):
            text = f"no force: {why}" if why else "the network process runs again: the force grows back"
            self._write(Event(now_ns, "parent", text, "warning" if why else "info"))
        self.withheld = why

    def tick(self, now_ns: int) -> bytes | None:
        """Make one servo tick; returns the message to send, if any. Before pairing there is no force."""
        for name, value in self.endpoint.signals():
            self._on_signal(now_ns, name, value)
        if self.origin_ns is None:
            if self.endpoint.paired and self._can_start:
                self._start(self._read()[0])
                self.ledger = self.coupling.ledger
                self.origin_ns = self.last_ns = self._expected_ns = now_ns  # last: a device may fail right here
            return None
        since_ns = now_ns - self.last_ns
        self._late = self.punctuality.is_late(since_ns)
        released = self._late or bool(self.withheld)
        for event in self.punctuality.see(now_ns, since_ns, released=released, excused=self._excused):
            self._write(event)
        self._excused = False
        if self.withheld:
            self.withheld_ns += since_ns
        self._releases_spring = released or self._renders_none
        message: bytes | None = control(self, self.endpoint, None, now_ns)
        if self.ticks % self.drive.record_every == 0 and not self.paused:
            self._sample(now_ns)
        return message

    @property
    def skippable_ticks(self) -> int:
        """The number of next ticks that `rest` may make later if nothing arrives; in virtual time only."""
        return 0

    def rest(self, now_ns: int, ticks: int, observe: Observe, *, then_tick: bool) -> None:
        """Make this many of the `skippable_ticks`, the first at `now_ns`.

        observe : called after these ticks with the smallest energies put in, then with the last.
        then_tick : the next call is the `tick` after them.
        """
        assert ticks == 0, "no tick of this servo may wait"

    def resume(self, now_ns: int, ticks: int) -> None:
        """Continue after `ticks` ticks that were made elsewhere, each in time, the last at `now_ns`."""
        self.last_ns = self._expected_ns = now_ns
        self.ticks += ticks
        self.punctuality.made(ticks)

    def place(self, position: Vector) -> None:
        """Begin at `position` [m], with the live hand there too. Call it before control starts."""
        assert self.live_hand is not None, "only a live hand can be placed"
        assert isinstance(self.device, SimulatedDevice), "only a simulated device can be placed"
        assert self.origin_ns is None, "control has started"
        self.live_hand.place(position)
        self.device.place(position)

    @property
    def _write(self) -> Callable[[Sample], None]:
        """Records a sample or an event."""
        return self.drive.write

    def write_later(self, write: Callable[[], None]) -> None:
        """Call `write` when the device has told which force it held: in the next tick, or at the end."""
        self._waiting = write

    def write_waiting(self) -> None:
        """Write the last tick's sample, if it waits for the force that the device has held since then."""
        if self._waiting is not None:
            self._waiting()
            self._waiting = None

    def stop(self) -> None:
        """Set the force to zero, for good."""
        self.write_waiting()
        self.device.apply((0.0,) * self.device.dof)

    def _read(self) -> tuple[Vector, Vector]:
        """The device's reading for this tick: position [m] and velocity [m/s]."""
        return self.device.read()

    def _on_signal(self, now_ns: int, name: str, value: Signal) -> None:
        """Take a signal from the world or from this side's own program."""
        if name == STOP and isinstance(value, str):
            self.stop_force(now_ns, value, asked=True)

    @property
    def _can_start(self) -> bool:
        """Whether control can start once this side is paired."""
        return True

    @abstractmethod
    def _start(self, x: Vector) -> None: ...

    @abstractmethod
    def measure(self, now_ns: int) -> None:
        """Advance a simulated device to now under its held force, read the device, and count the work."""

    @abstractmethod
    def act(self, now_ns: int) -> bytes | None:
        """Run the servo; returns the message to send, if there is one."""

    @abstractmethod
    def hold(self) -> None:
        """Let the device hold the servo's force, or its spring's set-position, until the next tick."""

    @abstractmethod
    def _sample(self, now_ns: int) -> None:
        """Record this tick."""

    @abstractmethod
    def _parts(self, x: Vector, force: Vector) -> ForceParts | None: ...

    def _periods(self, now_ns: int) -> int:
        """The number of periods to advance a simulated device, so that it keeps up with the clock: normally 1. It is
        higher if the servo was late, and 0 in the tick after a tick that was called late, or during a pause."""
        if self.paused:
            self._expected_ns = now_ns
        periods = periods_until(now_ns, self._expected_ns, self.drive.period_ns)
        self._expected_ns += periods * self.drive.period_ns
        return periods

    def _record(
        self, now_ns: int, x: Vector, v: Vector, force: Vector, hand: Vector | None, target: Vector | None
    ) -> None:
        """Record the device at x [m] with velocity v [m/s], the forces on it [N] and the target of its hand [m]."""
        if self.drive.write_motion is not None:
            self._emit(self.drive.write_motion, MetricSample(now_ns, x, force, target))
            return
        coupling = self.endpoint.coupling
        ledger = coupling.ledger
        spring, damper, model, added = self._parts(x, force) or _UNKNOWN
        age_s, transit_s = self.endpoint.used(now_ns)
        self._emit(
            self._write,
            DeviceSample(
                time_ns=now_ns,
                position_m=x, velocity_mps=v, set_position_m=coupling.set_position, target_m=coupling.target,
                force_N=force, spring_force_N=spring, damper_force_N=damper, model_force_N=model,
                added_damping_force_N=added, operator_force_N=hand, operator_target_m=target,
                operator_work_J=math.nan if hand is None else self.hand_work,
                reservoir_J=coupling.reservoir, deficit_J=coupling.deficit, potential_J=coupling.potential(x),
                sent_J=ledger.sent, credited_J=ledger.credited, margin_J=ledger.margin, slack_J=ledger.slack,
                bound_J=ledger.bound, work_J=ledger.work, stored_J=ledger.stored, account_J=ledger.reservoir,
                age_s=age_s, transit_s=transit_s,
            ),
        )  # fmt: skip
        if isinstance(self.device, SimulatedDevice) and (angles := self.device.posture):
            self._write(PostureSample(now_ns, angles))

    def _emit(self, write: Callable[[S], None], sample: S) -> None:
        """Write the sample of this tick; in the next one, if the device tells only then which force it held."""
        write(sample)


@equation
def control(side: Any, endpoint: Any, hand: Any, now_ns: int) -> Any:
    """Make a tick of a device under control; returns the message to send, if there is one.

    side, endpoint : a `DeviceSide` and its endpoint, or their records in compiled code. hand : the path of a simulated
    hand, in compiled code only. The functions below are the parts that differ between the two.
    """
    measure(side, hand, now_ns)
    take(side, endpoint, now_ns)
    message = act(side, endpoint, now_ns)
    hold(side)
    side.last_ns = now_ns
    side.ticks += 1
    return message


def measure(side: Any, hand: Any, now_ns: int) -> None:
    """Advance a simulated device to now under its held force, read the device, and count the work."""
    side.measure(now_ns)


def take(side: Any, endpoint: Any, now_ns: int) -> None:
    """Pass the samples and credits that arrived since the last tick to the coupling."""
    if endpoint.waiting or endpoint.credits:
        endpoint.take(now_ns)


def act(side: Any, endpoint: Any, now_ns: int) -> Any:
    """Run the servo; returns the message to send, if there is one."""
    return side.act(now_ns)


def hold(side: Any) -> None:
    """Let the device hold the servo's force, or its spring's set-position, until the next tick."""
    side.hold()
