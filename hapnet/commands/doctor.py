"""`hapnet doctor`: what this machine allows, one line each, with what to do about it."""

from __future__ import annotations

from hapnet.commands import output
from hapnet.commands.progress import Progress
from hapnet.doctor.machine import MISSING, OK, SKIPPED, WARNING, examine
from hapnet.transport.security import Security

_STYLE = {OK: "green", WARNING: "yellow", MISSING: "bold red", SKIPPED: "dim"}


def main(connect: list[str], json_to: str | None, security: Security, session: str, name: str) -> int:
    """Run the checks; returns 1 if something that hapnet needs is missing, otherwise 0."""
    from rich.text import Text

    words = output.console(json_to)
    checks = []
    with Progress(words, "examining"):
        for check in examine(connect, security, session, name):
            checks.append(check)
            line = Text(f"{check.state:<8} ", style=_STYLE[check.state]).append(
                f"{check.name:<18} {check.value}", "default"
            )
            words.print(line.append(f" → {check.advice}", _STYLE[check.state]) if check.advice else line)
    output.write_json([check.as_dict() for check in checks], json_to)
    return 1 if any(check.state == MISSING for check in checks) else 0
