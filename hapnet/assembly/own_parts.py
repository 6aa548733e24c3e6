"""What a user's own part does wrong is said in one line that names the part, wherever it shows."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from types import TracebackType

from hapnet.errors import HapnetError
from hapnet.loading import LENT, cause
from hapnet.params import Params
from netem import NetemError

_KINDS = {"scene": "scene", "operator": "operator", "hardware": "device", "coupling": "coupling"}
"""The parameters that can name a user's own part, and what people call it."""


@contextmanager
def named_failures(params: Params) -> Iterator[None]:
    """An error inside becomes a HapnetError that names the user's own parts of this run, if there are any.

    A part that gives something else than it should fails where that is used, and not in its own code.
    """
    try:
        yield
    except BaseException as error:
        named = named_failure(params, error)
        if named is error:
            raise
        raise named from error


def named_failure(params: Params, error: BaseException) -> BaseException:
    """The error as a HapnetError that names the part in whose code it arose, or else all own parts of this run.

    It is returned as it is if it is one already, or if this run has no own parts.
    """
    own = {kind: name for key, kind in _KINDS.items() if _is_own(name := str(params.get(key)))}
    if isinstance(error, HapnetError | NetemError | KeyboardInterrupt) or not own:
        return error
    passed = set(_modules(error.__traceback__))
    guilty = {kind: name for kind, name in own.items() if name.partition(":")[0] in passed} or own
    who = " or ".join(f"the {kind} {name}" for kind, name in guilty.items())
    return HapnetError(f"{who} failed: {cause(error)}")


def require_parts(what: str, part: object, protocol: type) -> None:
    """Raise HapnetError unless `part`, which people call `what`, has all that `protocol` names."""
    kinds = [kind for kind in protocol.__mro__ if kind.__module__ == protocol.__module__]
    names = {name for kind in kinds for name in (*vars(kind), *vars(kind).get("__annotations__", ()))}
    lacking = sorted(name for name in names if not name.startswith("_") and not hasattr(part, name))
    if lacking:
        missing = f"{type(part).__name__} has no {', '.join(lacking)}"
        raise HapnetError(f"{what} failed: {missing}; allowed: what has all parts of {protocol.__name__}")


def _is_own(name: str) -> bool:
    module, colon, attribute = name.partition(":")
    return name.startswith(LENT) or bool(colon and attribute.isidentifier() and module.replace(".", "a").isidentifier())


def _modules(trace: TracebackType | None) -> Iterator[str]:
    """The modules whose code an error has passed through."""
    while trace is not None:
        yield str(trace.tb_frame.f_globals.get("__name__"))
        trace = trace.tb_next
