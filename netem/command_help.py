"""The help of commands as plain text in two columns; on a narrow terminal each text stands below its flag.

A flag whose panel ends in `MORE`, all but the first paragraph of its text, and all but two of a command's, need
``--help-all``. Only public attributes are read, as which module defines the parameters' classes depends on typer's
version.
"""

from __future__ import annotations

import shutil
import textwrap
from collections.abc import Iterable, Mapping
from typing import Any

from typer.core import TyperCommand, TyperGroup

MORE = ", more"
"""The ending of the panels with flags that few users need: ``rich_help_panel="Link, more"``."""

HELP: Mapping[str, Any] = {"help_option_names": ["-h", "--help", "--help-all"]}
"""For ``context_settings`` of an app with these commands."""

_WIDEST, _STACKED, _INDENT, _LEFT = 100, 60, 2, 30
"""The widest text, the width below which columns are stacked, the indent of an entry, and the widest first column."""

Entry = tuple[str, str]
"""A flag, argument or command, and its text."""


class PlainCommand(TyperCommand):
    """A command with this help."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        ctx.meta[_ALL] = "--help-all" in args
        return super().parse_args(ctx, args)

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Write the help into click's formatter."""
        formatter.write(page(self, ctx))


class PlainGroup(TyperGroup):
    """A group of commands with this help."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Write the help into click's formatter."""
        formatter.write(page(self, ctx, self.sections(ctx)))

    def sections(self, ctx: Any) -> Mapping[str, list[Entry]]:
        """The commands under their headings, each with its line."""
        found = ((name, self.get_command(ctx, name)) for name in self.list_commands(ctx))
        return {
            "Commands": [
                (name, (command.short_help or command.help or "").partition("\n\n")[0])
                for name, command in found
                if command is not None and not command.hidden
            ]
        }


_ALL = "netem.help-all"


def page(command: Any, ctx: Any, sections: Mapping[str, list[Entry]] | None = None) -> str:
    """The help of a command or, with the `sections` of its commands, of a group."""
    width = min(shutil.get_terminal_size().columns, _WIDEST)
    panels: dict[str, list[Entry]] = {}
    left_out, all_ = 0, bool(ctx.meta.get(_ALL))
    for parameter in command.params:
        panel = _panel(parameter)
        if getattr(parameter, "hidden", False):
            continue
        if panel.endswith(MORE) and not all_:
            left_out += 1
            continue
        panels.setdefault(panel, []).append((_left(parameter, all_), _right(parameter, all_)))
    panels.setdefault("Options", []).append(("-h, --help", "Show this help."))
    parts = [[f"Usage: {' '.join([ctx.command_path, *command.collect_usage_pieces(ctx)])}"]]
    paragraphs = [text for text in (command.help or "").split("\n\n") if text]
    parts += [_filled(text, width) for text in (paragraphs if all_ else paragraphs[:2])]
    if sections is None:  # the flags of a group are of less use than its commands
        parts += [
            _section(title, panels[title], width) for title in sorted(panels, key=lambda title: title != "Arguments")
        ]
    else:
        parts += [_section(title, entries, width) for title, entries in (*sections.items(), *panels.items())]
    if command.epilog:
        parts.append(_filled(command.epilog, width))
    if left_out:
        text = f"`{ctx.command_path} --help-all` lists {left_out} more flags, which few users need."
        parts.append(_filled(text, width))
    elif not all_ and any("\n\n" in text for text in _texts(command)):
        parts.append(_filled(f"More about it: {ctx.command_path} --help-all", width))
    return "\n\n".join("\n".join(lines) for lines in parts) + "\n"


def _texts(command: Any) -> list[str]:
    """The texts whose second paragraphs are left out; the first paragraph of a command's help is its line."""
    about = (command.help or "").partition("\n\n")[2]
    return [about, *(getattr(parameter, "help", None) or "" for parameter in command.params)]


def _section(title: str, entries: Iterable[Entry], width: int) -> list[str]:
    entries = list(entries)
    column = min(max(len(left) for left, _ in entries), _LEFT) + 2 * _INDENT
    lines = [f"{title}:"]
    for left, right in entries:
        if width < _STACKED:
            lines += [f"{'':{_INDENT}}{left}", *_filled(right, width, 3 * _INDENT)]
            continue
        texts = _filled(right, width, column)
        fits = _INDENT + len(left) + _INDENT <= column and texts
        lines += [f"{'':{_INDENT}}{left}".ljust(column) + texts.pop(0).strip() if fits else f"{'':{_INDENT}}{left}"]
        lines += texts
    return lines


def _filled(text: str, width: int, indent: int = 0) -> list[str]:
    """The text in lines of at most `width` columns; no word is cut."""
    before = " " * indent
    return textwrap.wrap(
        text, width, initial_indent=before, subsequent_indent=before, break_long_words=False, break_on_hyphens=False
    )


def _panel(parameter: Any) -> str:
    default = "Arguments" if parameter.param_type_name == "argument" else "Options"
    return getattr(parameter, "rich_help_panel", None) or default


def _left(parameter: Any, all_: bool) -> str:
    """An argument's name; or a flag with its value's name, and its short names or all its names."""
    if parameter.param_type_name == "argument":
        return parameter.metavar or str(parameter.name).upper()
    short = [name for name in parameter.opts if not name.startswith("--")]
    long = [name for name in parameter.opts if name.startswith("--")]
    names = "/".join([", ".join([*short, *(long if all_ else long[:1])]), *parameter.secondary_opts])
    value = parameter.metavar or str(parameter.name).rpartition("_")[2].upper()
    return names if parameter.is_flag else f"{names} {value}"


def _right(parameter: Any, all_: bool) -> str:
    """The text of a flag, or only its first paragraph; with its default unless it is empty or False."""
    text = getattr(parameter, "help", None) or ""
    text = " ".join((text if all_ else text.partition("\n\n")[0]).split())
    shown, value = getattr(parameter, "show_default", True), getattr(parameter, "default", None)
    if isinstance(shown, str):
        default = shown
    elif (
        shown and parameter.param_type_name == "option" and isinstance(value, str | int | float) and value is not False
    ):
        default = (
            parameter.opts[0].lstrip("-") if value is True else f"{value:g}" if isinstance(value, float) else str(value)
        )
    else:
        default = ""
    return f"{text} [{default}]".strip() if default else text
