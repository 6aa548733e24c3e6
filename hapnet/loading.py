"""Imports a user's own parts, given as ``module:Name`` or published by a package; says in one line what fails.

The core imports no extension. When a run needs one that comes with hapnet (an arm, a tool that turns, a robot that
follows, a world that is not made of flat walls, a picture), `extension` looks it up in a table, and only then is its
module loaded. Other packages publish theirs as entry points of `hapnet.couplings`, `hapnet.worlds`, `hapnet.devices`.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from itertools import count
from pathlib import Path
from types import ModuleType
from typing import Any

from hapnet.errors import HapnetError, InvalidParameter
from netem.errors import unknown


@cache
def published(group: str) -> Mapping[str, tuple[str, str]]:
    """The parts that installed packages publish as entry points of this group.

    By name: ``module:Name``, and the package; "" where that is unknown.
    """
    from importlib.metadata import entry_points  # here, as it is slow to import

    return {
        point.name: (point.value, "" if point.dist is None else point.dist.name) for point in entry_points(group=group)
    }


@cache
def any_published(group: str) -> bool:
    """True if an installed package publishes entry points of this group.

    Only for what must be quick (`hapnet --help`, TAB): `published` first imports `importlib.metadata`, which takes ten
    times as long.
    """
    files = (file for folder in sys.path for file in Path(folder).glob("*-info/entry_points.txt"))
    return any(f"[{group}]" in file.read_text("utf-8") for file in files)


def load(parameter: str, name: str, allowed: str, known: Iterable[str] = ()) -> Any:
    """The object that ``module:Name`` names. Importing it runs the user's code, which may raise anything.

    Raises InvalidParameter: `name` has no colon, or the import failed; it names `parameter`, and says what is
    `allowed`, or which of the `known` names may be meant. The same where a file has named it: see `permitting`.
    """
    if name in _shared_parts:
        return _shared_parts[name]
    module, colon, attribute = name.partition(":")
    if not (module and colon and attribute):
        raise InvalidParameter(parameter, name, allowed, known)
    if _permits is not None:
        _permits(parameter, name)
    found: ModuleType | None = None
    try:
        found = import_module(module)
        return getattr(found, attribute)
    except HapnetError:  # it says itself what is wrong
        raise
    except AttributeError as error:
        nearly = () if found is None else tuple(vars(found))
        if unknown("", attribute, nearly):
            raise InvalidParameter(f"{module}: {parameter}", attribute, allowed, nearly) from error
        raise InvalidParameter(parameter, name, f"{allowed} ({failure(error)})") from error
    except BaseException as error:  # see `failure`
        raise InvalidParameter(parameter, name, f"{allowed} ({failure(error)})") from error


Permits = Callable[[str, str], None]
"""Takes a parameter and the name that stands there; raises HapnetError if that may not be loaded."""

_permits: Permits | None = None
_LONGEST = 400
_DRIVERS = ("hapnet.ext.devices.", "hapnet.ext.robots.")


@contextmanager
def permitting(permits: Permits) -> Iterator[None]:
    """While this is open, `load` asks `permits` first, in all threads. For names that may come from a stranger's file.

    The parts that installed packages publish, and hapnet's drivers, need no permission: but nothing else of hapnet, as
    a scene's text can call any function with any arguments. Inside another such context, that one goes on.
    """
    global _permits
    before = _permits

    def unless_installed(parameter: str, name: str) -> None:
        driver = parameter in ("hardware", "follower.robot") and name.startswith(_DRIVERS)
        if not driver and not any(name == value for value, _ in _all_published()):
            permits(parameter, name)

    _permits = before or unless_installed
    try:
        yield
    finally:
        _permits = before


def only_imported(parameter: str, name: str) -> None:
    """Permits what needs no import. To be used where the object is looked at, but not called."""
    if name.partition(":")[0] not in sys.modules:
        raise InvalidParameter(
            parameter, name, "a name that is imported already: a file names it, which imports nothing"
        )


@cache
def _all_published() -> tuple[tuple[str, str], ...]:
    groups = ("hapnet.couplings", "hapnet.worlds", "hapnet.devices", "hapnet.impairments")
    return tuple(found for group in groups for found in published(group).values())


LENT = "object:"
"""What the name of a lent part begins with: no other process knows it."""

_shared_parts: dict[str, object] = {}
_numbers = count(1)


@contextmanager
def shared_with_children(part: object, called: str) -> Iterator[str]:
    """A name that `load` takes for `part`: ``module:Name`` where it can be imported under that.

    Otherwise there is such a name inside this context only, with the word `called` in it.
    """
    module, name = str(getattr(part, "__module__", None)), str(getattr(part, "__qualname__", None))
    if getattr(sys.modules.get(module), name, None) is part:
        yield f"{module}:{name}"
        return
    own = f"{LENT}{called}-{next(_numbers)}"
    _shared_parts[own] = part
    try:
        yield own
    finally:
        del _shared_parts[own]


def failure(error: BaseException) -> str:
    """Describe in one line the exception that a call of a user's own part raised.

    Whatever it raises is its failure, so that such a call has an ``except BaseException``: a SystemExit would end the
    program without a word, a GeneratorExit or a CancelledError would pass for somebody else's. No task is cancelled
    inside such a call.

    Raises KeyboardInterrupt: `error` is one. Ctrl-C is no failure, and goes on from here.
    """
    if isinstance(error, KeyboardInterrupt):
        raise error
    return cause(error)


def cause(error: BaseException) -> str:
    """The error in one line, which is cut if it is long: it may quote a whole file."""
    line = " ".join(f"{type(error).__name__}: {error}".split()).removesuffix(":")
    return line if len(line) <= _LONGEST else f"{line[:_LONGEST]} ..."


_MODULES = {
    "arms": "hapnet.ext.arms.parameters",
    "tools": "hapnet.ext.tools.device",
    "tools' drivers": "hapnet.ext.tools.posed",
    "robots": "hapnet.ext.robots.following",
    "driven robots": "hapnet.ext.robots.robot_side",
    "compiling": "hapnet.ext.compiled.progress",
    "compiled": "hapnet.ext.compiled.whole_runs.coverage",
    "compiled ends": "hapnet.ext.compiled.real_time",
    "compiled runs": "hapnet.ext.compiled.whole_runs.run",
    "pictures": "hapnet.ext.pictures.run",
    "reports": "hapnet.ext.pictures.report",
    "mujoco": "hapnet.ext.engines.mujoco_engine",
    "soft": "hapnet.ext.soft.soft",
    "tools' worlds": "hapnet.ext.tools.scene",
    "solids": "hapnet.ext.solids.rigid",
    "own worlds": "hapnet.ext.engines.own_worlds",
}

WORLDS = ("mujoco", "soft", "tools' worlds", "solids")
"""The kinds of worlds that a text describes, in the order in which they are asked: `hapnet.plant.worlds.registry`."""


def has_extension(name: str) -> bool:
    """Whether an extension is installed, by its name in the table."""
    try:
        return find_spec(_MODULES[name]) is not None
    except ImportError:  # of a package around it
        return False


@cache
def extension(name: str) -> Any:
    """The module of an extension, by its name in the table."""
    return import_module(_MODULES[name])
