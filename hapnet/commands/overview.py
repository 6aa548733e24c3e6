"""What `hapnet --help` and `hapnet --version` print, without loading what the commands declare: that takes longer."""

from __future__ import annotations

from typing import Annotated

import typer

from netem.version_flag import versions

ASKED: tuple[list[str], ...] = ([], ["--help"], ["-h"], ["--version"])
"""The arguments that ask for no more."""

COMMANDS = {
    "run": "Run both processes on this machine, over Zenoh: a hand presses a virtual wall over a link with delay and "
    "loss.",
    "simulate": "Simulate both sides in virtual time: in one process, deterministic for a seed, much faster than real "
    "time.",
    "play": "Feel it on a live page, with the mouse as the hand. Both processes run on this machine, as in "
    "`hapnet run`.",
    "view": "Watch a pair that runs elsewhere on a live page, without disturbing it: `hapnet view -e tcp/HOST:17447`.",
    "device": "Run the device's side only, for two hosts: simulated device and hand. Start it before or after "
    "`hapnet world`.",
    "world": "Run the virtual world's side only, for two hosts. Start it before or after `hapnet device`.",
    "reproduce": "Simulate the paper's Figures 4, 5 and 6, with the numbers of its Section 4 (lost digits "
    "reconstructed).",
    "replay": "Repeat a recorded run in virtual time: as it was, or with the same hand and another link or coupling.",
    "report": "Turn one or two recordings into a page (HTML), figures and a summary. A torn one gets a repaired copy.",
    "compare": "Compare couplings over the same links, hands and seeds, in virtual time: which are passive, how "
    "transparent.",
    "export": "Write one or two recordings as tables: CSV, and Parquet. Those of two hosts are put on one clock.",
    "transparency": "Measure what couplings transmit of a wall: stiffness and damping over frequency, in virtual time.",
    "tune": "Search the parameters that are best for an objective and break no constraint; score them on other cases.",
    "devices": "List the devices that can be given to --device, what was found of each, and what is missing for it.",
    "emulate": "Stand in for a device: speak its protocol, with a simulated hand on the handle, in a process of its "
    "own.",
    "bench": "Measure what the servo, the message path and the simulation cost here, each beside a bare reference.",
    "doctor": "Check what this machine allows a servo to do, and say how to allow the rest.",
    "sweep": "Thousands of cases over parameters, links and seeds, in virtual time; `hapnet sweep plot` draws them.",
}
"""The first paragraph of each command's help, in the order in which they are declared."""


def program() -> typer.Typer:
    """The command `hapnet`, to which commands can be added."""
    app = typer.Typer(
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
    app.callback()(_before_any_command)
    return app


def _before_any_command(
    version: Annotated[
        bool,
        typer.Option("--version", help="Print versions for bug reports.", callback=versions("hapnet"), is_eager=True),
    ] = False,
) -> None:
    """The options before a command's name."""


def main(args: list[str]) -> int:
    """Print what `args` ask for; returns the exit code."""
    app = program()
    for name, text in COMMANDS.items():
        app.command(name, help=text)(_declared_elsewhere)
    try:
        app(args=args or ["--help"], prog_name="hapnet", standalone_mode=False)
    except KeyboardInterrupt:
        return 130
    return 0


def _declared_elsewhere() -> None:
    """A command's place in the list."""
