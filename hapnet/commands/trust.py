"""Modules that a recording names: whose they are is not known, so they are imported only if the user says so."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterable

from hapnet.errors import InvalidParameter
from hapnet.loading import Permits


def permits(files: str, typed: Iterable[object], *, trust: bool, ask: Callable[[str], bool] | None = None) -> Permits:
    """For `loading.permitting`: permits what the user typed, all with `trust`, and what the user says yes to.

    files : as text. typed : the values of the command line. ask : puts a question to the user; None: on a terminal.
    """
    answers: dict[str, bool] = {}
    texts = [str(value) for value in typed]

    def permit(parameter: str, name: str) -> None:
        if trust or any(re.search(rf"(?<![\w.]){re.escape(name)}(?![\w.:])", text) for text in texts):
            return
        if name not in answers:
            question = f"{files} names {name} ({parameter}): code that runs with your rights. Import it?"
            answers[name] = (ask or _asked)(question)
        if not answers[name]:
            allowed = f"permitted: {files} names it, and importing it runs its code (--trust, if you know who wrote it)"
            raise InvalidParameter(parameter, name, allowed)

    return permit


def _asked(question: str) -> bool:
    """The user's answer; no, if there is no terminal."""
    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        return False
    import typer

    return typer.confirm(question, default=False, err=True)
