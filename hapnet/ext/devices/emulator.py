"""The base of emulators: devices with a driver's protocol, without hardware, with a simulated hand on the handle.

An emulator runs in a separate process (`hapnet emulate NAME`) with its own clock, as a real device does. Its
handle is a `SimulatedDevice`. It counts the energy that its actuators gave to the hand, from the forces that really
acted: this account does not depend on the driver, or on hapnet's account.
"""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

from hapnet.checks import Vector
from hapnet.ext.arms.device import SimulatedArm
from hapnet.ext.arms.table import ArmTable
from hapnet.plant.device import SimulatedDevice

NANO = 1e-9
_MOST_BEHIND_NS = 1_000_000_000


class EmulatedHandle:
    """A simulated handle that moves in real time; the time is an argument.

    device : simulated; it moves in steps of its period, so its position may be that old.
    watchdog_s : the time without a command after which the force ends; None: it never ends.
    """

    def __init__(self, device: SimulatedDevice, watchdog_s: float | None = None) -> None:
        self.device = device
        self.watchdog_s = watchdog_s
        self._period_ns = round(device.period / NANO)
        self._start_ns: int | None = None
        self._commanded_ns = 0
        self.impulse_Ns: tuple[float, ...] = (0.0,) * device.dof
        """The integral of the actuators' force so far [Ns]."""
        self.work_J: float = 0.0
        """Energy that the actuators gave to the handle so far [J]; below zero: they took energy."""
        self.most_given_J: float = 0.0
        """The greatest value of `work_J` so far [J]: a passive side gives no more than its ceiling."""
        self.commands: int = 0
        self.released: int = 0
        """The number of times that the watchdog ended the force."""

    @property
    def force(self) -> Vector:
        """The force that acts now [N]."""
        return tuple(self.device.state.torque)

    def read(self, now_ns: int) -> tuple[Vector, Vector]:
        """Position [m] and velocity [m/s] at `now_ns`."""
        self._advance(now_ns)
        return self.device.position, self.device.velocity

    def age_ns(self, now_ns: int) -> int:
        """The age of the position that the last `read` returned, as the handle moves in steps [ns]."""
        assert self._start_ns is not None, "not read yet"
        return now_ns - self._start_ns - self.device.ticks * self._period_ns

    def impulse_at(self, now_ns: int) -> Vector:
        """The integral of the force up to `now_ns` [Ns], after a `read` at that time."""
        since_s = self.age_ns(now_ns) * NANO
        return tuple([impulse + since_s * force for impulse, force in zip(self.impulse_Ns, self.force, strict=True)])

    def hold(self, now_ns: int, force: Vector) -> Vector:
        """Let this force [N] act from `now_ns` on; returns the force that really acts."""
        self._advance(now_ns)
        self.commands += 1
        self._commanded_ns = now_ns
        return self.device.apply(force)

    def stored_J(self) -> float:
        """The energy from its actuators that the device itself holds [J]."""
        return 0.0

    def _advance(self, now_ns: int) -> None:
        """Advance the handle to the present, in steps; it does not move during a pause of more than a second."""
        if self._start_ns is None:
            self._start_ns = now_ns
        device = self.device
        behind = now_ns - self._start_ns - device.ticks * self._period_ns
        if behind > _MOST_BEHIND_NS:
            self._start_ns += behind - _MOST_BEHIND_NS
        while self._start_ns + (device.ticks + 1) * self._period_ns <= now_ns:
            at_ns = self._start_ns + device.ticks * self._period_ns
            late = self.watchdog_s is not None and (at_ns - self._commanded_ns) * NANO >= self.watchdog_s
            if late and any(self.force):
                device.apply((0.0,) * device.dof)
                self.released += 1
            before, stored_J = device.position, self.stored_J()
            device.advance()
            self.work_J += sum(f * (b - a) for f, a, b in zip(self.force, before, device.position, strict=True))
            self.work_J += stored_J - self.stored_J()
            period_s = self._period_ns * NANO
            self.impulse_Ns = tuple([j + f * period_s for j, f in zip(self.impulse_Ns, self.force, strict=True)])
            self.most_given_J = max(self.most_given_J, self.work_J)


class ArmHandle(EmulatedHandle):
    """An arm that hangs in the hand, with the joints as axes; work on its weight does not count as given to the hand.

    arm : `hold` sets its motors' torques [Nm]; their work counts from the first torque on.
    """

    def __init__(self, arm: SimulatedArm) -> None:
        super().__init__(arm)
        self._arm = arm
        self._is_driven = False

    def stored_J(self) -> float:
        return self._arm.potential if self._is_driven else 0.0

    def hold(self, now_ns: int, force: Vector) -> Vector:
        held = super().hold(now_ns, force)
        self._is_driven |= any(force)
        return held


class Emulator(ABC):
    """A device of one kind without hardware. The constructor takes its handle, a clock [ns], and its options."""

    dof: ClassVar[int] = 3
    """The number of the handle's axes."""
    force_limit: ClassVar[float | None] = None
    """The force limit of its amplifiers [N]."""
    watchdog_s: ClassVar[float | None] = None
    """The time without a command after which it ends the force [s]."""

    def __init__(self, handle: EmulatedHandle, clock: Callable[[], int]) -> None:
        self.handle: EmulatedHandle = handle
        self._clock = clock
        self.address = ""
        """Its address, as a text that can follow ``NAME:``."""

    @classmethod
    def arm(cls, options: Mapping[str, Any]) -> ArmTable | None:
        """The arm for an `ArmHandle`, with joints as axes; None: a handle with `dof` axes."""
        return None

    @abstractmethod
    def run(self, stop: threading.Event) -> None:
        """Serve until `stop` is set, which must be checked at least every 0.1 s."""
