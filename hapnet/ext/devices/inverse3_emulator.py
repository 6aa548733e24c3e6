"""An emulator of the Inverse Service with one Inverse3 and its grip, with faults on request.

Source: docs.haply.co, Inverse SDK 3.5 and 3.4: the simulation channel (inventory, one state for each message, a preset
as an object in `configure`, `force_render_full_state`), the events' names and levels. Not documented, and chosen here:
the time for which a command acts (`hold`), and that a service ignores a command with an unknown spelling.
"""

from __future__ import annotations

import json
import random
import select
import socket
import threading
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, ClassVar

from hapnet.checks import Vector, one_of
from hapnet.errors import InvalidParameter
from hapnet.ext.devices import inverse3_messages as wire
from hapnet.ext.devices.emulator import NANO, EmulatedHandle, Emulator
from hapnet.ext.devices.websocket import Gone, WebSocket, answer

DEVICE = "049D"
BASE_M = 0.1
"""The distance by which the origin of `defaults` lies behind that of `arm_front_centered` [m]."""
_STALL_NS = 500_000_000
_BRAKE_NS = 1_000_000_000
_LOOK_S = 0.05
_STEP_M = 1e-5
_NO_FORCE: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class _Faults:
    """The faults of an `Inverse3Emulator`, named as its arguments."""

    ignores: bool
    deaf: bool
    asleep: bool
    button: bool
    rubbish: float
    units: float
    latency_ns: int
    stall_ns: int
    brake_ns: int
    killed_ns: int


