"""Change an operator, sign, factor, comparison or constant of a formula, one at a time, and see whether a test fails.

Each mutant is made in a copy of the tree, and the default tests that import its module run there, those of its own room
first; then the quick ones. One whose tests take longer than `STAGES_S` is undecided. Nothing is compiled meanwhile,
except for soft bodies, whose tests take too long otherwise.
What fails without the mutant too, or only by taking a minute, is left out.
"""

import ast
import os
import random
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from tests.conftest import DATA, ROOT

ROOMS = (
    *(f"hapnet/{name}" for name in ("control", "mechanics", "plant", "couplings", "side", "summary")), "netem",
    *(f"hapnet/ext/{name}" for name in ("laws", "solids", "soft", "arms", "tools", "metrics")),
)  # fmt: skip
OTHER = {
    ast.Add: "-", ast.Sub: "+", ast.Mult: "/", ast.Div: "*", ast.Lt: ">", ast.Gt: "<", ast.LtE: ">=", ast.GtE: "<=",
    ast.Eq: "!=", ast.NotEq: "==",
}  # fmt: skip
COMMANDS = ("cli.py", "aio.py", "bench.py", "output.py", "plot.py", "progress.py", "picture.py")
"""Files by the end of their name: no formulas, but output and traffic."""
TINY = 1e-5
"""Constants up to this keep a formula from dividing by zero: others do that too."""
STAGES_S = (240, 240, 120)
TEST_S = 60


class Mutant(NamedTuple):
    """Of a file's text, what stands from `begin` to `end` becomes `text`."""

    file: Path
    line: int
    begin: int
    end: int
    text: str

    def changed(self, root: Path) -> str:
        """The file's text with the change."""
        text = (root / self.file).read_text("utf-8")
        return text[: self.begin] + self.text + text[self.end :]

    def shown(self, root: Path) -> str:
        """Its line before and after."""
        before, after = (root / self.file).read_text("utf-8").splitlines(), self.changed(root).splitlines()
        return f"{self.file}:{self.line}: {before[self.line - 1].strip()}  ->  {after[self.line - 1].strip()}"


def mutants_of(file: Path) -> Iterator[Mutant]:
    """All mutants of a file's functions: not of messages, types, defaults, or what is raised."""
    text = (ROOT / file).read_text("utf-8")
    starts = [0]
    for row in text.splitlines(keepends=True):
        starts.append(starts[-1] + len(row))

    def at(line: int, column: int) -> int:
        row = text[starts[line - 1] : starts[line]]
        return starts[line - 1] + len(row.encode()[:column].decode())

    def span(node: ast.expr) -> tuple[int, int]:
        return at(node.lineno, node.col_offset), at(node.end_lineno or 0, node.end_col_offset or 0)

    def between(left: ast.expr, right: ast.expr, old: str, new: str, line: int) -> Iterator[Mutant]:
        begin, end = span(left)[1], span(right)[0]
        found = text[begin:end].find(old)
        if found >= 0:
            yield Mutant(file, line, begin + found, begin + found + len(old), new)

    signs = {
        ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Lt: "<", ast.Gt: ">", ast.LtE: "<=",
        ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!=",
    }  # fmt: skip

    def constant(node: ast.Constant) -> Iterator[Mutant]:
        match node.value:
            case bool():
                return
            case int(value):
                yield Mutant(file, node.lineno, *span(node), repr(value + 1))
            case float(value) if value > TINY or value == 0.0:
                yield Mutant(file, node.lineno, *span(node), repr(value * 1.5 or 0.5))

    def visit(node: ast.AST) -> Iterator[Mutant]:
        if isinstance(node, ast.Raise | ast.JoinedStr | ast.Assert | ast.AnnAssign | ast.Subscript):
            return
        match node:
            case ast.BinOp(left=left, op=op, right=right) if type(op) in OTHER:
                if not any(isinstance(side, ast.JoinedStr | ast.List | ast.Tuple) for side in (left, right)):
                    yield from between(left, right, signs[type(op)], OTHER[type(op)], right.lineno)
                    if isinstance(op, ast.Mult):
                        yield Mutant(file, node.lineno, *span(node), f"({ast.unparse(right)})")
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                yield Mutant(file, node.lineno, *span(node), f"({ast.unparse(operand)})")
            case ast.Compare(left=left, ops=[op], comparators=[right]) if type(op) in OTHER:
                yield from between(left, right, signs[type(op)], OTHER[type(op)], right.lineno)
            case ast.Return(value=ast.BinOp() as value):
                yield Mutant(file, node.lineno, *span(value), f"-({ast.unparse(value)})")
        for child in ast.iter_child_nodes(node):
            if isinstance(node, ast.BinOp | ast.Compare | ast.Return | ast.IfExp) and isinstance(child, ast.Constant):
                yield from constant(child)
            yield from visit(child)

    for function in ast.walk(ast.parse(text)):
        if isinstance(function, ast.FunctionDef):
            for statement in function.body:
                if not isinstance(statement, ast.FunctionDef):
                    yield from visit(statement)


