"""Safety events of an arm, and of devices that connect and disconnect, from the Inverse Service's event socket."""

from __future__ import annotations

import time
from contextlib import suppress

from hapnet.errors import DeviceSilent
from hapnet.ext.devices import inverse3_messages as wire
from hapnet.ext.devices.websocket import Caller

STALL_S = 1.0
"""The time without force after a motor stall or the stability ceiling [s], as their end is not reported."""

_PAUSES = {"stall_detected": "a motor has stalled", "stability_ceiling": "its stability ceiling is reached"}
_HIGH = ("warning", "error", "critical", "panic")


class SafetyEvents:
    """The events of the service at `host`; `port` 0: do without them."""

    def __init__(self, host: str, port: int) -> None:
        self.caller: Caller | None = Caller(host, port) if port else None
        self._brake = self._stage = ""
        self._pause, self._until_s = "", 0.0
        self.away: set[str] = set()
        """The ids of the devices that sleep, or are disconnected."""

    @property
    def are_heard(self) -> bool:
        """Whether the socket is open, or not required."""
        return self.caller is None or self.caller.is_open

    def hear(self, device: str) -> None:
        """Process new events of the arm `device` and of grips, without waiting."""
        if self.caller is None:
            return
        with suppress(DeviceSilent):
            for raw in self.caller.receive(0.0):
                if (found := wire.notice(raw)) is not None:
                    self._handle_event(found, device)

    def _handle_event(self, found: wire.ForceEvent, device: str) -> None:
        if found.what in ("device-sleep", "device-disconnected") and found.device:
            self.away.add(found.device)
        elif found.what == "device-connected":
            self.away.discard(found.device)
        if found.device not in ("", device):
            return
        if found.what == "ebrake_triggered":
            self._brake = "its emergency brake is on"
        elif found.what == "ebrake_released":
            self._brake = ""
        elif found.what == "fod_stage_changed":
            self._stage = "its service reports a high risk (FOD stage)" if found.level in _HIGH else ""
        elif found.what in _PAUSES:
            self._pause, self._until_s = _PAUSES[found.what], time.monotonic() + STALL_S

    def braked(self, device: str = "") -> str:
        """The reason against a force of the arm `device` now; empty: a force is allowed."""
        if not self.are_heard:
            return "the event socket, which reports its brake, is not connected"
        if device in self.away:
            return "it is disconnected"
        if why := self._brake or self._stage:
            return why
        return self._pause if self._until_s > time.monotonic() else ""

    def close(self) -> None:
        """Close the socket."""
        if self.caller is not None:
            self.caller.close()
