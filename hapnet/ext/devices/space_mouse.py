"""A 3D mouse (SpaceMouse, SpaceNavigator) as input, by the reports in its HID descriptor.

Report 1 has three 16-bit numbers of the translation, within +-350: to the right, towards the user, down. Newer mice
add the rotation in the same report, older ones send it as report 2; it is not used. Report 3 has the buttons as bits.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path

from hapnet.ext.devices.input_device import InputDevice, existing

_FULL = 350.0
_VENDORS = ("0000256F", "0000046D")
"""The vendor IDs of 3Dconnexion, and of Logitech for older mice."""

_LOGITECH_MICE = ("C603", "C605", "C606", "C621", "C623", "C625", "C626", "C627", "C628", "C629", "C62B")


class SpaceMouse(InputDevice):
    """``3dmouse`` or ``3dmouse:/dev/hidraw2``; its file must be readable for the user (a udev rule)."""

    about = "a 3D mouse's translation as input, without force"
    udev = 'KERNEL=="hidraw*", ATTRS{idVendor}=="256f|046d", TAG+="uaccess"'

    @classmethod
    def found(cls) -> Sequence[str]:
        return existing([f"/dev/{path.name}" for path in sorted(Path("/sys/class/hidraw").glob("*")) if _is_ours(path)])

    def take(self, data: bytes) -> int:
        """Process one complete report, as the kernel returns one at a time."""
        match data[:1]:
            case b"\x01" if len(data) >= 7:
                right, near, down = struct.unpack_from("<3h", data, 1)
                self.deflections: list[float] = [max(-1.0, min(1.0, v / _FULL)) for v in (right, -near, -down)]
            case b"\x03" if len(data) >= 2:
                bits = int.from_bytes(data[1:5], "little")
                for number in range(max(bits.bit_length(), *(n + 1 for n in self.pressed), 2)):
                    self.pressed[number] = bool(bits >> number & 1)
        return len(data)


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
