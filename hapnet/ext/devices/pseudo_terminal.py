"""A pseudo-terminal for an emulator: its bytes come out of a port that a driver can open."""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from pathlib import Path
from random import Random

from hapnet.errors import HapnetError, InvalidParameter


class PseudoTerminal:
    """Both ends of a pseudo-terminal, and a name for the driver's end.

    link : a path that points to it, as the system's name changes. noise : share of the bytes that get lost in each
    direction, by `chance`.

    Attributes
    ----------
    device : the emulator's end, which does not block. address : the path to open.

    Raises InvalidParameter: the path cannot be made. HapnetError: Windows has no pseudo-terminals.
    """

    def __init__(self, link: str, noise: float, chance: Random) -> None:
        self._noise, self._chance = noise, chance
        self.device, self._driver, name = _terminals()
        self.address: str = link or name
        self._link = Path(link) if link else None
        if self._link is not None:
            try:
                if self._link.is_symlink():
                    self._link.unlink()
                self._link.symlink_to(name)
            except OSError as error:
                raise InvalidParameter("link", link, f"a path that can be made ({error.strerror})") from error

    def read(self) -> bytes:
        """Return the bytes that have come."""
        try:
            return self._lossy(os.read(self.device, 4096))
        except OSError:
            return b""

    def write(self, data: bytes) -> None:
        """Send bytes. If no program reads them, the excess is lost, as on a wire."""
        with suppress(OSError):
            os.write(self.device, self._lossy(data))

    def _lossy(self, data: bytes) -> bytes:
        if not self._noise:
            return data
        return bytes(byte for byte in data if self._chance.random() >= self._noise)

    def close(self) -> None:
        """Close both ends and remove the link."""
        with suppress(OSError):
            if self._link is not None:
                self._link.unlink()
        os.close(self.device)
        os.close(self._driver)


def _terminals() -> tuple[int, int, str]:
    """Both ends of a pseudo-terminal, the device's first, and the name of the driver's."""
    if sys.platform != "win32":
        import tty

        device, driver = os.openpty()
        for end in (device, driver):
            tty.setraw(end)
        os.set_blocking(device, False)
        return device, driver, os.ttyname(driver)
    else:  # noqa: RET505  # for mypy this is not unreachable
        raise HapnetError("Windows has no pseudo-terminals: emulate a port on Linux or macOS")