def chosen(count: int, seed: int) -> list[Mutant]:
    """Each of another file, as far as there are enough of them."""
    rng = random.Random(seed)
    files = [file.relative_to(ROOT) for room in ROOMS for file in sorted((ROOT / room).rglob("*.py"))]
    files = [file for file in files if not file.name.endswith(COMMANDS)]
    rng.shuffle(files)
    found: list[Mutant] = []
    while len(found) < count:
        for file in files:
            made = sorted(set(mutants_of(file)) - set(found))
            if made and len(found) < count:
                found.append(rng.choice(made))
    return found


def tests_of(module: Path, root: Path) -> list[str]:
    """The test files that import it, those of its own room first; then those that import what imports it."""
    texts = {file.relative_to(root): file.read_text("utf-8") for file in sorted((root / "tests").rglob("test_*.py"))}
    sources = sorted([*(root / "hapnet").rglob("*.py"), *(root / "netem").rglob("*.py")])
    users = importers(module, {file.relative_to(root): file.read_text("utf-8") for file in sources})
    room = module.parent.name
    direct = sorted(importers(module, texts), key=lambda f: (room not in f.parts, module.stem not in f.stem))
    return list(map(str, dict.fromkeys([*direct, *(file for user in users for file in importers(user, texts))])))


def importers(module: Path, texts: Mapping[Path, str]) -> list[Path]:
    """Those of the files that name it in an import."""
    name = ".".join(module.with_suffix("").parts)
    parent, _, leaf = name.rpartition(".")
    wanted = re.compile(rf"{re.escape(name)}\b|from {re.escape(parent)} import .*\b{leaf}\b")
    return [file for file, text in texts.items() if wanted.search(text)]


class Copy:
    """A copy of the tree, in which one mutant at a time stands. in_time : the last one's tests all came to an end."""

    def __init__(self, folder: Path) -> None:
        self.root = folder / "hapnet"
        shutil.copytree(
            ROOT,
            self.root,
            ignore=shutil.ignore_patterns(
                ".git", ".venv", ".*_cache", ".hypothesis", ".franka-sim", "__pycache__", "runs"
            ),
            symlinks=True,
        )
        (folder / "shared").mkdir()
        (folder / "shared" / "data").symlink_to(DATA)
        self.environment = {**os.environ, "PYTHONPATH": str(self.root), "PYTHONDONTWRITEBYTECODE": "1"}

    def failed(self, words: list[str], seconds: float, *, compiles: bool) -> str | None:
        """The first test that fails; None: none within so long."""
        words = ["-x", "-q", "-p", "no:cacheprovider", "-n", "0", "--force-reruns", "0", f"--timeout={TEST_S}", *words]
        program = subprocess.Popen(
            [sys.executable, "-m", "pytest", *words], cwd=self.root, text=True, start_new_session=True,
            env={**self.environment, "NUMBA_DISABLE_JIT": "" if compiles else "1"},
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        )  # fmt: skip
        try:
            out = program.communicate(timeout=seconds)[0]
        except subprocess.TimeoutExpired:
            os.killpg(program.pid, 9)
            out, self.in_time = program.communicate()[0], False
        found = re.search(r"^(?:FAILED|ERROR) (\S+?\[.*?\]|\S+)(?: - |$)", out, re.MULTILINE)
        return found[1] if found else None if program.returncode in (0, 5, -9) else "tests"

    def caught_by(self, mutant: Mutant) -> str | None:
        """The test that fails because of it."""
        self.in_time = True
        files, compiles = tests_of(mutant.file, self.root), "soft" in mutant.file.parts
        changed, before = mutant.changed(self.root), (self.root / mutant.file).read_text("utf-8")
        stages = (["-m", "quick", *files], ["-m", "not slow and not soak and not quick", *files], ["-m", "quick"])
        for words, limit_s in zip(stages, STAGES_S, strict=True):
            end_s = time.monotonic() + limit_s
            while (words[2:] or words == stages[-1]) and (left_s := end_s - time.monotonic()) > 0:
                (self.root / mutant.file).write_text(changed, "utf-8")
                test = self.failed(words, left_s, compiles=compiles)
                (self.root / mutant.file).write_text(before, "utf-8")
                if test is None:
                    break
                if self.failed([test], TEST_S, compiles=compiles) is None:
                    return test
                words = [*words, f"--deselect={test}" if "::" in test else f"--ignore={test}"]
        return None


def main(count: int = 60, seed: int = 1, first: int = 0) -> None:
    """count : how many; a second run with the same seed makes the same. first : begin with this one of them."""
    caught, mutants = 0, chosen(count, seed)[first:]
    with TemporaryDirectory() as folder:
        copy = Copy(Path(folder))
        for number, mutant in enumerate(mutants, first):
            begun_s = time.monotonic()
            test = copy.caught_by(mutant)
            caught += test is not None
            word = "caught" if test else "SURVIVED" if copy.in_time else "UNDECIDED"
            print(f"{number} {word} {time.monotonic() - begun_s:.0f} s "
                  f"{mutant.shown(copy.root)}  [{test or '-'}]", flush=True)  # fmt: skip
    print(f"{caught} of {count - first} caught")
