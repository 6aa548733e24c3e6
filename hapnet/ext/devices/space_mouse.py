"""A 3D mouse (SpaceMouse, SpaceNavigator) as input, by the reports in its HID descriptor.

Report 1 has three 16-bit numbers of the translation, within +-350: to the right, towards the user, down. Newer mice
add the rotation about these axes in the same report, older ones send it as report 2. Report 3 has the buttons as bits.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from pathlib import Path

from hapnet.checks import Vector
from hapnet.errors import InvalidParameter
from hapnet.ext.devices.input_device import InputDevice, existing, follow
from hapnet.mechanics.pose import of_rotation_vector

_FULL = 350.0
_VENDORS = ("0000256F", "0000046D")
"""The vendor IDs of 3Dconnexion, and of Logitech for older mice."""

_LOGITECH_MICE = ("C603", "C605", "C606", "C621", "C623", "C625", "C626", "C627", "C628", "C629", "C62B")


class SpaceMouse(InputDevice):
    """``3dmouse`` or ``3dmouse:/dev/hidraw2,rate=1``; its file must be readable for the user (a udev rule).

    turn : how far it turns at full deflection [rad]; with a `rate`, at full deflection `rate` times as fast [rad/s].
    Other options as for `InputDevice`.
    """

    about = "a 3D mouse's translation and rotation as input, without force"
    udev = 'KERNEL=="hidraw*", ATTRS{idVendor}=="256f|046d", TAG+="uaccess"'

    def __init__(
        self,
        dof: int,
        path: str = "",
        axes: str = "",
        reach: float = 0.04,
        dead: float = 0.05,
        rate: float = 0.0,
        turn: float = 0.5,
    ) -> None:
        if not 0.0 <= turn <= math.pi:
            raise InvalidParameter("turn", turn, "0 to 3.14159 rad")
        self._turn = turn
        self.turns: list[float] = [0.0] * 3
        """The deflections about x, y, z, each -1 to 1."""
        self._turned: Vector = (0.0,) * 3
        self._orientation: Vector = (1.0, 0.0, 0.0, 0.0)
        super().__init__(dof, path, axes, reach, dead, rate)

    def move(self, dt: float) -> None:
        super().move(dt)
        goal = [self._turn * self.beyond_dead_zone(d) for d in self.turns]
        if self.rate:
            self._turned = follow(self._turned, [self.rate * g for g in goal], dt)
            turned = _product(of_rotation_vector([w * dt for w in self._turned]), self._orientation)
            length = math.hypot(*turned)
            self._orientation = tuple([part / length for part in turned])
        else:
            self._turned = follow(self._turned, goal, dt)
            self._orientation = of_rotation_vector(self._turned)

    def orientation(self) -> Vector:
        return self._orientation

    def _open(self) -> None:
        super()._open()
        self.turns = [0.0] * 3

    @classmethod
    def found(cls) -> Sequence[str]:
        return existing([f"/dev/{path.name}" for path in sorted(Path("/sys/class/hidraw").glob("*")) if _is_ours(path)])

    def take(self, data: bytes) -> int:
        """Process one complete report, as the kernel returns one at a time."""
        match data[:1]:
            case b"\x01" if len(data) >= 7:
                self.deflections: list[float] = _deflections(data, 1)
                if len(data) >= 13:
                    self.turns = _deflections(data, 7)
            case b"\x02" if len(data) >= 7:
                self.turns = _deflections(data, 1)
            case b"\x03" if len(data) >= 2:
                bits = int.from_bytes(data[1:5], "little")
                for number in range(max(bits.bit_length(), *(n + 1 for n in self.pressed), 2)):
                    self.pressed[number] = bool(bits >> number & 1)
        return len(data)


def _product(a: Vector, b: Vector) -> Vector:
    """The quaternion of the rotation b, followed by a."""
    w, x, y, z = a
    s, i, j, k = b
    return (
        w * s - x * i - y * j - z * k, w * i + x * s + y * k - z * j,
        w * j - x * k + y * s + z * i, w * k + x * j - y * i + z * s,
    )  # fmt: skip


def _deflections(data: bytes, at: int) -> list[float]:
    """Three numbers of a report, along or about hapnet's axes: to the right, away from the user, up."""
    right, near, down = struct.unpack_from("<3h", data, at)
    return [max(-1.0, min(1.0, v / _FULL)) for v in (right, -near, -down)]


def _is_ours(device: Path) -> bool:
    """Whether the kernel's description of this HID device names a 3D mouse."""
    try:
        description = (device / "device" / "uevent").read_text("ascii", "replace")
    except OSError:
        return False
    for line in description.splitlines():
        if line.startswith("HID_ID="):
            _, vendor, product = line.removeprefix("HID_ID=").upper().split(":")
            return vendor == _VENDORS[0] or (vendor == _VENDORS[1] and product[-4:] in _LOGITECH_MICE)
    return False
