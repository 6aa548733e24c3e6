"""The HD library of OpenHaptics (`libHD.so`, `hd.dll`), by its public headers hd*.h 3.0 and 3.3.

Errors come on one stack for all threads, the newest first: `OpenHaptics.errors` empties it.
"""

from __future__ import annotations

import ctypes
import ctypes.util
from collections.abc import Callable, Iterator
from ctypes import POINTER, c_char_p, c_double, c_int, c_ubyte, c_uint, c_ulong, c_ushort, c_void_p
from typing import Any, NamedTuple

from hapnet.errors import HapnetError

NO_DEVICE = 0xFFFFFFFF
BUTTONS, POSITION, VELOCITY, TRANSFORM = 0x2000, 0x2050, 0x2051, 0x2052
MODEL, MAX_WORKSPACE, STYLES = 0x2501, 0x2550, 0x2555
MAX_STIFFNESS, MAX_FORCE, CONTINUOUS_FORCE, TEMPERATURE = 0x2602, 0x2603, 0x2604, 0x2605
FORCE, FORCE_OUTPUT = 0x2700, 0x4000
CALIBRATED, NEEDS_UPDATE, NEEDS_INPUT = 0x5000, 0x5001, 0x5002
ENCODER_RESET, AUTO, INKWELL = 1, 2, 4
DONE, CONTINUE = 0, 1
HIGHEST_PRIORITY, DEFAULT_PRIORITY = 65_535, 32_767

SUCCESS = 0
WARM_MOTORS = 0x0200
FORCE_ENDED = {0x0201: "its force was too large", 0x0202: "its force jumped", 0x0203: "it went faster than its limit"}
"""Errors after which the device's amplifiers go off, and come back by a ramp."""
LOST = {
    0x0300: "HD_DEVICE_FAULT",
    0x0302: "HD_COMM_ERROR: is it connected?",
    0x0303: "HD_COMM_CONFIG_ERROR",
    0x0304: "HD_TIMER_ERROR",
}
"""Errors during which there is no reading."""
_NAMES = {
    0x0100: "HD_INVALID_ENUM", 0x0101: "HD_INVALID_VALUE", 0x0102: "HD_INVALID_OPERATION",
    0x0103: "HD_INVALID_INPUT_TYPE", 0x0104: "HD_BAD_HANDLE", 0x0200: "HD_WARM_MOTORS", 0x0204: "HD_FORCE_ERROR",
    0x0300: "HD_DEVICE_FAULT: no such device, or it is not connected",
    0x0301: "HD_DEVICE_ALREADY_INITIATED: another program uses it", 0x0400: "HD_ILLEGAL_BEGIN",
    0x0401: "HD_ILLEGAL_END", 0x0402: "HD_FRAME_ERROR", 0x0500: "HD_INVALID_PRIORITY", 0x0501: "HD_SCHEDULER_FULL",
    0x0600: "HD_INVALID_LICENSE: its maker's licence is missing",
}  # fmt: skip

_MOST_ERRORS = 100
_WINDOWS_CALLBACK: Any = getattr(ctypes, "WINFUNCTYPE", ctypes.CFUNCTYPE)
CALLBACK = _WINDOWS_CALLBACK(c_uint, c_void_p)


class ErrorInfo(ctypes.Structure):
    """The result of hdGetError, by value."""

    _fields_ = [("code", c_uint), ("internal", c_int), ("device", c_uint)]


class Failure(NamedTuple):
    """An error from the library's stack."""

    code: int
    internal: int

    def __str__(self) -> str:
        known = FORCE_ENDED | LOST | _NAMES
        return f"{known.get(self.code, 'unknown error')} (0x{self.code:04X}, internal {self.internal})"


_FUNCTIONS: dict[str, tuple[Any, list[Any]]] = {
    "hdBeginFrame": (None, [c_uint]),
    "hdCheckCalibration": (c_uint, []),
    "hdDisable": (None, [c_uint]),
    "hdDisableDevice": (None, [c_uint]),
    "hdEnable": (None, [c_uint]),
    "hdEndFrame": (None, [c_uint]),
    "hdGetDoublev": (None, [c_uint, POINTER(c_double)]),
    "hdGetError": (ErrorInfo, []),
    "hdGetIntegerv": (None, [c_uint, POINTER(c_int)]),
    "hdGetString": (c_char_p, [c_uint]),
    "hdInitDevice": (c_uint, [c_char_p]),
    "hdIsEnabled": (c_ubyte, [c_uint]),
    "hdScheduleAsynchronous": (c_ulong, [CALLBACK, c_void_p, c_ushort]),
    "hdScheduleSynchronous": (None, [CALLBACK, c_void_p, c_ushort]),
    "hdSetDoublev": (None, [c_uint, POINTER(c_double)]),
    "hdStartScheduler": (None, []),
    "hdStopScheduler": (None, []),
    "hdUnschedule": (None, [c_ulong]),
    "hdUpdateCalibration": (None, [c_uint]),
}


class Calls:
    """The library's functions, as `c`, and combinations of them."""

    def __init__(self, library: Any) -> None:
        for name, (result, arguments) in _FUNCTIONS.items():
            function = getattr(library, name)
            function.restype, function.argtypes = result, arguments
        self.c: Any = library

    def errors(self) -> Iterator[Failure]:
        """All errors since the last call, the newest first."""
        for _ in range(_MOST_ERRORS):
            info = self.c.hdGetError()
            if info.code == SUCCESS:
                return
            yield Failure(info.code, info.internal)

    def doubles(self, name: int, count: int) -> list[float]:
        """The `count` numbers of the parameter `name`; 0 if the device lacks it."""
        values = (c_double * count)()
        self.c.hdGetDoublev(name, values)
        return list(values)

    def integer(self, name: int) -> int:
        """The parameter `name`; 0 if the device lacks it."""
        value = c_int()
        self.c.hdGetIntegerv(name, ctypes.byref(value))
        return value.value


class OpenHaptics:
    """The library at `path`; empty: where the system finds it.

    Attributes
    ----------
    slow : calls that may wait, for the device or for a lock that the scheduler's thread holds while it waits for the
        interpreter. Other threads of Python run meanwhile.
    quick : calls in the scheduler's own thread that only copy. Releasing the interpreter for each would cost more, up
        to 0.1 ms beside a busy thread.

    Raises HapnetError: there is no library, or a different one.
    """

    def __init__(self, path: str = "") -> None:
        found = path or find()
        if not found:
            raise HapnetError(f"the device needs {NEEDED}")
        loader: Any = getattr(ctypes, "WinDLL", ctypes.CDLL)
        try:
            self.slow, self.quick = Calls(loader(found)), Calls(ctypes.PyDLL(found))
        except (OSError, AttributeError) as error:
            raise HapnetError(f"{found} cannot be loaded as OpenHaptics' libHD: {error}") from None

    def in_scheduler(self, work: Callable[[], None]) -> None:
        """Do `work` once in the scheduler's thread, which must run, and wait for it."""

        def once(_: object) -> int:
            work()
            return DONE

        self.slow.c.hdScheduleSynchronous(CALLBACK(once), None, DEFAULT_PRIORITY)


NEEDED = "OpenHaptics (libHD) and the device's driver, both from 3D Systems, where the system finds libraries"


def find() -> str:
    """The library's name on this system; empty: not installed."""
    return next(filter(None, map(ctypes.util.find_library, ("HD", "hd"))), "")
