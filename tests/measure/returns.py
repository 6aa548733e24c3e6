"""Count the `return`s that each parameter passes on its way from what a user gives to the parts of a run.

A simulation is made (not run) while every call in hapnet is watched. A function is on the way of all parameters if it
was given parameters and returned parameters: a `Params`, a section of it, or what resolving makes of them. It is on
the way of one parameter if it returned a `Choice` with its name. Counted are the `return`s in the text of these
functions. What reads parameters and returns something else, such as a spring, is the end of the way.
"""

from __future__ import annotations

import ast
import sys
from collections import Counter
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import hapnet
from hapnet.assembly.build import Setup
from hapnet.assembly.choices import Choice
from hapnet.assembly.resolve import Resolved
from hapnet.params import DeviceParams, FollowerParams, Params, WorldParams
from hapnet.simulation.simulation import Simulation

PASSED = (Params, DeviceParams, WorldParams, FollowerParams, Setup, Resolved)
ROOT = str(Path(hapnet.__file__).parent)
RUNS: Mapping[str, Mapping[str, object]] = {
    "wall": {},
    "joints": {"scene": "joints"},
    "arm": {"scene": "free", "hardware": "omni"},
    "tool": {"scene": "tool:box + plane", "device.stiffness": (300.0, 2.0)},
    "scaled follower": {"scene": "box", "follower.robot": "simulated", "follower.motion_scale": 0.5},
    "tool's scaled follower": {
        "scene": "tool:box + plane",
        "follower.robot": "simulated",
        "follower.motion_scale": 0.5,
        "device.stiffness": (300.0, 2.0),
        "world.stiffness": (500.0, 3.0),
    },
    "wave": {"coupling": "wave"},
}


class Way:
    """The functions that parameters passed while a simulation was made with `changes`."""

    def __init__(self, changes: Mapping[str, object]) -> None:
        self.of_all: set[CodeType] = set()
        self.of_one: dict[str, set[CodeType]] = {}
        given = Params().set(changes)
        before = sys.getprofile()
        sys.setprofile(self._watch)
        try:
            Simulation(given, 1, kernel=False)
        finally:
            sys.setprofile(before)

    def _watch(self, frame: FrameType, event: str, result: Any) -> None:
        code = frame.f_code
        if event != "return" or not code.co_filename.startswith(ROOT):
            return
        if isinstance(result, Choice):
            for name in result.values:
                self.of_one.setdefault(name, set()).add(code)
        elif isinstance(result, PASSED):
            taken = code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]
            if any(isinstance(frame.f_locals.get(name), PASSED) for name in taken):
                self.of_all.add(code)

    def returns(self, name: str = "") -> Counter[str]:
        """The `return`s on the way of this parameter, or of one that nothing chooses, by functions."""
        return Counter({called(code): in_text(code) for code in self.of_all | self.of_one.get(name, set())})


def called(code: CodeType) -> str:
    """Module and function."""
    return f"{Path(code.co_filename).relative_to(ROOT).as_posix()}: {code.co_qualname}"


def in_text(code: CodeType) -> int:
    """The `return`s of a function; 1 of a lambda."""
    node = _functions(code.co_filename).get((code.co_name, code.co_firstlineno))
    return 1 if node is None else sum(isinstance(child, ast.Return) for child in _own(node))


def _own(node: ast.AST) -> list[ast.AST]:
    """All that is in a function, but not in those inside of it."""
    inside = [one for one in ast.iter_child_nodes(node) if not isinstance(one, ast.FunctionDef | ast.Lambda)]
    return inside + [deeper for one in inside for deeper in _own(one)]


@cache
def _functions(file: str) -> dict[tuple[str, int], ast.FunctionDef]:
    found = {}
    for node in ast.walk(ast.parse(Path(file).read_text("utf-8"))):
        if isinstance(node, ast.FunctionDef):
            found[node.name, min([node.lineno, *(one.lineno for one in node.decorator_list)])] = node
    return found


def longest(changes: Mapping[str, object]) -> tuple[str, Counter[str]]:
    """The parameter of this run that passes most `return`s, and these by functions."""
    way = Way(changes)
    name = max(way.of_one, key=lambda one: way.returns(one).total(), default="")
    return name, way.returns(name)


def main() -> None:
    """Of each kind of run print the parameter with the longest way, and the functions on it."""
    for kind, changes in RUNS.items():
        name, found = longest(changes)
        print(f"{kind}: {found.total()} returns on the way of {name}")
        print("".join(f"{count:6} {each}\n" for each, count in sorted(found.items())))


if __name__ == "__main__":
    main()
