"""The exceptions of hapnet: one root; every message names the offending value and what is allowed."""

from __future__ import annotations

from collections.abc import Iterable

from netem.errors import unknown


class HapnetError(Exception):
    """Root of all errors that hapnet raises on purpose."""


class InvalidParameter(HapnetError, ValueError):
    """A parameter has a value that is not allowed.

    name : the parameter by the user's name (``"stiffness"``, ``"world.wall.stiffness"``).
    value : the given value.
    allowed : what is accepted, as text.
    known : the accepted names, if the value is a name: the message suggests similar names.
    why : the reason, in place of what is allowed.
    """

    def __init__(self, name: str, value: object, allowed: str, known: Iterable[str] = (), why: str = "") -> None:
        self.name: str = name
        self.value: object = value
        self.allowed: str = allowed
        self.known: tuple[str, ...] = tuple(known)
        self.why: str = why
        says = f"{name} {value}: {why}" if why else f"{name} is {_short(value)}; allowed: {allowed}"
        super().__init__(unknown(name, value, self.known) or says)

    def renamed(self, name: str, value: object = None) -> InvalidParameter:
        """The same error under another name for the parameter; `value` : in place of the given one."""
        value = self.value if value is None else value
        return InvalidParameter(name, value, self.allowed, self.known, self.why)

    def __reduce__(self) -> tuple[type[InvalidParameter], tuple[str, object, str, tuple[str, ...], str]]:
        return type(self), (self.name, self.value, self.allowed, self.known, self.why)


class ProtocolError(HapnetError):
    """A message or a call does not follow the protocol."""


class LocalProtocolError(ProtocolError):
    """This side's own program makes a call that the protocol forbids: a defect of this side, never of a peer."""


class BadMessage(ProtocolError):
    """A received message does not follow the protocol, through a fault of its sender or of the network.

    It is counted under `kind` and dropped. (h11 calls such an error remote.)
    """

    def __init__(self, kind: str, detail: str) -> None:
        self.kind: str = kind
        self.detail: str = detail
        super().__init__(f"{kind}: {detail}")

    def __reduce__(self) -> tuple[type[BadMessage], tuple[str, str]]:
        return type(self), (self.kind, self.detail)


class RecordingError(HapnetError):
    """A file is not a recording, or a recording cannot be written."""


class OutputError(HapnetError):
    """The output of a run is missing or incomplete, although the run itself succeeded."""


class MissingLibrary(HapnetError):
    """A feature needs libraries (names with blanks between them) of an extra that is not installed."""

    def __init__(self, what: str, library: str, extra: str) -> None:
        self.what: str = what
        self.library: str = library
        self.extra: str = extra
        from hapnet.installing import install_command  # needed only here

        how = install_command(library)
        libraries = " and ".join(library.split())
        super().__init__(f"{what} needs {libraries}, of the extra `{extra}`, which is not installed: {how}")

    def __reduce__(self) -> tuple[type[MissingLibrary], tuple[str, str, str]]:
        return type(self), (self.what, self.library, self.extra)


class DeviceSilent(HapnetError):
    """A device gives no reading now, but may give one later: no answer in time, or the cable was pulled out.

    A driver raises it from `read` or `apply`. The servo continues without force and reads again at the next tick.
    """


class Ended(HapnetError):
    """A connected side has ended: its time was over, its only peer left, or the program left its ``async with``."""


class TransportError(HapnetError):
    """The transport could not be opened or set up."""


def _short(value: object, limit: int = 160) -> str:
    text = " ".join(repr(value).split())
    return text if len(text) <= limit else text[: limit - 3] + "..."
