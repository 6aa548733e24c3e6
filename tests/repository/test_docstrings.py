"""Docstrings are statements, and the names that they explain exist."""

import ast
import gc
import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PARAMETERS = re.compile(r"^([A-Za-z_]\w*(?:, [A-Za-z_]\w*)*) : ", re.MULTILINE)
"""A line ``name : meaning``, or ``name, other : meaning``."""
RESULTS = re.compile(r"^(?:Returns|Yields)\n-+\n(?:.+\n?)*", re.MULTILINE)
"""A section about a result, which may name its entries."""

Function = ast.FunctionDef | ast.AsyncFunctionDef
Documented = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef

BAD = '''"""What this module does."""

class Spring:
    """Is it a spring?

    stiffness : K.
    softness : its inverse.
    """

    def __init__(self, stiffness: float) -> None:
        """Make a spring. Is it stiff?"""

    def force(self, x: float) -> float:
        """The force.

        x, v : position and velocity.

        Returns
        -------
        newtons : the force.
        """
'''


@cache
def documented(tree: ast.Module) -> list[tuple[Documented, str]]:
    nodes = [node for node in ast.walk(tree) if isinstance(node, Documented)]
    return [(node, text) for node in nodes if (text := ast.get_docstring(node))]


def label(node: Documented) -> str:
    return "module" if isinstance(node, ast.Module) else node.name


def first_sentence(text: str) -> str:
    paragraph = " ".join(text.split("\n\n")[0].split())
    return re.split(r"(?<=[.?!])\s", paragraph)[0]


def questions(tree: ast.Module) -> list[str]:
    return [label(node) for node, text in documented(tree) if first_sentence(text).endswith("?")]


def riddles(tree: ast.Module) -> list[str]:
    return [label(node) for node, text in documented(tree) if re.match(r"What\b", text)]


def arguments(node: Function) -> set[str]:
    every = node.args
    named = [*every.posonlyargs, *every.args, *every.kwonlyargs, every.vararg, every.kwarg]
    return {one.arg for one in named if one is not None}


def names(node: ast.ClassDef | Function, classes: dict[str, ast.ClassDef]) -> set[str]:
    """The parameters of a function, and the keys that it writes; of a class also its attributes, and its bases'."""
    found = {part.value for part in ast.walk(node) if isinstance(part, ast.Constant) and isinstance(part.value, str)}
    if isinstance(node, Function):
        return found | arguments(node)
    for part in ast.walk(node):
        if isinstance(part, ast.Attribute):
            found.add(part.attr)
        elif isinstance(part, ast.AnnAssign) and isinstance(part.target, ast.Name):
            found.add(part.target.id)
    for part in node.body:
        if isinstance(part, Function):
            found |= {part.name} | (arguments(part) if part.name in {"__init__", "__new__", "__call__"} else set())
    for base in node.bases:
        name = ast.unparse(base).partition("[")[0].rpartition(".")[2]
        if name in classes and classes[name] is not node:
            found |= names(classes[name], classes)
    return found


def strangers(tree: ast.Module, classes: dict[str, ast.ClassDef]) -> list[str]:
    found = []
    for node, text in documented(tree):
        if not isinstance(node, ast.Module):
            explained = {name for line in PARAMETERS.findall(RESULTS.sub("", text)) for name in line.split(", ")}
            if explained:
                found += [f"{node.name}: {name}" for name in sorted(explained - names(node, classes))]
    return found


@pytest.mark.long
def test_no_docstring_asks_or_begins_with_what_and_a_line_about_a_parameter_names_one() -> None:
    """One test, as parsing all sources takes seconds; collections of garbage would go through all their nodes."""
    gc.disable()
    paths = [path for package in ("hapnet", "netem") for path in sorted((ROOT / package).rglob("*.py"))]
    trees = {str(path.relative_to(ROOT)): ast.parse(path.read_text("utf-8")) for path in paths}
    classes = {node.name: node for tree in trees.values() for node in ast.walk(tree) if isinstance(node, ast.ClassDef)}
    found = {path: questions(tree) + riddles(tree) + strangers(tree, classes) for path, tree in trees.items()}
    gc.enable()
    assert {path: each for path, each in found.items() if each} == {}


def test_bad_docstrings_are_found() -> None:
    tree = ast.parse(BAD)
    assert questions(tree) == ["Spring"]
    assert riddles(tree) == ["module"]
    assert strangers(tree, {}) == ["Spring: softness", "force: v"]
