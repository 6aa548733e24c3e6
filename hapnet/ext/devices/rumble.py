"""A gamepad's two motors, by the kernel's force feedback (Documentation/input/ff.rst, include/uapi/linux/input.h).

The motors turn eccentric weights: they have a strength, and no waveform. So the hand feels the size of a vibration.
"""

from __future__ import annotations

import math
import os
import struct
import sys
import time
from collections.abc import Callable
from glob import glob
from typing import Any

from hapnet.checks import Vector

if sys.platform == "win32":  # has no such files
    ioctl: Any = None
else:
    from fcntl import ioctl

EVERY_S = 0.02
"""The shortest time between two commands [s]; the motors take longer to change their speed."""

FULL_N = 0.05
"""The amplitude of a vibration for the motors' full strength [N]."""

_EFFECT = struct.Struct("@HhHHHHHxxHH28x")
"""struct ff_effect of 64 bits: type, id, direction, trigger (2), replay: length [ms] and delay; strong and weak."""

_EVENT = struct.Struct("@llHHi")
_UPLOAD = 1 << 30 | _EFFECT.size << 16 | ord("E") << 8 | 0x80
"""EVIOCSFF, _IOW('E', 0x80, struct ff_effect)."""

_FF, _RUMBLE, _NEW = 0x15, 0x50, -1
_LENGTH_MS = 500
"""The time for which they turn without a new command [ms]."""


class Rumble:
    """The motors of a joystick.

    file : its event file, opened for writing; None: there is none, or it may not be written, and the motors stay off.
    control : ioctl; clock : [s].
    """

    def __init__(
        self, file: int | None, control: Callable[..., Any] = ioctl, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._file, self._control, self._clock = file, control, clock
        self._number, self._strength = _NEW, 0.0
        self._squares, self._count, self._next_s = 0.0, 0, 0.0

    @classmethod
    def of(cls, joystick: str) -> Rumble:
        """The motors of the joystick at a path such as /dev/input/js0."""
        for event in glob(f"/sys/class/input/{os.path.basename(joystick)}/device/event*"):
            try:
                return cls(os.open(f"/dev/input/{os.path.basename(event)}", os.O_RDWR))
            except OSError:
                pass
        return cls(None)

    def vibrate(self, force: Vector) -> None:
        """Set the strength by the largest force [N] since the last command."""
        if self._file is None:
            return
        self._squares, self._count = self._squares + math.hypot(*force) ** 2, self._count + 1
        if (now_s := self._clock()) < self._next_s:
            return
        strength = min(1.0, math.sqrt(2.0 * self._squares / self._count) / FULL_N)
        self._squares, self._count, self._next_s = 0.0, 0, now_s + EVERY_S
        if strength or self._strength:
            self._turn(strength)

    def close(self) -> None:
        """Stop the motors."""
        if self._file is not None:
            self._turn(0.0)
        if self._file is not None:
            os.close(self._file)
            self._file = None

    def _turn(self, strength: float) -> None:
        assert self._file is not None
        size = round(65535 * strength)
        effect = bytearray(_EFFECT.pack(_RUMBLE, self._number, 0, 0, 0, _LENGTH_MS, 0, size // 2, size))
        try:
            self._control(self._file, _UPLOAD, effect)
            self._number = _EFFECT.unpack(effect)[1]  # the kernel numbers a new one
            os.write(self._file, _EVENT.pack(0, 0, _FF, self._number, 1))
        except OSError:  # it has no motors, or is unplugged
            os.close(self._file)
            self._file = None
        self._strength = strength
