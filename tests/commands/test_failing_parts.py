"""Parts of the user's own that fail, and processes that are killed."""

import os
import signal
from pathlib import Path

import pytest

from hapnet import cli
from hapnet.recording.mcap import read_recording
from tests.conftest import mostly_slow
from tests.support.arms import ARM, assert_no_force_last, heard as heard, here as here, linux, pressing
from tests.support.commands import Capture
from tests.support.processes import child_of, started

PARTS = """
import time
from hapnet.plant.operator import Sine
from hapnet.plant.worlds.scene import Scene

class Tired(Sine):
    def reference(self, t):
        if t > 0.3:
            raise ArithmeticError("no strength left")
        return super().reference(t)

class Endless(Scene):
    def next_step_s(self, rng):
        self.__dict__["left"] = self.__dict__.get("left", 60) - 1
        if self.left < 0:
            raise LookupError("out of steps")
        return super().next_step_s(rng)

def short(*, dof=1):
    from hapnet.plant.scenes.wall import wall
    made = wall(dof=dof)
    return Endless("short", dof, made.walls, 0.01, 0.02)
"""
TIRED = "hapnet: the operator parts:Tired failed: reference(0.301) raised ArithmeticError: no strength left\n"
SHORT = "hapnet: the scene parts:short failed: next_step_s() raised LookupError: out of steps\n"


INTERRUPTED = """
from hapnet.plant.operator import Sine

class Hand(Sine):
    def reference(self, t):
        if t > 0.3:
            raise KeyboardInterrupt
        return super().reference(t)

class World:
    dof = 1

    def step(self, dt, position, velocity):
        raise KeyboardInterrupt

class Reported(World):
    def step(self, dt, position, velocity):
        return (0.0,)

    def planes(self, position, reach_m):
        raise KeyboardInterrupt

def unbuilt():
    raise KeyboardInterrupt
"""


@pytest.mark.parametrize(
    ("flag", "part"), [("operator", "Hand"), ("scene", "World"), ("scene", "Reported"), ("scene", "unbuilt")]
)
def test_ctrl_c_inside_a_part_is_no_failure_of_it(flag: str, part: str, capsys: Capture) -> None:
    Path("interrupted.py").write_text(INTERRUPTED, "utf-8")
    assert cli.main(["simulate", f"--{flag}", f"interrupted:{part}", "--no-files"]) == 130
    assert "failed" not in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "says"),
    [
        pytest.param(("run", "--operator", "parts:Tired", "--out", "r"), TIRED, marks=pytest.mark.soak),
        pytest.param(
            ("run", "--scene", "parts:short", *ARM, "--out", "r", "--duration", "20"), SHORT, marks=pytest.mark.slow
        ),
        (("simulate", "--operator", "parts:Tired", "--no-files"), TIRED),
        (("simulate", "--scene", "parts:short", "--no-files"), SHORT),
        pytest.param(("run", "--realtime", "--operator", "parts:Tired", "--out", "r"), TIRED, marks=pytest.mark.slow),
    ],
    ids=["hand", "scene", "simulated hand", "simulated scene", "hand in the servo's process"],
)
def test_a_part_of_ones_own_that_raises_is_named_in_one_line(words: tuple[str, ...], says: str) -> None:
    Path("parts.py").write_text(PARTS, "utf-8")
    with started(*words) as program:
        code, stdout, stderr = program.end()
        assert not program.alive
    assert (code, stderr) == (2, says)
    assert "Traceback" not in stdout
    if words[0] == "run":
        assert read_recording("r/device.mcap").device is not None
    if ARM[0] in words:
        assert_no_force_last()


@linux
@pytest.mark.parametrize("more", mostly_slow([(("--realtime",),), ((),)], 0, 1), ids=["realtime", "thread"])
def test_the_children_of_a_run_that_is_killed_end_in_order(more: tuple[str, ...]) -> None:
    """They would hold the device for ever."""
    with started("run", *ARM, "--duration", 0, "--out", "r", *more) as program:
        program.until("a force", pressing)
        for role in ("device", "world"):
            child_of(program.process.pid, role)
        os.kill(program.process.pid, signal.SIGKILL)
        program.process.wait()
        program.until_gone(5.0)
    assert_no_force_last()
    for role in ("device", "world"):
        assert not read_recording(f"r/{role}.mcap").torn


@linux
@pytest.mark.slow
def test_the_children_of_a_run_that_is_killed_before_they_meet_end_too() -> None:
    with started("run", "--out", "r") as program:
        program.until("its directory", Path("r/log.jsonl").exists)
        program.until("a child", lambda: Path(f"/proc/{program.process.pid}/task/{program.process.pid}/children")
                      .read_text("ascii").count(" ") == 2)  # fmt: skip
        os.kill(program.process.pid, signal.SIGKILL)
        program.process.wait()
        program.until_gone()
