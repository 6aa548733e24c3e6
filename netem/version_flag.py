"""The `--version` flag of both commands."""

from __future__ import annotations

from collections.abc import Callable

import typer


def versions(program: str) -> Callable[[typer.Context, bool], None]:
    """The flag's callback: it prints the versions and ends the program."""

    def print_versions(context: typer.Context, wanted: bool) -> None:
        if wanted and not context.resilient_parsing:
            from netem.versions import described

            typer.echo(described(program))
            raise typer.Exit

    return print_versions
