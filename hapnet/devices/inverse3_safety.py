"""What the Inverse Service tells about an arm's safety, on its event socket: the emergency brake and stalled motors."""

from __future__ import annotations

import time
from contextlib import suppress

from hapnet.devices import inverse3_messages as wire
from hapnet.devices.websocket import Caller
from hapnet.errors import DeviceSilent

STALL_S = 1.0
"""The service tells when a motor stalls, but not when that is over."""


class SafetyEvents:
    """The events of the service at `host`; `port` 0: they are not listened to."""

    def __init__(self, host: str, port: int) -> None:
        self.caller: Caller | None = Caller(host, port) if port else None
        self._brake = ""
        self._stalled_until_s = 0.0

    @property
    def are_heard(self) -> bool:
        """Is the socket open, or none wanted?"""
        return self.caller is None or self.caller.is_open

    def hear(self, device: str) -> None:
        """Take what has come about the arm `device`, without waiting."""
        if self.caller is None:
            return
        with suppress(DeviceSilent):
            for raw in self.caller.receive(0.0):
                if (found := wire.notice(raw)) is None or found.device not in ("", device):
                    continue
                if found.what == "ebrake_triggered":
                    self._brake = "its emergency brake is on"
                elif found.what == "ebrake_released":
                    self._brake = ""
                elif found.what == "stall_detected":
                    self._stalled_until_s = time.monotonic() + STALL_S

    def braked(self) -> str:
        """Why there should be no force now; empty: there may be one."""
        if not self.are_heard:
            return "its events, which tell of the brake, cannot be heard"
        if not self._brake and self._stalled_until_s > time.monotonic():
            return "a motor has stalled"
        return self._brake

    def close(self) -> None:
        """Close the socket."""
        if self.caller is not None:
            self.caller.close()
