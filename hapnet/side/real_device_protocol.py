"""The device that `RealDeviceSide` drives: its optional parts are there, whatever the driver has of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from hapnet.checks import Vector
from hapnet.plant.device import Device
from hapnet.wire.fields import Signal


class RealDevice(Device, Protocol):
    """A device with what only real ones have."""

    name: str
    watchdog_s: float | None
    """It takes the force away by itself when no command has come for so long [s]; None: it does not."""

    smallest_mass: float | None
    """The handle is felt as no lighter [kg]; None: not declared."""

    knows_force: bool
    """Is what `acted` returns known from the device?"""

    @property
    def blocks(self) -> bool:
        """Whether `read` waits for its next reading."""

    @property
    def missed(self) -> int:
        """Readings that it made and nobody took."""

    def begin(self) -> None:
        """Control begins."""

    def acted(self) -> Vector | None:
        """The force that acted between the last two readings [N], if the device reports it."""

    def interval(self) -> float | None:
        """The time between the last two readings [s] by the device's own clock, if it reports that."""

    def orientation(self) -> Vector | None:
        """How its handle is turned, as of the last reading: a unit quaternion, or None if it is not known."""

    def signal(self, name: str, value: Signal) -> None:
        """The world sends a value beside the stream."""

    def vibrate(self, force: Vector) -> None:
        """Take the part of the force that grains make now [N]."""

    def braked(self) -> str:
        """Why it renders no force now; empty: it does."""

    def buttons(self) -> Sequence[bool]:
        """Its buttons as of the last reading."""

    def close(self) -> None:
        """Let go of it."""
