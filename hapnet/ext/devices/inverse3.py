"""Haply's Inverse3, through the Inverse Service on this machine or another. Its page is inverse3.md.

The service answers each message with one state. So a tick sends one message, the force; its answer, with the position
at which that force began to act, is the next tick's reading. By then it has usually arrived, so there is no wait.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Sequence
from contextlib import closing
from importlib.util import find_spec
from operator import mul, sub
from typing import TYPE_CHECKING

from hapnet.checks import Vector, one_of
from hapnet.devices.driver import Axes, Driver
from hapnet.errors import DeviceSilent, HapnetError, InvalidParameter, MissingLibrary
from hapnet.ext.devices import inverse3_messages as wire
from hapnet.installing import install_command

if TYPE_CHECKING:
    from hapnet.ext.devices.websocket import Caller

PATIENCE_S = 0.005
"""The longest wait of a reading [s]; the servo's watchdog, 20 ms by default, is several times longer."""

SURE_S = 0.01
"""A command is assumed to act until the next one within this time [s]; its true duration is not documented."""

UNKNOWN_S = 0.02
"""After a longer time without a reading the force that acted counts as not known [s]."""

MINVERSE_REACH_M = 0.04
"""The reach of a Minverse in both directions [m]. Its force is not documented."""

_UNFELT = 50
_ASKS = 5
"""The number of requests for the arm's preset in a session, if messages do not contain it."""
_START_S = 2.0
_FIND_S = 0.2
_MOST_UNANSWERED = 2
_NO_FORCE: Vector = (0.0, 0.0, 0.0)
_PRESETS = ("arm_front_centered", "led_front_centered", "arm_front", "led_front", "defaults")


