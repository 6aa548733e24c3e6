"""One command for all that is measured by hand: each module beside this one is a program, its `main` says the options.

``python -m tests.measure`` lists them; ``python -m tests.measure NAME --help`` says what one measures.
"""

import ast
import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

import typer

PROGRAMS = {file.stem: file for file in sorted(Path(__file__).parent.glob("[!_]*.py"))}


def first_line(file: Path) -> str:
    """Of a module's docstring; the module is not imported."""
    return (ast.get_docstring(ast.parse(file.read_text("utf-8"))) or "").partition("\n")[0]


def main(words: Sequence[str]) -> int:
    """Run the program that the first word names, with the options that follow; without words: list all."""
    name, *options = words or ("",)
    if name not in PROGRAMS:
        width = max(map(len, PROGRAMS))
        print("\n".join(f"{each:{width}}  {first_line(file)}" for each, file in PROGRAMS.items()))
        return 0 if name in ("", "--help") else 2
    program = import_module(f"tests.measure.{name}")
    app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    app.command(help=program.__doc__, epilog=program.main.__doc__)(program.main)
    app(options, prog_name=f"python -m tests.measure {name}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
