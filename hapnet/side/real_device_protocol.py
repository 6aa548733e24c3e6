"""The device that `RealDeviceSide` drives; optional methods exist even if the driver lacks them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from hapnet.checks import Vector
from hapnet.plant.device import Device
from hapnet.wire.fields import Signal


class RealDevice(Device, Protocol):
    """A device with the attributes and methods that only real devices have."""

    name: str
    watchdog_s: float | None
    """The device ends its force by itself when no command has come for this time [s]; None: it does not."""

    smallest_mass: float | None
    """A lower bound of the mass felt at the handle [kg]; None: not declared."""

    knows_force: bool
    """Whether the result of `acted` comes from the device itself."""

    @property
    def jaw(self) -> bool:
        """Whether its last axis is the opening of a jaw."""

    @property
    def blocks(self) -> bool:
        """Whether `read` waits for its next reading."""

    @property
    def missed(self) -> int:
        """The number of readings that the device made and that were not read."""

    def begin(self) -> None:
        """Prepare for control, which begins now."""

    def acted(self) -> Vector | None:
        """The force that acted between the last two readings [N], if the device reports it."""

    def interval(self) -> float | None:
        """The time between the last two readings [s] by the device's own clock, if it reports that."""

    def orientation(self) -> Vector | None:
        """The orientation of its handle at the last reading: a unit quaternion, or None if it is unknown."""

    def signal(self, name: str, value: Signal) -> None:
        """Take a value that the world sends beside the stream."""

    def vibrate(self, force: Vector) -> None:
        """Take the part of the present force that comes from grains [N]."""

    def braked(self) -> str:
        """The reason why it renders no force now; empty: it renders force."""

    def buttons(self) -> Sequence[bool]:
        """The states of its buttons at the last reading."""

    def close(self) -> None:
        """Close the connection to the device."""
