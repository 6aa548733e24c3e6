"""Ctrl-C in a program of one's own that has a side in it."""

import os
import signal
import sys
from pathlib import Path

import pytest

from hapnet import read_recording
from hapnet.transport.config import local_address
from tests.conftest import mostly_slow
from tests.support.cancelling import Noting
from tests.support.processes import Program

PROGRAM = """
import asyncio, sys
from hapnet import connect_device, connect_world
from tests.realtime.test_connect_cancel import SETTINGS

async def main(address, file, realtime):
    async with connect_world(SETTINGS, listen=address):
        device = connect_device(
            SETTINGS, device="tests.support.cancelling:Noting", connect=address, record=file, realtime=realtime
        )
        async with device as side:
            try:
                async for sample in side.samples():
                    if sample.force_N[0] < -0.1:
                        print("felt", flush=True)
            finally:
                print("leaving", flush=True)

asyncio.run(main(sys.argv[1], sys.argv[2], sys.argv[3] == "True"))
"""


@pytest.mark.parametrize("realtime", mostly_slow([True, False], 1))
@pytest.mark.parametrize("times", mostly_slow([1, 2], 1))
def test_ctrl_c_ends_the_program_and_leaves_all_in_order(tmp_path: Path, realtime: bool, times: int) -> None:
    """Pressed again it ends sooner, in the same order: no force, a whole recording, no process."""
    file, force = tmp_path / "run.mcap", tmp_path / "force"
    words = ("-c", PROGRAM, local_address(str(tmp_path)), file, realtime)
    with Program(*words, command=(sys.executable,), env={Noting.FILE: str(force)}) as program:
        for said in ("felt", "leaving")[:times]:
            program.until_line(said)
            os.killpg(program.process.pid, signal.SIGINT)
        code, _, err = program.end()
        program.until_gone()
    assert code == -signal.SIGINT
    assert err.splitlines()[-1] == "KeyboardInterrupt"
    assert float(force.read_text("ascii")) == 0.0
    recording = read_recording(file)
    assert not recording.torn
    assert recording.summary is not None
