"""The state of a real device's side from tick to tick: silences, the force that it may hold, and the last reports."""

from __future__ import annotations

import math
from collections.abc import Sequence

from hapnet.checks import Vector
from hapnet.errors import DeviceSilent, HapnetError
from hapnet.recording.samples import Event
from hapnet.records.vectors import inner
from hapnet.side.device import Write
from hapnet.side.endpoint import NANO, DeviceControl
from hapnet.side.notices import signal_text
from hapnet.side.real_device_protocol import RealDevice

FIRST_READING_S = 10.0
"""A device that gives no reading for this time after its start has failed [s]; a later silence may last longer."""

_TURNED_EVERY_NS = 10_000_000


class DeviceSilence:
    """Missed readings and commands of the device `name`; without a reading for longer than `patience_ns` it is silent.

    Attributes
    ----------
    missed : the number of missed readings and commands. count, total_ns : the number of silences, and their duration.
    lasts : whether the device is silent now. heard_ns : the time of the last reading; None: there was none.
    """

    def __init__(self, name: str, patience_ns: int) -> None:
        self._name, self._patience_ns = name, patience_ns
        self.missed = self.count = self.total_ns = 0
        self.lasts = False
        self.heard_ns: int | None = None
        self._first_try_ns: int | None = None

    def miss(self, now_ns: int, error: DeviceSilent, *, starts: bool = False) -> Event | None:
        """Count a missed reading or command; returns the event if a silence begins with it.

        starts : a peer has come, and control has not begun.

        Raises HapnetError: the device has given no reading for `FIRST_READING_S` since its start, or while it `starts`.
        """
        self.missed += 1
        if self.heard_ns is None:
            self._first_try_ns = now_ns if self._first_try_ns is None else self._first_try_ns
            if now_ns - self._first_try_ns > FIRST_READING_S / NANO:
                text = f"the device {self._name} failed: no reading within {FIRST_READING_S:g} s: {error}"
                raise HapnetError(text)
        elif starts and now_ns - self.heard_ns > FIRST_READING_S / NANO:
            text = f"no reading for {FIRST_READING_S:g} s, and the force had not begun: {error}"
            raise HapnetError(f"the device {self._name} failed: {text}")
        elif now_ns - self.heard_ns <= self._patience_ns:
            return None  # the reserve covers the force that is held meanwhile
        if self.lasts:
            return None
        self.lasts = True
        self.count += 1
        return Event(now_ns, "device", f"the device {self._name} is silent, no force: {error}", "warning")

    def hear(self, now_ns: int) -> Event | None:
        """Note a reading; returns the event if a silence ends with it."""
        lasted_ns = 0 if self.heard_ns is None else now_ns - self.heard_ns
        self.heard_ns = now_ns
        if not self.lasts:
            return None
        self.lasts = False
        self.total_ns += lasted_ns
        text = f"the device {self._name} is back after {lasted_ns * 1e-6:.1f} ms: the force grows"
        return Event(now_ns, "device", text)


class ActuatorForce:
    """The force that the actuators may hold.

    Attributes
    ----------
    sent : the newest command [N]. before : a command that may still be held, since a later one failed; None: there is
    none. is_reported : whether the device has reported a force that acted. risk_J : the most energy that a force may
    have put out beyond what was in store.
    """

    def __init__(self, dof: int) -> None:
        self.sent: Vector = (0.0,) * dof
        self.before: Vector | None = None
        self.is_reported = False
        self.risk_J = 0.0

    def doubt(self) -> None:
        """Note that the newest command may still be held when the next one has been sent."""
        self.before = self.sent

    def worst(self, possible: Sequence[Vector], moved: Vector, most_m: float, stored_J: float) -> Vector:
        """Return the possible force that counts while the device `moved` [m].

        Energy that the force may have put out counts, for as long as the force can have been held; energy that it may
        have taken in does not count. most_m : as far as the device can go meanwhile. stored_J : covers that energy.
        """
        self.risk_J = max(self.risk_J, max(math.hypot(*force) for force in possible) * most_m - stored_J)
        share = min(1.0, most_m / far) if (far := math.hypot(*moved)) else 0.0
        put_out = [share * inner(force, moved) for force in possible]
        worst = max(range(len(possible)), key=put_out.__getitem__)
        return tuple([share * f if put_out[worst] > 0.0 else 0.0 for f in possible[worst]])


class Changes:
    """The last values of things of which only a change is reported. first : their values before the first report."""

    def __init__(self, **first: object) -> None:
        self._last = first

    def see(self, name: str, value: object) -> bool:
        """Take a value; returns whether it has changed."""
        changed = value != self._last[name]
        self._last[name] = value
        return changed


class HandleReports:
    """The handle's buttons, which the world hears of when they change, and its orientation, at most every 10 ms."""

    def __init__(self) -> None:
        self.buttons: tuple[bool, ...] = ()
        self._turned_ns = 0

    def send(self, now_ns: int, device: RealDevice, endpoint: DeviceControl, write: Write) -> None:
        """Send the world what is due."""
        buttons = tuple(device.buttons())
        if buttons != self.buttons:
            self.buttons = buttons
            endpoint.report("buttons", buttons)
            write(Event(now_ns, "signal", signal_text("buttons", buttons)))
        if now_ns - self._turned_ns >= _TURNED_EVERY_NS and (turned := device.orientation()) is not None:
            self._turned_ns = now_ns
            endpoint.report("orientation", turned)
