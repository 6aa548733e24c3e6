"""Force Dimension's devices (omega, delta, sigma, lambda) and the Novint Falcon, by the maker's library `libdhd`.

**Experimental**: written after the library's documented functions, and tested against a stand-in of it, never on a
device. The library is the maker's and is loaded when the device is made. Its page is force_dimension.md.
"""

from __future__ import annotations

import ctypes
import ctypes.util
from collections.abc import Callable, Sequence
from ctypes import POINTER, byref, c_bool, c_byte, c_char_p, c_double, c_int, c_ubyte, c_uint
from typing import NamedTuple

from hapnet.checks import Vector
from hapnet.devices.driver import Axes, Driver
from hapnet.errors import DeviceSilent, HapnetError, InvalidParameter
from hapnet.mechanics.pose import quaternion

_NAMES = ("drd", "dhd", "drd64", "dhd64")  # the last two on Windows
"""Names of the library. `libdrd` has the functions of `libdhd` too, and calibrates a device by itself."""

_WATCHDOG_TICKS = 160
"""The device disables forces after this number of 125 us without a command: 20 ms."""

_ON, _OFF = 1, 0
_ROOM = 64
"""The buffer's size for `dhdGetStatus`, which takes no size and writes 12 to 17 numbers in known versions."""

_POWER, _RESET, _FORCE, _CAUSE, _LOCKS = 0, 3, 5, 14, 15
_CAUSES = {
    1: "the force button was pressed: press it again",
    2: "it went faster than its own limit: press its force button",
    3: "its watchdog disabled forces: they are enabled again",
    4: "a program disabled its forces",
    5: "its USB cable was out",
    6: "its dead-man switch is released",
}
_WATCHDOG_CAUSE = 3
_ID, _DOUBLES = c_byte, [POINTER(c_double)] * 3
_FUNCTIONS: dict[str, tuple[type, list[type]]] = {
    "dhdClose": (c_int, [_ID]),
    "dhdEnableExpertMode": (c_int, []),
    "dhdEnableForce": (c_int, [c_ubyte, _ID]),
    "dhdErrorGetLastStr": (c_char_p, []),
    "dhdGetButtonMask": (c_uint, [_ID]),
    "dhdGetDeviceCount": (c_int, []),
    "dhdGetForce": (c_int, [*_DOUBLES, _ID]),
    "dhdGetLinearVelocity": (c_int, [*_DOUBLES, _ID]),
    "dhdGetOrientationFrame": (c_int, [POINTER(c_double * 9), _ID]),
    "dhdGetPosition": (c_int, [*_DOUBLES, _ID]),
    "dhdGetStatus": (c_int, [POINTER(c_int * _ROOM), _ID]),
    "dhdGetSystemName": (c_char_p, [_ID]),
    "dhdHasWrist": (c_bool, [_ID]),
    "dhdOpenID": (c_int, [_ID]),
    "dhdSetBrakes": (c_int, [c_int, _ID]),
    "dhdSetForce": (c_int, [c_double, c_double, c_double, _ID]),
    "dhdSetGravityCompensation": (c_int, [c_int, _ID]),
    "dhdStop": (c_int, [_ID]),
}  # fmt: skip
_OPTIONAL: dict[str, tuple[type, list[type]]] = {
    "dhdGetForceAndTorque": (c_int, [*_DOUBLES, *_DOUBLES, _ID]),
    "dhdGetForceAndTorqueAndGripperForce": (c_int, [*_DOUBLES, *_DOUBLES, POINTER(c_double), _ID]),
    "dhdGetGripperGap": (c_int, [POINTER(c_double), _ID]),
    "dhdGetGripperLinearVelocity": (c_int, [POINTER(c_double), _ID]),
    "dhdHasActiveGripper": (c_bool, [_ID]),
    "dhdIsLeftHanded": (c_bool, [_ID]),
    "dhdHasActiveWrist": (c_bool, [_ID]),
    "dhdSetForceAndGripperForce": (c_int, [c_double] * 4 + [_ID]),
    "dhdSetForceAndTorque": (c_int, [c_double] * 6 + [_ID]),
    "dhdSetWatchdog": (c_int, [c_ubyte, _ID]),
    "drdAutoInit": (c_int, [_ID]),
    "drdClose": (c_int, [_ID]),
    "drdIsInitialized": (c_bool, [_ID]),
    "drdIsSupported": (c_bool, [_ID]),
    "drdOpenID": (c_int, [_ID]),
    "drdStop": (c_int, [c_bool, _ID]),
}
"""An older library has no watchdog, or no torques. `drd...` are functions of `libdrd`: without them a device is
calibrated by hand."""


