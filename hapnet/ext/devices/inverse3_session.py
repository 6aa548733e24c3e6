"""A session with Haply's Inverse Service: its arm and the arm's preset, and the forces that may act meanwhile."""

from __future__ import annotations

from collections import deque
from operator import mul
from typing import TYPE_CHECKING, Any

from hapnet.checks import Vector
from hapnet.errors import DeviceSilent, HapnetError, InvalidParameter
from hapnet.ext.devices import inverse3_messages as wire

if TYPE_CHECKING:
    from hapnet.ext.devices.websocket import Caller

AUTO = "auto"
NO_FORCE: Vector = (0.0, 0.0, 0.0)

_ASKS = 5
"""The number of requests for the arm's preset in a session, if messages do not contain it."""

_MOST_UNANSWERED = 2


class ArmSession:
    """A session at the service.

    requested : the arm's id; empty: the only one. preset : of the arm, which sets its origin. spelling : the force's
    name in a command; ``auto``: by the service's inventory.

    Attributes
    ----------
    device : the arm's id; empty: the service has not listed its arms yet. kind : inverse3 or minverse. frame : the
    preset that the service reports; None: not known.
    """

    def __init__(self, service: Caller, requested: str, preset: str, spelling: str) -> None:
        self.service = service
        self.preset, self.spelling = preset, spelling
        self.device = self.kind = ""
        self.frame: str | None = None
        self._requested, self._finds_spelling = requested, spelling == AUTO
        self._calls = self._to_skip = self._requests_left = 0

    def restart_if_lost(self) -> bool:
        """Restart the session if the connection is a new one, as the service has dropped the client's settings then;
        returns whether it is."""
        if self._calls == self.service.calls:
            return False
        self._calls = self.service.calls
        self.device = ""
        return True

    def choose(self, arms: list[str], message: dict[str, Any] | None, *, first: bool) -> None:
        """Choose the arm of those that the session's first message lists. first : whether no state was read yet.

        Raises DeviceSilent: it is not among them. InvalidParameter: so at the start.
        """
        if not arms or message is None:
            self.service.close()
            raise DeviceSilent(f"{self.service.url} lists no arm")
        if self._requested not in ("", *arms) or (not self._requested and len(arms) > 1):
            if first:
                raise InvalidParameter("device", self._requested, "one of the service's arms: " + ", ".join(arms))
            self.service.close()
            raise DeviceSilent(f"{self.service.url} has no arm {self._requested}")
        self.device = self._requested = self._requested or arms[0]
        self.kind = wire.kind_of(message, self.device)
        if self._finds_spelling:
            self.spelling = wire.spelling_of(message, self.device)
        self._to_skip, self._requests_left = 2, _ASKS

    def greet(self) -> None:
        """Set the arm's preset. Its positions are not in hapnet's frame yet."""
        self.service.send(wire.greeting(self.device, self.preset, self.spelling, self.kind))

    @property
    def settles(self) -> bool:
        """Whether the next state does not count as a reading, as the preset does not act yet or is not known."""
        return self._to_skip > 0

    def settle(self, message: dict[str, Any] | None, *, first: bool) -> None:
        """Take a state that does not count, and send the next command, without force.

        Raises HapnetError: after a lost connection the preset is not the requested one; forces are rendered in that
        one only.
        """
        self._to_skip -= 1
        found = None if message is None else wire.preset_of(message, self.device)
        if found is None and self.preset == wire.NO_FRAME:
            found = wire.NO_FRAME
        if not self._to_skip and self._requests_left and found is None:
            self._to_skip, self._requests_left = 1, self._requests_left - 1
        if self._to_skip:
            self.service.send(wire.whole(self.device, self.spelling, self.kind))
            return
        if not first and found != self.preset:
            put = f"the service put the arm {self.device} at {found or 'no preset'}"
            raise HapnetError(f"{put}, not at {self.preset}")
        self.frame = found
        self.send(NO_FORCE)

    def send(self, force: Vector) -> None:
        """Send a command. Raises DeviceSilent."""
        self.service.send(wire.command(self.device, force, self.spelling, self.kind))


class ForcesUnderway:
    """The forces that may have acted since the last reading: a force acts from its answer on, until the next one.

    Attributes
    ----------
    acting : the force since the last answer. unanswered : those in commands without an answer, in their order.
    """

    def __init__(self) -> None:
        self.acting = NO_FORCE
        self.unanswered: deque[Vector] = deque()
        self._possible: deque[Vector] = deque(maxlen=100)

    @property
    def are_many(self) -> bool:
        """Whether so many commands have no answer that no more should be sent."""
        return len(self.unanswered) >= _MOST_UNANSWERED

    def sent(self, force: Vector) -> None:
        """Note a command that was sent."""
        self.unanswered.append(force)

    def answered(self) -> None:
        """Note the answer to the oldest command."""
        if self.unanswered:
            self._possible.append(self.acting)
            self.acting = self.unanswered.popleft()

    def lose_answers(self) -> None:
        """Note that commands without an answer will have none, as the connection was lost; they may have acted."""
        self._possible.extend(self.unanswered)
        self.unanswered.clear()

    def release(self) -> None:
        """Note that a new session begins, with a command without force."""
        self._possible.append(self.acting)
        self.acting = NO_FORCE
        self.sent(NO_FORCE)

    def restart(self) -> None:
        """Forget the forces before a reading."""
        self._possible.clear()

    def worst(self, moved: Vector, *, may_have_ended: bool) -> Vector:
        """The force that gave out most energy while the arm moved so [m]; may_have_ended : there may have been none."""
        possible = [*self._possible, NO_FORCE] if may_have_ended else list(self._possible)
        return max(possible, key=lambda force: sum(map(mul, force, moved)), default=NO_FORCE)
