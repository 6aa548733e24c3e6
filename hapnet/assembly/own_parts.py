"""Reports an error in a user's own part in one line that names the part, wherever the error appears."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import TracebackType
from typing import Any

from hapnet.errors import HapnetError, InvalidParameter
from hapnet.laws import GROUP as LAWS
from hapnet.loading import LENT, cause, published
from hapnet.params import Params
from hapnet.plant.worlds.registry import GROUP as WORLDS
from netem import NetemError

_KINDS = {"scene": "scene", "operator": "operator", "hardware": "device", "coupling": "coupling"}
"""The parameters that can name a user's own part, and the word for it in messages."""

_GROUPS = {"scene": WORLDS, "coupling": LAWS}
"""The entry points with which packages publish such parts under their own names."""


@contextmanager
def named_failures(params: Params) -> Iterator[None]:
    """Turn an error inside into a HapnetError that names the user's own parts of this run, if there are any.

    If a part returns a wrong value, the error appears where that value is used, and not in the part's own code.
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

    A HapnetError is returned unchanged, and so is any error of a run without own parts.
    """
    if isinstance(error, HapnetError | NetemError | KeyboardInterrupt):
        return error
    own = {f"the {kind} {name}": target for key, kind in _KINDS.items()
           if _is_own(target := _target(key, name := str(params.get(key))))}  # fmt: skip
    if not own:
        return error
    passed = set(_modules(error.__traceback__))
    guilty = [who for who, target in own.items() if target.partition(":")[0] in passed] or own
    parts = " or ".join(guilty)
    return HapnetError(f"{parts} failed: {cause(error)}")


def require_parts(what: str, part: object, protocol: type) -> None:
    """Raise HapnetError unless `part`, called `what` in the message, has all attributes of `protocol`."""
    names = {name for kind in protocol.__mro__ for name in (*vars(kind), *vars(kind).get("__annotations__", ()))}
    lacking = sorted(name for name in names if not name.startswith("_") and not hasattr(part, name))
    if lacking:
        missing = f"{type(part).__name__} has no {', '.join(lacking)}"
        raise HapnetError(f"{what} failed: {missing}; allowed: an object with all parts of {protocol.__name__}")


def _target(key: str, name: str) -> str:
    """``module:NAME`` of a part, also where a package publishes it under another name."""
    return published(_GROUPS[key]).get(name, (name, ""))[0] if key in _GROUPS else name


def _is_own(name: str) -> bool:
    module, colon, attribute = name.partition(":")
    return name.startswith(LENT) or bool(colon and attribute.isidentifier() and module.replace(".", "a").isidentifier())


def _modules(trace: TracebackType | None) -> Iterator[str]:
    """Yield the modules through whose code an error has passed."""
    while trace is not None:
        yield str(trace.tb_frame.f_globals.get("__name__"))
        trace = trace.tb_next


@contextmanager
def closed_if_refused(device: Any) -> Iterator[None]:
    """Close the open device if the body of this context raises an error."""
    try:
        yield
    except BaseException:
        with suppress(HapnetError):
            device.close()
        raise


@contextmanager
def named_section(section: str) -> Iterator[None]:
    """Add the section to the parameter's name in a part's error, as a part has only the parameter's own name."""
    try:
        yield
    except InvalidParameter as error:
        if error.name not in ("mass", "damping", "stiffness"):
            raise
        raise error.renamed(f"{section}.{error.name}") from error