class Inverse3(Driver):
    """An Inverse3 (or Inverse3x, Minverse) at the service's address: ``inverse3:localhost:10001,axes=xz``.

    address : host and port of the service. device : the arm's id; empty: the only one. axes : as in `Axes`. preset : of
    the arm, which sets its origin. spelling : the force's name in a command, ``vector`` or ``values``; auto: by the
    service's inventory. events : port of the event socket; 0: do without it, and without the brake's state.
    watchdog_ms : the measured time without a command after which the arm ends its force; 0: not measured.
    More than twenty attributes: nine of them are declarations of the driver.

    Raises InvalidParameter: an option is not allowed. MissingLibrary: `websockets` is not installed. HapnetError: no
    service answers, or it has no such arm.
    """

    about = "Haply Inverse3, through the Inverse Service"
    tested = "tested with an emulator"
    emulator = "hapnet.ext.devices.inverse3_emulator:Inverse3Emulator"
    rate_hz: float = 1000.0
    force_limit: float = 10.0
    continuous_force: float = 4.0
    resolution: float = 1e-5
    stiffness_range: tuple[float, float] = (1.0, 1000.0)
    knows_force = False

    def __init__(
        self,
        dof: int,
        address: str = "localhost:10001",
        device: str = "",
        axes: str = "",
        preset: str = _PRESETS[0],
        spelling: str = "auto",
        events: int = 10020,
        watchdog_ms: float = 0.0,
    ) -> None:
        host, port = _host_and_port(address)
        if not 0 <= events < 65536:
            raise InvalidParameter("events", events, "a port, or 0 to do without")
        one_of("preset", preset, _PRESETS)
        one_of("spelling", spelling, ("auto", *wire.SPELLINGS))
        if self.missing():
            raise MissingLibrary("the Inverse3", "websockets", "haply")
        from hapnet.ext.devices.inverse3_safety import SafetyEvents
        from hapnet.ext.devices.websocket import Caller

        self.dof = dof
        self._axes = Axes(axes, dof)
        self._device, self._requested_arm = "", device
        self._preset, self._spelling, self._kind = preset, spelling, ""
        self._has_spelling = spelling != "auto"
        self._frame: str | None = None
        """The arm's preset, as the service reports it; None: not known yet."""
        self._unfelt = 0
        self.workspace: float = 0.35 if preset.endswith("_centered") else 0.7
        self.watchdog_s: float | None = watchdog_ms * 1e-3 or None
        self._service = Caller(host, port)
        self._safety = SafetyEvents(host, events)
        self._calls = 0
        self._to_skip = self._requests_left = 0
        self._unanswered: deque[Vector] = deque()
        self._acting = _NO_FORCE  # since the last answer
        self._forces_since_reading: deque[Vector] = deque(maxlen=100)
        self._last: wire.Inverse3State | None = None
        self._last_s = 0.0
        self._acted: Vector | None = None
        self.damaged: int = 0
        """The number of messages without a state."""
        try:
            self._begin()
        except HapnetError:
            self.close()
            raise

    @classmethod
    def missing(cls) -> str:
        return f"websockets: {install_command('websockets')}" if find_spec("websockets") is None else ""

    @classmethod
    def found(cls) -> Sequence[str]:
        if cls.missing():
            return ()
        from hapnet.ext.devices.websocket import Caller

        service = Caller("localhost", 10001)
        with closing(service):
            return tuple(f"device={name}" for name in _inventory(service, _FIND_S))

    def home(self) -> None:
        assert self._last is not None, "it was read when it was made"
        if self._frame != self._preset:
            found = "reports no preset" if self._frame is None else f"has it at {self._frame}"
            raise HapnetError(
                f"the service did not put the arm {self._device} at {self._preset}: it {found}; a service before 3.5"
                f" has only preset={wire.NO_FRAME}"
            )
        if not self._last.powered:
            raise HapnetError(f"the arm {self._device} has no power: plug its power supply in")
        if not self._last.calibrated:
            raise HapnetError(f"the arm {self._device} is not calibrated: calibrate it first, as on its maker's page")

    def read(self) -> tuple[Vector, Vector]:
        """The state in the answer to the last command, as old as that command.

        Raises DeviceSilent: no state within `PATIENCE_S`, or the service is not connected.
        """
        self._safety.hear(self._device)
        until_s = time.monotonic() + PATIENCE_S
        self._check_for_new_session()
        if self._service.is_open and self._device and not self._unanswered:
            self._send(_NO_FORCE if self.braked() else self._acting)  # otherwise no state would come
        newest = None
        while newest is None:
            if (left_s := until_s - time.monotonic()) <= 0.0:
                raise DeviceSilent(f"no state from {self._service.url} for {PATIENCE_S * 1e3:g} ms")
            came = self._service.receive(left_s)
            self._check_for_new_session()
            for raw in came:
                newest = self._take(raw) or newest
            if newest is None and self._device and not self._unanswered:
                raise DeviceSilent(f"a message from {self._service.url} has no state of the arm {self._device}")
        now_s = time.monotonic()
        self._acted = self._mean_force(newest, now_s - self._last_s)
        self._last, self._last_s = newest, now_s
        self._check_service_force(newest)
        self._forces_since_reading.clear()
        return self._axes.take(newest.position), self._axes.take(newest.velocity)

    def apply(self, force: Vector) -> None:
        """Send the force. The service does not report the force that the arm really makes."""
        if not self._device:
            raise DeviceSilent(f"the session at {self._service.url} has not begun")
        whole = _NO_FORCE if self.braked() else self._axes.spread(force)
        if len(self._unanswered) >= _MOST_UNANSWERED:
            if any(whole) or any(self._unanswered[-1]):
                raise DeviceSilent(f"{self._service.url} has not answered the last {_MOST_UNANSWERED} commands")
            return  # a command without force is already on its way
        self._send(whole)

    def acted(self) -> Vector | None:
        return self._acted

    def buttons(self) -> tuple[bool, ...]:
        """The grip's buttons; released while the grip sleeps or is lost."""
        if self._last is None:
            return ()
        is_away = self._last.grip in self._safety.away
        return (False,) * len(self._last.buttons) if is_away else self._last.buttons

    def orientation(self) -> Vector | None:
        """The grip's orientation at the last reading: a unit quaternion (w, x, y, z); None: not known."""
        return None if self._last is None else self._last.orientation

    def braked(self) -> str:
        if self._last is not None and not self._last.powered:
            return "it has no power"
        if self._last is not None and not self._last.calibrated:
            return "it is not calibrated"
        return self._safety.braked(self._device)

    def close(self) -> None:
        self._service.close()
        self._safety.close()

    def _begin(self) -> None:
        """Read the first state. Raises HapnetError: no service answers, or it has no such arm."""
        until_s = time.monotonic() + _START_S
        while self._last is None or not self._safety.are_heard:
            try:
                self.read()
            except DeviceSilent as error:
                if time.monotonic() > until_s:
                    raise HapnetError(f"no Inverse Service: {error}") from error
                time.sleep(0.001)
            if time.monotonic() > until_s and self._last is not None and not self._safety.are_heard:
                raise HapnetError("the service's event socket does not answer: give its port, events=0 to do without")

    def _check_for_new_session(self) -> None:
        """Begin anew after a lost connection, as the service drops the client's settings."""
        if self._calls != self._service.calls:
            self._calls = self._service.calls
            self._forces_since_reading.extend(self._unanswered)  # they may have acted
            self._unanswered.clear()
            self._device = ""

    def _take(self, raw: bytes) -> wire.Inverse3State | None:
        """The state in a message, if it counts as a reading."""
        message = wire.parsed(raw)
        if not self._device:
            self._greet(message)
            return None
        if self._unanswered:
            self._forces_since_reading.append(self._acting)
            self._acting = self._unanswered.popleft()
        if self._to_skip:
            self._to_skip -= 1
            if not self._to_skip and self._requests_left and self._preset_in(message) is None:
                self._to_skip, self._requests_left = 1, self._requests_left - 1
            if self._to_skip:
                self._service.send(wire.whole(self._device, self._spelling, self._kind))
                self._unanswered.append(_NO_FORCE)
            else:
                self._learn_frame(message)
                self._send(_NO_FORCE)
            return None
        found = None if message is None else wire.state(message, self._device)
        self.damaged += found is None
        return found

    def _greet(self, message: dict[str, object] | None) -> None:
        """Answer a session's first message, which lists the arms. The arm's positions are not in hapnet's frame yet."""
        arms = [] if message is None else wire.arms(message)
        if not arms:
            self.damaged += 1
            self._service.close()
            raise DeviceSilent(f"{self._service.url} lists no arm")
        if self._requested_arm not in ("", *arms) or (not self._requested_arm and len(arms) > 1):
            if self._last is None:
                raise InvalidParameter("device", self._requested_arm, "one of the service's arms: " + ", ".join(arms))
            self._service.close()
            raise DeviceSilent(f"{self._service.url} has no arm {self._requested_arm}")
        self._device = self._requested_arm = self._requested_arm or arms[0]
        assert message is not None, "it lists arms"
        self._kind = wire.kind_of(message, self._device)
        if self._kind == "minverse":
            self.workspace = MINVERSE_REACH_M
        if not self._has_spelling:
            self._spelling = wire.spelling_of(message, self._device)
        self._to_skip, self._requests_left = 2, _ASKS
        self._forces_since_reading.append(self._acting)
        self._acting = _NO_FORCE
        self._unanswered.append(_NO_FORCE)
        self._service.send(wire.greeting(self._device, self._preset, self._spelling, self._kind))

    def _preset_in(self, message: dict[str, object] | None) -> str | None:
        found = None if message is None else wire.preset_of(message, self._device)
        return wire.NO_FRAME if found is None and self._preset == wire.NO_FRAME else found

    def _learn_frame(self, message: dict[str, object] | None) -> None:
        """Take the arm's preset from a message. Forces are rendered in the requested preset only."""
        found = self._preset_in(message)
        if self._last is not None and found != self._preset:
            raise HapnetError(
                f"the service put the arm {self._device} at {found or 'no preset'}, not at {self._preset}"
            )
        self._frame = found

    def _check_service_force(self, newest: wire.Inverse3State) -> None:
        """Check that the service takes the forces, by the force that it reports.

        Raises HapnetError: it reported zero for `_UNFELT` readings with a force.
        """
        if newest.force is None or not any(self._acting):
            return
        self._unfelt = 0 if any(newest.force) else self._unfelt + 1
        if self._unfelt >= _UNFELT and not self.braked():
            raise HapnetError(
                f"the service accepts no force for the arm {self._device}: its current_cursor_force stayed 0 while"
                f" {self._spelling} were sent (spelling=..., or another client holds the arm)"
            )

    def _send(self, force: Vector) -> None:
        self._service.send(wire.command(self._device, force, self._spelling, self._kind))
        self._unanswered.append(force)

    def _mean_force(self, newest: wire.Inverse3State, elapsed_s: float) -> Vector | None:
        """The force that acted between the last two readings; of several candidates, that which gave out most energy.

        None: not known.
        """
        if self._last is None or elapsed_s > UNKNOWN_S:
            return None if self._last is not None else (0.0,) * self.dof
        possible = list(self._forces_since_reading)
        if elapsed_s > SURE_S or self.braked():
            possible.append(_NO_FORCE)
        moved = tuple(map(sub, newest.position, self._last.position))
        worst = max(possible, key=lambda force: sum(map(mul, force, moved)), default=_NO_FORCE)
        return self._axes.take(worst)


def _inventory(service: Caller, seconds: float) -> list[str]:
    """The arms that the service lists to a new client; none if no service answers."""
    until_s = time.monotonic() + seconds
    while (left_s := until_s - time.monotonic()) > 0.0:
        try:
            for raw in service.receive(left_s):
                if (message := wire.parsed(raw)) is not None:
                    return wire.arms(message)
        except DeviceSilent:
            time.sleep(0.01)
    return []


def _host_and_port(address: str) -> tuple[str, int]:
    host, _, port = address.rpartition(":")
    if not host or not port.isdecimal() or not 0 < int(port) < 65536:
        raise InvalidParameter("address", address, "a host and a port, such as localhost:10001")
    return host.strip("[]"), int(port)
