"""The code blocks of README and of all pages: how they are found, what their comments ask for, and how they are run.

`tests/README.md` says what an author may write above a block.
"""

import re
import shlex
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass, replace
from functools import cache
from io import StringIO
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import typer

from hapnet import cli
from hapnet.ext.metrics.measured import DEFINED
from hapnet.params import Params
from hapnet.recording.mcap import save
from hapnet.recording.samples import Recording
from hapnet.records.record import EQUATIONS
from hapnet.simulation.simulation import simulate
from netem import cli as netem_cli
from tests.conftest import ROOT

FOLDERS = ("hapnet", "netem", "examples", "tests", ".github", ".site/pages")
PAGES = [ROOT / "README.md", *sorted(file for folder in FOLDERS for file in (ROOT / folder).rglob("*.md"))]
DATA_ONLY = {"mermaid": "a diagram", "text": "what the block before prints"}
MAINS: dict[str, Callable[[list[str]], int]] = {"hapnet": cli.main, "netem": netem_cli.main}
PROCESSES = ("run", "device", "world", "emulate")
"""Subcommands that start processes, or wait for one: they run in real time."""

_COMMENT = re.compile(r"^<!-- (.+) -->$")
_NAME = re.compile(r"^# ([\w-]+\.(?:toml|py))(?::.*)?\n")


@dataclass(frozen=True)
class Block:
    """A fenced block: where it begins, its language, what the comment above it says, and its text.

    printed : the block of text that follows it: what it prints; None if there is none.
    """

    page: Path
    line: int
    language: str
    comment: str
    text: str
    printed: str | None = None

    @property
    def name(self) -> str:
        return f"{self.page.relative_to(ROOT)}:{self.line}"

    @property
    def why_not(self) -> str:
        """Why it is not run; empty: it is."""
        return self.comment.removeprefix("not run: ") if self.comment.startswith("not run: ") else ""

    @property
    def words(self) -> set[str]:
        """What its comment asks for."""
        return set() if self.why_not else {word.strip() for word in self.comment.split(",") if word}

    @property
    def commands(self) -> list[str]:
        """A shell's commands, a line each; a backslash at the end joins two lines."""
        lines = self.text.replace("\\\n", " ").splitlines()
        return [line for line in lines if shlex.split(line, comments=True)]

    @property
    def is_in_real_time(self) -> bool:
        """Does it start the two sides as they are on two hosts, in processes or in one program?"""
        if self.language == "python":
            return "asyncio" in self.text
        argvs = [shlex.split(line, comments=True) for line in self.commands] if self.language == "sh" else []
        return any(argv[0] == "hapnet" and argv[1] in PROCESSES for argv in argvs)


@cache
def blocks(page: Path) -> tuple[Block, ...]:
    found: list[Block] = []
    lines = iter(enumerate(page.read_text("utf-8").splitlines(), 1))
    before, follows = "", False  # whether nothing but blank lines came since the last block
    for number, line in lines:
        if not line.startswith("```"):
            before, follows = line, follows and not line.strip()
            continue
        inside = _until_fence(lines)
        comment = _COMMENT.match(before)
        block = Block(page, number, line[3:].strip(), comment[1] if comment else "", inside)
        if block.language == "text" and follows:
            found[-1] = replace(found[-1], printed=inside)
        found.append(block)
        before, follows = "", True
    return tuple(found)


def _until_fence(lines: Iterator[tuple[int, str]]) -> str:
    inside = []
    for _, line in lines:
        if line.startswith("```"):
            return "\n".join(inside) + "\n"
        inside.append(line)
    raise AssertionError("a block without an end")


ALL = [block for page in PAGES for block in blocks(page)]


# What is in the directory in which a block runs


def prepare(directory: Path, page: Path, certificates: Path) -> None:
    """The files that pages speak of: recordings, a hand, meshes, models, and what the page itself says to save."""
    (directory / "examples").symlink_to(ROOT / "examples")
    (directory / "certificates").symlink_to(certificates)
    (directory / "users").write_text("alice:secret\n", "utf-8")
    (directory / "password").write_text("secret\n", "utf-8")
    (directory / "password").chmod(0o600)
    (directory / "word").write_text("correct horse\n", "utf-8")
    (directory / "word").chmod(0o600)
    times = np.arange(0.0, 3.0, 0.02)
    rows = [f"{t:.2f},{0.02 * (1.0 - np.cos(2.0 * t)):.6f},0.0,1,0.5" for t in times]
    (directory / "hand.csv").write_text("\n".join(["time_s,x_m,y_m,pen_down,pressure", *rows]) + "\n", "utf-8")
    (directory / "bumps.csv").write_text("\n".join(["0,1,0,1", "1,0,1,0"] * 2) + "\n", "utf-8")
    (directory / "door.xml").write_text(_DOOR, "utf-8")
    (directory / "arm.xml").write_text(_ARM, "utf-8")
    for block in blocks(page):
        if name := _NAME.match(block.text):
            (directory / name[1]).write_text(shorter(block.text), "utf-8")
    if ".mcap" in page.read_text("utf-8"):
        _record(directory)


