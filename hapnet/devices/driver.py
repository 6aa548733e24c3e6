"""The interface of a driver, and its optional declarations. README.md beside this file explains each part.

A driver needs no base class: hapnet looks its parts up by name. `Driver` has a default for every part that is optional.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar

from hapnet.checks import Vector
from hapnet.errors import InvalidParameter

NO_FORCE = 1e-6
"""The force limit of a device without motors [N]: so small that the coupling keeps no energy in reserve for it."""


class Driver(ABC):
    """A haptic device. Its constructor takes ``dof``, and the options that follow the device's name, as keywords.

    All lengths are in metres, forces in newtons, in a right-handed frame: x to the right, y away from the user, z up.
    None means not declared: then the run's parameter is used, or nothing is limited.

    More than twenty attributes: one for each declaration that a device may make.
    """

    about: ClassVar[str] = ""
    """A short description of the device, for `hapnet devices`."""
    tested: ClassVar[str] = "untested"
    """How far this driver was tested: ``tested with an emulator``, or with which hardware."""
    udev: ClassVar[str] = ""
    """On Linux: the udev rule that lets the user at the machine open the device; empty: none is needed."""
    emulator: ClassVar[str] = ""
    """``module:Class`` of an emulator (`hapnet.ext.devices.emulator.Emulator`); empty: none."""

    rate_hz: float | None = None
    """The fastest servo that the device keeps up with [Hz]; a class attribute. None: as fast as the servo is set."""
    blocking: bool = False
    """Whether `read` waits for the next reading of the device. If so, the device sets the servo's pace."""

    dof: int
    jaw: bool = False
    """Whether the last axis is the opening of a jaw, 0 where it is closed. A class that can have one, has an option of
    this name; one that always has one, declares it as a class attribute."""
    force_limit: float | None = None
    """The maximum force of the actuators [N]."""
    resolution: float = 0.0
    """The resolution of the encoders [m]; 0: exact."""
    continuous_force: float | None = None
    """The force that the actuators can give continuously [N]; they give larger forces only for about `thermal_s`."""
    thermal_s: float = 10.0
    """Time constant with which the actuators heat up [s]."""
    greatest_speed: float | None = None
    """The greatest speed of the handle [m/s]."""
    workspace: float | Vector | None = None
    """The handle's reach from its origin in both directions [m], or on each axis."""
    stiffness_range: tuple[float, float] | None = None
    """Smallest and largest stiffness that the device renders [N/m]."""
    damping_range: tuple[float, float] | None = None
    """Smallest and largest damping that the device renders [Ns/m]."""
    smallest_mass: float | None = None
    """Smallest apparent mass in any direction [kg]."""
    watchdog_s: float | None = None
    """The time without a command after which the device itself sets its force to zero [s]; None: it never does."""
    dead_man: int | None = None
    """The number of the button that must be held for a force (dead-man switch); None: there is none."""
    missed: int = 0
    """The number of readings so far that the device made and the program missed, for the summary."""
    knows_force: bool = True
    """Whether the device reports the force that `acted` returns. False: it is a command, assumed to have acted."""

    @classmethod
    def missing(cls) -> str:
        """The name of what must be installed before the driver can be used; empty: nothing is missing."""
        return ""

    @classmethod
    def found(cls) -> Sequence[str]:
        """The devices that are connected to this machine, each as the text that follows ``NAME:`` in `--device`."""
        return ()

    def home(self) -> None:
        """Calibrate the device, before its first reading. This may take long, and may need an action of the user.

        Raises HapnetError: the user has to do something first, which the message names.
        """
        return

    def begin(self) -> None:
        """Prepare for forces, as the sides are now connected: enable the motors, open a catch."""
        return

    @abstractmethod
    def read(self) -> tuple[Vector, Vector]:
        """Position [m] and velocity [m/s] now, `dof` finite numbers each.

        Raises DeviceSilent: there is no reading now. Anything else ends the run.
        """

    @abstractmethod
    def apply(self, force: Vector) -> Vector | None:
        """Hold this force [N] until the next call; returns the force really applied, or None if it is not known.

        Raises DeviceSilent: the command was not sent. Anything else ends the run.
        """

    def acted(self) -> Vector | None:
        """The mean force that really acted between the last two readings [N]; None: what `apply` returned.

        If the device's commands may arrive late, or not at all, return the force here: the account counts it.
        """
        return None

    def contact_force(self) -> Vector | None:
        """The measured force of the surroundings on a follower robot, as of the last reading [N]; None: not known.

        It excludes the motors' force. It is positive along an axis if the surroundings push the robot that way.
        """
        return None

    def interval(self) -> float | None:
        """The time between the last two readings by the device's own clock [s]; None: use the times of `read`.

        With it, readings that a busy machine delivers all at once are not mistaken for fast motion.
        """
        return None

    def orientation(self) -> Vector | None:
        """The orientation of the handle at the last reading, a unit quaternion w, x, y, z; None: not known."""
        return None

    def signal(self, name: str, value: object) -> None:
        """Take a value that the world sends as a signal: a light, a sound, a vibration. It must return at once."""
        return

    def vibrate(self, force: Vector) -> None:
        """Take the part of the force that the grains of surfaces make [N], after each `apply`: for an actuator that
        only vibrates.

        It must return at once. The account does not count what such an actuator does.
        """
        return

    def braked(self) -> str:
        """The reason why the device renders no force now, such as a brake or no power; empty: it renders force.

        Meanwhile the commanded force is zero, and afterwards it grows from zero.
        """
        return ""

    def buttons(self) -> Sequence[bool]:
        """The state of each button at the last reading: True if pressed."""
        return ()

    def close(self) -> None:
        """Release the device, after the last force was set to zero."""
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
            raise InvalidParameter("axes", text, f"{allowed}; a minus before a letter reverses its axis")
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
