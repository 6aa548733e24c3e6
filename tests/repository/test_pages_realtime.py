"""The code blocks of pages that start processes, as a reader starts them; on this machine, and for a short time."""

import contextlib
import sys
from pathlib import Path

import pytest

from hapnet.transport.config import free_address
from tests.support.pages import ALL, Block, argv_of, prepare, quick, shorter
from tests.support.processes import HAPNET, Program, started

pytestmark = pytest.mark.slow
BLOCKS = [block for block in ALL if block.is_in_real_time and not block.why_not]


@pytest.fixture
def directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("block", [pytest.param(block, id=block.name) for block in BLOCKS])
def test_a_block_runs(block: Block, certificates: Path, directory: Path) -> None:
    for module in ("serial", "websockets", "mujoco", "igl"):
        pytest.importorskip(module, reason=f"{module} is not installed")
    prepare(directory, block.page, certificates)
    port = free_address().rpartition(":")[2]
    here = {"192.168.0.2": "127.0.0.1", "0.0.0.0": "127.0.0.1", "17447": port, "/tmp/axis": str(directory / "axis")}
    if block.language == "python":
        (directory / "page.py").write_text(reported(shorter(block.text), here), "utf-8")
        ends_well(started("page.py", command=(sys.executable,)))
        return
    lines = [quick(argv_of(reported(line, here))) for line in block.commands if " -m pip " not in line]
    with contextlib.ExitStack() as running:
        while "in two terminals" in block.words and len(lines) > 1:
            program = running.enter_context(started(*lines.pop(0)[1:]))
            program.until("a word", lambda said=program: bool(said.out or said.err))
        for argv in lines:
            ends_well(started(*argv[1:], command=HAPNET))


def reported(text: str, here: dict[str, str]) -> str:
    """The same with this machine's addresses and files."""
    for there, instead in here.items():
        text = text.replace(there, instead)
    return text


def ends_well(program: Program) -> None:
    with program:
        code, out, err = program.end()
        assert code == 0, out + err
