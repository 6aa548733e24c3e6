"""Haply's Inverse3, through the Inverse Service on this machine or another. Its page is inverse3.md.

The service answers each message with one state. So a tick sends one message, the force; its answer, with the position
at which that force began to act, is the next tick's reading. By then it has usually arrived, so there is no wait.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import closing
from importlib.util import find_spec
from operator import sub
from typing import TYPE_CHECKING

from hapnet.checks import Vector, one_of
from hapnet.devices.driver import Axes, Driver
from hapnet.errors import DeviceSilent, HapnetError, InvalidParameter, MissingLibrary
from hapnet.ext.devices import inverse3_messages as wire
from hapnet.ext.devices.inverse3_session import AUTO, NO_FORCE, ArmSession, ForcesUnderway
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
_START_S = 2.0
_FIND_S = 0.2
_PRESETS = ("arm_front_centered", "led_front_centered", "arm_front", "led_front", "defaults")


class Inverse3(Driver):
    """An Inverse3 (or Inverse3x, Minverse) at the service's address: ``inverse3:localhost:10001,axes=xz``.

    address : host and port of the service. device : the arm's id; empty: the only one. axes : as in `Axes`. preset : of
    the arm, which sets its origin. spelling : the force's name in a command, ``vector`` or ``values``; auto: by the
    service's inventory. events : port of the event socket; 0: do without it, and without the brake's state.
    watchdog_ms : the measured time without a command after which the arm ends its force; 0: not measured.

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
        spelling: str = AUTO,
        events: int = 10020,
        watchdog_ms: float = 0.0,
    ) -> None:
        host, port = _host_and_port(address)
        if not 0 <= events < 65536:
            raise InvalidParameter("events", events, "a port, or 0 to do without")
        one_of("preset", preset, _PRESETS)
        one_of("spelling", spelling, (AUTO, *wire.SPELLINGS))
        if self.missing():
            raise MissingLibrary("the Inverse3", "websockets", "haply")
        from hapnet.ext.devices.inverse3_safety import SafetyEvents
        from hapnet.ext.devices.websocket import Caller

        self.dof = dof
        self._axes = Axes(axes, dof)
        self.workspace: float = 0.35 if preset.endswith("_centered") else 0.7
        self.watchdog_s: float | None = watchdog_ms * 1e-3 or None
        self._session = ArmSession(Caller(host, port), device, preset, spelling)
        self._safety = SafetyEvents(host, events)
        self._forces = ForcesUnderway()
        self._unfelt = 0
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
        device, preset, frame = self._session.device, self._session.preset, self._session.frame
        if frame != preset:
            found = "reports no preset" if frame is None else f"has it at {frame}"
            raise HapnetError(
                f"the service did not put the arm {device} at {preset}: it {found}; a service before 3.5"
                f" has only preset={wire.NO_FRAME}"
            )
        if not self._last.powered:
            raise HapnetError(f"the arm {device} has no power: plug its power supply in")
        if not self._last.calibrated:
            raise HapnetError(f"the arm {device} is not calibrated: calibrate it first, as on its maker's page")

    def read(self) -> tuple[Vector, Vector]:
        """The state in the answer to the last command, as old as that command.

        Raises DeviceSilent: no state within `PATIENCE_S`, or the service is not connected.
        """
        session, service = self._session, self._session.service
        self._safety.hear(session.device)
        until_s = time.monotonic() + PATIENCE_S
        self._check_for_new_session()
        if service.is_open and session.device and not self._forces.unanswered:
            self._send(NO_FORCE if self.braked() else self._forces.acting)  # otherwise no state would come
        newest = None
        while newest is None:
            if (left_s := until_s - time.monotonic()) <= 0.0:
                raise DeviceSilent(f"no state from {service.url} for {PATIENCE_S * 1e3:g} ms")
            came = service.receive(left_s)
            self._check_for_new_session()
            for raw in came:
                newest = self._take(raw) or newest
            if newest is None and session.device and not self._forces.unanswered:
                raise DeviceSilent(f"a message from {service.url} has no state of the arm {session.device}")
        now_s = time.monotonic()
        self._acted = self._mean_force(newest, now_s - self._last_s)
        self._last, self._last_s = newest, now_s
        self._check_service_force(newest)
        self._forces.restart()
        return self._axes.take(newest.position), self._axes.take(newest.velocity)

    def apply(self, force: Vector) -> None:
        """Send the force. The service does not report the force that the arm really makes."""
        url = self._session.service.url
        if not self._session.device:
            raise DeviceSilent(f"the session at {url} has not begun")
        whole = NO_FORCE if self.braked() else self._axes.spread(force)
        if self._forces.are_many:
            if any(whole) or any(self._forces.unanswered[-1]):
                raise DeviceSilent(f"{url} has not answered the last {len(self._forces.unanswered)} commands")
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
        return self._safety.braked(self._session.device)

    def close(self) -> None:
        self._session.service.close()
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
        """Begin anew after a lost connection."""
        if self._session.restart_if_lost():
            self._forces.lose_answers()

    def _take(self, raw: bytes) -> wire.Inverse3State | None:
        """The state in a message, if it counts as a reading."""
        message, session = wire.parsed(raw), self._session
        if not session.device:
            self._greet(message)
            return None
        self._forces.answered()
        if session.settles:
            session.settle(message, first=self._last is None)
            self._forces.sent(NO_FORCE)
            return None
        found = None if message is None else wire.state(message, session.device)
        self.damaged += found is None
        return found

    def _greet(self, message: dict[str, object] | None) -> None:
        """Answer a session's first message, which lists the arms."""
        arms = [] if message is None else wire.arms(message)
        self.damaged += not arms
        self._session.choose(arms, message, first=self._last is None)
        if self._session.kind == "minverse":
            self.workspace = MINVERSE_REACH_M
        self._forces.release()
        self._session.greet()

    def _check_service_force(self, newest: wire.Inverse3State) -> None:
        """Check that the service takes the forces, by the force that it reports.

        Raises HapnetError: it reported zero for `_UNFELT` readings with a force.
        """
        if newest.force is None or not any(self._forces.acting):
            return
        self._unfelt = 0 if any(newest.force) else self._unfelt + 1
        if self._unfelt >= _UNFELT and not self.braked():
            raise HapnetError(
                f"the service accepts no force for the arm {self._session.device}: its current_cursor_force stayed 0"
                f" while {self._session.spelling} were sent (spelling=..., or another client holds the arm)"
            )

    def _send(self, force: Vector) -> None:
        self._session.send(force)
        self._forces.sent(force)

    def _mean_force(self, newest: wire.Inverse3State, elapsed_s: float) -> Vector | None:
        """The force that acted between the last two readings; of several candidates, that which gave out most energy.

        None: not known.
        """
        if self._last is None or elapsed_s > UNKNOWN_S:
            return None if self._last is not None else (0.0,) * self.dof
        moved = tuple(map(sub, newest.position, self._last.position))
        may_have_ended = elapsed_s > SURE_S or bool(self.braked())
        return self._axes.take(self._forces.worst(moved, may_have_ended=may_have_ended))


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
