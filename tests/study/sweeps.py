"""What the tests of sweeps share: specs of cases that last milliseconds, and scenes that go wrong."""

import multiprocessing
import os
import signal
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hapnet.errors import HapnetError
from hapnet.ext.study.journal import Journal
from hapnet.ext.study.spec import Spec
from hapnet.plant.scenes.wall import wall
from hapnet.plant.worlds.scene import Scene
from hapnet.plant.worlds.walls import WALL_STIFFNESS
from tests.support.processes import until

DEADLY, BROKEN, FATAL = 666.0, 13.0, 999.0
TOUCHY = f"""
[fixed]
duration_s = 0.2
operator = "sine"
scene = "{__name__}:touchy"
"""
SHORT = """
[fixed]
duration_s = 0.2
operator = "sine"
[vary]
coupling = ["pspm", "zoh"]
link = ["lan", "4g"]
seed = "0:10"
"""


@dataclass(frozen=True)
class Broken(Scene):
    """A scene with a programmer's mistake in it."""

    def next_step_s(self, rng: np.random.Generator) -> float:
        raise ZeroDivisionError("a step\nof two lines")


def touchy(*, dof: int = 1, stiffness: float = WALL_STIFFNESS) -> Scene:
    """A wall; of one stiffness it is broken, of another it kills the worker that makes it, of a third all the sweep."""
    if stiffness == DEADLY and multiprocessing.parent_process() is not None:
        os.kill(os.getpid(), signal.SIGKILL)
    if stiffness == FATAL and multiprocessing.parent_process() is not None:
        _end_it_all(Path("half"))
    made = wall(dof=dof, stiffness=stiffness)
    return Broken("broken", dof, made.walls) if stiffness == BROKEN else made


def done(directory: Path) -> int:
    """How many results the journal of a sweep has that may be under way; -1 without one."""
    try:
        journal = Journal.look(directory)
    except HapnetError:
        return -1
    try:
        return journal.count()[1]
    finally:
        journal.close()


def _end_it_all(directory: Path) -> None:
    """Once some results are on the disk, kill the sweep, the first time: its process, or its group as WHOM says."""
    sweep = multiprocessing.parent_process()
    assert sweep.pid is not None
    try:
        Path("killing").touch(exist_ok=False)  # by one worker: to the next one another process is the parent
    except FileExistsError:
        return
    until(lambda: done(directory) > 0)
    if os.environ["WHOM"] == "all":
        os.killpg(0, signal.SIGKILL)
    os.kill(sweep.pid, signal.SIGKILL)


def spec_file(directory: Path, text: str, name: str = "study") -> Path:
    file = directory / f"{name}.toml"
    file.write_text(text, encoding="utf-8")
    return file


def journal_of(directory: Path, text: str, *, fresh: bool = False) -> Journal:
    spec = Spec.read(spec_file(directory, text))
    return Journal.create_or_resume(directory, spec, spec.cases(), fresh=fresh)


def known(table: dict[str, list[Any]]) -> dict[str, list[Any]]:
    """The columns of a table that do not depend on who ran it when."""
    return {name: column for name, column in table.items() if name not in ("wall_s", "worker")}
