"""A gamepad or joystick as input, by the kernel's joystick interface (Documentation/input/joydev/joystick-api.rst).

The left stick is x (right) and y (away from the user), the right stick's vertical axis is z. Its motors render the
grain of surfaces, if its event file may be written (`rumble.py`).
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from glob import glob

from hapnet.checks import Vector
from hapnet.errors import InvalidParameter
from hapnet.ext.devices.input_device import InputDevice, existing
from hapnet.ext.devices.rumble import Rumble

_EVENT = struct.Struct("=IhBB")
"""An event: time in ms, value, kind, number of the button or axis."""

_AT_START = 0x80
_FULL = 32767.0
_SIGNS = 1.0, -1.0, -1.0
"""Signs of the sticks for x, y and z, as the kernel's vertical axes grow downwards."""


class Gamepad(InputDevice):
    """``gamepad`` or ``gamepad:/dev/input/js0,sticks=0/1/5``.

    sticks : the kernel's numbers of the axes for x, y and z, joined by /; pads differ in those of the right stick
    (`jstest` of the package joystick shows them). jaw : the number of a trigger's axis, which closes a jaw that is open
    by `reach` where it is released; 0: none. Other options as for `InputDevice`.
    """

    about = "a gamepad's or joystick's sticks as input, without force; its motors vibrate over a grain"

    def __init__(
        self,
        dof: int,
        path: str = "",
        axes: str = "",
        reach: float = 0.04,
        dead: float = 0.05,
        rate: float = 0.0,
        sticks: str = "0/1/4",
        jaw: int = 0,
    ) -> None:
        numbers = sticks.split("/")
        if len(numbers) != 3 or len(set(numbers)) != 3 or not all(number.isdecimal() for number in numbers):
            raise InvalidParameter("sticks", sticks, "three different numbers of axes for x, y and z, such as 0/1/4")
        self._places = {int(number): place for place, number in enumerate(numbers)}
        if jaw < 0 or (jaw and jaw in self._places):
            raise InvalidParameter("jaw", jaw, f"a trigger's axis, none of the sticks {sticks}; 0: no jaw")
        self._trigger, self._pressed, self.jaw = jaw, 0.0, jaw > 0
        super().__init__(dof, path, axes, reach, dead, rate)
        self.rumble: Rumble = Rumble.of(self._path)

    def jaws(self) -> Vector:
        return (self.reach * (1.0 - self.beyond_dead_zone(self._pressed)),) if self.jaw else ()

    def vibrate(self, force: Vector) -> None:
        self.rumble.vibrate(force)

    def close(self) -> None:
        self.rumble.close()
        super().close()

    @classmethod
    def found(cls) -> Sequence[str]:
        return existing(sorted(glob("/dev/input/js*")))

    def take(self, data: bytes) -> int:
        whole = len(data) // _EVENT.size * _EVENT.size
        for _, value, kind, number in _EVENT.iter_unpack(data[:whole]):
            match kind & ~_AT_START:
                case 0x01:  # a button
                    self.pressed[number] = bool(value)
                case 0x02 if number in self._places:
                    place = self._places[number]
                    self.deflections[place] = _SIGNS[place] * max(-1.0, value / _FULL)
                case 0x02 if self.jaw and number == self._trigger:
                    self._pressed = max(0.0, (value / _FULL + 1.0) / 2.0)
        return whole
