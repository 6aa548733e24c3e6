"""The interface of a driver, and its optional declarations. README.md beside this file explains each part.

A driver needs no base class: hapnet asks for the parts by name. `Driver` has a default for every part that is optional.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar

from hapnet.checks import Vector
from hapnet.errors import InvalidParameter

NO_FORCE = 1e-6
"""The force limit of a device without motors [N]: so the coupling keeps no energy for a force."""


class Driver(ABC):
    """A haptic device. Made with ``dof``, and with the options that follow the device's name as keywords.

    All lengths are in metres, forces in newtons, in a right-handed frame: x to the right, y away from the user, z up.
    What is None is not declared: the run's parameters stand in for it, or nothing is limited.
    """

    about: ClassVar[str] = ""
    """A short description of the device, for `hapnet devices`."""
    tested: ClassVar[str] = "untested"
    """How far this driver was tested: ``emulator-tested``, or on which hardware."""
    udev: ClassVar[str] = ""
    """On Linux: the udev rule with which the user at the machine may open it; empty: it needs none."""
    emulator: ClassVar[str] = ""
    """``module:Class`` of an emulator (`hapnet.ext.devices.emulator.Emulator`); empty: none."""

    rate_hz: float | None = None
    """The fastest servo that the device keeps up with [Hz]; a class attribute. None: as fast as the servo is set."""
    blocking: bool = False
    """Does `read` wait for the next reading of the device? Then the device sets the servo's pace."""

    dof: int
    force_limit: float | None = None
    """The maximum force of the actuators [N]."""
    resolution: float = 0.0
    """Of the encoders [m]; 0: exact."""
    continuous_force: float | None = None
    """The force that the actuators can give for ever [N]; larger ones only for `thermal_s`."""
    thermal_s: float = 10.0
    """Time constant with which the actuators heat up [s]."""
    greatest_speed: float | None = None
    """The handle is never faster [m/s]."""
    workspace: float | Vector | None = None
    """How far the handle reaches from its origin in both directions [m], or on each axis."""
    stiffness_range: tuple[float, float] | None = None
    """Smallest and largest stiffness that the device renders [N/m]."""
    damping_range: tuple[float, float] | None = None
    """Smallest and largest damping that the device renders [Ns/m]."""
    smallest_mass: float | None = None
    """Smallest apparent mass in any direction [kg]."""
    watchdog_s: float | None = None
    """The device itself takes the force away when no command has come for so long [s]; None: it does not."""
    dead_man: int | None = None
    """The button that must be held for a force; None: there is none."""
    missed: int = 0
    """Readings that the device made and nobody took, so far: the summary counts them."""
    knows_force: bool = True
    """Is what `acted` returns known from the device? False: it is a command, believed to have acted then."""

    @classmethod
    def missing(cls) -> str:
        """A text that says what must be installed before the driver can be made; empty: nothing."""
        return ""

    @classmethod
    def found(cls) -> Sequence[str]:
        """The devices that are connected to this machine, each as a text that can follow ``NAME:``."""
        return ()

    def home(self) -> None:
        """Calibrate the device, before its first reading. It may take its time, and ask the user for something.

        Raises HapnetError: says what the user has to do first.
        """
        return

    def begin(self) -> None:
        """The sides have met: from now on forces come that are not zero. Enable the motors, open a catch."""
        return

    @abstractmethod
    def read(self) -> tuple[Vector, Vector]:
        """Position [m] and velocity [m/s] now, `dof` finite numbers each.

        Raises DeviceSilent: there is no reading now. Anything else ends the run.
        """

    @abstractmethod
    def apply(self, force: Vector) -> Vector | None:
        """Hold this force [N] until the next call; returns the one that is really applied, or None if it is not known.

        Raises DeviceSilent: the command did not go out. Anything else ends the run.
        """

    def acted(self) -> Vector | None:
        """The mean force that really acted between the last two readings [N]; None: what `apply` returned.

        A device whose commands arrive late, or not at all, reports it here: the account counts this force.
        """
        return None

    def contact_force(self) -> Vector | None:
        """The measured force of its surroundings on a robot that follows, as of the last reading [N]; None: not known.

        The motors' force is no part of it. Positive along an axis: the surroundings push the robot that way.
        """
        return None

    def interval(self) -> float | None:
        """The time between the last two readings by the device's own clock [s]; None: by when `read` returned.

        Readings that waited together on a busy machine are no fast motion: only the device knows when it took them.
        """
        return None

    def orientation(self) -> Vector | None:
        """How the handle is turned, as of the last reading: a unit quaternion w, x, y, z; None: not known."""
        return None

    def signal(self, name: str, value: object) -> None:
        """The world sends this value beside the stream: a light, a sound, a vibration. It must return at once."""
        return

    def vibrate(self, force: Vector) -> None:
        """Take the part of the force that the grains of surfaces make [N], after each `apply`: for an actuator that
        only vibrates.

        It must return at once. The account does not count what such an actuator does.
        """
        return

    def braked(self) -> str:
        """A text that says why the device renders no force now: a brake, no power. Empty: it does.

        Meanwhile it gets no force, and afterwards the force grows from zero.
        """
        return ""

    def buttons(self) -> Sequence[bool]:
        """The buttons as of the last reading: True is pressed."""
        return ()

    def close(self) -> None:
        """Let go of the device, after the last force was set to zero."""
        return


_ONE = re.compile(r"(-?)([xyz])")


class Axes:
    """The choice of axes `text` of a device with `native` axes, for a scene with `dof` of them.

    text : one letter for each axis of the scene, with a minus if its direction is reversed; empty: the first ones.

    Raises InvalidParameter: they do not fit.
    """

    def __init__(self, text: str, dof: int, native: int = 3) -> None:
        letters = "xyz"[:native]
        text = text or letters[:dof]
        chosen = _ONE.findall(text)
        names = [letter for _, letter in chosen]
        whole = "".join(map("".join, chosen)) == text
        if not whole or len(names) != dof or len(set(names)) != dof or not set(names) <= set(letters):
            allowed = f"{dof} of {letters}, one for each axis of the scene, such as {letters[:dof] or 'x'}"
            raise InvalidParameter("axes", text, f"{allowed}; a minus before one turns it round")
        self._native = native
        self._chosen = [(letters.index(letter), -1.0 if sign else 1.0) for sign, letter in chosen]

    def take(self, whole: Vector) -> Vector:
        """The scene's axes of a vector of the device."""
        return tuple([sign * whole[axis] for axis, sign in self._chosen])

    def spread(self, part: Vector) -> Vector:
        """The vector of the device whose chosen axes are `part`; the others are 0."""
        whole = [0.0] * self._native
        for (axis, sign), value in zip(self._chosen, part, strict=True):
            whole[axis] = sign * value
        return tuple(whole)
