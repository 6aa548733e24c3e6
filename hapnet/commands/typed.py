"""The flags as the user typed them, in errors: a parameter that came from a flag is named by the flag."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import Any

from hapnet.errors import HapnetError, InvalidParameter
from netem.command_help import PlainCommand

FIELDS: Mapping[str, tuple[str, ...]] = {
    "follower.robot": ("follower", "hardware"),  # the second with --role follower
    "device.servo": ("servo",),
    "device.servo_hz": ("servo_hz",),
    "duration_s": ("duration",),
    "duration": ("duration",),
    "wire.deadband": ("deadband",),
    "device.on_silence": ("on_silence",),
    "world.on_silence": ("on_silence",),
    "device.silence_after_s": ("silence_after",),
    "world.silence_after_s": ("silence_after",),
}
"""By parameter, the fields of option groups that set it, where their names differ."""


class Command(PlainCommand):
    """A command whose errors name the flags that were typed."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        ctx.meta[_ARGS] = words = list(args)
        try:
            return super().parse_args(ctx, args)
        except Exception as error:  # which module defines click's own depends on typer's version
            _name_value(error, words)
            raise

    def invoke(self, ctx: Any) -> Any:
        """Run the command."""
        try:
            return super().invoke(ctx)
        except HapnetError as error:
            text = in_words_of(str(error), dict(self._typed(ctx)), within=isinstance(error, InvalidParameter))
            if text != str(error):
                error.args = (text, *error.args[1:])
            raise

    def _typed(self, ctx: Any) -> Iterator[tuple[str, str]]:
        """(parameter, flag) of every flag that was typed; `--set` is last, as it overrides the others."""
        words = [word.partition("=")[0] for word in ctx.meta[_ARGS]]
        for option in self.params:
            flag = next((word for word in words if word in option.opts), None)
            if flag is not None:
                fields = (parameter for parameter, names in FIELDS.items() if option.name in names)
                yield from ((parameter, flag) for parameter in (str(option.name), *fields))
        for word in ctx.params.get("assign") or ():
            yield word.partition("=")[0].strip(), "--set"
            yield "parameter", "--set"


_ARGS = "hapnet.args"


def _name_value(error: Any, args: list[str]) -> None:
    """Name the value in click's error about a flag, as its message has only what is allowed."""
    names = getattr(getattr(error, "param", None), "opts", ())
    words = [part for word in args for part in (word.split("=", 1) if word.startswith("--") else [word])]
    for name, value in pairwise(words):
        if name.startswith("-") and name in names:
            error.param_hint = f"'{name} {value}'"


def in_words_of(text: str, typed: Mapping[str, str], *, within: bool = True) -> str:
    """The text of an error whose subject is a parameter in `typed`, with the flag in the parameter's place.

    `--set` is followed by the parameter, which is a part of what was typed. within : the parameter may stand behind a
    module's name and a colon.
    """
    place = r"(?:[\w.]+: )?" if within else ""
    found = re.match(rf"({place}unknown )?([\w.]+)(?= is | '| [^ ]+: | [^ ]+(?: \+ [^ ]+)* is )", text)
    flag = None if found is None else typed.get(found[2])
    if found is None or flag is None:
        return text
    return f"--set: {text}" if flag == "--set" else f"{found[1] or ''}{flag}{text[found.end() :]}"
