"""Groups of options: a frozen dataclass of flags, declared once, is one parameter of each command that has these flags.

::

    @dataclass(frozen=True)
    class LinkOptions:
        delay: flags.Delay = None
        loss: flags.Loss = None

    @app.command()
    @grouped
    def run(*, seed: flags.Seed = 0, links: LinkOptions, out: flags.Out = None) -> int: ...

typer sees ``--seed --delay --loss --out``, in this order; `run` gets ``links=LinkOptions(delay=..., loss=...)``.
A command can leave out some of a group's flags: ``links: Annotated[LinkOptions, Without("loss")]``.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass
from functools import wraps
from typing import Annotated, Any, TypeVar, get_args, get_origin, get_type_hints

T = TypeVar("T")


@dataclass(frozen=True, init=False)
class Without:
    """In a command's annotation of a group: fields without flags in this command. They keep their defaults."""

    names: tuple[str, ...]

    def __init__(self, *names: str) -> None:
        object.__setattr__(self, "names", names)


def grouped(command: Callable[..., T]) -> Callable[..., T]:
    """The command in the form that typer needs: each parameter that is a group is replaced by the group's fields.

    Raises TypeError: `Without` names a field that the group does not have. ValueError: two flags have the same name.
    """
    hints = get_type_hints(command, include_extras=True)
    flags: list[inspect.Parameter] = []
    groups: dict[str, tuple[Callable[..., object], list[str]]] = {}
    for name, parameter in inspect.signature(command).parameters.items():
        group, omitted = _group(hints[name])
        if group is None:
            flags.append(parameter.replace(annotation=hints[name], kind=parameter.KEYWORD_ONLY))
            continue
        types = get_type_hints(group, include_extras=True)
        defaults = {field.name: field.default for field in fields(group)}
        if unknown := omitted - set(defaults):
            raise TypeError(f"{group.__name__} has no {', '.join(sorted(unknown))}")
        kept = [field for field in defaults if field not in omitted]
        groups[name] = group, kept
        flags += [
            inspect.Parameter(field, parameter.KEYWORD_ONLY, default=defaults[field], annotation=types[field])
            for field in kept
        ]

    @wraps(command)
    def expanded(**given: Any) -> T:
        built = {name: group(**{field: given.pop(field) for field in kept}) for name, (group, kept) in groups.items()}
        return command(**given, **built)

    expanded.__dict__["__signature__"] = inspect.Signature(flags)
    expanded.__annotations__ = {flag.name: flag.annotation for flag in flags}
    return expanded


def _group(hint: Any) -> tuple[Any, set[str]]:
    """The group that an annotation stands for, and the fields it leaves out; None for a plain flag."""
    kind, *beside = get_args(hint) if get_origin(hint) is Annotated else (hint,)
    if not (isinstance(kind, type) and is_dataclass(kind)):
        return None, set()
    return kind, {name for extra in beside if isinstance(extra, Without) for name in extra.names}