_ARM = """
<mujoco><worldbody>
  <body pos="0.1 0 0.1"><joint name="shoulder" axis="0 0 1"/><geom type="capsule" size=".01" fromto="0 0 0 .1 0 0"/>
    <body pos="0.1 0 0"><joint name="elbow" axis="0 0 1"/><geom type="capsule" size=".01" fromto="0 0 0 .1 0 0"/></body>
  </body></worldbody>
  <actuator><motor joint="shoulder"/><motor joint="elbow"/></actuator>
  <keyframe><key name="home" qpos="0.5 0.5"/></keyframe>
</mujoco>
"""

_DOOR = """
<mujoco><worldbody><body name="door" pos="0.1 0 0"><joint name="hinge" axis="0 0 1" damping="0.1"/>
<geom type="box" size="0.02 0.1 0.1" mass="1"/>
<body name="handle" pos="-0.05 -0.1 0"><geom type="sphere" size="0.01" mass="0.1"/></body></body></worldbody></mujoco>
"""


def _record(directory: Path) -> None:
    """A run's recording, and those of its two sides, as a device and a world on two hosts have them."""
    whole = simulate(Params(duration_s=1.0), seed=5).recording

    def side(role: str, **without: Any) -> Recording:
        meta = {**whole.meta, "role": role, "clock": "boot:1", "session": "default"}
        if role == "device":
            meta["origin_ns"] = whole.meta["device_origin_ns"]
        return replace(whole, meta=meta, events=[], summary=None, **without)

    save(whole, directory / "run.mcap")
    save(side("device", world=None), directory / "device.mcap")
    save(side("world", device=None), directory / "world.mcap")


# How a block is made short

_SHORTER = (
    (r"Params\(\)", "Params(duration_s=0.5)"),
    (r"range\(500\)", "range(1)"),
    (r'seed = "\d+:\d+"', 'seed = "0:1"'),
    (r"trials = \d+", "trials = 2"),
    (r"generation = \d+", "generation = 2"),
    (r"(?m)^\[fixed\](.*)$", r"[fixed]\1\nduration_s = 0.5"),
    (r'(?m)^(\[score\].*\nlink = .*\nseed = )"0:1"', r'\1"1:2"'),  # no case is tuned on and scored on
)


def shorter(text: str) -> str:
    """The same code with less to do."""
    for what, instead in _SHORTER:
        text = re.sub(what, instead, text)
    return text


_LESS = {"--duration": "0.3", "--seeds": "0:2"}
"""What flags that say how much are replaced by, where they are given."""

_ADDED: dict[str, tuple[str, ...]] = {
    "run": ("--duration=0.3", "--no-files"),
    "simulate": ("--duration=0.3", "--no-files"),
    "replay": ("--duration=0.3",),
    "device": ("--duration=0.3",),
    "world": ("--duration=0.3",),
    "compare": ("--duration=2", "--seeds=0:1", "--link=lan", "--operator=press", "--workers=1"),
    "transparency": ("--seeds=0:1", "--link=lan", "--coupling=zoh", "--workers=1"),
    "reproduce": ("--duration=2",),
}
"""What a command is given besides, where it is not given already."""


def quick(argv: Sequence[str]) -> list[str]:
    """The command with less to do."""
    before = ("", *argv)
    argv = [_LESS.get(last, word) for last, word in zip(before, argv, strict=False)]
    added = _ADDED.get(argv[1], ()) if argv[0] == "hapnet" and len(argv) > 1 else ()
    return [*argv, *(flag for flag in added if flag.partition("=")[0] not in argv)]


# How a block is run


def run_python(text: str) -> None:
    """Run a block; the metrics and equations that it defines are no other test's."""
    module, metrics = ModuleType("page"), dict(DEFINED)
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, "page", module)  # dataclasses look there for the annotations' names
        try:
            exec(compile(shorter(text), "<page>", "exec"), module.__dict__)
        finally:
            for name in DEFINED.keys() - metrics.keys():
                del DEFINED[name]
            for function in [one for one in EQUATIONS if one.__module__ == "page"]:
                del EQUATIONS[function]


def run_shell(block: Block) -> str:
    """What its commands print, each run in this process by the command's own entry; each must end well.

    Of the shell's language `> FILE` is known. What is to be installed is there already.
    """
    printed = StringIO()
    for line in block.commands:
        if " -m pip " in line:
            continue
        argv = argv_of(line)
        target = argv.pop(argv.index(">") + 1) if ">" in argv else None
        argv = [word for word in argv if word != ">"]
        argv = argv if block.printed is not None else quick(argv)
        said = StringIO()
        with redirect_stdout(said):
            code = MAINS[argv[0]](argv[1:])
        assert code == 0, f"{line}: exit code {code}\n{said.getvalue()}"
        (Path(target).write_text(said.getvalue(), "utf-8") if target else printed.write(said.getvalue()))
    return printed.getvalue()


def argv_of(line: str) -> list[str]:
    """The words of a command."""
    return shlex.split(line, comments=True)


@cache
def _program(name: str) -> Any:
    return typer.main.get_command({"hapnet": cli.app, "netem": netem_cli.app}[name])


def check_words(argv: Sequence[str]) -> None:
    """Raises what a wrong command or flag of `hapnet` or `netem` raises; runs nothing."""
    command, context, rest = _program(argv[0]), None, list(argv[1:])
    while hasattr(command, "resolve_command"):  # a group; whose class it is depends on typer's version
        if not rest or rest[0].startswith("-"):
            return  # the program's own flags
        context = command.make_context(command.name, rest, parent=context)
        _, command, rest = command.resolve_command(context, [*context._protected_args, *context.args])
    command.make_context(command.name, rest, parent=context)
