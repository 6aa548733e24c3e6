"""A gamepad or joystick as input, by the kernel's joystick interface (Documentation/input/joydev/joystick-api.rst).

The left stick is x (right) and y (away from the user), the right stick's vertical axis is z.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from glob import glob

from hapnet.devices.input_device import InputDevice, existing

_EVENT = struct.Struct("=IhBB")
"""Time in ms, value, kind, number of the button or axis."""

_AT_START = 0x80
_FULL = 32767.0
_PLACES = {0: (0, 1.0), 1: (1, -1.0), 4: (2, -1.0)}
"""The kernel's axes, and which of ours they are: its vertical ones grow downwards."""


class Gamepad(InputDevice):
    """``gamepad`` or ``gamepad:/dev/input/js0``."""

    about = "a gamepad's or joystick's sticks as input, without force"

    @classmethod
    def found(cls) -> Sequence[str]:
        return existing(sorted(glob("/dev/input/js*")))

    def take(self, data: bytes) -> int:
        whole = len(data) // _EVENT.size * _EVENT.size
        for _, value, kind, number in _EVENT.iter_unpack(data[:whole]):
            match kind & ~_AT_START:
                case 0x01:  # a button
                    self.pressed[number] = bool(value)
                case 0x02 if number in _PLACES:
                    place, sign = _PLACES[number]
                    self.deflections[place] = sign * max(-1.0, value / _FULL)
        return whole
