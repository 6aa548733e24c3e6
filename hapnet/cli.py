"""The `hapnet` command: it finds its commands, and makes a line and an exit code of every error.

A command is a function of hapnet/commands/ that has its file's name: `run` in run.py. Its arguments are the flags, its
docstring is the help, and the first paragraph of that stands in the list of commands. For `hapnet --help` and for TAB
it is read from the file's text, so that no command is loaded; a command's file is imported when it is asked for.
"""

from __future__ import annotations

import io
import os
import re
import sys
import warnings
from contextlib import redirect_stdout, suppress
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from hapnet.commands import output
from hapnet.errors import HapnetError, OutputError
from netem.errors import NetemError, unknown
from netem.version_flag import versions

_FIRST = ("run", "simulate", "play", "view", "bridge", "device", "world", "reproduce", "replay", "report", "compare",
          "export", "transparency", "tune", "devices", "emulate", "bench", "doctor", "sweep")  # fmt: skip
"""The order of the list of commands; any other command comes behind these, by its name."""

_COMMANDS = Path(__file__).parent / "commands"


@cache
def _about(name: str) -> str | None:
    """The first paragraph of a command's help; None: there is no such command."""
    file = _COMMANDS / f"{name}.py"
    if not name.isidentifier() or not file.exists():
        return None
    pattern = rf'^def {name}\(.*?"""(.*?)(?:\n\n|""")'
    head = re.search(pattern, file.read_text("utf-8"), re.MULTILINE | re.DOTALL)
    return head and " ".join(head[1].split())


def commands() -> dict[str, str]:
    """Each command with the first paragraph of its help, in the order of the list."""
    names = sorted(file.stem for file in _COMMANDS.glob("*.py"))
    found = {name: about for name in names if (about := _about(name)) is not None}
    return {name: found[name] for name in sorted(found, key=lambda each: (*_FIRST, each).index(each))}


class _Commands(TyperGroup):
    """The commands; only the one that is run, or whose help is asked for, is imported."""

    def list_commands(self, ctx: Any) -> list[str]:
        return list(commands())

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return the entry for a command in the list."""
        return None if (about := _about(cmd_name)) is None else TyperCommand(cmd_name, help=about)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        name, *rest = args
        if _about(name) is not None:
            return name, _load(name), rest
        if not ctx.resilient_parsing and (hint := unknown("command", name, commands())):
            raise HapnetError(hint)
        return super().resolve_command(ctx, args)


def _load(name: str) -> Any:
    """A command, ready to be run: the function, or the group `app` of its file."""
    from netem.groups import grouped

    module = import_module(f"hapnet.commands.{name}")
    if (own := getattr(module, "app", None)) is None:
        own = typer.Typer(add_completion=False)
        own.command(name)(grouped(getattr(module, name)))
    return typer.main.get_command(own)


app = typer.Typer(
    cls=_Commands,
    name="hapnet",
    help="Passive haptics over bad networks: a haptic device and a virtual world, coupled by passive set-position "
    "modulation (PSPM) over Zenoh through an emulated lossy link. `hapnet run` shows it.",
    epilog="Exit codes: 0 all is well; 2 an argument or file is wrong, or the run failed: one line says what; 3 "
    "the run went to its end, but its output is not complete, or the device's force was stopped; 4 a coupling that "
    "claims to be passive was not; 5 somebody else spoke in a side's name, so that nobody knows; "
    "128 + N stopped by signal N (Ctrl-C: 130).",
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


@app.callback()
def _before_any_command(
    version: Annotated[
        bool,
        typer.Option("--version", help="Print versions for bug reports.", callback=versions("hapnet"), is_eager=True),
    ] = False,
) -> None:
    """The options before a command's name."""


def main(argv: list[str] | None = None) -> int:
    """Run the command; returns its exit code, and prints one line on standard error if that is 2, 3 or 4."""
    args = sys.argv[1:] if argv is None else argv
    if "" not in sys.path:
        sys.path.append("")  # module:Class is looked up from the current directory too
    if "_HAPNET_COMPLETE" in os.environ:
        return _complete()
    try:
        code = app(args=args or ["--help"], prog_name="hapnet", standalone_mode=False)
    except OutputError as error:
        return _fail(str(error), 3)
    except (HapnetError, NetemError) as error:
        return _fail(str(error))
    except typer.Abort:
        return 130
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:
        raise  # `output.unless_closed` has it
    except OSError as error:
        if error.filename is None:
            raise
        return _fail(f"{error.filename}: {error.strerror}")
    except Exception as error:
        # click's own errors: which module defines them depends on typer's version
        format_message = getattr(error, "format_message", None)
        if format_message is None:
            raise
        context = getattr(error, "ctx", None)
        asked = "hapnet" if context is None else context.command_path
        return _fail(f"{format_message().rstrip('.')}; see {asked} --help")
    finally:
        output.remove_empty()
    return code if isinstance(code, int) else 0


def _complete() -> int:
    """Answer a shell's question, after TAB or for its script: the environment holds it. Print nothing else."""
    warnings.simplefilter("ignore")
    offered = io.StringIO()
    code, glued = 1, False
    with suppress(Exception):
        from hapnet.commands import complete

        glued = os.environ["_HAPNET_COMPLETE"] == "complete_bash" and complete.glue()
        try:
            with redirect_stdout(offered):
                app(args=[], prog_name="hapnet", standalone_mode=False)
        except SystemExit as ended:
            code = ended.code if isinstance(ended.code, int) else 0
    print(complete.behind(offered.getvalue()) if glued else offered.getvalue(), end="")
    return code


def _fail(line: str, code: int = 2) -> int:
    with suppress(OSError):  # a closed terminal
        print(f"hapnet: {line}", file=sys.stderr)
    return code
