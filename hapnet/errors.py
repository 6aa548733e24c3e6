"""What hapnet raises: one root, and every message names the offending value and what is allowed."""

from __future__ import annotations

import sys


class HapnetError(Exception):
    """Root of all errors that hapnet raises on purpose."""


class InvalidParameter(HapnetError, ValueError):
    """A parameter has a value that is not allowed.

    Parameters
    ----------
    name : the parameter, as its user knows it (``"stiffness"``, ``"world.wall.stiffness"``).
    value : what was given.
    allowed : what would have been accepted, in words.
    """

    def __init__(self, name: str, value: object, allowed: str) -> None:
        self.name, self.value, self.allowed = name, value, allowed
        super().__init__(f"{name} is {_short(value)}; allowed: {allowed}")

    def __reduce__(self) -> tuple[type[InvalidParameter], tuple[str, object, str]]:
        return type(self), (self.name, self.value, self.allowed)


class ProtocolError(HapnetError):
    """Something does not follow the protocol."""


class LocalProtocolError(ProtocolError):
    """This side's own program asks for what the protocol does not allow: a defect here, never a peer's doing."""


class BadMessage(ProtocolError):
    """A received message does not follow the protocol, by its sender's fault or the network's.

    It is counted under `kind` and dropped. (h11 calls such an error remote.)
    """

    def __init__(self, kind: str, detail: str) -> None:
        self.kind, self.detail = kind, detail
        super().__init__(f"{kind}: {detail}")

    def __reduce__(self) -> tuple[type[BadMessage], tuple[str, str]]:
        return type(self), (self.kind, self.detail)


class RecordingError(HapnetError):
    """A file is not a recording, or a recording cannot be written."""


class OutputError(HapnetError):
    """What a run was to write is missing or not complete, though the run went well."""


class MissingLibrary(HapnetError):
    """Something needs a library of an extra that is not installed."""

    def __init__(self, what: str, library: str, extra: str) -> None:
        self.what, self.library, self.extra = what, library, extra
        how = f"python3 -m pip --python {sys.executable} install {library}"
        super().__init__(f"{what} needs {library}, of the extra `{extra}`, which is not installed: {how}")

    def __reduce__(self) -> tuple[type[MissingLibrary], tuple[str, str, str]]:
        return type(self), (self.what, self.library, self.extra)


class TransportError(HapnetError):
    """The transport could not be opened or set up."""


def _short(value: object, limit: int = 160) -> str:
    text = " ".join(repr(value).split())
    return text if len(text) <= limit else text[: limit - 3] + "..."
