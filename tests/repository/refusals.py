"""All refusals of the package as a person reads them: ``python -m tests.repository.refusals`` prints them, by module.

They are collected from the source: each call that makes an error of hapnet or netem, with the names of its values in
braces. `InvalidParameter` is written as its message: ``NAME is VALUE; allowed: ...``.
"""

import ast
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

from tests.conftest import ROOT

PACKAGES = ("hapnet", "netem")
ERRORS = {
    "InvalidParameter", "HapnetError", "RecordingError", "OutputError", "TransportError", "DeviceSilent", "Ended",
    "LocalProtocolError", "ProtocolError", "NetemError", "ProfileError", "TimelineError", "RelayError",
}  # fmt: skip


class Refusal(NamedTuple):
    """A message: where its error is made, and its text."""

    file: str
    line: int
    text: str


@cache
def refusals() -> list[Refusal]:
    """All refusals, by file and line."""
    files = sorted(file for package in PACKAGES for file in (ROOT / package).rglob("*.py"))
    return [refusal for file in files for refusal in _of_file(file)]


def _of_file(file: Path) -> Iterator[Refusal]:
    tree = ast.parse(file.read_text("utf-8"))
    yield from sorted(_inside(tree, {}, str(file.relative_to(ROOT))))


def _inside(node: ast.AST, texts: dict[str, ast.expr], file: str) -> Iterator[Refusal]:
    """The refusals in a node. texts : those assigned to names around it."""
    if isinstance(node, ast.Module | ast.FunctionDef | ast.AsyncFunctionDef):
        own = {argument.arg for argument in node.args.args} if not isinstance(node, ast.Module) else set()
        texts = {name: text for name, text in texts.items() if name not in own} | _assigned(node)
    if isinstance(node, ast.Call) and (name := _name(node.func)) in ERRORS and (node.args or node.keywords):
        yield Refusal(file, node.lineno, _message(name, node, texts))
    for child in ast.iter_child_nodes(node):
        yield from _inside(child, texts, file)


def _name(node: ast.expr) -> str:
    return node.id if isinstance(node, ast.Name) else node.attr if isinstance(node, ast.Attribute) else ""


def _assigned(scope: ast.AST) -> dict[str, ast.expr]:
    """The texts that are assigned to names in a module or function, and not in the functions in it."""
    found: dict[str, ast.expr] = {}
    waiting = list(ast.iter_child_nodes(scope))
    while waiting:
        node = waiting.pop(0)
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef | ast.Lambda):
            continue
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.JoinedStr | ast.Constant | ast.BinOp):
            found |= {target.id: node.value for target in node.targets if isinstance(target, ast.Name)}
        waiting += ast.iter_child_nodes(node)
    return found


def _message(name: str, call: ast.Call, texts: dict[str, ast.expr]) -> str:
    words = [_text(argument, texts) for argument in call.args]
    named = {word.arg: _text(word.value, texts) for word in call.keywords}
    if name not in ("InvalidParameter", "ProfileError"):
        return " ".join(words)
    parameter, value, allowed = [*words, "", "", ""][:3]
    why = named.get("why", words[4] if len(words) > 4 else "")
    if name == "ProfileError":
        return f"{parameter}: {why}" if why else f"{parameter}: {value} is not allowed; allowed: {allowed}"
    return f"{parameter} {value}: {why}" if why else f"{parameter} is {value}; allowed: {named.get('allowed', allowed)}"


def _text(node: ast.expr, texts: dict[str, ast.expr], depth: int = 0) -> str:
    match node:
        case ast.Constant(value=value):
            return str(value)
        case ast.JoinedStr(values=values):
            return "".join(_text(value, texts, depth) for value in values)
        case ast.FormattedValue(value=ast.Name(id=name)) if name in texts and depth < 3:
            return _text(texts[name], texts, depth + 1)
        case ast.FormattedValue(value=value):
            return "{" + ast.unparse(value) + "}"
        case ast.Name(id=name) if name in texts and depth < 3:
            return _text(texts[name], texts, depth + 1)
        case ast.BinOp(left=left, op=ast.Add(), right=right):
            return _text(left, texts, depth) + _text(right, texts, depth)
    return "{" + ast.unparse(node) + "}"


def main() -> int:
    before = ""
    for refusal in refusals():
        if refusal.file != before:
            before = refusal.file
            print(f"\n{before}")
        print(f"  {refusal.line}: {refusal.text}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
