"""Each line of README and pages, in an environment with few extras, which grows by the commands of its messages.

``python -m tests.measure environments DIRECTORY report view ...`` makes an environment without pip for each of these
extras ("" for none; "report,view" for both) from this tree, runs each line there as in an activated environment, and
prints what each said. A message that says what to install is followed, and the line must then run: no traceback, and
no message twice.
"""

from __future__ import annotations

import os
import re
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

from tests.conftest import ROOT

SHORT = "--duration 0.5 --no-files"
LINES = (
    f"hapnet simulate --seed 1 {SHORT}",
    f"hapnet run {SHORT}",
    "hapnet simulate --duration 0.5 --out out",
    "hapnet report out",
    "hapnet export out --format csv",
    "hapnet export out --format rosbag2",
    f"hapnet simulate {SHORT} --scene 'mesh:examples/ring.obj?unit=mm'",
    f"hapnet simulate {SHORT} --scene 'tool:peg + hole?at=0,0,-20mm'",
    f"hapnet simulate {SHORT} --scene soft:organ",
    f"hapnet simulate {SHORT} --scene mujoco:examples/dominoes.xml",
    f"hapnet simulate {SHORT} --scene sdf:examples.fields:gyroid",
    f"hapnet simulate {SHORT} --device omni",
    f"hapnet simulate {SHORT} --coupling examples.own_law:Mine --set mine.stiffness=50",
    "hapnet compare --duration 1 --seeds 0:1 --link lan --operator press --workers 1",
    "hapnet transparency --seeds 0:1 --link lan --coupling zoh --workers 1",
    "hapnet devices",
    "hapnet run --device serial:/dev/null --duration 0.5 --no-files",
    "hapnet run --device inverse3 --duration 0.5 --no-files",
    "hapnet run --device ros2:/x --duration 0.5 --no-files",
    "hapnet view out --no-browser --port 0",
    "hapnet play --no-browser --port 0",
    "PAGE",
    *(f"python examples/{name}.py" for name in ("own_world", "own_law", "verdict_of_recordings", "link_study")),
)
RUNS_ON = ("hapnet play", "hapnet view")
"""Lines that end only when they are told to."""

PAGE = """
from hapnet.assembly.build import prepare
from hapnet.ext.page.commands.play import led
from hapnet.commands.run import check_sides
from hapnet.errors import HapnetError
from hapnet.params import Params
from hapnet.ext.page.choices import SCENES
for label, words in SCENES.items():
    try:
        check_sides(prepare(led(Params().set({"scene": words, "dof": 0})), "sampled"))
        assert "needs" not in label, f"{label} works, and says that it lacks something"
    except HapnetError as error:
        assert "needs the extra" in label, f"{label} is offered, and does not work: {error}"
        print(f"{label}: {error}", file=sys.stderr)
print(", ".join(SCENES))
"""
COMMAND = re.compile(r"not installed: (.* -m pip .*install .*)$", re.MULTILINE)


def said_by(line: str, folder: Path, environment: Path) -> tuple[int, str]:
    """The exit code of a line in that environment, activated, and what it printed."""
    argv = [str(environment / "bin" / "python"), "-c", PAGE] if line == "PAGE" else shlex.split(line)
    path = f"{environment / 'bin'}:{os.environ['PATH']}"
    env = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    program = subprocess.Popen(
        argv, cwd=folder, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, start_new_session=True,
        env={**env, "PATH": path, "VIRTUAL_ENV": str(environment)}, executable=_found(argv[0], environment),
    )  # fmt: skip
    if line.startswith(RUNS_ON):
        end = time.monotonic() + 40.0
        while program.poll() is None and time.monotonic() < end:
            time.sleep(0.2)
        if program.poll() is None:
            os.kill(program.pid, signal.SIGINT)
    try:
        out = program.communicate(timeout=300)[0]
    finally:
        program.kill()
    return program.returncode, out


def _found(name: str, environment: Path) -> str:
    return name if "/" in name else str(environment / "bin" / name)


def tried(line: str, folder: Path, environment: Path) -> list[str]:
    """What is wrong with a line; installs what its messages say."""
    seen: set[str] = set()
    while True:
        code, out = said_by(line, folder, environment)
        last = out.strip().splitlines()[-1] if out.strip() else ""
        print(f"  {line}: code {code}: {last[:160]}", flush=True)
        if "Traceback" in out:
            return [f"{line}: {out[-1500:]}"]
        commands = COMMAND.findall(out)
        if not commands:
            return []
        for command in dict.fromkeys(commands):
            if command in seen:
                return [f"{line}: said twice: {command}"]
            seen.add(command)
            done = subprocess.run(command, shell=True, text=True, capture_output=True, cwd=folder)
            print(f"  followed: {command.split(' install ')[-1]}: code {done.returncode}", flush=True)
            if done.returncode:
                return [f"{command}: {done.stderr[-500:]}"]


def main(folder: Path, extras: list[str]) -> None:
    wrong = []
    for number, extra in enumerate(extras):
        environment, work = folder.absolute() / f"e{number}", folder.absolute() / f"w{number}"
        work.mkdir(parents=True)
        (work / "examples").symlink_to(ROOT / "examples")
        subprocess.run(["python3", "-m", "venv", "--without-pip", environment], check=True)
        what = f"{ROOT}[{extra}]" if extra else str(ROOT)
        pip = ["python3", "-m", "pip", "-q", "--python", str(environment / "bin" / "python"), "install", "-e", what]
        subprocess.run(pip, check=True, capture_output=True)
        print(f"[{extra}]", flush=True)
        for line in LINES:
            wrong += [f"[{extra}] {one}" for one in tried(line, work, environment)]
    print("\n".join(wrong) or "nothing is wrong")
    sys.exit(len(wrong))
