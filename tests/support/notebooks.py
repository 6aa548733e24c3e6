"""The notebooks of `examples/`: their code, cell by cell."""

import ast
import json
from pathlib import Path
from typing import Any

from tests.conftest import ROOT

NOTEBOOKS = sorted((ROOT / "examples").glob("*.ipynb"))


def cells(notebook: Path) -> list[dict[str, Any]]:
    return json.loads(notebook.read_text("utf-8"))["cells"]


def code(notebook: Path) -> list[str]:
    """The text of each cell with code."""
    return ["".join(cell["source"]) for cell in cells(notebook) if cell["cell_type"] == "code"]


def run(notebook: Path) -> list[object]:
    """What each cell shows: the value of its last line, if that is an expression. As Jupyter does, one after the other.

    Any text that a notebook would show of a value is made.
    """
    names: dict[str, object] = {"__name__": "__main__"}
    shown = []
    for number, text in enumerate(code(notebook), 1):
        tree = ast.parse(text)
        last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
        where = f"{notebook.name}, cell {number}"
        exec(compile(tree, where, "exec"), names)
        value = None if last is None else eval(compile(ast.Expression(last.value), where, "eval"), names)
        if hasattr(value, "_repr_html_"):
            assert value._repr_html_().startswith("<")
        shown.append(value)
    return shown