class Limits(NamedTuple):
    """Limits from the maker's data sheet: force [N], reach in both directions [m], stiffness [N/m]."""

    force_N: float
    reach_m: float
    stiffness: float


_KNOWN = {
    "omega": Limits(12.0, 0.12, 14_500.0),
    "delta": Limits(20.0, 0.26, 14_500.0),
    "sigma": Limits(20.0, 0.15, 14_500.0),
    "lambda": Limits(20.0, 0.19, 14_500.0),
    "falcon": Limits(8.0, 0.08, 8_000.0),
}
_UNKNOWN = Limits(8.0, 0.3, 8_000.0)
_ALL = (*_KNOWN.values(), _UNKNOWN)


_GRIP_N, _GRIP_M = 8.0, 0.03
"""Greatest force of the grips of omega.7 and sigma.7, and an opening beyond theirs of 25 mm, from their data sheets."""


class ForceDimension(Driver):
    """``dhd``, or ``dhd:1`` for the second device.

    number : of the device, from 0. axes : the axes for the scene, as in `Axes`. library : path of the library; empty:
    where the system finds it. gravity : whether the device carries the weight of its own arms. calibrate : whether a
    device that is not calibrated may move by itself, if `libdrd` supports that. jaw : whether the last
    axis is the opening of its grip (omega.7, sigma.7).

    Raises InvalidParameter: a value is not allowed. HapnetError: no library, or no device.
    """

    about = "Force Dimension omega, delta, sigma, lambda; Novint Falcon (libdhd)"
    udev = (
        'SUBSYSTEM=="usb", ATTR{idVendor}=="1451", TAG+="uaccess"\n'
        'SUBSYSTEM=="usb", ATTR{idVendor}=="0403", ATTR{idProduct}=="cb48", TAG+="uaccess"'  # Novint Falcon
    )
    tested = "experimental: tested with a stand-in of the library"
    rate_hz: float = 1000.0
    resolution: float = 1e-5
    force_limit: float = min(each.force_N for each in _ALL)  # until the device is open and its model known
    stiffness_range: tuple[float, float] = (0.0, min(each.stiffness for each in _ALL))

    def __init__(
        self,
        dof: int,
        number: int = 0,
        axes: str = "",
        library: str = "",
        gravity: bool = True,
        calibrate: bool = True,
        jaw: bool = False,
    ) -> None:
        if not 0 <= number <= 15:
            raise InvalidParameter("number", number, "0 to 15")
        self.dof = dof
        self.jaw: bool = jaw
        self._axes = Axes(axes, dof - jaw)
        self._dhd = _load(library)
        self._robotic = hasattr(self._dhd, "drdAutoInit")
        self._id = (self._dhd.drdOpenID if self._robotic else self._dhd.dhdOpenID)(number)
        if self._id < 0:
            raise HapnetError(f"no device {number} of Force Dimension: {self._why()} ({self._count()} connected)")
        self._buttons = 0
        self._begun = False
        self._off = ""
        self._gravity, self._calibrates = gravity, calibrate
        self._has_wrist = bool(self._dhd.dhdHasWrist(self._id))
        has_torque = hasattr(self._dhd, "dhdHasActiveWrist") and self._dhd.dhdHasActiveWrist(self._id)
        self.apply_wrench: Callable[[Vector, Vector], tuple[Vector, Vector]] | None = None
        """Hold a force [N] and a torque [Nm]; returns both as applied; None: the wrist has no motors."""
        if has_torque:
            self.apply_wrench = self._apply_wrench
        self.name: str = (self._dhd.dhdGetSystemName(self._id) or b"").decode(errors="replace")
        limits = next((found for name, found in _KNOWN.items() if name in self.name.lower()), _UNKNOWN)
        self.force_limit = limits.force_N
        self.workspace: float | Vector = limits.reach_m
        if jaw:
            self._take_grip(limits)
        self.stiffness_range = (0.0, limits.stiffness)
        self._dhd.dhdEnableExpertMode()
        has_watchdog = hasattr(self._dhd, "dhdSetWatchdog") and self._dhd.dhdSetWatchdog(_OFF, self._id) >= 0
        self.watchdog_s: float | None = _WATCHDOG_TICKS * 125e-6 if has_watchdog else None

    def _take_grip(self, limits: Limits) -> None:
        """Use its grip. Raises HapnetError: it has none with motors."""
        dhd, own = self._dhd, self._id
        if not (hasattr(dhd, "dhdHasActiveGripper") and dhd.dhdHasActiveGripper(own)):
            self.close()
            raise HapnetError(f"{self.name} has no grip with motors: leave out jaw=yes, and + grip in the scene")
        self.apply_wrench = None
        self.force_limit = min(limits.force_N, _GRIP_N)
        self.workspace = (*(limits.reach_m,) * (self.dof - 1), _GRIP_M)

    @classmethod
    def missing(cls) -> str:
        return "" if _find() else "libdrd or libdhd, from Force Dimension's SDK"

    @classmethod
    def found(cls) -> Sequence[str]:
        return tuple(str(number) for number in range(max(0, _load("").dhdGetDeviceCount())))

    def home(self) -> None:
        """Calibrate the device, automatically if possible. Without this its positions are invalid.

        Raises HapnetError: the user must calibrate it by hand, or its locks are closed, or it has no power.
        """
        status = self._status()
        if not status[_POWER]:
            raise HapnetError(f"{self.name} has no power")
        if status[_LOCKS] == 1:
            raise HapnetError(f"the locks of {self.name} are closed: open them first")
        if not status[_RESET]:
            return
        if self._robotic and self._calibrates and self._dhd.drdIsSupported(self._id):
            done = self._dhd.drdAutoInit(self._id) >= 0
            self._dhd.drdStop(False, self._id)  # no force before `begin`
            if done and not self._status()[_RESET]:
                return
        raise HapnetError(f"{self.name} is not calibrated: move its handle through its calibration first")

    def begin(self) -> None:
        """Enable the forces: brakes off, own weight carried, watchdog on.

        Raises HapnetError: the device refuses a setting.
        """
        dhd, own = self._dhd, self._id
        self._require(dhd.dhdSetBrakes(_OFF, own))
        self._require(dhd.dhdSetGravityCompensation(_ON if self._gravity else _OFF, own))
        self._set_zero()  # the watchdog counts from here; refused perhaps before the forces are on
        if self.watchdog_s is not None:
            self._require(dhd.dhdSetWatchdog(_WATCHDOG_TICKS, own))
        self._require(dhd.dhdEnableForce(_ON, own))
        self._require(self._set_zero())
        self._begun = True

    def read(self) -> tuple[Vector, Vector]:
        """Position [m] and velocity [m/s], which the library estimates over 20 ms.

        Raises DeviceSilent: the library reports an error.
        """
        position = self._numbers("dhdGetPosition")
        velocity = self._numbers("dhdGetLinearVelocity")
        self._buttons = self._dhd.dhdGetButtonMask(self._id)
        x, v = self._axes.take(_to_hapnet(position)), self._axes.take(_to_hapnet(velocity))
        if not self.jaw:
            return x, v
        (gap,), (rate,) = self._numbers("dhdGetGripperGap", 1), self._numbers("dhdGetGripperLinearVelocity", 1)
        return (*x, gap), (*v, self._opening_sign() * rate)

    def apply(self, force: Vector) -> Vector:
        """Hold this force; it is zero while the device has its forces off. After its watchdog they are enabled again.

        Raises DeviceSilent: the library reports an error.
        """
        if not self._begun:
            return (0.0,) * self.dof
        if self.jaw:
            return self._apply_with_grip(force)
        if self._dhd.dhdSetForce(*_theirs(self._axes.spread(force)), self._id) < 0:
            raise DeviceSilent(f"{self.name} accepts no force: {self._why()}")
        if not self._renders():
            return (0.0,) * self.dof
        # if motors saturate, the library reports the force that they make
        return self._axes.take(_to_hapnet(self._numbers("dhdGetForce")))

    def _apply_with_grip(self, force: Vector) -> Vector:
        *push, grip = force
        theirs = (*_theirs(self._axes.spread(tuple(push))), self._opening_sign() * grip)
        if self._dhd.dhdSetForceAndGripperForce(*theirs, self._id) < 0:
            raise DeviceSilent(f"{self.name} accepts no force: {self._why()}")
        if not self._renders():
            return (0.0,) * self.dof
        applied = self._numbers("dhdGetForceAndTorqueAndGripperForce", 7)
        return (*self._axes.take(_to_hapnet(applied[:3])), self._opening_sign() * applied[6])

    def _opening_sign(self) -> float:
        """The sign of the library's grip force and velocity that open: negative for a left hand."""
        return -1.0 if self._dhd.dhdIsLeftHanded(self._id) else 1.0

    def _apply_wrench(self, force: Vector, torque: Vector) -> tuple[Vector, Vector]:
        none = (0.0,) * self.dof, (0.0,) * 3
        if not self._begun:
            return none
        theirs = (*_theirs(self._axes.spread(force)), *_theirs(torque))
        if self._dhd.dhdSetForceAndTorque(*theirs, self._id) < 0:
            raise DeviceSilent(f"{self.name} accepts no force: {self._why()}")
        if not self._renders():
            return none
        applied = self._numbers("dhdGetForceAndTorque", 6)
        return self._axes.take(_to_hapnet(applied[:3])), _to_hapnet(applied[3:])

    def _renders(self) -> bool:
        """Whether its forces are on. After its watchdog they are enabled again, from zero."""
        status = self._status()
        if status[_FORCE]:
            self._off = ""
            return True
        self._off = "it has no power" if not status[_POWER] else _CAUSES.get(status[_CAUSE], "its forces are off")
        if status[_CAUSE] == _WATCHDOG_CAUSE:
            self._set_zero()
            self._dhd.dhdEnableForce(_ON, self._id)
        return False

    def orientation(self) -> Vector | None:
        """The orientation of the wrist, if there is one: a unit quaternion w, x, y, z in hapnet's frame."""
        if not self._has_wrist:
            return None
        frame = (c_double * 9)()
        if self._dhd.dhdGetOrientationFrame(byref(frame), self._id) < 0:
            return None
        columns = [_to_hapnet((frame[k], frame[3 + k], frame[6 + k])) for k in (1, 0, 2)]
        turned = [columns[0], tuple([-c for c in columns[1]]), columns[2]]  # hapnet's axes are libdhd's y, -x and z
        return quaternion([[turned[column][row] for column in range(3)] for row in range(3)])

    def braked(self) -> str:
        """The reason why its forces were off at the last command; when they are on again the force grows from zero."""
        return self._off

    def buttons(self) -> tuple[bool, ...]:
        return tuple(bool(self._buttons >> k & 1) for k in range(max(1, self._buttons.bit_length())))

    def close(self) -> None:
        if self._id >= 0:
            self._dhd.dhdStop(self._id)
            (self._dhd.drdClose if self._robotic else self._dhd.dhdClose)(self._id)
            self._id = -1

    def _numbers(self, function: str, count: int = 3) -> Vector:
        numbers = [c_double() for _ in range(count)]
        if getattr(self._dhd, function)(*map(byref, numbers), self._id) < 0:
            raise DeviceSilent(f"{self.name} gives no reading: {self._why()}")
        return tuple([number.value for number in numbers])

    def _status(self) -> list[int]:
        """Read the status; -1 for each value that an older library does not report."""
        status = (c_int * _ROOM)(*[-1] * _ROOM)
        if self._dhd.dhdGetStatus(byref(status), self._id) < 0:
            raise DeviceSilent(f"{self.name} does not report its state: {self._why()}")
        return list(status)

    def _set_zero(self) -> int:
        if self.jaw:
            return int(self._dhd.dhdSetForceAndGripperForce(0.0, 0.0, 0.0, 0.0, self._id))
        return int(self._dhd.dhdSetForce(0.0, 0.0, 0.0, self._id))

    def _require(self, result: int) -> None:
        if result < 0:
            why = self._why()
            self.close()
            raise HapnetError(f"the device of Force Dimension cannot be set up: {why}")

    def _count(self) -> int:
        return int(self._dhd.dhdGetDeviceCount())

    def _why(self) -> str:
        return (self._dhd.dhdErrorGetLastStr() or b"unknown error").decode(errors="replace")


def _to_hapnet(theirs: Vector) -> Vector:
    """Convert to hapnet's frame; the library's x points to the user, y to the right, z up."""
    x, y, z = theirs
    return y, -x, z


def _theirs(ours: Vector) -> Vector:
    x, y, z = ours
    return -y, x, z


def _find() -> str | None:
    return next(filter(None, map(ctypes.util.find_library, _NAMES)), None)


def _load(library: str) -> ctypes.CDLL:
    path = library or _find()
    if path is None:
        raise HapnetError(
            "the device needs libdrd or libdhd, from Force Dimension's SDK, where the system finds libraries"
        )
    try:
        loaded = ctypes.CDLL(path)
        optional = {name: types for name, types in _OPTIONAL.items() if hasattr(loaded, name)}
        for name, (result, arguments) in (_FUNCTIONS | optional).items():
            function = getattr(loaded, name)
            function.restype, function.argtypes = result, arguments
    except (OSError, AttributeError) as error:
        raise HapnetError(f"{path} is no libdhd: {error}") from None
    return loaded
