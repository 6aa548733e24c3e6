"""How much there is to read: lines, imports, small modules, class names that stand twice, and the reading path."""

import ast
import re
from collections import Counter

from tests.conftest import ROOT

SMALL = 60


def main() -> None:
    """No options: lines of Python as they stand in the tree, docstrings, comments and blank lines included."""
    sources = {file: file.read_text("utf-8") for file in sorted((ROOT / "hapnet").rglob("*.py"))}
    trees = {file: ast.parse(text) for file, text in sources.items()}
    lengths = {file: len(text.splitlines()) for file, text in sources.items()}
    nodes = [node for tree in trees.values() for node in ast.walk(tree)]
    imports = sum(
        (node.end_lineno or 0) - node.lineno + 1 for node in nodes if isinstance(node, ast.Import | ast.ImportFrom)
    )
    classes = Counter(
        name
        for tree in trees.values()
        for name in {node.name for node in ast.walk(tree) if isinstance(node, ast.ClassDef)}
    )
    double = sorted(name for name, modules in classes.items() if modules > 1)
    small = sum(0 < lines < SMALL and file.name != "__init__.py" for file, lines in lengths.items())
    tests = sum(len(file.read_text("utf-8").splitlines()) for file in (ROOT / "tests").rglob("*.py"))
    path = set(re.findall(r"^\| `(hapnet/[^`]*)`", (ROOT / "hapnet" / "READING.md").read_text("utf-8"), re.MULTILINE))
    print(f"lines under hapnet/: {sum(lengths.values()):,} in {len(lengths)} modules, {imports:,} of them imports")
    print(f"lines under tests/: {tests:,}")
    print(f"modules of less than {SMALL} lines, packages' own aside: {small}")
    print(f"class names that stand in several modules: {len(double)}: {', '.join(double)}")
    print(f"reading path: {len(path)} files, {sum(lengths[ROOT / file] for file in path):,} lines")
