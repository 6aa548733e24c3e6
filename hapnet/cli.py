"""The `hapnet` command: the table of its commands, and one line and an exit code for every error.

A command is a function: its arguments are the flags, and its docstring is the help below the line in the table.
`hapnet --help` and TAB read the table, and import no command; a command's module is imported when the command is run
or its help is printed. Other packages publish their commands as entry points of `hapnet.commands`.
"""

from __future__ import annotations

import io
import os
import sys
import warnings
from collections.abc import Mapping
from contextlib import redirect_stdout, suppress
from functools import cache
from pkgutil import resolve_name
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from hapnet.commands import output
from hapnet.errors import HapnetError, OutputError
from hapnet.loading import any_published, load, published
from netem.command_help import HELP, Entry, PlainGroup
from netem.errors import NetemError, unknown
from netem.version_flag import versions

GROUP = "hapnet.commands"
"""The entry points by which other packages publish their commands, as ``module:function``."""

COMMANDS: Mapping[str, tuple[str, str]] = {
    "run": ("hapnet.commands.run:run", "Run both sides on this machine, over an emulated bad network."),
    "play": ("hapnet.ext.page.commands.play:play", "Run both sides with a live page, and the mouse as the hand."),
    "device": ("hapnet.commands.device:device", "Run the device's side, with `hapnet world` on another host."),
    "world": ("hapnet.commands.device:world", "Run the world's side, with `hapnet device` on another host."),
    "simulate": ("hapnet.commands.simulate:simulate", "Simulate both sides in virtual time: fast and repeatable."),
    "report": ("hapnet.ext.pictures.commands:report", "Turn recordings into a page (HTML), figures and a summary."),
    "devices": ("hapnet.ext.devices.commands:devices", "List the devices, and the hardware that was found for each."),
    "doctor": ("hapnet.ext.doctor.commands:doctor", "Check this machine, a network or a device; print what to mend."),
    "view": ("hapnet.ext.page.commands.view:view", "Watch a pair that runs elsewhere on a live page."),
    "replay": ("hapnet.commands.replay:replay", "Repeat a recorded run, also with another link or coupling."),
    "export": ("hapnet.commands.export:export", "Write recordings as tables: CSV, and Parquet."),
    "compare": (
        "hapnet.ext.study.commands.compare:compare",
        "Compare couplings over the same links, operators and seeds.",
    ),
    "transparency": (
        "hapnet.ext.study.commands.transparency:transparency",
        "Measure how couplings transmit a wall, over frequency.",
    ),
    "sweep": ("hapnet.ext.study.commands.sweep:app", "Run thousands of cases over parameters, links and seeds."),
    "tune": ("hapnet.ext.study.commands.tune:tune", "Search for the best parameters within constraints."),
    "graph": (
        "hapnet.ext.many.commands.graph:app",
        "Check a graph: several hands in one world, each with a link.",
    ),
    "reproduce": ("hapnet.ext.pictures.commands:reproduce", "Simulate the paper's Figures 4, 5 and 6."),
    "bridge": ("hapnet.ext.page.commands.bridge:bridge", "Publish a running pair on ROS 2's topics, without ROS."),
    "emulate": ("hapnet.ext.devices.commands:emulate", "Emulate a device: its protocol, and a hand on the handle."),
    "bench": ("hapnet.ext.bench.commands:bench", "Measure the cost of servo, message path and simulation here."),
    "compile": ("hapnet.ext.compiled.commands:compile_couplings", "Make machine code for simulations and servos now."),
}
"""hapnet's own commands in the order of the list: the function (or a `typer.Typer` with several), and its help."""

FIRST = 8
"""The number of commands in front; the list shows the others under "Research"."""


@cache
def commands() -> dict[str, str]:
    """Each command with its line in the list; for a command of another package, the package's summary."""
    own = {name: line for name, (_, line) in COMMANDS.items()}
    return own | {name: _summary(package) for name, (_, package) in sorted(_others().items()) if name not in own}


def _others() -> Mapping[str, tuple[str, str]]:
    """The commands of other packages: the function of each, and the package."""
    return published(GROUP) if any_published(GROUP) else {}


def _summary(package: str) -> str:
    from importlib.metadata import metadata

    return str(metadata(package).json.get("summary", f"A command of {package}."))


class _Commands(PlainGroup):
    """The group of commands; it imports a command only to run it or to print its help."""

    def list_commands(self, ctx: Any) -> list[str]:
        return list(commands())

    def sections(self, ctx: Any) -> Mapping[str, list[Entry]]:
        """The commands in front, the others, and those of other packages."""
        entries, own = list(commands().items()), len(COMMANDS)
        parts = {"Commands": entries[:FIRST], "Research": entries[FIRST:own], "Of other packages": entries[own:]}
        return {title: part for title, part in parts.items() if part}

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return the entry for a command in the list."""
        return None if (line := commands().get(cmd_name)) is None else TyperCommand(cmd_name, help=line)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        name, *rest = args
        if (command := _command(name)) is not None:
            return name, command, rest
        if not ctx.resilient_parsing and (hint := unknown("command", name, commands())):
            raise HapnetError(hint)
        return super().resolve_command(ctx, args)


def _command(name: str) -> Any:
    """A command, ready to be run; None: no command has this name."""
    if name in COMMANDS:
        where, line = COMMANDS[name]
        command = _for_typer(name, resolve_name(where))
        command.help = "\n\n".join(filter(None, (line, command.help)))
        return command
    if name in _others():
        where, package = _others()[name]
        return _for_typer(name, load(f"the command {name} of {package}", where, "a function that can be imported"))
    return None


def _for_typer(name: str, command: Any) -> Any:
    from hapnet.commands.typed import Command
    from netem.groups import grouped

    if not isinstance(command, typer.Typer):
        alone = typer.Typer(add_completion=False)
        alone.command(name, cls=Command)(grouped(command))
        command = alone
    return typer.main.get_command(command)


app = typer.Typer(
    cls=_Commands,
    name="hapnet",
    help="Passive haptics over bad networks. Begin with `hapnet run`, or with `hapnet play` and the mouse.",
    epilog="Exit codes: 0 all is well; 2 an argument or file is wrong, or the run failed: one line names the error; 3 "
    "the run went to its end, but its output or a recording it read is incomplete, or the device's force was stopped; "
    "4 a coupling that claims to be passive was not; 5 another sender used a side's name, so passivity is unknown; "
    "128 + N stopped by signal N (Ctrl-C: 130).",
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings=dict(HELP),
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
        raise  # handled by `output.unless_closed`
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
    """Print the completions after TAB, or the completion script, as the environment requests; print nothing else."""
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
