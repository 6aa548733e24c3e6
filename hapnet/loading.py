"""Imports a user's own parts, given as ``module:Name`` or published by a package; reports a failure in one line.

The core imports no extension. When a run needs one of hapnet's (an arm, a tool that turns, a robot that follows, a
world that is not made of flat walls, a picture), `extension` looks up its module in a table, and loads it only then.
Other packages publish extensions as entry points of `hapnet.couplings`, `hapnet.worlds`, `hapnet.devices`.
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

    By name: ``module:Name``, and the package ("" if it is unknown).
    """
    from importlib.metadata import entry_points  # here, as it is slow to import

    return {
        point.name: (point.value, "" if point.dist is None else point.dist.name) for point in entry_points(group=group)
    }


@cache
def any_published(group: str) -> bool:
    """True if an installed package publishes entry points of this group.

    Use it only where speed matters (`hapnet --help`, TAB): `published` imports `importlib.metadata`, which takes ten
    times as long.
    """
    files = (file for folder in sys.path for file in Path(folder).glob("*-info/entry_points.txt"))
    return any(f"[{group}]" in file.read_text("utf-8") for file in files)


def load(parameter: str, name: str, allowed: str, known: Iterable[str] = ()) -> Any:
    """The object that ``module:Name`` names. Importing it runs the user's code, which may raise anything.

    Raises InvalidParameter: `name` has no colon, the import failed, or a file may not name it (see `permitting`). The
    message names `parameter`, and what is `allowed`, or the `known` names that are similar.
    """
    if name in _shared_parts:
        return _shared_parts[name]
    module, colon, attribute = name.partition(":")
    if not (module and colon and attribute):
        raise InvalidParameter(parameter, name, allowed, known)
    if _permits is not None:
        _permits(parameter, name)
    imported: ModuleType | None = None
    try:
        imported = import_module(module)
        return getattr(imported, attribute)
    except HapnetError:  # its own message is good enough
        raise
    except AttributeError as error:
        names = () if imported is None else tuple(vars(imported))
        if unknown("", attribute, names):
            raise InvalidParameter(f"{module}: {parameter}", attribute, allowed, names) from error
        raise InvalidParameter(parameter, name, f"{allowed} ({failure(error)})") from error
    except BaseException as error:  # see `failure`
        why = ""
        if isinstance(error, ModuleNotFoundError) and error.name and f"{module}.".startswith(f"{error.name}."):
            why = f"cannot import module {module!r} (is {module.replace('.', '/')}.py in this directory?)"
        raise InvalidParameter(parameter, name, f"{allowed} ({failure(error)})", why=why) from error


Permits = Callable[[str, str], None]
"""Takes a parameter and its value, ``module:Name``; raises HapnetError if that may not be loaded."""

_permits: Permits | None = None
_LONGEST = 400
_DRIVERS = ("hapnet.ext.devices.", "hapnet.ext.robots.")


@contextmanager
def permitting(permits: Permits) -> Iterator[None]:
    """Within this context `load` calls `permits` first, in all threads: for names from a file that is not trusted.

    The parts that installed packages publish, and hapnet's drivers, need no permission. The rest of hapnet does, as
    a scene's text can call any function with any arguments. If contexts are nested, the outermost one applies.
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
    """A `Permits` that allows only names of imported modules. Use it where the object is inspected, but not called."""
    if name.partition(":")[0] not in sys.modules:
        raise InvalidParameter(
            parameter, name, "a name that is imported already: a file names it, which imports nothing"
        )


@cache
def _all_published() -> tuple[tuple[str, str], ...]:
    groups = ("hapnet.couplings", "hapnet.worlds", "hapnet.devices", "hapnet.impairments")
    return tuple(part for group in groups for part in published(group).values())


LENT = "object:"
"""The prefix of the names of parts that cannot be imported; such a name is valid in this process only."""

_shared_parts: dict[str, object] = {}
_numbers = count(1)


@contextmanager
def shared_with_children(part: object, called: str) -> Iterator[str]:
    """A name with which `load` returns `part`: ``module:Name`` if it can be imported under that name.

    Otherwise a name with the word `called` in it, which is valid only inside this context.
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

    Anything that it raises is its failure, so such a call has an ``except BaseException``: a SystemExit would end the
    program silently, and a GeneratorExit or a CancelledError would seem to come from elsewhere. No task is cancelled
    inside such a call.

    Raises KeyboardInterrupt: `error` is one. Ctrl-C is not a failure, and is raised again.
    """
    if isinstance(error, KeyboardInterrupt):
        raise error
    return cause(error)


def cause(error: BaseException) -> str:
    """The error in one line, cut if it is long: it may quote a whole file."""
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
    "compiled names": "hapnet.ext.compiled.names",
    "compiled ends": "hapnet.ext.compiled.real_time",
    "compiled runs": "hapnet.ext.compiled.whole_runs.run",
    "pictures": "hapnet.ext.pictures.run",
    "reports": "hapnet.ext.pictures.report",
    "report commands": "hapnet.ext.pictures.commands",
    "several reports": "hapnet.ext.pictures.several",
    "mujoco": "hapnet.ext.engines.mujoco_engine",
    "soft": "hapnet.ext.soft.soft",
    "tools' worlds": "hapnet.ext.tools.scene",
    "solids": "hapnet.ext.solids.rigid",
    "grips": "hapnet.ext.solids.grip",
    "shared": "hapnet.ext.many.shared",
    "graphs": "hapnet.ext.many.commands.graph",
    "seats": "hapnet.ext.many.commands.live",
    "local graphs": "hapnet.ext.many.commands.local",
    "reports on graphs": "hapnet.ext.many.commands.report",
    "own worlds": "hapnet.ext.engines.own_worlds",
}

WORLDS = ("grips", "mujoco", "soft", "shared", "tools' worlds", "solids")
"""The kinds of worlds that a text describes, in the order in which `hapnet.plant.worlds.registry` tries them."""


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