class Inverse3Emulator(Emulator):
    """10 N, 0.01 mm, and no force once no command has come for `hold` seconds.

    port : of the service; 0: any free port. events : port of its event socket; 0: any; -1: none. spelling : the
    only one that it accepts, ``vector`` or ``values``; both: either. hold : the time for which a command acts [s].
    latency : the delay before it handles a message [s]. stall : after this time it neither reads nor sends for 0.5 s
    [s]. brake : on for 1 s at this interval [s]. killed : it ends without notice after this time [s]. rubbish : share
    of the states that are random bytes. units : factor of its positions; 1000 is a mistake of units. button : whether
    the grip's button a is pressed. ignores : it ignores presets, so its origin is 0.1 m off. deaf : it takes no forces.
    asleep : its grip sleeps. seed : of the random numbers.
    """

    dof = 3
    force_limit: ClassVar[float] = 10.0
    watchdog_s: ClassVar[float] = 0.01

    def __init__(
        self,
        handle: EmulatedHandle,
        clock: Callable[[], int],
        port: int = 10001,
        events: int = 10020,
        spelling: str = "both",
        hold: float = 0.01,
        latency: float = 0.0,
        stall: float = 0.0,
        brake: float = 0.0,
        killed: float = 0.0,
        rubbish: float = 0.0,
        units: float = 1.0,
        button: bool = False,
        ignores: bool = False,
        deaf: bool = False,
        asleep: bool = False,
        seed: int = 0,
    ) -> None:
        super().__init__(handle, clock)
        one_of("spelling", spelling, ("both", *wire.SPELLINGS))
        self._is_old = spelling == "values"  # a service before 3.5: no presets, session numbers or reported forces
        stall_ns, brake_ns, killed_ns, latency_ns = (round(s / NANO) for s in (stall, brake, killed, latency))
        self._faults = _Faults(
            ignores=ignores or self._is_old, deaf=deaf, asleep=asleep, button=button, rubbish=rubbish, units=units,
            latency_ns=latency_ns, stall_ns=stall_ns, brake_ns=brake_ns, killed_ns=killed_ns,
        )  # fmt: skip
        self._preset = wire.NO_FRAME
        self._spellings = wire.SPELLINGS if spelling == "both" else (spelling,)
        handle.watchdog_s = hold
        self._random = random.Random(seed)
        self._service = _listen("port", port)
        self._reports = None if events < 0 else _listen("events", events)
        self.address: str = f"localhost:{self.port}"
        if self.events != 10020:
            self.address += f",events={self.events}"
        self._clients: dict[WebSocket, bool] = {}  # True once the inventory was sent
        self._listeners: list[WebSocket] = []
        self._waiting: deque[tuple[int, WebSocket, bytes]] = deque()
        self._braked = False
        self.greetings: int = 0
        """The number of sessions that were configured."""

    @property
    def port(self) -> int:
        return int(self._service.getsockname()[1])

    @property
    def events(self) -> int:
        """The port of the event socket; 0: there is none."""
        return 0 if self._reports is None else int(self._reports.getsockname()[1])

    def run(self, stop: threading.Event) -> None:
        start_ns = self._clock()
        faults = self._faults
        stalled = not faults.stall_ns
        try:
            while not stop.is_set():
                age_ns = self._clock() - start_ns
                if faults.killed_ns and age_ns >= faults.killed_ns:
                    break
                if not stalled and age_ns >= faults.stall_ns:
                    stalled = True
                    stop.wait(_STALL_NS * NANO)
                self._brake_now(bool(faults.brake_ns) and age_ns % faults.brake_ns >= faults.brake_ns - _BRAKE_NS)
                self.serve(_LOOK_S)
                self.handle.read(self._clock())
        finally:
            for one in (self._service, self._reports, *self._clients, *self._listeners):
                if one is not None:
                    one.close()

    def serve(self, seconds: float) -> None:
        """Handle the messages that have come, waiting at most `seconds`."""
        watched: list[socket.socket | WebSocket] = [self._service, *self._clients, *self._listeners]
        if self._reports is not None:
            watched.append(self._reports)
        if self._waiting:
            seconds = min(seconds, max(0.0, (self._waiting[0][0] - self._clock()) * NANO))
        for ready in select.select(watched, [], [], seconds)[0]:
            if isinstance(ready, socket.socket):
                caller = answer(ready.accept()[0])
                if ready is self._service:
                    self._clients[caller] = False
                else:
                    self._listeners.append(caller)
            else:
                self._listen_to(ready)
        while self._waiting and self._waiting[0][0] <= self._clock():
            _, client, message = self._waiting.popleft()
            self._handle(client, message)

    def announce(self, safety_type: str) -> None:
        """Send a safety event to all clients of the event socket."""
        data = {"device_family": "inverse", "device_id": DEVICE, "safety_type": safety_type}
        event = {"name": "device-safety-triggered", "category": "device", "level": "error", "data": data, "message": ""}
        for hearer in list(self._listeners):
            with suppress(Gone):
                hearer.send(json.dumps(event).encode())

    def _listen_to(self, caller: WebSocket) -> None:
        try:
            messages = caller.receive(0.0)
            if self._clients.get(caller) is False and caller.is_open:
                self._clients[caller] = True
                caller.send(json.dumps(self._message(whole=True)).encode())
        except Gone:
            caller.close()
            self._clients.pop(caller, None)
            if caller in self._listeners:
                self._listeners.remove(caller)
            return
        if caller in self._clients:
            due_ns = self._clock() + self._faults.latency_ns
            self._waiting.extend((due_ns, caller, message) for message in messages)

    def _handle(self, client: WebSocket, raw: bytes) -> None:
        """Let a message's force act, and answer with the present state."""
        message = wire.parsed(raw) or {}
        self.greetings += "configure" in message.get("session", {})
        session = message.get("session", {})
        answer = json.dumps(self._message(whole=not self._is_old and "force_render_full_state" in session)).encode()
        self._configure(message)
        if (force := self._commanded(message)) is not None and not self._faults.deaf:
            self.handle.hold(self._clock(), _NO_FORCE if self._braked else force)
        if self._random.random() < self._faults.rubbish:
            answer = bytes(self._random.randrange(32, 127) for _ in range(len(answer)))
        try:
            client.send(answer)
        except Gone:
            client.close()
            self._clients.pop(client, None)

    def _configure(self, message: dict[str, Any]) -> None:
        for entry in message.get("inverse3", ()):
            preset = entry.get("configure", {}).get("preset")
            if isinstance(preset, dict) and not self._faults.ignores:
                self._preset = str(preset.get("preset", self._preset))

    def _commanded(self, message: dict[str, Any]) -> Vector | None:
        for entry in message.get("inverse3", ()):
            forces = entry.get("commands", {}).get("set_cursor_force", {})
            for spelling in self._spellings:
                if entry.get("device_id") == DEVICE and spelling in forces:
                    return tuple([float(forces[spelling][name]) for name in "xyz"])
        return None

    def _brake_now(self, braked: bool) -> None:
        if braked != self._braked:
            self._braked = braked
            self.announce("ebrake_triggered" if braked else "ebrake_released")
            if braked:
                self.handle.hold(self._clock(), _NO_FORCE)

    def _message(self, whole: bool = False) -> dict[str, Any]:
        x, v = self.handle.read(self._clock())
        if self._preset == wire.NO_FRAME and not self._is_old:
            x = (x[0], x[1] + BASE_M, x[2])
        force = self.handle.force
        state = {
            "cursor_position": _named([self._faults.units * _STEP_M * round(p / _STEP_M) for p in x]),
            "cursor_velocity": _named([self._faults.units * p for p in v]),
            "angular_position": {"a0": 0.0, "a1": 0.0, "a2": 0.0},
            "angular_velocity": {"a0": 0.0, "a1": 0.0, "a2": 0.0},
            "body_orientation": {"w": 1.0, "x": 0.0, "y": 0.0, "z": 0.0},
            "current_cursor_force": _named(force),
            "control_domain": "cartesian",
            "control_mode": "force" if any(force) else "idle",
        }
        status = {"calibrated": True, "in_use": True, "power_supply": True, "ready": True, "started": True}
        arm: dict[str, Any] = {"device_id": DEVICE, "state": state, "status": status}
        grip = {
            "device_id": "61576",
            "state": {
                "orientation": {"w": 1.0, "x": 0.0, "y": 0.0, "z": 0.0},
                "buttons": {"a": self._faults.button, "b": False, "c": False},
                "hall": 0,
            },
            "status": {"awake": not self._faults.asleep, "connected": True, "ready": not self._faults.asleep},
        }
        if whole:
            arm["config"] = {"type": "inverse3", "handedness": "right"}
            if not self._is_old:
                arm["config"] |= {"preset": self._preset, "basis": {"permutation": "XYZ"}}
        if self._is_old:
            for part in ("current_cursor_force", "control_domain", "control_mode"):
                del state[part]
            return {"inverse3": [arm], "wireless_verse_grip": [grip]}
        return {"session_id": 7, "inverse3": [arm], "wireless_verse_grip": [grip]}


def _named(values: Any) -> dict[str, float]:
    return dict(zip("xyz", values, strict=True))


def _listen(name: str, port: int) -> socket.socket:
    try:
        return socket.create_server(("127.0.0.1", port))
    except (OSError, OverflowError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InvalidParameter(name, port, f"a port that is free ({reason})") from error
